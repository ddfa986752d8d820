"""Every driver of an arm, gripper or camera, behind a fake of its machine, passes the kit of `anther.robot.testing`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import fake_franka
import fake_ur
import numpy as np
import pytest
import test_ros2
import test_sawyer_ros1
from fake_franka import FakeFranka
from fake_rethink_gripper import FakeRethinkGripper
from fake_robot import FakeArm, FakeGripper
from fake_robotiq import FakeRobotiq
from fake_ros2 import FakeController, FakeNode
from fake_ros_master import FakeMaster
from fake_sawyer import FakeSawyer
from fake_ur import FakeUR
from live_cameras import FakeWebcam, webcam
from slow_clock import AGAIN_IF_HELD_UP, clock, sleep

from anther.core.geometry import Array
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import GripperState
from anther.robot.drivers.intera import RethinkGripper, types
from anther.robot.drivers.robotiq import Robotiq2F, open_line
from anther.robot.drivers.ros1 import Node
from anther.robot.testing import (
    ARM_CHECKS,
    ARM_FAULT_CHECKS,
    CAMERA_CHECKS,
    GRIPPER_CHECKS,
    ArmRig,
    CameraRig,
    GripperRig,
    check_delayed_stop,
    check_impossible_opening,
    check_missing_grip_force,
    check_motion,
    check_refusal,
    check_stale_readings,
)

pytestmark = AGAIN_IF_HELD_UP
named = lambda check: check.__name__  # noqa: E731


def history(robot: Any) -> Callable[[], tuple[Array, Array]]:
    def read() -> tuple[Array, Array]:
        times, joints = zip(*list(robot.log), strict=True)
        return np.array(times), np.array(joints)

    return read


def setting(robot: Any, name: str, value: Any) -> Callable[[], None]:
    return lambda: setattr(robot, name, value)


def rig_of(robot: Any, connect: Callable[[], Any], acceleration: Array, **options: Any) -> ArmRig:
    """Return the rig of a fake whose faults are attributes of the same names."""
    faults = {
        "silence": setting(robot, "mute", True),
        "not a number": setting(robot, "offset", np.full(len(acceleration), np.nan)),
        "clock jump": setting(robot, "ahead", -1.0),
    }
    given: dict[str, Any] = {"clock": clock, "sleep": sleep, "commands": lambda: len(robot.heard)}
    given |= {"history": history(robot)} | options
    return ArmRig(connect, acceleration=acceleration, **given | {"faults": faults | options.get("faults", {})})


def sawyers() -> Iterator[ArmRig]:
    master = FakeMaster()
    with closing(FakeSawyer(master.uri, clock=clock, sleep=sleep)) as robot:
        connect = lambda: test_sawyer_ros1.connected(master.uri, mode="trajectory")  # noqa: E731
        faults = {"force lost": setting(robot, "numb", True), "stop": setting(robot, "pressed", True)}
        yield rig_of(robot, connect, SAWYER.acceleration, faults=faults)
    master.stop()


def ros2s() -> Iterator[ArmRig]:
    node, model = FakeNode(), test_ros2.MODEL
    with closing(FakeController(model.joints, test_ros2.READY, node.tell, clock=clock, sleep=sleep)) as robot:
        node.deliver = robot.hear
        yield rig_of(robot, lambda: test_ros2.connected(node), model.acceleration)


def urs() -> Iterator[ArmRig]:
    with closing(FakeUR(clock=clock, sleep=sleep)) as robot:
        faults = {"stop": setting(robot, "pressed", True)}
        yield rig_of(robot, lambda: fake_ur.connected(robot), fake_ur.model().acceleration, notice=0.25, faults=faults)


def frankas() -> Iterator[ArmRig]:
    with closing(FakeFranka()) as robot:
        late = setting(robot, "lag", 1.0)
        stop = lambda: robot.reflex("", fake_franka.RobotMode.UserStopped)  # noqa: E731
        yield rig_of(
            robot,
            lambda: fake_franka.connected(robot),
            np.full(7, fake_franka.ACCELERATION),
            clock=robot.clock,
            sleep=robot.sleep,
            commands=lambda: len(robot.calls),
            faults={"silence": setting(robot, "lag", 0.2), "clock jump": late, "stop": stop},
        )


@pytest.fixture(params=[sawyers, ros2s, urs, frankas], ids=["sawyer", "ros2", "ur", "franka"])
def arm_rig(request: pytest.FixtureRequest) -> Iterator[ArmRig]:
    yield from request.param()


BUSY = pytest.mark.flaky(reruns=3)
"""A machine that is busy in that moment delays the very command that brakes."""
ARM = [
    pytest.param(check, marks=BUSY if check is check_delayed_stop else [], id=check.__name__)
    for check in (*ARM_CHECKS, *ARM_FAULT_CHECKS)
]


@pytest.mark.parametrize("check", ARM)
def test_arm(check: Callable[[ArmRig], None], arm_rig: ArmRig) -> None:
    check(arm_rig)


def robotiqs() -> Iterator[GripperRig]:
    with closing(FakeRobotiq()) as machine:

        def connect() -> Robotiq2F:
            driver = Robotiq2F(open_line(f"{machine.scheme}://127.0.0.1:{machine.port}"))
            driver.enable()
            return driver

        insert = lambda width: setattr(machine, "thick", round(228 - 225 * width / 0.085))  # noqa: E731
        yield GripperRig(connect, insert, setting(machine, "mute", True))


def rethinks() -> Iterator[GripperRig]:
    master = FakeMaster()
    with closing(FakeRethinkGripper(master.uri)) as machine:

        def connect() -> RethinkGripper:
            driver = RethinkGripper(Node(master.uri, "/anther", types()))
            driver.enable()
            return driver

        def lose_force() -> None:
            machine.force_told = False
            machine.values["force_response_n"] = None
            time.sleep(0.2)

        yield GripperRig(connect, lambda w: setattr(machine, "width", w), setting(machine, "deaf", True), lose_force)
    master.stop()


@pytest.fixture(params=[robotiqs, rethinks], ids=["robotiq", "rethink"])
def gripper_rig(request: pytest.FixtureRequest) -> Iterator[GripperRig]:
    yield from request.param()


@pytest.mark.parametrize("check", GRIPPER_CHECKS, ids=named)
def test_gripper(check: Callable[[GripperRig], None], gripper_rig: GripperRig) -> None:
    check(gripper_rig)


@pytest.mark.parametrize("check", CAMERA_CHECKS, ids=named)
def test_camera(check: Callable[[CameraRig], None]) -> None:
    fake = FakeWebcam()

    def unplug() -> None:
        fake.there = False
        time.sleep(0.3)

    check(CameraRig(lambda: webcam(fake), time.sleep, unplug))


class Stale(FakeArm):
    """It goes on telling the last joints, whatever the machine says."""


class Dishonest(FakeArm):
    """It says that it has gone where it has not."""

    def joints(self) -> Array:
        return np.array(SAWYER.neutral)


class Generous(FakeGripper):
    """It moves wherever it is sent, and makes 0 of a force that is missing."""

    def state(self) -> GripperState:
        return GripperState(self.opening, 0.0, False)


def unfaulted(arm: type, fault: str) -> ArmRig:
    """Return the rig of an arm on which a fault has no effect."""
    return ArmRig(arm, time.time, lambda s: None, SAWYER.acceleration, commands=lambda: 0, faults={fault: lambda: None})


@pytest.mark.parametrize(
    ("check", "rig", "message"),
    [
        (check_motion, ArmRig(Dishonest, time.time, lambda s: None, SAWYER.acceleration), "joints at the end"),
        (
            check_stale_readings,
            unfaulted(Stale, "silence"),
            "got no error; allowed: DeviceError",
        ),
        (
            check_refusal,
            unfaulted(FakeArm, "stop"),
            "follow, where the machine stops: got no error; allowed: DeviceError",
        ),
        (check_impossible_opening, GripperRig(Generous), "got no error"),
        (check_missing_grip_force, GripperRig(Generous, lose_force=lambda: None), "allowed: NaN"),
    ],
    ids=["dishonest", "stale", "unstoppable", "generous", "no force"],
)
def test_a_driver_that_breaks_a_promise_is_caught(check: Callable[[Any], None], rig: Any, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check(rig)
