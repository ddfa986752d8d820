"""Execution: reach, grasp, shake and let go, each command within the safety limits, with a record whatever happens."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from anther.core.errors import AntherError, FailureKind, InputError, StageFailure
from anther.core.oscillation import choose_rate
from anther.pollination.execution._closing import close, lost_grip
from anther.pollination.execution._concurrent import (
    APPROACH_SPEED,
    Arrive,
    DecisionThread,
    ShakeDirection,
    WatchedShake,
    early_reach,
)
from anther.pollination.execution._trial import EARLY, PHASES, Step, Trial
from anther.pollination.grasp import STAND_OFF, Grasp
from anther.robot.cell import TrajectoryPlanner
from anther.robot.devices import (
    ArmRecord,
    ArmSample,
    DeviceError,
    Frame,
    GripperState,
    Imu,
    ImuReadings,
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
    "APPROACH_SPEED",
    "EARLY",
    "PHASES",
    "Arrive",
    "Progress",
    "ShakeDirection",
    "Step",
    "Trial",
    "WatchedShake",
    "early_reach",
    "execute",
    "lost_grip",
]  # fmt: skip

Progress = Callable[[int, int, str], None]  # called with (phases done, phases in all, the phase that begins)
_KINDS: dict[type, FailureKind] = {InputError: "limits_exceeded", KeyboardInterrupt: "interrupted"}


def execute(
    planner: TrajectoryPlanner,
    shake: ShakePlan,
    robot: Robot,
    limits: SafetyLimits,
    *,
    progress: Progress | None = None,
    arrive: Arrive | None = None,
    watched: WatchedShake | None = None,
) -> Trial:
    """Open, reach, approach, close, shake, let go and retreat.

    Whatever goes wrong, Ctrl-C included, the arm holds, the gripper opens, the arm retreats along the approach where it
    still can, and the returned trial says how far it came and why it stopped (`finished`, `failure`, `stop_reason`).
    Nothing is raised, so that no record is lost. A side camera that fails stops nothing: the trial is a "device_fault".
    It may start with the gripper closed on a plant: it opens first, and the planner draws the arm back.

    Args:
        planner: of motions that start where the arm is.
        shake: the plan; `shake.grasp` must hold arm joints.
        robot: the machines.
        limits: every command is checked against them.
        progress: called before each phase.
        arrive: waits for an earlier motion of the arm (`early_reach`), as the phase "early reach".
        watched: chooses the shake's pieces during the motion, at the grasp of `shake`; None, or without a side camera:
            the shake is executed as planned.
    """
    watched = None if robot.side_camera is None else watched
    work = _Work(planner, shake, guard(robot, limits), limits, progress, watched)
    try:
        if arrive is not None:
            with work.phase(EARLY):
                work.note(arrive())
        if work.robot.motor is None:
            check_shake(shake.amplitude, shake.frequency, shake.duration, limits)
        _execute_phases(work)
        _release(work)
    except (Exception, KeyboardInterrupt) as error:
        work.fail(error)
        _recover(work)
    return work.trial()


@dataclass(slots=True, eq=False)
class _Work:
    """A trial under way."""

    planner: TrajectoryPlanner
    plan: ShakePlan
    robot: Robot
    limits: SafetyLimits
    progress: Progress | None
    watched: WatchedShake | None = None
    marks: list[tuple[str, float, float]] = field(default_factory=list)
    grips: list[GripperState] = field(default_factory=list)
    shaken: ArmRecord = field(default_factory=lambda: ArmRecord.of([]))
    samples: list[ArmSample] = field(default_factory=list)
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
        """Record an error; the first one names the failure."""
        reason = str(error) if isinstance(error, AntherError) else f"{type(error).__name__}: {error}"
        if self.stop_reason != "finished":
            self.stop_reason += f"; then: {reason}"
            return
        kind = error.kind if isinstance(error, StageFailure) else _KINDS.get(type(error), "device_fault")
        self.stop_reason, self.failure = reason, kind

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow a trajectory and record its times."""
        return self.note(self.robot.arm.follow(trajectory, watch, more))

    def note(self, record: ArmRecord) -> ArmRecord:
        """Record and return a motion; the time since the last motion belongs to the previous phase.

        What was before the first motion is none of the trial's time.
        """
        begin = float(record.times[0])
        if not self.clock:
            self.marks = [(name, begin, begin) for name, _, _ in self.marks]
        elif len(self.marks) > 1:
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
            np.array([(s.time, s.force) for s in self.samples], dtype=float).reshape(-1, 2),
            self.watched.steps if self.watched else (),
        )


