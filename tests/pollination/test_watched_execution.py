"""A shake that is decided while it lasts: its pieces are streamed, and whatever goes wrong in one ends safely."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Event, Timer
from typing import Any

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm, FakeCamera, FakeGripper, fake_robot
from test_execution import GRASP, PLANNER, Blind, Plan

from anther.core.errors import InputError
from anther.pollination.execution import PHASES, ShakeDirection, Step, Trial, execute
from anther.pollination.execution._concurrent import DecisionThread
from anther.pollination.grasp import STAND_OFF
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import LEAD, ArmSample, DeviceError, Frame, ImuReadings, Robot
from anther.robot.swing import Swing
from evaluation.robustness.faulty_machines import Fault, with_faults

TONES = np.array([4.0, 6.0])
PIECES = {"probe": (0.0008, 0.0006), "step": (0.002, 0.0), "hold": (0.003, 0.0), "end": (0.0, 0.0)}
NAMES = tuple(PIECES)[:3]


class Scripted:
    """Asks for the same pieces whatever it sees; `fault` may raise when a piece is decided."""

    rate = 15.0
    directions: tuple[ShakeDirection, ...] = (ShakeDirection(np.array([0, 1.0, 0]), np.ones(2, bool), 0.003),)

    def __init__(self, fault: Callable[[int], None] = lambda _: None, pieces: Sequence[Sequence[float]] = ()) -> None:
        self.fault, self.sizes = fault, list(pieces or PIECES.values())
        self.pieces: list[Swing] = []
        self.steps: tuple[Step, ...] = ()
        self.looks: list[tuple[list[Frame], list[ArmSample]]] = []

    def frame_rate(self, rates: Sequence[float]) -> float:
        assert self.rate in rates
        return self.rate

    def begin(self, frame: Frame) -> Swing:
        assert isinstance(frame, Frame)
        self.fault(0)
        self.pieces = [Swing.first(TONES, self.sizes[0], 1.5, 0.4)]
        return self.pieces[0]

    def steady_from(self, piece: Swing) -> float:
        return piece.begin + 0.5

    def next_piece(
        self,
        piece: Swing,
        frames: Sequence[Frame],
        samples: Sequence[ArmSample],
        readings: ImuReadings | None = None,
    ) -> Swing:
        count = len(self.pieces)
        self.fault(count)
        self.looks.append((list(frames), list(samples)))
        when = samples[0].time + self.steady_from(piece), samples[-1].time
        flowers = (1.5, float("nan"))
        self.steps += (
            Step(*when, tuple(TONES), (0.1, 0.2), (0.0, 1.0, 0.0), flowers, {"slip": 0.5}, f"piece {count}", 0.01),
        )
        last = count == len(self.sizes) - 1
        self.pieces.append(piece.then(self.sizes[count], 0.4 if last else 1.2, 0.4))
        return self.pieces[-1]


def check_end(trial: Trial, arm: FakeArm, gripper: FakeGripper) -> None:
    """Check a trial that was ended in its shake: the arm was held, the pads are open, it is out of the plant."""
    assert not trial.finished
    assert trial.phases == PHASES
    assert arm.held >= 1
    assert gripper.opening == GRASP.opening
    away = SAWYER.forward(arm.joints())[:3, 3] - GRASP.T_world_flange[:3, 3]
    assert np.linalg.norm(away) == pytest.approx(STAND_OFF, abs=4e-3)


def test_the_pieces_follow_each_other_without_a_stop() -> None:
    arm, watched = FakeArm(), Scripted()
    trial = execute(PLANNER, Plan(), fake_robot(arm), LIMITS, watched=watched)
    assert trial.finished
    assert trial.phases == PHASES
    assert arm.held == 0
    assert trial.steps == watched.steps
    assert len(trial.steps) == 3
    assert np.diff(trial.shake_times).max() < 0.021
    seconds = sum(piece.seconds for piece in watched.pieces)
    assert np.ptp(trial.shake_times) == pytest.approx(seconds, abs=0.05)
    y = SAWYER.forward(trial.measured)[:, 1, 3] - GRASP.T_world_flange[1, 3]
    passed = trial.shake_times - trial.shake_times[0]
    for i, piece in enumerate(watched.pieces):
        own = (passed >= piece.begin + 0.01 * i) & (passed <= piece.begin + 0.01 * i + piece.seconds)
        wanted = piece.motion(passed[own] - piece.begin - 0.01 * i)[0]  # the fake arm's clock ticks between motions
        assert y[own] == pytest.approx(wanted, abs=2e-5)
    assert trial.commanded[-1] == pytest.approx(trial.commanded[0], abs=1e-6)


def test_tones_of_two_lines_move_the_pads_along_both() -> None:
    """From one piece to the next the shake turns from y to z without a stop."""
    watched, ends = Scripted(pieces=[(0.002, 0.0), (0.0, 0.0015), (0.0, 0.0)]), ([0, 1.0, 0], [0, 0, 1.0])
    watched.directions = tuple(
        ShakeDirection(np.array(end), tone == TONES, 0.003) for end, tone in zip(ends, TONES, strict=True)
    )
    trial = execute(PLANNER, Plan(), fake_robot(), LIMITS, watched=watched)
    assert trial.finished
    away = SAWYER.forward(trial.measured)[:, :3, 3] - GRASP.T_world_flange[:3, 3]
    passed = trial.shake_times - trial.shake_times[0]
    for i, piece in enumerate(watched.pieces):
        own = (passed >= piece.begin + 0.01 * i) & (passed <= piece.begin + 0.01 * i + piece.seconds)
        for line in watched.directions:
            wanted = piece.only(line.active).motion(passed[own] - piece.begin - 0.01 * i)[0]
            assert away[own] @ line.direction == pytest.approx(wanted, abs=3e-5)
    assert np.abs(away[:, 1:]).max(axis=0) == pytest.approx([0.002, 0.0015], rel=0.02)
    assert trial.commanded[-1] == pytest.approx(trial.commanded[0], abs=1e-6)


def test_each_piece_is_decided_in_time_by_what_was_seen_of_the_one_before() -> None:
    watched = Scripted()
    execute(PLANNER, Plan(), fake_robot(), LIMITS, watched=watched)
    for i, (frames, samples) in enumerate(watched.looks):
        piece, begin = watched.pieces[i], samples[0].time
        assert samples[-1].time - begin == pytest.approx(piece.begin + piece.seconds - LEAD, abs=0.06)
        assert frames[0].time == pytest.approx(begin + piece.begin + 0.5, abs=1e-6)


def test_only_by_the_arms_clock_is_a_decision_late() -> None:
    """While the arm's time stands still it is waited for; where time goes on the piece goes on, and then it follows."""
    first, decided = Swing.first(TONES, (0.002, 0.0), 1.5, 0.4), Event()
    wanted = first.then((0.003, 0.0), 1.2, 0.4)

    def decide() -> Swing:
        decided.wait()
        return wanted

    felt = [ArmSample(0.0, np.zeros(7), np.zeros(7), 0.0)]
    deciding = DecisionThread(felt)
    Timer(0.1, decided.set).start()
    assert deciding.wait_for_next(first, decide).amplitudes == pytest.approx(wanted.amplitudes)
    decided.clear()
    Timer(0.05, lambda: felt.append(replace(felt[0], time=2 * DecisionThread.patience))).start()
    longer = deciding.wait_for_next(first, decide)
    assert deciding.pending
    assert longer.amplitudes == pytest.approx(first.amplitudes)
    assert longer.seconds == DecisionThread.extension
    decided.set()
    late = deciding.wait_for_next(longer, decide)
    assert late.begin == longer.begin + longer.seconds
    assert late.amplitudes == pytest.approx(wanted.amplitudes)
    deciding.close()


