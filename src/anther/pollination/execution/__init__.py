"""Execution: reach, grasp, shake and let go, each command within the safety limits, with a record whatever happens."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from anther.core.errors import AntherError, FailureKind, InputError, StageFailure
from anther.core.oscillation import choose_rate
from anther.pollination.execution._beside import (
    APPROACH_SPEED,
    Arrive,
    Deciding,
    Line,
    Watched,
    early_reach,
)
from anther.pollination.execution._closing import close, lost_grip
from anther.pollination.execution._trial import EARLY, PHASES, Step, Trial
from anther.pollination.grasp import STAND_OFF, Grasp
from anther.robot.cell import TrajectoryPlanner
from anther.robot.devices import (
    ArmRecord,
    ArmSample,
    DeviceError,
    Frame,
    GripperState,
    JointTrajectory,
    More,
    Robot,
    SafetyLimits,
    Watch,
)
from anther.robot.safety import check_idle, check_pieces, check_shake, guard
from anther.robot.swing import Swing, whole_shake

if TYPE_CHECKING:
    from anther.pollination.shake import ShakePlan

__all__ = [
    "APPROACH_SPEED", "EARLY", "PHASES", "Arrive", "Line", "Progress", "Step", "Trial", "Watched",
    "early_reach", "execute", "lost_grip",
]  # fmt: skip

Progress = Callable[[int, int, str], None]  # called with (phases done, phases in all, the phase that begins)
THERE = 1e-3  # rad; an arm this near to where the approach begins need not go there (simulated servos: 4e-6)
BESIDE = 0.002
"""The pads meet a petiole beside the stem where it is expected to reach so far beyond it (`Grasp.squeezed`) [m], or
nobody knows."""
SETTLE = 0.6
"""Leaves that the gripper touched calm down for so long before the shake [s]."""
CALM = 2.0
"""A petiole that the pads meet swings for so long [s]."""
_KINDS: dict[type, FailureKind] = {InputError: "limits_exceeded", KeyboardInterrupt: "interrupted"}


def execute(
    planner: TrajectoryPlanner,
    shake: ShakePlan,
    robot: Robot,
    limits: SafetyLimits,
    *,
    progress: Progress | None = None,
    arrive: Arrive | None = None,
    watched: Watched | None = None,
) -> Trial:
    """Open, reach, approach, close, shake, let go and retreat.

    Whatever goes wrong, Ctrl-C included, the arm holds, the gripper opens, the arm retreats along the approach where it
    still can, and the returned trial says what was done and why it stopped (`finished`, `failure`, `stop_reason`).
    Nothing is raised, so that no record is lost. A side camera that fails stops nothing: the trial is a "device_fault".
    It may start with the gripper closed on a plant: it opens first, and the planner draws the arm back.

    Args:
        planner: of motions that start where the arm is.
        shake: the plan; `shake.grasp` must hold arm joints.
        robot: the machines.
        limits: every command is checked against them.
        progress: called before each phase.
        arrive: waits for a motion of the arm that was begun before (`early_reach`), as the phase "early reach".
        watched: decides the shake's pieces on the way, at the grasp of `shake`; None, or
            without a side camera: as planned.
    """
    watched = None if robot.side_camera is None else watched
    work = _Work(planner, shake, guard(robot, limits), limits, progress, watched)
    try:
        if arrive is not None:
            with work.phase(EARLY):
                work.note(arrive())
        if work.robot.motor is None:
            check_shake(shake.amplitude, shake.frequency, shake.duration, limits)
        _forward(work)
        _back(work)
    except (Exception, KeyboardInterrupt) as error:
        work.fail(error)
        _retire(work)
    return work.trial()


@dataclass(slots=True, eq=False)
class _Work:
    """A trial under way."""

    planner: TrajectoryPlanner
    plan: ShakePlan
    robot: Robot
    limits: SafetyLimits
    progress: Progress | None
    watched: Watched | None = None
    marks: list[tuple[str, float, float]] = field(default_factory=list)
    grips: list[GripperState] = field(default_factory=list)
    shaken: ArmRecord = field(default_factory=lambda: ArmRecord.of([]))
    felt: list[ArmSample] = field(default_factory=list)
    frames: tuple[Frame, ...] = ()
    clock: float = 0.0
    in_plant: bool = False
    stop_reason: str = "finished"
    failure: FailureKind | None = None

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        if self.progress:
            self.progress(len(self.marks), len(PHASES), name)
        self.marks.append((name, self.clock, self.clock))
        try:
            yield
        finally:
            self.marks[-1] = (name, self.marks[-1][1], self.clock)

    def fail(self, error: BaseException) -> None:
        """Note what went wrong; of several things the first names the failure."""
        reason = str(error) if isinstance(error, AntherError) else f"{type(error).__name__}: {error}"
        if self.stop_reason != "finished":
            self.stop_reason += f"; then: {reason}"
            return
        kind = error.kind if isinstance(error, StageFailure) else _KINDS.get(type(error), "device_fault")
        self.stop_reason, self.failure = reason, kind

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow, and note when."""
        return self.note(self.robot.arm.follow(trajectory, watch, more))

    def note(self, record: ArmRecord) -> ArmRecord:
        """Note when the arm moved, and return that; what passed since the last motion was the previous phase's."""
        begin = float(record.times[0])
        if len(self.marks) > 1:
            self.marks[-2] = (*self.marks[-2][:2], begin)
        self.marks[-1] = (self.marks[-1][0], begin, begin)
        self.clock = float(record.times[-1])
        return record

    def trial(self) -> Trial:
        grips = np.array([(g.opening, g.force, g.is_gripping) for g in self.grips], dtype=float).reshape(-1, 3)
        return Trial(
            tuple(name for name, _, _ in self.marks),
            np.array([(a, b) for _, a, b in self.marks], dtype=float).reshape(-1, 2),
            self.shaken.times,
            self.shaken.commanded,
            self.shaken.measured,
            grips,
            np.array([f.time for f in self.frames]),
            self.stop_reason,
            self.failure,
            self.frames,
            np.array([(s.time, s.force) for s in self.felt], dtype=float).reshape(-1, 2),
            self.watched.steps if self.watched else (),
        )


