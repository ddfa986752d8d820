"""A motor in the gripper: the simulated one does what it is asked, and the guard lets nothing else pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain as joined

import numpy as np
import pytest
from fake_robot import LIMITS, fake_robot, horizontal_grasp
from small_planner import solve
from straight_plant import BASE, chain, plant_of, straight_plant

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import inverse, transform
from anther.core.oscillation import fit_swing
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import ArmRecord, ArmSample, DeviceError, MoreSwing, SafetyLimits, Watch
from anther.robot.safety import GuardedMotor, guard
from anther.robot.safety._motion import check_swing
from anther.robot.swing import Swing
from anther.sim import arm_model, simulated_cell
from anther.sim._motor import SimMotor
from anther.sim.cell import Cell, Params
from anther.sim.plant import SimPlant
from anther.sim.robot import SimGripper
from anther.sim.truth import NOMINAL, Truth, draw

Q = solve(horizontal_grasp(np.add(BASE, [0, 0, 0.25]), np.zeros(7)).T_world_flange)
FIRST = Swing.first([30.0], [1e-3], 0.6, 0.3)
LAST = FIRST.then([0.0], 0.2, 0.2)


def holding(truth: Truth = NOMINAL, coil: float = arm_model.COIL.force, plant: SimPlant | None = None) -> Cell:
    """Return a cell whose gripper holds the stem of a plant, and in which a motor shakes it."""
    cell = Cell(plant or straight_plant(), Q, Params(coil_force=coil), truth)
    SimGripper(cell).move(0.0)
    return cell


def then(*pieces: Swing | None) -> MoreSwing:
    """Return what gives these pieces one after the other, then None."""
    left: Iterator[Swing | None] = joined(pieces, iter(lambda: None, 0))
    return lambda: next(left)


def swings(cell: Cell, since: float, until: float, frequency: float) -> tuple[float, float, float]:
    """Return how far carriage, flange and held stem swung along the closing axis [m]."""
    log = cell.log()
    rows = (log.times >= since) & (log.times <= until)
    times, qpos, y = log.times[rows], log.qpos[rows], cell.flange_pose()[:3, 1]
    held = int(np.argmin(np.linalg.norm(cell.plant.end[:20] - BASE - [0, 0, 0.25], axis=1)))
    stem = np.array([(cell.segment_poses(q)[held] @ np.r_[cell.plant.end[held], 1])[:3] for q in qpos])
    motor = qpos[:, [cell.model.joint("motor").qposadr[0]]] * y
    paths = motor, cell.flange_pose(qpos)[:, :3, 3], stem
    carried, recoil, moved = (fit_swing(times, np.outer(path @ y, y), frequency).amplitude for path in paths)
    return carried, recoil, moved


def test_pads_that_hold_a_stem_easily_do_not_let_it_drift_away() -> None:
    """The twentieth part of what friction bears pulls; damped softly, MuJoCo's friction lets 1.5 mm a second go by."""
    T = transform(np.array([[-0.032, -0.001, 0.999], [0.031, -1, 0], [0.999, 0.031, 0.032]]), (0.593, 0, 0.087))
    plant = simulated_cell.grow("tomato", 10000, 0.0, simulated_cell.usual_distance(SAWYER), draw(10000))
    cell = Cell(plant, solve(T), Params(coil_force=arm_model.COIL.force))
    SimGripper(cell).move(0.0)
    begin, first = cell.time, Swing.first([38.6], [0.6e-3], 1.0, 0.2)
    SimMotor(cell).swing(first, None, then(first.then([0.0], 0.2, 0.2)))
    log = cell.log()
    held = np.bincount(log.contact_other[(log.contact_pad < 2) & (log.contact_other >= 0)]).argmax()
    end = np.r_[plant.end[held], 1]
    first_q, last_q = log.qpos[np.searchsorted(log.times, begin)], log.qpos[-1]
    places = [inverse(cell.pads_pose(q)) @ cell.segment_poses(q)[held] @ end for q in (first_q, last_q)]
    assert np.linalg.norm(places[1] - places[0]) < 3e-4