def test_a_trial_keeps_its_steps_on_disk(tmp_path: Path) -> None:
    trial = execute(PLANNER, Plan(), fake_robot(), LIMITS, watched=Scripted())
    trial.save(tmp_path / "trial.npz")
    back = Trial.load(tmp_path / "trial.npz")
    assert len(back.steps) == 3
    for step, was in zip(back.steps, trial.steps, strict=True):
        assert np.array_equal(step.flowers, was.flowers, equal_nan=True)
        assert replace(step, flowers=()) == replace(was, flowers=())
    assert back.steady == trial.steady
    assert (back.steps[0].used, back.steps[0].binds, back.steps[0].median) == (0.5, "slip", 1.5)


def test_a_shake_is_steady_in_its_last_steps_alike_or_all_the_time_or_never() -> None:
    watched = execute(PLANNER, Plan(), fake_robot(), LIMITS, watched=Scripted())
    first, second, last = watched.steps
    gentler = replace(first, amplitudes=tuple(0.5 * a for a in last.amplitudes))
    same = replace(second, frequencies=last.frequencies, amplitudes=last.amplitudes, direction=last.direction)
    for steps, begin in (((gentler, same, last), second.begin), ((same, gentler, last), last.begin)):
        assert replace(watched, steps=steps).steady == (begin, last.end)
    plain = execute(PLANNER, Plan(), fake_robot(), LIMITS)
    assert plain.steps == ()
    assert plain.steady == (plain.shake_times[0], plain.shake_times[-1])
    assert replace(plain, shake_times=[], commanded=np.zeros((0, 7)), measured=np.zeros((0, 7))).steady == (0.0, 0.0)
    nothing = Step(0.0, 1.0, (4.0,), (0.001,), (0.0, 1.0, 0.0), (float("nan"),), {}, "", 0.0)
    assert (nothing.used, nothing.binds) == (0.0, "")
    assert np.isnan(nothing.median)


