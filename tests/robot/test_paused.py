"""Every driver that streams to an arm, when Python was asleep or a clock jumps: the arm stands, and does not jump.

The arms move all joints forward, behind their own fakes, which stop by themselves when they hear nothing.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import fake_franka
import fake_ur
import numpy as np
import pytest
import test_ros2
import test_sawyer_ros1
from fake_franka import FakeFranka
from fake_ros2 import FakeController, FakeNode
from fake_ros_master import FakeMaster
from fake_sawyer import FakeSawyer
from fake_ur import FakeUR
from slow_clock import AGAIN_IF_HELD_UP, SLOWER, clock, sleep

from anther.core.geometry import Array
from anther.robot.arm import sawyer
from anther.robot.devices import Arm, ArmSample, DeviceError, JointTrajectory, Watch

pytestmark = AGAIN_IF_HELD_UP
PAUSE = 0.3
"""Longer than any time-out of a robot or driver, and the braking after it [s]."""
JUMP = 2e-3
"""An arm further than this from where it goes on within its acceleration has jumped [rad]."""


class Rig(NamedTuple):
    """An arm's driver, its fake, a far motion, and the fake's time; `clock_jumps`: by a second back."""

    arm: Arm
    robot: Any
    path: JointTrajectory
    acceleration: Array
    clock: Callable[[], float]
    sleep: Callable[[float], None]
    clock_jumps: Callable[[], Any]

    def log(self) -> tuple[Array, Array]:
        """Return times (T,) [s] and joints (T, J) [rad] of all that the arm did."""
        times, joints = zip(*list(self.robot.log), strict=True)
        return np.array(times), np.array(joints)

    def under_way(self, do: Callable[[], Any]) -> Watch:
        """Return a watcher that does something each time, once the arm has gone a third of a quarter radian."""
        start = self.path.positions[0]

        def watch(sample: ArmSample) -> None:
            if np.abs(sample.measured - start).max() > 0.08:
                do()

        return watch

    def check(self) -> None:
        """Check that the arm never jumped nor went back, and stands."""
        self.sleep(0.2)
        times, joints = self.log()
        seconds = np.diff(times)[:, None]
        rate = np.diff(joints, axis=0) / seconds
        beyond = np.abs(np.diff(rate, axis=0)) - self.acceleration * (seconds[1:] + seconds[:-1]) / 2
        assert (beyond * seconds[1:]).max() < JUMP
        assert np.diff(joints, axis=0).min() > -1e-3
        assert np.ptp(joints[-10:], axis=0).max() < 1e-4


def sawyers() -> Iterator[Rig]:
    master = FakeMaster()
    with (
        closing(FakeSawyer(master.uri, clock=clock, sleep=sleep)) as robot,
        closing(test_sawyer_ros1.connected(master.uri, mode="trajectory")) as arm,
    ):
        path = test_sawyer_ros1.far(arm)
        yield Rig(arm, robot, path, sawyer.ACCELERATION, clock, sleep, lambda: behind(robot))
    master.stop()


def ros2s() -> Iterator[Rig]:
    node, model = FakeNode(), test_ros2.MODEL
    with closing(FakeController(model.joints, test_ros2.READY, node.tell, clock=clock, sleep=sleep)) as robot:
        node.deliver = robot.hear
        with closing(test_ros2.connected(node)) as arm:
            yield Rig(arm, robot, test_ros2.far(arm, 0.3), model.acceleration, clock, sleep, lambda: behind(robot))


def urs() -> Iterator[Rig]:
    with closing(FakeUR(clock=clock, sleep=sleep)) as robot, closing(fake_ur.connected(robot)) as arm:
        yield Rig(arm, robot, fake_ur.far(arm), fake_ur.MODEL.acceleration, clock, sleep, lambda: behind(robot))


def frankas() -> Iterator[Rig]:
    with closing(FakeFranka()) as robot, closing(fake_franka.connected(robot)) as arm:
        most, late = np.full(7, fake_franka.ACCELERATION), lambda: setattr(robot, "lag", 1.0)
        yield Rig(arm, robot, fake_franka.far(arm), most, robot.clock, robot.sleep, late)


def behind(robot: Any) -> None:
    robot.ahead = -1.0


@pytest.fixture(params=[sawyers, ros2s, urs, frankas], ids=["sawyer", "ros2", "ur", "franka"])
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    yield from request.param()


def test_after_a_pause_beyond_every_time_out_the_arm_stands_where_it_is(rig: Rig) -> None:
    woke = list[float]()

    def pause() -> None:
        if not woke:
            rig.sleep(PAUSE)
            woke.append(rig.clock())

    with pytest.raises(DeviceError):
        rig.arm.follow(rig.path, rig.under_way(pause))
    rig.check()
    times, joints = rig.log()
    assert np.ptp(joints[times >= woke[0]], axis=0).max() < 1e-3
    assert joints[-1].max() < rig.path.positions[-1].max()


@pytest.mark.flaky(reruns=3)  # a machine that is busy in that moment delays the very command that brakes
def test_after_a_short_delay_the_arm_is_braked_without_a_jump(rig: Rig) -> None:
    def fail() -> None:
        rig.sleep(0.02)
        raise DeviceError("enough")

    with pytest.raises(DeviceError, match="enough"):
        rig.arm.follow(rig.path, rig.under_way(fail))
    rig.check()


def test_where_the_robots_clock_jumps_the_arm_is_braked_without_a_jump(rig: Rig) -> None:
    with pytest.raises(DeviceError, match="ms old"):
        rig.arm.follow(rig.path, rig.under_way(rig.clock_jumps))
    rig.check()


def test_a_process_that_was_stopped_sends_an_arm_that_stands_nowhere() -> None:
    """SIGSTOP in full motion, and SIGCONT when the robot has stopped by itself."""
    master = FakeMaster()
    program = test_sawyer_ros1.MOVES.format(here=str(Path(__file__).parents[1] / "support"))
    with (
        closing(FakeSawyer(master.uri, clock=clock, sleep=sleep)) as robot,
        subprocess.Popen([sys.executable, "-c", program, master.uri], stdout=-1, stderr=-1, text=True) as driver,
    ):
        assert driver.stdout is not None
        assert driver.stderr is not None
        assert driver.stdout.readline() == "ready\n"
        while np.abs(robot.v).max() < 0.4:
            time.sleep(0.01)
        os.kill(driver.pid, signal.SIGSTOP)
        time.sleep(SLOWER * PAUSE)
        before, stood = len(robot.commands), robot.q.copy()
        os.kill(driver.pid, signal.SIGCONT)
        said = driver.stderr.read()
    assert "DeviceError" in said or "Late" in said
    assert np.abs(robot.q - stood).max() < 1e-3
    for _, _, joints, rate in robot.commands[before:]:
        assert joints == pytest.approx(stood, abs=1e-3)
        assert not rate.any()
    master.stop()
