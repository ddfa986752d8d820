"""Machines that fail on purpose: each fault strikes where it says, and an execution with it ends safely, on record."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm, FakeCamera, FakeGripper, fake_robot
from small_planner import SmallPlanner, solve
from straight_plant import straight_plant
from test_execution import GRASP, PLANNER, Plan

from anther.core.errors import FailureKind, StageFailure
from anther.core.files import read_json
from anther.core.runs import Run
from anther.pollination.execution import PHASES, Trial, execute
from anther.pollination.grasp import STAND_OFF
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import ArmSample, DeviceError
from anther.robot.safety import GuardedArm
from anther.show.summary import _verdict
from anther.sim._motor import contact_force
from anther.sim.cell import Cell
from anther.sim.robot import SimArm, robot_of
from evaluation.robustness.faulty_machines import STALE, Fault, FaultyCamera, Kind, with_faults

STRIKES: list[tuple[Fault, FailureKind | None]] = [
    (Fault("command rejected", 1), "device_fault"),
    (Fault("command rejected", 0, lasting=True), "device_fault"),
    (Fault("arm stops", 0, 0.3), "device_fault"),
    (Fault("arm stops", 3, 0.3), "device_fault"),
    (Fault("arm stops", 4, 0.3), "device_fault"),
    (Fault("arm stops", 1, 0.5, lasting=True), "device_fault"),
    (Fault("stale joints", 0, 0.3), "device_fault"),
    (Fault("stale joints", 3, 0.3, lasting=True), "device_fault"),
    (Fault("stale with noise", 1, 0.3), "device_fault"),
    (Fault("one joint stale", 3, 0.3), "device_fault"),
    (Fault("pushed", 1, 0.5), "collision"),
    (Fault("pushed", 2, 0.2, lasting=True), "collision"),
    (Fault("gripper jam", 1), "device_fault"),
    (Fault("gripper jam", 2), None),  # the next step of closing moves it on
    (Fault("gripper jam", 4), "device_fault"),
    (Fault("gripper jam", 2, lasting=True), "device_fault"),
    (Fault("frames lost", 0, 0.0), "device_fault"),
    (Fault("frames lost", 0, 0.5), None),
    (Fault("ctrl-c", 3, 0.5), "interrupted"),
    (Fault("ctrl-c", 1, 0.5, lasting=True), "interrupted"),
]


@pytest.mark.parametrize(("fault", "failure"), STRIKES, ids=lambda x: str(x) if isinstance(x, str) else None)
def test_every_fault_ends_safely_on_record_and_the_next_trial_works(
    tmp_path: Path, fault: Fault, failure: FailureKind | None
) -> None:
    arm, gripper = FakeArm(), FakeGripper()
    execute(PLANNER, Plan(), with_faults(fake_robot(arm, gripper), fault), LIMITS).save(tmp_path / "trial.npz")
    trial = Trial.load(tmp_path / "trial.npz")
    assert trial.failure == failure
    assert trial.finished == (failure is None)
    assert trial.stop_reason
    jammed = fault.kind == "gripper jam" and fault.lasting
    assert (gripper.opening == GRASP.opening) is not jammed
    away = np.linalg.norm(SAWYER.forward(arm.joints())[:3, 3] - GRASP.T_world_flange[:3, 3])
    went_in = "approach" in trial.phases
    obeys = not fault.lasting and fault.kind not in STALE
    if jammed:
        assert away < 1e-3
    elif went_in and obeys:
        assert away == pytest.approx(STAND_OFF, abs=2e-3)
    if failure is not None and fault.kind != "frames lost":
        assert arm.held >= 1
    again = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS)
    assert again.finished
    assert again.phases == PHASES


def test_a_fault_that_does_not_strike_changes_nothing() -> None:
    for kind in ("arm stops", "gripper jam", "frames lost"):
        assert execute(PLANNER, Plan(), with_faults(fake_robot(), Fault(kind, 99)), LIMITS).finished


def test_frames_are_lost_one_by_one_or_for_good() -> None:
    once, ever = (FaultyCamera(FakeCamera(), Fault("frames lost", 1, lasting=lasting)) for lasting in (False, True))
    for camera, losses in ((once, 1), (ever, 3)):
        lost = 0
        for _ in range(4):
            try:
                camera.read()
            except DeviceError:
                lost += 1
        assert lost == losses


KILLED = """
import sys
sys.path += ["../..", "../support", "../pollination"]
from pathlib import Path
from fake_robot import LIMITS, fake_robot
from test_execution import PLANNER, Plan
from anther.pollination.execution import Trial, execute
from anther.core.runs import Run
from evaluation.robustness.faulty_machines import Fault, with_faults
with Run(Path(sys.argv[1]), quiet=True) as run:
    robot = with_faults(fake_robot(), Fault("kill -9", 3, 0.5))
    run.stage("execution", Trial.load, lambda _: execute(PLANNER, Plan(), robot, LIMITS))