def _forward(work: _Work) -> None:
    """From wherever the arm is to the end of the shake."""
    grasp, arm = work.plan.grasp, work.robot.arm
    if grasp.joints is None:
        raise StageFailure("unreachable", "the grasp has no arm joints. Plan it with the arm's reach.")
    with work.phase("open"):  # whatever cannot be done at this grasp is refused before anything moves to it
        p, outward = work.plan, work.planner.line(grasp.joints, grasp.pregrasp(STAND_OFF), APPROACH_SPEED)
        shake = JointTrajectory.standstill(grasp.joints, 1.0)
        if work.robot.motor is None:
            pieces = whole_shake(p.amplitude, p.frequency, p.duration)
            shake = work.planner.swing(grasp.joints, p.direction, pieces, p.amplitude)
        check_idle(work.robot.gripper.move(work.plan.grasp.opening))
    with work.phase("reach"):
        if np.abs(arm.joints() - outward.positions[-1]).max() > THERE:
            work.follow(work.planner.move(arm.joints(), outward.positions[-1]))
    with work.phase("approach"):
        work.in_plant = True
        work.follow(outward.backwards())
    with work.phase("close"):
        closed = close(work.robot.gripper, grasp, work.plan.press)
        work.grips.append(closed)
        work.follow(JointTrajectory.standstill(arm.joints(), _wait_after(grasp)))
        if why := lost_grip(closed, work.robot.gripper.state()):
            raise StageFailure("nothing_grasped", f"{why}. Try the next grasp.")
    with work.phase("shake"):
        first = _first(work, work.watched)
        if work.watched is None or first is None:
            _shake(work, lambda: work.follow(shake, work.felt.append))
        else:
            _watch(work, work.watched, first)
        work.grips.append(work.robot.gripper.state())


