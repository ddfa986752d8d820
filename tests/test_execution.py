"""Execution and safety: order of things, every limit, and a safe end with a record whatever happens."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm, FakeGripper, fake_robot, horizontal_grasp
from hypothesis import given
from hypothesis import strategies as st
from small_planner import SmallPlanner, solve

from anther.arm import sawyer
from anther.devices import DeviceError, JointTrajectory, SafetyLimits
from anther.errors import InputError, StageFailure
from anther.execution import PHASES, Params, Trial, choose_rate, execute
from anther.geometry import Array, Box
from anther.grasp import Grasp
from anther.oscillation import alias
from anther.safety import GuardedArm, check_shake, check_trajectory

POINT = np.array([0.72, 0.0, -0.08])
GRASP = horizontal_grasp(POINT, np.zeros(7))
GRASP = horizontal_grasp(POINT, solve(GRASP.T_world_flange))
PLANNER = SmallPlanner()


@dataclass(frozen=True)
class Plan:
    grasp: Grasp = GRASP
    direction: Array = field(default_factory=lambda: np.array([0, 1.0, 0]))
    amplitude: float = 0.004
    frequency: float = 5.0
    duration: float = 0.6


def test_a_trial_runs_its_phases_in_order_and_ends_clear_of_the_plant() -> None:
    arm, gripper = FakeArm(), FakeGripper(0.008)
    robot = fake_robot(arm, gripper)
    seen: list[tuple[int, int]] = []
    trial = execute(PLANNER, Plan(), robot, LIMITS, progress=lambda *step: seen.append(step))
    assert trial.finished
    assert trial.phases == PHASES
    assert np.all(trial.phase_times[:, 1] >= trial.phase_times[:, 0])
    assert np.all(np.diff(trial.phase_times[:, 0]) >= 0)
    assert seen == [(i, len(PHASES)) for i in range(len(PHASES))]
    assert gripper.commands == [Params().opening, pytest.approx(0.008 - Params().squeeze), Params().opening]
    away = sawyer.forward(arm.joints())[:3, 3]
    assert away == pytest.approx(GRASP.pregrasp(Params().stand_off)[:3, 3], abs=1e-4)
    assert len(trial.frames) == len(trial.frame_times) > 8


def test_the_shake_is_what_was_planned() -> None:
    trial = execute(PLANNER, Plan(), fake_robot(), LIMITS)
    y = sawyer.forward(trial.measured)[:, 1, 3]
    assert np.ptp(y) / 2 == pytest.approx(0.004, rel=0.05)
    assert trial.shake_times[-1] - trial.shake_times[0] == pytest.approx(0.6, abs=1e-6)


@pytest.mark.parametrize(
    ("width", "kind"), [(0.0, "nothing_grasped"), (0.001, "nothing_grasped"), (0.03, "branch_or_leaf_grasped")]
)
def test_a_wrong_grip_is_let_go(width: float, kind: str) -> None:
    gripper = FakeGripper(width)
    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(), gripper), LIMITS)
    assert trial.failure == kind
    assert "Try the next grasp" in trial.stop_reason
    assert "shake" not in trial.phases
    assert gripper.commands[-1] == Params().opening
    assert trial.phases[-1] == "retreat"


def test_a_stem_thinner_than_it_looked_is_closed_upon_in_steps() -> None:
    gripper = FakeGripper(0.005)
    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(), gripper), LIMITS)
    assert trial.finished
    closing = [w for w in gripper.commands if w < Params().opening]
    assert len(closing) > 1
    assert np.all(np.diff(closing) < 0)
    assert trial.gripper[0, 0] == pytest.approx(0.005)


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
    assert gripper.commands[-1] == Params().opening
    near_plant = when >= 1
    assert (trial.phases[-1] == "retreat") == near_plant


def test_a_dead_arm_still_gets_a_record() -> None:
    def fault(done: int) -> None:
        raise DeviceError("no answer")

    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(fault=fault)), LIMITS)
    assert "no answer" in trial.stop_reason
    assert trial.phases[:2] == ("open", "reach")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"amplitude": 0.05, "frequency": 10.0}, "amplitude x 2 pi frequency"),
        ({"duration": 8.0}, "shake duration"),
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


def path(goal: Array, *, seconds: float = 5.0, start: Array = sawyer.NEUTRAL) -> JointTrajectory:
    t = np.linspace(0, seconds, 200)
    q = start + (t / seconds)[:, None] * (goal - start)
    return JointTrajectory(t, q, np.gradient(q, t, axis=0))


def turned(joint: int, angle: float) -> Array:
    return sawyer.NEUTRAL + angle * np.eye(7)[joint]


BAD: dict[str, tuple[JointTrajectory, SafetyLimits]] = {
    "start of the path": (path(sawyer.NEUTRAL, start=sawyer.NEUTRAL + 0.2), LIMITS),
    "joint 1": (path(turned(1, 4.0), seconds=30), LIMITS),
    "speed of joint 0": (path(turned(0, 1.0), seconds=0.3), LIMITS),
    "workspace": (
        path(turned(0, 1.5)),
        replace(LIMITS, workspace=Box(np.array([0.0, -0.5, -0.5]), np.array([1.0, 0.5, 1.0]))),
    ),
    "keep-out": (
        path(turned(0, 0.5)),
        replace(LIMITS, keep_out=(Box(np.array([0.3, 0.2, 0.0]), np.array([0.5, 0.5, 0.5])),)),
    ),
    "flange speed": (path(sawyer.NEUTRAL + 0.3), replace(LIMITS, flange_speed=0.01)),
}


@pytest.mark.parametrize("message", BAD)
def test_each_limit_refuses_and_the_arm_holds(message: str) -> None:
    trajectory, limits = BAD[message]
    arm = FakeArm()
    with pytest.raises(StageFailure, match=message) as failure:
        GuardedArm(arm, limits).follow(trajectory)
    assert failure.value.kind == "limits_exceeded"
    assert (arm.done, arm.held) == (0, 1)


def test_a_sound_path_passes() -> None:
    check_trajectory(path(sawyer.NEUTRAL + 0.1), sawyer.NEUTRAL, LIMITS)
    check_shake(0.005, 5.0, 5.0, LIMITS)


@given(frequency=st.floats(0.5, 40))
def test_the_camera_rate_can_tell_the_phase(frequency: float) -> None:
    rate = choose_rate(frequency, Params().rates)
    assert rate in Params().rates
    assert rate >= 8 * frequency or 0.05 < alias(frequency, rate) / rate < 0.45


def test_a_camera_rate_at_twice_the_frequency_is_avoided() -> None:
    assert choose_rate(30.0, (60.0, 90.0)) == 90.0
    assert choose_rate(45.0, (60.0, 90.0)) == 60.0
    assert choose_rate(1.0, (15.0, 60.0)) == 15.0


def test_a_trial_survives_the_disk(tmp_path: Path) -> None:
    trial = execute(PLANNER, Plan(), fake_robot(), LIMITS)
    trial.save(tmp_path / "trial.npz")
    back = Trial.load(tmp_path / "trial.npz")
    assert (back.phases, back.stop_reason, back.failure) == (trial.phases, trial.stop_reason, trial.failure)
    for name in ("phase_times", "shake_times", "commanded", "measured", "gripper", "frame_times"):
        assert np.array_equal(getattr(back, name), getattr(trial, name))
    (tmp_path / "trial.npz").write_bytes((tmp_path / "trial.npz").read_bytes()[:200])
    with pytest.raises(InputError, match="truncated"):
        Trial.load(tmp_path / "trial.npz")
