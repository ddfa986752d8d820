"""The Robotiq 2F's driver against pymodbus' simulator, over Modbus TCP and with a serial line's frames."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
from fake_robot import LIMITS
from fake_robotiq import FakeRobotiq

from anther.core.errors import InputError
from anther.robot.devices import DeviceError, Gripper
from anther.robot.drivers.robotiq import Robotiq2F, open_line
from anther.robot.safety import GuardedGripper, check_idle


@pytest.fixture(params=["tcp", "serial"])
def machine(request: pytest.FixtureRequest) -> Iterator[FakeRobotiq]:
    with closing(FakeRobotiq(serial=request.param == "serial")) as fake:
        yield fake


@pytest.fixture
def gripper(machine: FakeRobotiq) -> Iterator[Robotiq2F]:
    with closing(Robotiq2F(address(machine))) as driver:
        yield driver


def address(machine: FakeRobotiq) -> Any:
    return open_line(f"{machine.scheme}://127.0.0.1:{machine.port}")


def test_nothing_moves_before_it_is_enabled(gripper: Robotiq2F, machine: FakeRobotiq) -> None:
    with pytest.raises(DeviceError, match="not activated"):
        gripper.move(0.02)
    assert machine.writes == []


def test_it_opens_closes_and_tells_what_it_holds(gripper: Robotiq2F, machine: FakeRobotiq) -> None:
    conforms: Gripper = gripper
    gripper.enable()
    assert gripper.counts == (3, 228)
    assert conforms.stroke == 0.085
    state = conforms.move(0.03)
    assert state.opening == pytest.approx(0.03, abs=3e-4)
    assert (state.force, state.is_gripping) == (0.0, False)
    assert conforms.state() == state
    machine.thick = 205
    held = conforms.move(0.004)
    assert held.is_gripping
    assert held.opening == pytest.approx(0.085 * 23 / 225, abs=1e-4)
    assert held.force == 20.0
    assert not conforms.move(0.085).is_gripping


def test_the_registers_are_the_manuals(machine: FakeRobotiq) -> None:
    """Full speed and force to the end: 09 10 03E8 0003 06 0900 00FF FFFF in Robotiq's own example."""
    with closing(Robotiq2F(address(machine), force=235.0, speed=0.15)) as driver:
        driver.enable()
    assert machine.writes[:3] == [[0, 0, 0xFFFF], [0x0100, 0, 0xFFFF], [0x0900, 0x00FF, 0xFFFF]]


def test_behind_the_guard_it_is_a_gripper(gripper: Robotiq2F, machine: FakeRobotiq) -> None:
    gripper.enable()
    guarded = GuardedGripper(gripper, LIMITS)
    machine.thick = 205
    assert guarded.move(0.006).is_gripping
    assert not guarded.move(0.085).is_gripping
    with pytest.raises(Exception, match="gripper opening"):
        guarded.move(0.09)


@pytest.mark.parametrize(("met", "message"), [(2, "gripper force: got 20.0 N and something held"), (3, "jammed")])
def test_an_object_detection_that_is_stuck_is_noticed(
    gripper: Robotiq2F, machine: FakeRobotiq, met: int, message: str
) -> None:
    gripper.enable()
    machine.thick, machine.met = 205, met
    guarded = GuardedGripper(gripper, LIMITS)

    def close() -> None:
        check_idle(guarded.move(0.04))
        guarded.move(0.004)

    with pytest.raises(DeviceError, match=message):
        close()
    machine.thick = 255
    assert guarded.move(0.085).opening == pytest.approx(0.085, abs=1e-3)


def test_pads_that_are_blocked_are_told(gripper: Robotiq2F, machine: FakeRobotiq) -> None:
    gripper.enable()
    machine.stuck = True
    with (
        closing(Robotiq2F(address(machine), clock=lambda: 10 * time.monotonic())) as hasty,
        pytest.raises(DeviceError, match="its motion does not end"),
    ):
        hasty.move(0.01)


@pytest.mark.parametrize(("fault", "message"), [(0x08, "too hot"), (0x0E, "too much current"), (0x03, "fault 0x03")])
def test_its_faults_are_told_in_words(gripper: Robotiq2F, machine: FakeRobotiq, fault: int, message: str) -> None:
    gripper.enable()
    machine.fault = fault
    with pytest.raises(DeviceError, match=message):
        gripper.move(0.01)


def test_what_is_not_there_or_not_possible_is_refused(machine: FakeRobotiq) -> None:
    with pytest.raises(DeviceError, match=r"nothing answers at tcp://127.0.0.1:1\."):
        open_line("tcp://127.0.0.1:1")
    line = address(machine)
    with pytest.raises(InputError, match="grip force"):
        Robotiq2F(line, force=5.0)
    with pytest.raises(DeviceError, match=r"it refuses|no answer"):
        Robotiq2F(line, device=3)
    line.close()