@pytest.mark.parametrize(("frequency", "amplitude"), [(10.0, 1.2e-3), (30.0, 1e-3), (50.0, 0.4e-3)])
def test_the_motor_moves_the_held_stem_and_hardly_the_arm(frequency: float, amplitude: float) -> None:
    """The carriage goes as far as it is asked; the arm gives way by a tenth, and the contact by as much again."""
    cell, seen = holding(), list[ArmSample]()
    motor, begin = SimMotor(cell), cell.time
    first = Swing.first([frequency], [amplitude], 0.7, 0.2)
    record = motor.swing(first, seen.append, then(first.then([0.0], 0.2, 0.2)))
    carried, recoil, moved = swings(cell, begin + 0.3, begin + 0.7, frequency)
    assert carried == pytest.approx(amplitude, rel=0.03)
    assert recoil < 0.12 * amplitude
    assert moved == pytest.approx(amplitude, rel=0.2)
    assert np.diff([s.time for s in seen]).max() <= 0.02
    assert np.abs(record.measured - record.commanded).max() < 0.003
    assert len(record.times) == len(record.measured)
    assert abs(cell.carriage_at()) < 2e-5
    assert motor.amplitude() < 1e-4


def test_pieces_join_without_a_jolt_wherever_they_meet() -> None:
    """The seam lies between two steps and in full swing: the carriage's jerk there is no larger than elsewhere."""
    cell = holding()
    first = Swing.first([30.0, 12.0], [0.6e-3, 0.3e-3], 0.5013, 0.2)
    second = first.then([0.9e-3, 0.1e-3], 0.5, 0.4)
    begin = cell.time
    SimMotor(cell).swing(first, None, then(second, second.then([0.0, 0.0], 0.3, 0.3)))
    log = cell.log()
    path = log.qpos[:, cell.model.joint("motor").qposadr[0]]
    times = log.times - begin
    asked = np.concatenate([p.motion(times[(times >= p.begin) & (times < p.begin + p.seconds)] - p.begin)[0]
                            for p in (first, second)])  # fmt: skip
    rows = (times >= 0) & (times < second.begin + second.seconds)
    assert np.abs(path[rows] - asked).max() < 0.06e-3


def test_more_is_asked_for_before_the_end_and_in_time() -> None:
    cell, asked = holding(), list[float]()
    begin, following = cell.time, then(LAST)

    def more() -> Swing | None:
        asked.append(cell.time - begin)
        return following()

    SimMotor(cell).swing(FIRST, None, more)
    assert asked == pytest.approx([0.3, 0.6], abs=0.011)  # the last piece is shorter than LEAD


def test_a_motor_that_is_off_moves_as_it_is_off_and_its_sensor_tells() -> None:
    cell = holding(replace(NOMINAL, motor_gain=0.88))
    motor, seen = SimMotor(cell), list[float]()
    motor.swing(FIRST, lambda _: seen.append(motor.amplitude()), then(LAST))
    assert max(seen) == pytest.approx(0.88e-3, rel=0.03)


@pytest.mark.parametrize(
    ("piece", "message"),
    [
        (Swing.first([5.0], [3e-3], 0.5, 0.2), "motor place: got 0.003 m; it has 0.002"),
        (Swing.first([60.0], [1.5e-3], 0.5, 0.2), "motor force without a stem"),
    ],
)
def test_what_the_motor_cannot_do_it_refuses(piece: Swing, message: str) -> None:
    cell = holding()
    with pytest.raises(DeviceError, match=message):
        SimMotor(cell).swing(piece, None, None)
    assert abs(cell.carriage_at()) < 1e-5


def test_a_coil_too_weak_for_what_it_holds_is_noticed() -> None:
    rod = plant_of(chain(BASE + np.linspace(0, 0.3, 13)[:, None] * [0, 0, 1.0], 0.004, youngs=1e11), damping_ratio=0.3)
    cell = holding(coil=4.0, plant=rod)
    with pytest.raises(DeviceError, match="does not follow"):
        SimMotor(cell).swing(Swing.first([12.0], [1.5e-3], 0.5, 0.1), lambda _: None, None)


@pytest.mark.parametrize("error", [KeyboardInterrupt, DeviceError("the arm is lost")])
def test_whatever_is_raised_on_the_way_stops_the_motor(error: BaseException | type[BaseException]) -> None:
    cell = holding()

    def watch(sample: ArmSample) -> None:
        if sample.time > begin + 0.4:
            raise error

    begin = cell.time
    with pytest.raises((KeyboardInterrupt, DeviceError)):
        SimMotor(cell).swing(FIRST, watch, then(LAST))
    assert cell.time < begin + 0.6
    assert abs(cell.carriage_at()) < 5e-5
    assert cell.timestep == cell.params.timestep