def _first(work: _Work, watched: Watched | None) -> Swing | None:
    """Return the first piece of a shake that is watched; None: it is not, or the camera is blind, so do as planned."""
    if watched is None or work.robot.side_camera is None:
        return None
    try:
        return watched.begin(work.robot.side_camera.read())
    except DeviceError as error:
        if work.robot.motor is not None:  # no plan is made for what it does unwatched
            raise
        work.fail(error)
        return None


def _watch(work: _Work, watched: Watched, first: Swing) -> None:
    """Shake in pieces, each decided by what was seen of the one before, without a stop between them."""
    camera, motor = work.robot.side_camera, work.robot.motor
    assert camera is not None
    rest, done, deciding = work.robot.arm.joints(), [first], Deciding(work.felt)

    def joints(piece: Swing) -> JointTrajectory:
        moved = [(line, piece.only(line.tones)) for line in watched.lines]
        check_pieces([(line.direction, own) for line, own in moved], work.limits)
        paths = [
            work.planner.swing(rest, line.direction, [own], line.reach)
            for line, own in moved
            if own.before.any() or own.amplitudes.any()
        ]
        return JointTrajectory(
            paths[0].times,
            rest + sum(path.positions - rest for path in paths),
            np.asarray(sum(path.velocities for path in paths)),
        )

    def more() -> Swing | None:
        piece, frames = done[-1], list[Frame]()
        if piece.stops:
            return None
        if not deciding.under_way:
            try:
                frames = camera.recorded(work.felt[0].time + watched.since(piece))
            except DeviceError as error:
                work.fail(error)
        done.append(deciding.after(piece, partial(watched.go_on, piece, frames, tuple(work.felt))))
        return done[-1]

    def onward() -> JointTrajectory | None:
        piece = more()
        return None if piece is None else joints(piece)

    try:
        if motor is None:
            _shake(work, lambda: work.follow(joints(first), work.felt.append, onward))
        else:
            _shake(work, lambda: work.note(motor.swing(first, work.felt.append, more)))
    finally:
        deciding.close()


def _shake(work: _Work, move: Callable[[], ArmRecord]) -> None:
    with _filmed(work):
        try:
            work.shaken = move()
        except BaseException:
            work.shaken = ArmRecord.of(work.felt)
            raise


@contextmanager
def _filmed(work: _Work) -> Iterator[None]:
    """Record with the side camera, if there is one; what goes wrong with it is noted and stops nothing."""
    camera = work.robot.side_camera
    if camera is None:
        yield
        return
    try:
        watched, rates = work.watched, camera.rates
        camera.start(watched.frame_rate(rates) if watched else choose_rate(work.plan.frequency, rates))
    except DeviceError as error:
        work.fail(error)
    shaken = False
    try:
        yield
        shaken = True
    finally:
        try:
            work.frames = tuple(camera.stop())
            if shaken:
                if not work.frames:
                    raise DeviceError("the side camera returned no frame of the shake.")
                camera.read()  # a camera that failed after the last look would go unnoticed
        except DeviceError as error:
            work.fail(error)


def _back(work: _Work) -> None:
    with work.phase("release"):
        work.grips.append(work.robot.gripper.move(work.plan.grasp.opening))
    with work.phase("retreat"):
        back = work.plan.grasp.pregrasp(STAND_OFF)
        work.follow(work.planner.line(work.robot.arm.joints(), back, APPROACH_SPEED))
    work.in_plant = False


def _retire(work: _Work) -> None:
    """Hold, open, and leave the plant by the way the gripper came: only if the arm held and the pads opened."""

    def done(step: Callable[[], Any]) -> bool:
        try:
            step()
        except (Exception, KeyboardInterrupt) as error:
            work.fail(error)
            return False
        return True

    if work.robot.motor is not None:
        done(work.robot.motor.stop)
    held = done(work.robot.arm.hold)
    opened = done(lambda: work.robot.gripper.move(work.plan.grasp.opening))
    if held and opened and work.in_plant:
        done(lambda: _back(work))


def _wait_after(grasp: Grasp) -> float:
    """Return how long what the gripper touched swings after closing [s]: a petiole between the pads for longer."""
    free = grasp.squeezed is not None and grasp.squeezed < BESIDE
    return SETTLE if free else CALM