def _execute_phases(work: _Work) -> None:
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
        there = 1e-3  # rad, from which the reach is skipped (simulated servos: 4e-6)
        if np.abs(arm.joints() - outward.positions[-1]).max() > there:
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
        first = _first_piece(work, work.watched)
        if work.watched is None or first is None:
            _shake(work, lambda: work.follow(shake, work.samples.append))
        else:
            _shake_watched(work, work.watched, first)
        work.grips.append(work.robot.gripper.state())


def _first_piece(work: _Work, watched: WatchedShake | None) -> Swing | None:
    """Return the first piece of a watched shake; None if it is not watched or the camera fails: shake as planned."""
    if watched is None or work.robot.side_camera is None:
        return None
    try:
        return watched.begin(work.robot.side_camera.read())
    except DeviceError as error:
        if work.robot.motor is not None:  # no plan is made for what it does unwatched
            raise
        work.fail(error)
        return None


def _shake_watched(work: _Work, watched: WatchedShake, first: Swing) -> None:
    """Shake in pieces without a stop, each chosen from the observation of the one before."""
    camera, motor, imu = work.robot.side_camera, work.robot.motor, work.robot.imu
    assert camera is not None
    rest, done, deciding = work.robot.arm.joints(), [first], DecisionThread(work.samples)

    def joints(piece: Swing) -> JointTrajectory:
        moved = [(line, piece.only(line.active)) for line in watched.directions]
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
        piece, frames, readings = done[-1], list[Frame](), None
        if piece.stops:
            return None
        if not deciding.pending:
            since = work.samples[0].time + watched.steady_from(piece)
            try:
                frames = camera.recorded(since)
            except DeviceError as error:
                work.fail(error)
            readings = _recorded(imu, since)
        seen = (piece, frames, tuple(work.samples), readings)
        done.append(deciding.wait_for_next(piece, partial(watched.next_piece, *seen)))
        return done[-1]

    def onward() -> JointTrajectory | None:
        piece = more()
        return None if piece is None else joints(piece)

    try:
        with _record_hand(imu):
            if motor is None:
                _shake(work, lambda: work.follow(joints(first), work.samples.append, onward))
            else:
                _shake(work, lambda: work.note(motor.swing(first, work.samples.append, more)))
    finally:
        deciding.close()


def _recorded(imu: Imu | None, since: float) -> ImuReadings | None:
    """Return what an inertial sensor read; of one that fails nothing, and the shake goes on. None: there is none."""
    try:
        return None if imu is None else imu.recorded(since)
    except AntherError:  # of numbers that are none, too
        return ImuReadings.none()


@contextmanager
def _record_hand(imu: Imu | None) -> Iterator[None]:
    """Record with the hand's inertial sensor, if any; without it the shake is as it would be."""
    if imu is None:
        yield
        return
    with suppress(DeviceError):
        imu.start()
    try:
        yield
    finally:
        with suppress(DeviceError):
            imu.stop()


def _shake(work: _Work, move: Callable[[], ArmRecord]) -> None:
    with _record_frames(work):
        try:
            work.shaken = move()
        except BaseException:
            work.shaken = ArmRecord.of(work.samples)
            raise


@contextmanager
def _record_frames(work: _Work) -> Iterator[None]:
    """Record with the side camera, if any; a camera error is recorded and stops nothing."""
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
                camera.read()  # reveals a failure after the last recorded frame
        except DeviceError as error:
            work.fail(error)


def _release(work: _Work) -> None:
    with work.phase("release"):
        work.grips.append(work.robot.gripper.move(work.plan.grasp.opening))
    with work.phase("retreat"):
        back = work.plan.grasp.pregrasp(STAND_OFF)
        work.follow(work.planner.line(work.robot.arm.joints(), back, APPROACH_SPEED))
    work.in_plant = False


def _recover(work: _Work) -> None:
    """Hold, open, and retreat along the approach; the retreat only if the arm held and the pads opened."""

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
        done(lambda: _release(work))


def _wait_after(grasp: Grasp) -> float:
    """Return the wait after closing for touched organs to come to rest [s]; longer with a petiole between the pads."""
    beside = 0.002  # m that a petiole reaches beyond the stem, from which the pads touch it
    free = grasp.squeezed is not None and grasp.squeezed < beside
    settle = 0.6  # s for touched leaves to come to rest
    calm = 2.0  # s for a petiole that the pads touch
    return settle if free else calm