@pytest.mark.parametrize("rate", [30.0, 90.0])
def test_the_frame_rate_is_what_the_shake_asks_for(rate: float) -> None:
    robot, watched = fake_robot(), Scripted()
    watched.rate = rate
    execute(PLANNER, Plan(), robot, LIMITS, watched=watched)
    assert isinstance(robot.side_camera, FakeCamera)
    assert robot.side_camera.asked == [rate]


def test_without_a_side_camera_the_plan_is_carried_out() -> None:
    watched = Scripted()
    trial = execute(PLANNER, Plan(), replace(fake_robot(), side_camera=None), LIMITS, watched=watched)
    assert trial.finished
    assert watched.pieces == []
    assert np.ptp(trial.shake_times) == pytest.approx(Plan().duration, abs=1e-6)


class Lost(FakeCamera):
    """Reads nothing."""

    def read(self) -> Frame:
        raise DeviceError("no picture")


def test_a_camera_that_sees_nothing_at_rest_leaves_the_plan() -> None:
    watched = Scripted()
    trial = execute(PLANNER, Plan(), replace(fake_robot(), side_camera=Lost()), LIMITS, watched=watched)
    assert trial.failure == "device_fault"
    assert "no picture" in trial.stop_reason
    assert trial.phases == PHASES
    assert watched.pieces == []
    assert np.ptp(trial.shake_times) == pytest.approx(Plan().duration, abs=1e-6)


@pytest.mark.parametrize("at", ["start", "stop", "frames"])
def test_a_camera_that_records_nothing_stops_nothing(at: str) -> None:
    trial = execute(PLANNER, Plan(), replace(fake_robot(), side_camera=Blind(at)), LIMITS, watched=Scripted())
    assert trial.failure == "device_fault"
    assert trial.phases == PHASES
    assert len(trial.steps) == 3


# Faults in each of the pieces.


@pytest.mark.parametrize("piece", range(3), ids=NAMES)
@pytest.mark.parametrize(
    ("kind", "failure"),
    [
        ("arm stops", "device_fault"),
        ("pushed", "collision"),
        ("ctrl-c", "interrupted"),
        ("stale joints", "device_fault"),
    ],
)
@pytest.mark.parametrize("lasting", [False, True])
def test_a_fault_of_the_arm_in_any_piece_ends_safely(kind: str, failure: str, piece: int, lasting: bool) -> None:
    arm, gripper, watched = FakeArm(), FakeGripper(), Scripted()
    robot = with_faults(fake_robot(arm, gripper), Fault(kind, 3, 0.5, lasting, piece))  # type: ignore[arg-type]
    trial = execute(PLANNER, Plan(), robot, LIMITS, watched=watched)
    assert trial.failure == failure
    assert arm.held >= 1
    assert gripper.opening == GRASP.opening
    if not lasting and kind != "stale joints":
        check_end(trial, arm, gripper)
    assert trial.steps == watched.steps
    assert len(trial.steps) == piece
    begin = sum(p.seconds for p in watched.pieces[:piece])
    passed = np.ptp(trial.shake_times)
    assert begin + 0.4 * watched.pieces[piece].seconds < passed < begin + 0.8 * watched.pieces[piece].seconds
    again = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS, watched=Scripted())
    assert again.finished


