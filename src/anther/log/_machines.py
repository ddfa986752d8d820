"""The devices of a robot, which tell a log what they are asked and what they read: `anther.devices` on both sides."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Protocol

from anther.devices import (
    Arm,
    ArmRecord,
    ArmSample,
    Camera,
    Frame,
    Gripper,
    GripperState,
    JointTrajectory,
    More,
    MoreSwing,
    Motor,
    Robot,
    Watch,
)
from anther.geometry import Array, Intrinsics
from anther.swing import Swing

RATE = 15.0
"""So many frames of a camera are kept a second."""


class Say(Protocol):
    """How something is kept; see `Log.say`."""

    def __call__(self, what: str, value: Any, when: float | None = None) -> None: ...


def heard(robot: Robot, say: Say, look: Callable[[], None]) -> Robot:
    """Return the machines, each of which says what it does.

    Args:
        robot: the machines.
        say: keeps it, and never waits.
        look: called whenever a shake under way was decided on.
    """
    side, motor = robot.side_camera, robot.motor
    return replace(
        robot,
        arm=HeardArm(robot.arm, say, look),
        gripper=HeardGripper(robot.gripper, say),
        wrist_camera=HeardCamera(robot.wrist_camera, say, "wrist_camera"),
        side_camera=None if side is None else HeardCamera(side, say, "side_camera"),
        motor=None if motor is None else HeardMotor(motor, say, look),
    )


@contextmanager
def _told(say: Say) -> Iterator[None]:
    """Say why a machine stopped."""
    try:
        yield
    except BaseException as error:
        say("stopped", f"{error}" or type(error).__name__)
        raise


class HeardArm:
    """An `Arm`."""

    def __init__(self, arm: Arm, say: Say, look: Callable[[], None]) -> None:
        self._arm, self._say, self._look = arm, say, look

    def joints(self) -> Array:
        """See `anther.devices.Arm`."""
        return self._arm.joints()

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """See `anther.devices.Arm`."""

        def onward() -> JointTrajectory | None:
            assert more is not None
            piece = more()
            self._look()
            if piece is not None:
                self._say("motion", piece)
            return piece

        self._say("motion", trajectory)
        with _told(self._say):
            return self._arm.follow(trajectory, watching(self._say, watch), None if more is None else onward)

    def hold(self) -> None:
        """See `anther.devices.Arm`."""
        self._say("stopped", "the arm is asked to hold")
        self._arm.hold()


class HeardMotor:
    """A `Motor`."""

    def __init__(self, motor: Motor, say: Say, look: Callable[[], None]) -> None:
        self._motor, self._say, self._look = motor, say, look

    def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
        """See `anther.devices.Motor`."""

        def onward() -> Swing | None:
            assert more is not None
            piece = more()
            self._look()
            return piece

        with _told(self._say):
            return self._motor.swing(first, watching(self._say, watch), None if more is None else onward)

    def stop(self) -> None:
        """See `anther.devices.Motor`."""
        self._say("stopped", "the motor is asked to stop")
        self._motor.stop()

    def amplitude(self) -> float:
        """See `anther.devices.Motor`."""
        return self._motor.amplitude()


class HeardGripper:
    """A `Gripper`."""

    def __init__(self, gripper: Gripper, say: Say) -> None:
        self._gripper, self._say = gripper, say

    @property
    def stroke(self) -> float:
        """See `anther.devices.Gripper`."""
        return self._gripper.stroke

    def move(self, opening: float) -> GripperState:
        """See `anther.devices.Gripper`."""
        with _told(self._say):
            state = self._gripper.move(opening)
        self._say("gripper", (opening, state))
        return state

    def state(self) -> GripperState:
        """See `anther.devices.Gripper`."""
        state = self._gripper.state()
        self._say("gripper", (None, state))
        return state


class HeardCamera:
    """A `Camera`, of which at most `RATE` frames a second are kept."""

    def __init__(self, camera: Camera, say: Say, name: str) -> None:
        self._camera, self._say, self._name = camera, say, name
        self._kept = float("-inf")

    @property
    def intrinsics(self) -> Intrinsics:
        """See `anther.devices.Camera`."""
        return self._camera.intrinsics

    @property
    def rates(self) -> tuple[float, ...]:
        """See `anther.devices.Camera`."""
        return self._camera.rates

    def read(self) -> Frame:
        """See `anther.devices.Camera`."""
        frame = self._camera.read()
        self._keep([frame])
        return frame

    def start(self, rate: float) -> None:
        """See `anther.devices.Camera`."""
        self._camera.start(rate)

    def recorded(self, since: float) -> list[Frame]:
        """See `anther.devices.Camera`."""
        return self._keep(self._camera.recorded(since))

    def stop(self) -> list[Frame]:
        """See `anther.devices.Camera`."""
        return self._keep(self._camera.stop())

    def _keep(self, frames: list[Frame]) -> list[Frame]:
        for frame in frames:
            if frame.time >= self._kept + 1 / RATE - 1e-3:
                self._kept = frame.time
                self._say(self._name, frame, frame.time)
        return frames


def watching(say: Say, watch: Watch | None) -> Watch:
    """Return a watcher that keeps every reading before the given one sees it."""

    def seen(sample: ArmSample) -> None:
        say("arm", sample, sample.time)
        if watch is not None:
            watch(sample)

    return seen
