"""Rethink's gripper through the robot's I/O topics."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from fake_rethink_gripper import FakeRethinkGripper
from fake_robot import LIMITS
from fake_ros_master import FakeMaster

from anther.robot.devices import DeviceError, Gripper
from anther.robot.drivers.intera import IoDevice, RethinkGripper, types
from anther.robot.drivers.ros1 import Node
from anther.robot.safety import GuardedGripper


@pytest.fixture
def master() -> Iterator[str]:
    small = FakeMaster()
    yield small.uri
    small.stop()


@pytest.fixture
def node(master: str) -> Iterator[Node]:
    with closing(Node(master, "/anther", types())) as made:
        yield made


@pytest.fixture
def machine(master: str) -> Iterator[FakeRethinkGripper]:
    with closing(FakeRethinkGripper(master)) as fake:
        yield fake


def test_it_opens_closes_and_tells_what_it_holds(node: Node, machine: FakeRethinkGripper) -> None:
    gripper = RethinkGripper(node)
    conforms: Gripper = gripper
    with pytest.raises(DeviceError, match="not calibrated"):
        gripper.move(0.03)
    gripper.enable()
    assert machine.values["speed_mps"] == 0.15
    state = conforms.move(0.03)
    assert state.opening == pytest.approx(0.03, abs=1e-4)
    assert (state.force, state.is_gripping) == (0.0, False)
    machine.width = 0.008
    held = conforms.move(0.005)
    assert held.opening == pytest.approx(0.008, abs=1e-4)
    assert (held.force, held.is_gripping) == (9.0, True)
    assert not conforms.move(0.04).is_gripping


def test_what_is_wrong_with_it_is_told(node: Node, machine: FakeRethinkGripper) -> None:
    gripper = RethinkGripper(node)
    gripper.enable()
    machine.values["has_error"] = True
    time.sleep(0.3)
    with pytest.raises(DeviceError, match="reports an error"):
        gripper.state()
    gripper.enable()
    machine.deaf = True
    with pytest.raises(DeviceError, match="does not acknowledge position_m"):
        gripper.move(0.01)


def test_a_signal_that_is_missing_is_not_0(node: Node, machine: FakeRethinkGripper) -> None:
    gripper = RethinkGripper(node)
    gripper.enable()
    for nothing in (None, "none", True):
        machine.force_told = False
        machine.values["force_response_n"] = nothing
        time.sleep(0.2)
        assert np.isnan(gripper.state().force)
        with pytest.raises(DeviceError, match="missing signal"):
            GuardedGripper(gripper, LIMITS).state()
    machine.force_told, machine.grip_told = True, False
    machine.values["is_gripping"] = None
    time.sleep(0.2)
    with pytest.raises(DeviceError, match="does not tell is_gripping"):
        gripper.state()


def test_a_device_that_is_not_there_is_told(node: Node) -> None:
    with pytest.raises(DeviceError, match="not heard"):
        RethinkGripper(node)
    with pytest.raises(DeviceError, match="no signal 'left'; it has none"):
        IoDevice(node, "robot/nothing").set("left", True)