@pytest.mark.parametrize("piece", range(3), ids=NAMES)
def test_frames_lost_in_any_piece_stop_nothing(piece: int) -> None:
    arm, gripper, watched = FakeArm(), FakeGripper(), Scripted()
    robot = with_faults(fake_robot(arm, gripper), Fault("frames lost", 0, 1.0, piece=piece))
    trial = execute(PLANNER, Plan(), robot, LIMITS, watched=watched)
    assert [not frames for frames, _ in watched.looks] == [i == piece for i in range(3)]
    assert (trial.failure, arm.held) == ("device_fault", 0)
    assert "lost on the cable" in trial.stop_reason
    assert trial.phases == PHASES
    assert len(trial.steps) == 3
    assert gripper.opening == GRASP.opening


@pytest.mark.parametrize("count", range(4), ids=("before", *NAMES))
@pytest.mark.parametrize("error", [RuntimeError("bug"), KeyboardInterrupt(), InputError("odd"), DeviceError("no")])
def test_one_who_watches_and_raises_ends_the_shake_safely(error: BaseException, count: int) -> None:
    def fault(now: int) -> None:
        if now == count:
            raise error

    if count == 0 and isinstance(error, DeviceError):
        pytest.skip("a device that fails before the shake leaves the plan")
    arm, gripper, watched = FakeArm(), FakeGripper(), Scripted(fault)
    trial = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS, watched=watched)
    check_end(trial, arm, gripper)
    assert str(error) in trial.stop_reason
    assert trial.steps == watched.steps
    assert len(trial.steps) == max(count - 1, 0)
    assert (len(trial.shake_times) > 0) == (count > 0)
    assert (len(trial.frames) > 0) == (count > 0)


@pytest.mark.parametrize("piece", range(3), ids=NAMES)
@pytest.mark.parametrize(
    ("sizes", "message"),
    [((0.0, 0.02), "allowed"), ((0.004, 0.0), "displacement of a swing"), ((float("nan"), 0.0), "swing amplitudes")],
)
def test_a_piece_beyond_the_limits_is_not_begun(sizes: tuple[float, float], message: str, piece: int) -> None:
    pieces = list(PIECES.values())
    pieces[piece] = sizes
    arm, gripper, watched = FakeArm(), FakeGripper(), Scripted(pieces=pieces)
    trial = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS, watched=watched)
    check_end(trial, arm, gripper)
    assert message in trial.stop_reason
    assert trial.failure == "limits_exceeded"
    assert len(trial.steps) == piece
    y = SAWYER.forward(trial.measured)[:, 1, 3] - GRASP.T_world_flange[1, 3] if len(trial.measured) else np.zeros(1)
    assert np.abs(y).max() < 0.0031


def test_tones_and_lines_that_together_exceed_a_limit_are_not_begun() -> None:
    """Each tone would pass alone; the sum passes a little above what it reaches, along one line or two."""
    ends = tuple(ShakeDirection(end, tone == TONES, 0.003) for end, tone in zip(np.eye(3)[1:], TONES, strict=True))
    limits, plan = replace(LIMITS, shake_acceleration=2.2), Plan(amplitude=0.0005)
    for lines, most in ((Scripted.directions, 3.1), (ends, 2.4)):
        watched, wider = (Scripted(pieces=[(0.0001, 0.0001), (0.0015, 0.0015), (0.0, 0.0)]) for _ in range(2))
        watched.directions = wider.directions = lines
        trial = execute(PLANNER, plan, fake_robot(), limits, watched=watched)
        assert trial.failure == "limits_exceeded"
        assert "acceleration of the shake" in trial.stop_reason
        assert len(trial.steps) == 1
        assert execute(PLANNER, plan, fake_robot(), replace(limits, shake_acceleration=most), watched=wider).finished