def test_a_cell_without_a_motor_has_none_and_says_so() -> None:
    cell = Cell(straight_plant(), Q)
    assert cell.model.nu == 22
    assert cell.carriage_at() == 0.0
    with pytest.raises(InputError, match="motor"):
        SimMotor(cell)


class FakeMotor:
    """Does what it is told; `readings` are the arm's, `measured` what its sensor says."""

    measured = 0.0

    def __init__(self, readings: Callable[[int], ArmSample] | None = None) -> None:
        self.readings = readings or (lambda k: ArmSample(0.01 * k, np.zeros(7), 1e-5 * k * np.ones(7), 0.0))
        self.pieces: list[Swing] = []
        self.stopped = 0

    def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
        piece: Swing | None = first
        while piece is not None:
            self.pieces.append(piece)
            for k in range(5):
                assert watch
                watch(self.readings(5 * len(self.pieces) + k))
            piece = more() if more else None
        return ArmRecord.of([])

    def stop(self) -> None:
        self.stopped += 1

    def amplitude(self) -> float:
        return self.measured


def test_the_guard_lets_a_sound_swing_pass_as_a_copy() -> None:
    machine = FakeMotor()
    GuardedMotor(machine, LIMITS).swing(FIRST, None, then(LAST))
    assert [p.amplitudes.tolist() for p in machine.pieces] == [[1e-3], [0.0]]
    assert machine.pieces[0] is not FIRST
    assert machine.stopped == 0


BAD_FIRST: dict[str, tuple[Swing, SafetyLimits]] = {
    "swing of the motor": (Swing.first([10.0], [2e-3], 0.5, 0.2), LIMITS),
    "speed of the motor": (FIRST, replace(LIMITS, shake_speed=0.1)),
    "acceleration of the motor": (Swing.first([50.0], [1e-3], 0.5, 0.2), LIMITS),
    "duration of the swing": (Swing.first([30.0], [1e-4], LIMITS.shake_duration + 0.1, 0.2), LIMITS),
    "begin of the swing": (LAST, LIMITS),
}


@pytest.mark.parametrize("message", BAD_FIRST)
def test_each_limit_refuses_before_anything_moves(message: str) -> None:
    machine, (piece, limits) = FakeMotor(), BAD_FIRST[message]
    with pytest.raises(StageFailure, match=message) as caught:
        GuardedMotor(machine, limits).swing(piece, None, then(LAST))
    assert caught.value.kind == "limits_exceeded"
    assert machine.pieces == []
    assert machine.stopped == 1


def test_a_short_ramp_counts_as_acceleration() -> None:
    with pytest.raises(StageFailure, match="acceleration of the motor"):
        check_swing(Swing.first([10.0], [1e-3], 0.5, 2e-3), None, LIMITS)
    check_swing(Swing.first([10.0], [1e-3], 0.5, 0.1), None, LIMITS)


@pytest.mark.parametrize(
    "piece",
    [
        replace(LAST, before=np.array([0.9e-3])),
        replace(LAST, begin=0.7),
        replace(LAST, frequencies=np.array([29.0])),
        Swing(np.array([30.0, 20.0]), np.zeros(2), 0.2, 0.2, np.array([1e-3, 0.0]), 0.6),
    ],
)
def test_a_piece_that_does_not_join_is_refused_and_the_motor_stopped(piece: Swing) -> None:
    machine = FakeMotor()
    with pytest.raises(StageFailure, match="does not join"):
        GuardedMotor(machine, LIMITS).swing(FIRST, None, then(piece))
    assert len(machine.pieces) == machine.stopped == 1


def test_one_tone_of_two_may_not_change_its_frequency() -> None:
    first = Swing.first([20.0, 30.0], [2e-4, 2e-4], 0.6, 0.5)
    check_swing(first.then([2e-4, 2e-4], 0.2, 0.1), first, LIMITS)
    other = replace(first.then([2e-4, 2e-4], 0.2, 0.1), frequencies=np.array([20.0, 31.0]))
    with pytest.raises(StageFailure, match="does not join"):
        check_swing(other, first, LIMITS)


def test_a_swing_may_not_end_in_motion() -> None:
    for more in (None, then(None)):
        machine = FakeMotor()
        with pytest.raises(StageFailure, match="end in motion"):
            GuardedMotor(machine, LIMITS).swing(FIRST, None, more)
        assert machine.stopped == 1


