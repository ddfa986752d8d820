"""Execution: order of things, and a safe end with a record whatever happens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from alike import check_kept
from fake_robot import LIMITS, FakeArm, FakeCamera, FakeGripper, fake_robot, horizontal_grasp
from small_planner import SmallPlanner, solve

from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.pollination.execution import APPROACH_SPEED, PHASES, execute
from anther.pollination.execution._closing import STEP
from anther.pollination.grasp import STAND_OFF, Grasp
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import ArmRecord, ArmSample, DeviceError, Frame, GripperState, JointTrajectory, More, Watch
from anther.robot.swing import Swing

POINT = np.array([0.72, 0.0, -0.08])
GRASP = horizontal_grasp(POINT, np.zeros(7))
GRASP = horizontal_grasp(POINT, solve(GRASP.T_world_flange))
PLANNER = SmallPlanner()


@dataclass(frozen=True)
class Plan:
    grasp: Grasp = GRASP
    direction: Array = field(default_factory=lambda: np.array([0, 1.0, 0]))
    amplitude: float = 0.003
    frequency: float = 5.0
    duration: float = 0.6
    press: float = 8.0


def test_a_trial_runs_its_phases_in_order_and_ends_clear_of_the_plant() -> None:
    arm, gripper = FakeArm(), FakeGripper(0.008)
    robot = fake_robot(arm, gripper)
    seen: list[tuple[int, int, str]] = []
    trial = execute(PLANNER, Plan(), robot, LIMITS, progress=lambda *step: seen.append(step))
    assert trial.finished
    assert trial.phases == PHASES
    assert np.all(trial.phase_times[:, 1] >= trial.phase_times[:, 0])
    assert np.all(np.diff(trial.phase_times[:, 0]) >= 0)
    assert seen == [(i, len(PHASES), name) for i, name in enumerate(PHASES)]
    assert gripper.commands == pytest.approx([GRASP.opening, 0.0085, 0.008, 0.0075, GRASP.opening])
    away = SAWYER.forward(arm.joints())[:3, 3]
    assert away == pytest.approx(GRASP.pregrasp(STAND_OFF)[:3, 3], abs=1e-4)
    assert len(trial.frames) == len(trial.frame_times) > 8


def test_time_before_the_first_motion_is_none_of_the_trial() -> None:
    arm = FakeArm()
    arm.clock = 7.0
    trial = execute(PLANNER, Plan(), fake_robot(arm), LIMITS)
    assert trial.finished
    assert trial.phase_times[0] == pytest.approx(7.0, abs=0.02)
    assert np.ptp(trial.phase_times[PHASES.index("open")]) == 0.0


@pytest.mark.parametrize("joint", [0, 3, 6])
def test_an_arm_with_one_joint_elsewhere_reaches_before_it_approaches(joint: int) -> None:
    assert GRASP.joints is not None
    before = PLANNER.line(GRASP.joints, GRASP.pregrasp(STAND_OFF), APPROACH_SPEED).positions[-1]
    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(before + 0.1 * (np.arange(7) == joint))), LIMITS)
    assert trial.finished
    assert np.ptp(trial.phase_times[PHASES.index("reach")]) > 0.1


@pytest.mark.parametrize(
    ("squeezed", "wait"),
    [(0.0, 0.6), (0.0019, 0.6), (0.004, 2.0), (None, 2.0)],
)
def test_pads_that_press_a_petiole_wait_until_it_is_calm(squeezed: float | None, wait: float) -> None:
    trial = execute(PLANNER, Plan(replace(GRASP, squeezed=squeezed)), fake_robot(), LIMITS)
    assert np.ptp(trial.phase_times[PHASES.index("close")]) == pytest.approx(wait, abs=0.02)


def test_the_shake_is_what_was_planned() -> None:
    trial = execute(PLANNER, Plan(), fake_robot(), LIMITS)
    y = SAWYER.forward(trial.measured)[:, 1, 3]
    assert np.ptp(y) / 2 == pytest.approx(0.003, rel=0.05)
    assert trial.shake_times[-1] - trial.shake_times[0] == pytest.approx(0.6, abs=1e-6)


def test_a_refused_shake_is_known_before_anything_moves() -> None:
    class Hits(SmallPlanner):
        def swing(self, q: Array, direction: Array, pieces: Sequence[Swing], reach: float) -> JointTrajectory:
            raise StageFailure("collision", "a shake of 3 mm hits something")

    arm, gripper = FakeArm(), FakeGripper(0.008)
    trial = execute(Hits(), Plan(), fake_robot(arm, gripper), LIMITS)
    assert trial.failure == "collision"
    assert trial.phases == ("open",)
    assert arm.done == 0
    assert gripper.commands == [GRASP.opening], "it is let go of whatever was held"


@pytest.mark.parametrize(
    ("width", "kind"), [(0.0, "nothing_grasped"), (0.001, "nothing_grasped"), (0.03, "branch_or_leaf_grasped")]
)
def test_a_wrong_grip_is_let_go(width: float, kind: str) -> None:
    gripper = FakeGripper(width)
    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(), gripper), LIMITS)
    assert trial.failure == kind
    assert "Try the next grasp" in trial.stop_reason
    assert "shake" not in trial.phases
    assert gripper.commands[-1] == GRASP.opening
    assert trial.phases[-1] == "retreat"


@pytest.mark.parametrize(
    ("nearer", "grips", "shaken"),
    [(0.0, True, True), (0.0004, True, True), (0.001, True, False), (0.0, False, False)],
    ids=["as it was", "a count nearer", "the stem slid out", "says so itself"],
)
def test_what_slid_out_of_the_pads_is_not_shaken(nearer: float, grips: bool, shaken: bool) -> None:
    class Slides(FakeGripper):
        """What it holds when it has closed slides out before it is looked at again."""

        looked = 0

        def state(self) -> GripperState:
            state = super().state()
            self.looked += state.is_gripping
            later = self.looked > 1 and state.is_gripping
            return replace(state, opening=state.opening - nearer, is_gripping=grips) if later else state

    gripper = Slides(0.008)
    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(), gripper), LIMITS)
    assert ("shake" in trial.phases) == shaken
    assert trial.failure == (None if shaken else "nothing_grasped")
    assert gripper.commands[-1] == GRASP.opening


class SoftStem(FakeGripper):
    """Presses with 6 N for each millimetre that it is closed further than the stem is wide."""

    def state(self) -> GripperState:
        force = 6e3 * max(self.width - self.commands[-1], 0) if self.opening <= self.width else 0.0
        return GripperState(self.opening, force, force > 1)


@pytest.mark.parametrize("width", [0.0036, 0.0078, 0.011])
@pytest.mark.parametrize("press", [3.0, 8.0, 10.0])
def test_the_pads_close_in_steps_and_press_no_more_than_the_plan_asks_for(width: float, press: float) -> None:
    gripper = SoftStem(width)
    trial = execute(PLANNER, Plan(press=press), fake_robot(FakeArm(), gripper), LIMITS)
    assert trial.finished
    assert trial.gripper[0, 0] == pytest.approx(width)
    assert 0.95 * press <= trial.gripper[0, 1] < press + 6e3 * STEP


@pytest.mark.parametrize(("width", "held"), [(0.0038, True), (0.0028, False)])
def test_a_stem_half_as_thick_as_measured_is_held_though_it_gives_way(width: float, held: bool) -> None:
    """Measured 8 mm thick, it is met at half of that, and presses with 6 N only 1 mm further on."""

    class GivesWay(SoftStem):
        def move(self, opening: float) -> GripperState:
            super().move(opening)
            self.opening = opening
            return self.state()

    trial = execute(PLANNER, Plan(press=5.0), fake_robot(FakeArm(), GivesWay(width)), LIMITS)
    assert trial.finished == held
    assert trial.failure == (None if held else "nothing_grasped")


def test_a_gripper_that_cannot_press_as_the_shake_needs_does_not_shake() -> None:
    trial = execute(PLANNER, Plan(press=9.0), fake_robot(FakeArm(), FakeGripper(0.008)), LIMITS)
    assert trial.failure == "limits_exceeded"
    assert "press with 8.0 N; the plan asks for 9.0 N" in trial.stop_reason
    assert "shake" not in trial.phases
    assert trial.phases[-1] == "retreat"


@pytest.mark.parametrize("when", range(5))
@pytest.mark.parametrize("error", [DeviceError("the arm stopped"), RuntimeError("bug"), KeyboardInterrupt()])
def test_a_fault_in_any_motion_ends_held_open_and_recorded(when: int, error: BaseException) -> None:
    def fault(done: int) -> None:
        if done == when and not arm.held:
            raise error

    arm, gripper = FakeArm(), FakeGripper()
    arm.fault = fault
    trial = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS)
    assert not trial.finished
    assert str(error) in trial.stop_reason
    assert arm.held >= 1
    assert gripper.commands[-1] == GRASP.opening
    near_plant = when >= 1
    assert (trial.phases[-1] == "retreat") == near_plant


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_shake_cut_short_keeps_what_was_seen_of_it(share: float) -> None:
    class Stopping(FakeArm):
        def follow(
            self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None
        ) -> ArmRecord:
            def until(sample: ArmSample) -> None:
                if self.done == 3 and sample.time - start > share * trajectory.duration:
                    self.done = -100
                    raise KeyboardInterrupt
                assert watch is not None
                watch(sample)

            start = self.clock + 0.01
            return super().follow(trajectory, until, more)

    arm, gripper = Stopping(), FakeGripper()
    trial = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS)
    assert trial.failure == "interrupted"
    assert trial.phases == PHASES
    assert len(trial.frames) > 8
    assert gripper.opening == GRASP.opening
    whole = execute(PLANNER, Plan(), fake_robot(), LIMITS)
    assert len(trial.shake_times) == pytest.approx(share * len(whole.shake_times), abs=2)
    assert trial.commanded == pytest.approx(whole.commanded[: len(trial.commanded)], abs=1e-9)


def test_a_second_ctrl_c_leaves_the_arm_holding_and_the_record_whole() -> None:
    def fault(done: int) -> None:
        if done >= 2:
            raise KeyboardInterrupt

    arm, gripper = FakeArm(), FakeGripper()
    arm.fault = fault
    trial = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS)
    assert trial.failure == "interrupted"
    assert trial.stop_reason.count("KeyboardInterrupt") == 2
    assert arm.held >= 2
    assert gripper.opening == GRASP.opening


def test_a_gripper_that_does_not_open_is_not_torn_away() -> None:
    class Jammed(FakeGripper):
        def move(self, opening: float) -> GripperState:
            return self.state() if opening > self.opening else super().move(opening)

    arm = FakeArm()
    trial = execute(PLANNER, Plan(), fake_robot(arm, Jammed()), LIMITS)
    assert trial.failure == "device_fault"
    assert "the gripper jammed" in trial.stop_reason
    assert trial.phases[-1] == "release"
    assert SAWYER.forward(arm.joints())[:3, 3] == pytest.approx(GRASP.T_world_flange[:3, 3], abs=1e-3)
    assert arm.held >= 1


class Blind(FakeCamera):
    """Loses every frame, or refuses to start."""

    def __init__(self, at: str) -> None:
        super().__init__()
        self.at = at

    def start(self, rate: float) -> None:
        if self.at == "start":
            raise DeviceError("no such device")
        super().start(rate)

    def stop(self) -> list[Frame]:
        if self.at == "stop":
            raise DeviceError("frames lost")
        return []


@pytest.mark.parametrize("at", ["start", "stop", "frames"])
def test_a_blind_side_camera_stops_nothing_and_is_recorded(at: str) -> None:
    robot = replace(fake_robot(), side_camera=Blind(at))
    trial = execute(PLANNER, Plan(), robot, LIMITS)
    assert trial.phases == PHASES
    assert len(trial.shake_times) > 10
    assert trial.failure == "device_fault"
    assert not trial.finished


def test_an_arm_that_does_not_hold_is_not_sent_anywhere() -> None:
    class Drifts(FakeArm):
        def hold(self) -> None:
            super().hold()
            raise DeviceError("it does not hold")

    arm, gripper = Drifts(), FakeGripper()
    arm.fault = lambda done: None if done < 2 else pytest.fail("the arm was moved on")  # a close, whose grip is wrong
    gripper.width = 0.03
    trial = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS)
    assert trial.failure == "branch_or_leaf_grasped"
    assert "it does not hold" in trial.stop_reason
    assert arm.done == 2, "reach and approach alone"
    assert gripper.commands[-1] == GRASP.opening


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"amplitude": 0.05, "frequency": 10.0}, "amplitude x 2 pi frequency"),
        ({"duration": LIMITS.shake_duration + 0.1}, "shake duration"),
        ({"amplitude": -0.001}, "allowed: a number > 0"),
        ({"frequency": float("nan")}, "allowed: a number > 0"),
    ],
)
def test_a_shake_over_the_limits_moves_nothing(changes: dict[str, float], message: str) -> None:
    arm = FakeArm()
    trial = execute(PLANNER, replace(Plan(), **changes), fake_robot(arm), LIMITS)  # type: ignore[arg-type]
    assert trial.failure == "limits_exceeded"
    assert message in trial.stop_reason
    assert arm.done == 0
    assert trial.phases == ()


def test_a_grasp_without_joints_is_unreachable() -> None:
    trial = execute(PLANNER, Plan(grasp=replace(GRASP, joints=None)), fake_robot(), LIMITS)
    assert trial.failure == "unreachable"


def test_a_trial_survives_the_disk(tmp_path: Path) -> None:
    check_kept(execute(PLANNER, Plan(), fake_robot(), LIMITS), tmp_path / "trial.npz")
