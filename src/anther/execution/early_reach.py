"""Early reach: the arm goes before the best grasp while the shake is still being chosen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from threading import Event

from anther.devices import ArmRecord, ArmSample, DeviceError, Robot, SafetyLimits
from anther.errors import StageFailure
from anther.execution import APPROACH_SPEED, TrajectoryPlanner
from anther.grasp import STAND_OFF, Grasp
from anther.safety import guard

Arrive = Callable[[], ArmRecord]
"""Waits for the arm and returns what it did; raises what went wrong on the way."""


@contextmanager
def early_reach(
    planner: TrajectoryPlanner, grasp: Grasp, robot: Robot, limits: SafetyLimits
) -> Iterator[Arrive | None]:
    """Open the gripper and go before a grasp while the block computes; it is given a function that waits for the arm.

    The motion is planned before the block begins, because a planner serves one caller at a time; where there is none,
    nothing moves and the block gets None. When the block ends early, Ctrl-C included, the arm stops where it is.

    Args:
        planner: of motions that start where the arm is.
        grasp: the one most likely to be taken.
        robot: the machines; nobody else may command them before the arm was waited for.
        limits: every command is checked against them.
    """
    safe, called_off = guard(robot, limits), Event()

    def watch(_: ArmSample) -> None:
        if called_off.is_set():
            raise DeviceError("the motion to the grasp was called off.")

    try:
        if grasp.joints is None:
            raise StageFailure("unreachable", "the grasp has no arm joints.")
        outward = planner.line(grasp.joints, grasp.pregrasp(STAND_OFF), APPROACH_SPEED)
        motion = planner.move(safe.arm.joints(), outward.positions[-1])
    except (StageFailure, DeviceError):  # the trial meets it again, and says so
        yield None
        return

    def go() -> ArmRecord:
        safe.gripper.move(grasp.opening)
        return safe.arm.follow(motion, watch)

    with ThreadPoolExecutor(1) as thread:
        going = thread.submit(go)

        def arrive() -> ArmRecord:
            try:
                return going.result()
            except BaseException:
                called_off.set()
                _until_done(going)
                raise

        try:
            yield arrive
        finally:
            called_off.set()
            _until_done(going)


def _until_done(going: Future[ArmRecord]) -> None:
    """Wait for an arm that was called off, through any further Ctrl-C: nobody else may command it before it stands."""
    while not going.done():
        with suppress(KeyboardInterrupt):
            wait([going])