def test_a_swing_that_grows_may_grow() -> None:
    class Prompt(FakeMotor):
        def amplitude(self) -> float:
            return 0.0 if self.done else self.pieces[-1].reach

        def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
            self.done = False
            record = super().swing(first, watch, more)
            self.done = True
            return record

    small = Swing.first([30.0], [0.1e-3], 0.6, 0.3)
    large = small.then([1e-3], 0.6, 0.3)
    machine = Prompt()
    GuardedMotor(machine, LIMITS).swing(small, None, then(large, large.then([0.0], 0.2, 0.2)))
    assert len(machine.pieces) == 3


def test_a_motor_that_ends_early_moves_too_far_or_goes_on_is_not_believed() -> None:
    class Early(FakeMotor):
        def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
            return ArmRecord.of([])

    class Restless(FakeMotor):
        measured = 0.3e-3

    class Wild(FakeMotor):
        measured = 1.6e-3

    for machine, message in (
        (Early(), "ended before"),
        (Restless(), "it still moves by 0.3 mm"),
        (Wild(), "asked were 1 mm"),
    ):
        with pytest.raises(DeviceError, match=message):
            GuardedMotor(machine, LIMITS).swing(FIRST, None, then(LAST))
        assert machine.stopped == 1


@pytest.mark.parametrize(
    ("sample", "kind", "message"),
    [
        (ArmSample(1.0, np.zeros(7), np.zeros(7), 30.0), "collision", "contact force"),
        (ArmSample(1.0, np.zeros(7), np.full(7, 0.06), 0.0), "device_fault", "does not follow"),
        (ArmSample(0.0, np.zeros(7), np.full(7, 1e-4), 0.0), "device_fault", "clock"),
    ],
)
def test_the_arm_is_watched_while_the_motor_runs(sample: ArmSample, kind: str, message: str) -> None:
    sound = ArmSample(0.5, np.zeros(7), np.zeros(7), 0.0)
    machine = FakeMotor(lambda k: sound if k == 5 else sample)
    with pytest.raises(StageFailure, match=message) as caught:
        GuardedMotor(machine, LIMITS).swing(FIRST, None, then(LAST))
    assert caught.value.kind == kind
    assert machine.stopped == 1


def test_short_pieces_swing_no_longer_than_a_shake_may_last() -> None:
    piece = FIRST
    while piece.begin + piece.seconds + 0.5 <= LIMITS.shake_duration:
        piece = check_swing(piece.then(FIRST.amplitudes, 0.5, 0.1), piece, LIMITS)
    with pytest.raises(StageFailure, match="duration of the swing"):
        check_swing(piece.then(FIRST.amplitudes, 0.5, 0.1), piece, LIMITS)


def test_ctrl_c_stops_the_motor_and_a_motor_that_cannot_stop_hides_nothing() -> None:
    def interrupt(_: int) -> ArmSample:
        raise KeyboardInterrupt

    class Stuck(FakeMotor):
        def stop(self) -> None:
            super().stop()
            raise DeviceError("it does not answer")

    machine = Stuck(interrupt)
    with pytest.raises(KeyboardInterrupt):
        GuardedMotor(machine, LIMITS).swing(FIRST, None, then(LAST))
    assert machine.stopped == 1


def test_the_guard_of_a_robot_guards_its_motor() -> None:
    assert guard(fake_robot(), LIMITS).motor is None
    guarded = guard(replace(fake_robot(), motor=FakeMotor()), LIMITS).motor
    assert isinstance(guarded, GuardedMotor)


def test_a_bare_motor_beside_a_guarded_arm_is_guarded_and_limits_are_tightened() -> None:
    robot, slow = replace(guard(fake_robot(), LIMITS), motor=FakeMotor()), replace(LIMITS, shake_speed=0.1)
    assert isinstance(guard(robot, LIMITS).motor, GuardedMotor)
    tight = guard(guard(robot, LIMITS), slow).motor
    with pytest.raises(StageFailure, match="speed of the motor"):
        tight.swing(FIRST, None, then(LAST))  # type: ignore[union-attr]


def test_the_guarded_simulated_motor_swings_and_stops() -> None:
    cell = holding()
    motor, begin = GuardedMotor(SimMotor(cell), LIMITS), cell.time
    motor.swing(FIRST, None, then(LAST))
    assert swings(cell, begin + 0.4, begin + 0.6, 30.0)[0] == pytest.approx(1e-3, rel=0.03)
    assert motor.amplitude() < 1e-4
