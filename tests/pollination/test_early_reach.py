"""Early reach: the arm goes while something is computed, and whatever goes wrong is the trial's to tell."""

from __future__ import annotations

from concurrent.futures import wait
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm, FakeGripper, fake_robot, horizontal_grasp
from small_planner import SmallPlanner, solve
from test_execution import POINT, Plan

from anther.core.errors import StageFailure
from anther.pollination.execution import APPROACH_SPEED, EARLY, PHASES, early_reach, execute
from anther.pollination.grasp import STAND_OFF
from anther.robot.devices import ArmRecord, DeviceError, JointTrajectory, More, Watch

GRASP = horizontal_grasp(POINT, solve(horizontal_grasp(POINT, np.zeros(7)).T_world_flange))


def before_the_grasp(arm: FakeArm) -> float:
    """Return how far the arm is from where the straight way in begins [rad]."""
    begin = SmallPlanner().line(GRASP.joints, GRASP.pregrasp(STAND_OFF), APPROACH_SPEED).positions[-1]
    return float(np.abs(arm.joints() - begin).max())


def test_the_arm_is_there_when_the_block_has_computed_and_the_trial_goes_on_from_there():
    arm, gripper = FakeArm(), FakeGripper()
    robot = fake_robot(arm, gripper)
    with early_reach(SmallPlanner(), GRASP, robot, LIMITS) as arrive:
        assert arrive is not None
        trial = execute(SmallPlanner(), Plan(), robot, LIMITS, arrive=arrive)
    assert trial.finished
    assert trial.phases == (EARLY, *PHASES)
    spans = dict(zip(trial.phases, trial.phase_times, strict=True))
    assert np.ptp(spans[EARLY]) > 1
    assert np.ptp(spans["reach"]) < 0.2
    assert np.all(trial.phase_times[1:, 0] >= trial.phase_times[:-1, 1] - 1e-9)


def test_it_moves_while_the_block_runs():
    arm = FakeArm()
    with early_reach(SmallPlanner(), GRASP, fake_robot(arm), LIMITS) as arrive:
        assert arrive is not None
        arrive()
        assert before_the_grasp(arm) < 1e-6


@pytest.mark.parametrize("error", [KeyboardInterrupt(), StageFailure("limits_exceeded", "no shake is allowed")])
def test_when_the_block_fails_the_arm_stops(error: BaseException):
    arm = SlowArm()

    def compute() -> None:
        arm.moving.wait(5)
        raise error

    with pytest.raises(type(error)), early_reach(SmallPlanner(), GRASP, fake_robot(arm), LIMITS):
        compute()
    assert before_the_grasp(arm) > 0.1
    assert arm.held >= 1


def test_a_fault_on_the_way_is_the_trials():
    def fault(done: int) -> None:
        if done == 0:
            raise DeviceError("the arm has lost power.")

    arm = FakeArm(fault=fault)
    robot = fake_robot(arm)
    with early_reach(SmallPlanner(), GRASP, robot, LIMITS) as arrive:
        trial = execute(SmallPlanner(), Plan(), robot, LIMITS, arrive=arrive)
    assert (trial.failure, trial.phases) == ("device_fault", (EARLY,))
    assert "lost power" in trial.stop_reason
    assert arm.held >= 1


def test_ctrl_c_while_waiting_for_the_arm_stops_it(monkeypatch: pytest.MonkeyPatch):
    def ctrl_c(*_: Any) -> Any:
        raise KeyboardInterrupt

    arm = SlowArm()
    robot = fake_robot(arm)
    with early_reach(SmallPlanner(), GRASP, robot, LIMITS) as arrive:
        arm.moving.wait(5)
        with monkeypatch.context() as patched:
            patched.setattr("concurrent.futures.Future.result", ctrl_c)
            trial = execute(SmallPlanner(), Plan(), robot, LIMITS, arrive=arrive)
    assert trial.failure == "interrupted"
    assert arm.held >= 1
    assert before_the_grasp(arm) > 0.1


def test_a_second_ctrl_c_waits_for_the_arm_too(monkeypatch: pytest.MonkeyPatch):
    pressed = []

    def ctrl_c_first(futures: Any) -> Any:
        pressed.append(futures)
        if len(pressed) == 1:
            raise KeyboardInterrupt
        return wait(futures)

    monkeypatch.setattr("anther.pollination.execution._concurrent.wait", ctrl_c_first)
    arm = SlowArm()

    def interrupted() -> None:
        with early_reach(SmallPlanner(), GRASP, fake_robot(arm), LIMITS):
            arm.moving.wait(5)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len(pressed) == 2
    assert before_the_grasp(arm) > 0.1


@pytest.mark.parametrize("joints", [None, GRASP.joints])
def test_where_there_is_no_way_nothing_moves(joints: Any):
    def refuse(*_: Any) -> JointTrajectory:
        raise StageFailure("unreachable", "no way")

    planner: Any = SimpleNamespace(line=SmallPlanner().line, move=refuse)
    arm = FakeArm()
    grasp = horizontal_grasp(POINT, joints)
    with early_reach(planner, grasp, fake_robot(arm), LIMITS) as arrive:
        assert arrive is None
    assert arm.done == 0
    assert np.array_equal(arm.joints(), FakeArm().joints())


class SlowArm(FakeArm):
    """Takes as long as the motion, in steps, so that something can happen meanwhile."""

    def __init__(self) -> None:
        super().__init__()
        self.moving = Event()

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        def slowly(sample: Any) -> None:
            self.moving.set()
            Event().wait(0.005)
            if watch:
                watch(sample)

        return super().follow(trajectory, slowly, more)
