"""Device proxies that record every command and reading; `robot.devices` on both sides."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from anther.robot.devices import (
    ArmRecord,
    ArmSample,
    Frame,
    GripperState,
    JointTrajectory,
    More,
    MoreSwing,
    Proxy,
    Robot,
    Watch,
    wrap,
)
from anther.robot.swing import Swing


class Say(Protocol):
    """How something is kept; see `Log.say`."""

    def __call__(self, what: str, value: Any, when: float | None = None) -> None: ...


def log_machines(robot: Robot, say: Say, look: Callable[[], None]) -> Robot:
    """Return the machines, each of which says what it does.

    Args:
        robot: the machines.
        say: keeps it, and never waits.
        look: called whenever a shake under way was decided on.
    """
    return wrap(
        robot,
        arm=lambda arm: _LoggedArm(arm, say, look),
        gripper=lambda gripper: _LoggedGripper(gripper, say),
        wrist_camera=lambda camera: _LoggedCamera(camera, say, "wrist_camera"),
        side_camera=lambda camera: _LoggedCamera(camera, say, "side_camera"),
        motor=lambda motor: _LoggedMotor(motor, say, look),
    )


@contextmanager
def _log_failure(say: Say) -> Iterator[None]:
    """Say why a machine stopped."""
    try:
        yield
    except BaseException as error:
        say("stopped", f"{error}" or type(error).__name__)
        raise


class _Logged(Proxy):
    """A machine that says what it does."""

    def __init__(self, machine: Any, say: Say, look: Callable[[], None] = lambda: None) -> None:
        super().__init__(machine)
        self._say, self._look = say, look

    def _watching(self, watch: Watch | None) -> Watch:
        """Return a watcher that keeps every reading before the given one sees it."""

        def record(sample: ArmSample) -> None:
            self._say("arm", sample, sample.time)
            if watch is not None:
                watch(sample)

        return record

    def _log_next(self, more: Callable[[], Any] | None, named: str = "") -> Callable[[], Any] | None:
        """Return what asks what comes next, and keeps it under a name."""
        if more is None:
            return None

        def next_piece() -> Any:
            piece = more()
            self._look()
            if named and piece is not None:
                self._say(named, piece)
            return piece

        return next_piece


class _LoggedArm(_Logged):
    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        self._say("motion", trajectory)
        with _log_failure(self._say):
            return self._machine.follow(trajectory, self._watching(watch), self._log_next(more, "motion"))

    def hold(self) -> None:
        self._say("stopped", "the arm is asked to hold")
        self._machine.hold()


class _LoggedMotor(_Logged):
    def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
        with _log_failure(self._say):
            return self._machine.swing(first, self._watching(watch), self._log_next(more))

    def stop(self) -> None:
        self._say("stopped", "the motor is asked to stop")
        self._machine.stop()


class _LoggedGripper(_Logged):
    def move(self, opening: float) -> GripperState:
        with _log_failure(self._say):
            state = self._machine.move(opening)
        self._say("gripper", (opening, state))
        return state

    def state(self) -> GripperState:
        state = self._machine.state()
        self._say("gripper", (None, state))
        return state


class _LoggedCamera(_Logged):
    """At most 15 frames a second are kept."""

    def __init__(self, camera: Any, say: Say, name: str) -> None:
        super().__init__(camera, say)
        self._name, self._apart, self._kept = name, 1 / 15 - 1e-3, float("-inf")

    def read(self) -> Frame:
        return self._keep([self._machine.read()])[0]

    def recorded(self, since: float) -> list[Frame]:
        return self._keep(self._machine.recorded(since))

    def stop(self) -> list[Frame]:
        return self._keep(self._machine.stop())

    def _keep(self, frames: list[Frame]) -> list[Frame]:
        for frame in frames:
            if frame.time >= self._kept + self._apart:
                self._kept = frame.time
                self._say(self._name, frame, frame.time)
        return frames