def test_a_camera_is_not_blamed_for_a_shake_that_did_not_begin() -> None:
    class Empty(FakeCamera):
        def stop(self) -> list[Frame]:
            return []

    robot = replace(fake_robot(), side_camera=Empty())
    trial = execute(PLANNER, Plan(), robot, LIMITS, watched=Scripted(pieces=[(0.0, 0.02)]))
    assert "camera" not in trial.stop_reason
    assert "camera returned no frame" in execute(PLANNER, Plan(), robot, LIMITS, watched=Scripted()).stop_reason


def test_a_camera_that_fails_after_the_last_look_is_told() -> None:
    class Unplugged(FakeCamera):
        def read(self) -> Frame:
            if self.reads:
                raise DeviceError("unplugged")
            return super().read()

    trial = execute(PLANNER, Plan(), replace(fake_robot(), side_camera=Unplugged()), LIMITS, watched=Scripted())
    assert "unplugged" in trial.stop_reason
    assert trial.phases == PHASES
    assert len(trial.steps) == 3
    assert len(trial.frames) > 0


def test_a_shake_that_goes_on_for_too_long_is_ended() -> None:
    arm, gripper = FakeArm(), FakeGripper()
    watched = Scripted(pieces=[(0.0008, 0.0006)] * 40)
    trial = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS, watched=watched)
    check_end(trial, arm, gripper)
    assert "shake duration" in trial.stop_reason
    assert np.ptp(trial.shake_times) < LIMITS.shake_duration


def test_one_who_never_stops_the_pads_is_not_left_so() -> None:
    class Endless(Scripted):
        def next_piece(self, *seen: Any) -> Swing:
            new = super().next_piece(*seen)
            return replace(new, amplitudes=np.zeros(2), ramp=new.seconds) if len(self.pieces) > 2 else new

    arm, gripper = FakeArm(), FakeGripper()
    robot: Robot = fake_robot(arm, gripper)
    trial = execute(PLANNER, Plan(), robot, LIMITS, watched=Endless())
    assert trial.finished
    assert trial.commanded[-1] == pytest.approx(trial.commanded[0], abs=1e-6)


@pytest.mark.parametrize("look", range(3))
def test_a_picture_that_stands_still_while_the_arm_swings_is_a_fault_and_no_look(look: int) -> None:
    """The shake goes on without eyes, and comes to its end."""
    watched = Scripted()
    robot = with_faults(fake_robot(), Fault("frozen picture", piece=look))
    trial = execute(PLANNER, Plan(), robot, LIMITS, watched=watched)
    assert trial.failure == "device_fault"
    assert "same picture" in trial.stop_reason
    assert trial.phases == PHASES
    assert [bool(frames) for frames, _ in watched.looks] == [n < look for n in range(3)]


class BrokenImu:
    """An inertial sensor that fails whenever it is asked, or only for what it read; `asked` counts that."""

    T_cam_imu = np.eye(4)

    def __init__(self, *, starts: bool) -> None:
        self.starts, self.asked, self.stopped = starts, 0, 0

    def start(self) -> None:
        if not self.starts:
            raise DeviceError("it does not answer")

    def recorded(self, since: float) -> ImuReadings:
        self.asked += 1
        raise DeviceError(f"it lost what it read since {since}")

    def stop(self) -> None:
        self.stopped += 1
        raise DeviceError("it does not answer")


@pytest.mark.parametrize("starts", [True, False])
def test_an_inertial_sensor_that_fails_stops_nothing_and_its_readings_are_none(starts: bool) -> None:
    class Told(Scripted):
        told: tuple[ImuReadings | None, ...] = ()

        def next_piece(self, *seen: Any) -> Swing:
            self.told = (*self.told, seen[3])
            return super().next_piece(*seen)

    imu, watched, plain = BrokenImu(starts=starts), Told(), Told()
    trial = execute(PLANNER, Plan(), replace(fake_robot(), imu=imu, T_flange_imu=np.eye(4)), LIMITS, watched=watched)
    assert trial.finished
    assert trial.failure is None
    assert imu.stopped == 1
    assert imu.asked == len(watched.told) == 3
    assert all(told is not None and not len(told.times) for told in watched.told), "why is said by who uses them"
    execute(PLANNER, Plan(), fake_robot(), LIMITS, watched=plain)
    assert plain.told == (None, None, None)
