"""Computation concurrent with arm motion: decisions during a watched shake, and the early reach to a grasp.

Defines the protocol of a watched shake.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import replace
from threading import Event
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.pollination.execution._trial import Step
from anther.pollination.grasp import STAND_OFF, Grasp
from anther.robot.cell import TrajectoryPlanner
from anther.robot.devices import ArmRecord, ArmSample, DeviceError, Frame, ImuReadings, Robot, SafetyLimits
from anther.robot.safety import guard
from anther.robot.swing import Swing

APPROACH_SPEED = 0.2
"""Of the flange on the straight way in and out [m/s]: a guess. At 0.12 simulated plants are pushed no less."""


class ShakeDirection(NamedTuple):
    """A direction along which a watched shake may move the pads.

    Attributes:
        direction: (3,) unit, world.
        active: (K,) which frequencies of a piece move along it.
        reach: largest displacement of the pads [m].
    """

    direction: Array
    active: NDArray[np.bool_]
    reach: float


class WatchedShake(Protocol):
    """A shake whose pieces are chosen during the motion from the side camera's frames.

    Attributes:
        directions: along which its pieces move the pads.
        steps: executed so far.
    """

    @property
    def directions(self) -> Sequence[ShakeDirection]: ...
    @property
    def steps(self) -> tuple[Step, ...]: ...

    def frame_rate(self, rates: Sequence[float]) -> float:
        """Return the camera rate to use, out of `rates` [1/s]."""
        ...

    def begin(self, frame: Frame) -> Swing:
        """Return the first piece; `frame` shows the held plant at rest."""
        ...

    def steady_from(self, piece: Swing) -> float:
        """Return the time from which the frames of the current piece are needed [s], from the start of the shake."""
        ...

    def next_piece(
        self,
        piece: Swing,
        frames: Sequence[Frame],
        samples: Sequence[ArmSample],
        readings: ImuReadings | None = None,
    ) -> Swing:
        """Return the next piece (`piece.then`), after frames and readings of the hand's inertial sensor since
        `steady_from`, and all readings of the arm.

        The last one ends at rest. Called in another thread; until it returns, the piece goes on as it is.
        """
        ...


class DecisionThread:
    """Runs the decisions of a watched shake in a thread.

    Attributes:
        patience: longest wait for a decision [s]; the rest of a machine's `LEAD` is for checking the next piece.
        extension: of a piece whose successor is not decided yet [s].

    Args:
        samples: the arm's readings so far; grows during the motion. The wait is timed by it, so that a simulated arm,
            whose clock stops meanwhile, waits for every decision.
    """

    patience, extension = 0.12, 0.5

    def __init__(self, samples: Sequence[ArmSample]) -> None:
        self._samples, self._pool = samples, ThreadPoolExecutor(1)
        self._future: Future[Swing] | None = None

    @property
    def pending(self) -> bool:
        """Whether a decision is still running."""
        return self._future is not None

    def wait_for_next(self, piece: Swing, decide: Callable[[], Swing]) -> Swing:
        """Return the decided successor of a piece; without a decision in time, it goes on for `extension`."""
        asked = self._samples[-1].time
        future = self._future = self._future or self._pool.submit(decide)
        while not wait([future], timeout=0.01).done:
            if self._samples[-1].time - asked > self.patience:
                return piece.then(piece.amplitudes, self.extension, self.extension)
        self._future = None
        return replace(future.result(), begin=piece.begin + piece.seconds)

    def close(self) -> None:
        """Abandon any running decision."""
        self._pool.shutdown(wait=False, cancel_futures=True)


Arrive = Callable[[], ArmRecord]
"""Waits for the arm and returns its record; raises the error of the motion."""


@contextmanager
def early_reach(
    planner: TrajectoryPlanner, grasp: Grasp, robot: Robot, limits: SafetyLimits
) -> Iterator[Arrive | None]:
    """Open the gripper and move in front of a grasp while the block computes; yields a function that waits for the arm.

    The motion is planned before the block begins, because a planner serves one caller at a time; without a
    plan nothing moves and the block gets None. When the block ends early, Ctrl-C included, the arm stops where it is.

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
    except (StageFailure, DeviceError):  # the trial meets it again and reports it
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
                _wait_until_done(going)
                raise

        try:
            yield arrive
        finally:
            called_off.set()
            _wait_until_done(going)


def _wait_until_done(going: Future[ArmRecord]) -> None:
    """Wait for an arm that was called off, through any further Ctrl-C: nobody else may command it before it stands."""
    while not going.done():
        with suppress(KeyboardInterrupt):
            wait([going])
