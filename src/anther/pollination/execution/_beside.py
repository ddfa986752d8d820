"""What goes on beside a moving arm: what follows a piece of a shake is decided, or the shake itself still chosen.

What execution asks for that stands here too: who watches.
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
from anther.robot.devices import ArmRecord, ArmSample, DeviceError, Frame, Robot, SafetyLimits
from anther.robot.safety import guard
from anther.robot.swing import Swing

APPROACH_SPEED = 0.12
"""Of the flange on the straight way in and out [m/s]."""
PATIENCE = 0.12
"""How long a decision is waited for [s]; of the `LEAD` that a machine gives, the rest is for checking what follows."""
LONGER = 0.5  # s: a piece goes on so much longer while what follows it is not decided


class Line(NamedTuple):
    """A line along which a watched shake may move the pads.

    Attributes:
        direction: (3,) unit, world.
        tones: (K,) which tones of its pieces move along it.
        reach: the pads never move further [m].
    """

    direction: Array
    tones: NDArray[np.bool_]
    reach: float


class Watched(Protocol):
    """A shake that is decided while it lasts, by what the side camera sees.

    Attributes:
        lines: along which its pieces move the pads.
        steps: what was done so far.
    """

    @property
    def lines(self) -> Sequence[Line]: ...
    @property
    def steps(self) -> tuple[Step, ...]: ...

    def frame_rate(self, rates: Sequence[float]) -> float:
        """Return at which of the camera's rates [1/s] it wants frames."""
        ...

    def begin(self, frame: Frame) -> Swing:
        """Return the first piece; `frame` shows the held plant at rest."""
        ...

    def since(self, piece: Swing) -> float:
        """Return from when on the frames of the piece under way are wanted [s], counted from the shake's begin."""
        ...

    def go_on(self, piece: Swing, frames: Sequence[Frame], samples: Sequence[ArmSample]) -> Swing:
        """Return the next piece (`piece.then`), after frames since `since` and all readings of the arm.

        The last one ends at rest. Called in another thread; until it returns, the piece goes on as it is.
        """
        ...


class Deciding:
    """Decisions in a thread of their own.

    Args:
        felt: the arm's readings so far; it grows while the arm moves. Waiting is timed by it, so that a simulated arm,
            whose time stands still meanwhile, waits for every decision.
    """

    def __init__(self, felt: Sequence[ArmSample]) -> None:
        self._felt, self._pool = felt, ThreadPoolExecutor(1)
        self._coming: Future[Swing] | None = None

    @property
    def under_way(self) -> bool:
        """Whether what follows the piece that was last asked about is still being decided."""
        return self._coming is not None

    def after(self, piece: Swing, decide: Callable[[], Swing]) -> Swing:
        """Return what follows a piece: what is decided of it or, until that is there, the same for `LONGER`."""
        asked = self._felt[-1].time
        coming = self._coming = self._coming or self._pool.submit(decide)
        while not wait([coming], timeout=0.01).done:
            if self._felt[-1].time - asked > PATIENCE:
                return piece.then(piece.amplitudes, LONGER, LONGER)
        self._coming = None
        return replace(coming.result(), begin=piece.begin + piece.seconds)

    def close(self) -> None:
        """Wait for no decision any more."""
        self._pool.shutdown(wait=False, cancel_futures=True)


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