"""


def test_kill_9_in_the_shake_is_on_record_and_the_run_goes_on(tmp_path: Path) -> None:
    words = [sys.executable, "-c", KILLED, str(tmp_path)]
    assert subprocess.run(words, cwd=Path(__file__).parent, check=False).returncode == -signal.SIGKILL
    noted = read_json(tmp_path / "progress.json")
    assert (noted["stage"], noted["failure"]) == ("execution", "interrupted")
    assert "--restart-from" in noted["message"]
    arm, gripper = FakeArm(np.asarray(GRASP.joints)), FakeGripper()  # as the killed process left them
    gripper.move(0.0065)
    with Run(tmp_path, restart_from="where-it-stopped", quiet=True) as run:
        run.stage("execution", Trial.load, lambda _: execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS))
    assert Trial.load(tmp_path / "09_trial.npz").finished
    assert gripper.commands[1] == GRASP.opening  # it lets go before it moves


# The simulated arm: real servos, real contact.


@pytest.fixture
def cell() -> Cell:
    return Cell(straight_plant())


@pytest.mark.parametrize("kind", ["arm stops", *STALE, "ctrl-c"])
def test_the_simulated_arm_stops_dead(cell: Cell, kind: Kind) -> None:
    robot = with_faults(robot_of(cell), Fault(kind, 0, 0.5))
    path = SmallPlanner().move(cell.joints, cell.joints + 0.3)
    with pytest.raises((StageFailure, KeyboardInterrupt)):
        GuardedArm(robot.arm, LIMITS).follow(path)
    stopped = cell.joints
    SimArm(cell).hold()
    assert cell.joints == pytest.approx(stopped, abs=2e-3)
    assert 0.02 < np.abs(stopped - SAWYER.neutral).max() < 0.28


def test_the_simulated_arm_feels_what_it_runs_into() -> None:
    above = SAWYER.forward(SAWYER.neutral)
    above[:3, 3] = [0.6, 0.25, -0.30]  # the fingertips are 4 cm above the bench
    below = above.copy()
    below[2, 3] -= 0.12
    cell = Cell(straight_plant(), solve(above))
    assert contact_force(cell) == 0
    felt: list[ArmSample] = []
    with pytest.raises(StageFailure, match="contact force") as failure:
        GuardedArm(SimArm(cell), LIMITS).follow(SmallPlanner().line(cell.joints, below, 0.05), felt.append)
    assert failure.value.kind == "collision"
    assert max(s.force for s in felt) <= LIMITS.contact_force
    log = cell.log()
    touched = log.times[log.contact_sample[log.contact_force > 0].min()]
    assert cell.time - touched < 0.4
    assert np.abs(cell.joints - felt[-1].measured).max() < 0.01


@pytest.mark.parametrize(
    ("execution", "told"),
    [
        ("interrupted", "interrupted"),
        ("device_fault", "device_fault"),
        ("nothing_grasped", "slipped"),
        (None, "slipped"),
    ],
)
def test_trial_json_names_the_fault_rather_than_what_the_judge_found(execution: str | None, told: str) -> None:
    done: Any = SimpleNamespace(trial=SimpleNamespace(failure=execution, stop_reason="the cable"))
    parts = {"unharmed": True, "flowers_moved": True, "organ_grasped": "stem"}
    verdict: Any = SimpleNamespace(success=False, held=False, failure="slipped", reason="it slipped", **parts)
    summary = _verdict(done, verdict, None)
    assert summary["failure"] == told
    assert summary["message"] == ("it slipped" if told == "slipped" else "the cable")
    held: Any = SimpleNamespace(success=True, held=True, failure=None, reason="", **parts)
    summary = _verdict(done, held, None)
    assert summary["held_unharmed"] == summary["held"] == (told == "slipped")
