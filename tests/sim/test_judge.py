"""The judge on a straight plant: a good grasp, and each way to fail."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from fake_robot import LIMITS, horizontal_grasp
from small_planner import SmallPlanner, solve
from straight_plant import BASE, straight_plant, with_blade

from anther.core.geometry import Array
from anther.pollination.execution import Trial, execute
from anther.pollination.grasp import Grasp
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.devices import Robot
from anther.sim import judge as judging
from anther.sim.cell import BENCH, Cell
from anther.sim.judge import Verdict, judge
from anther.sim.plant import Organ, SimPlant
from anther.sim.robot import SimArm, SimGripper, robot_of

HEIGHT = 0.22
GRASP = horizontal_grasp(np.add(BASE, [0, 0, HEIGHT]), np.zeros(7), diameter=0.0082)
GRASP = replace(GRASP, joints=solve(GRASP.T_world_flange))
PLANNER = SmallPlanner()


@dataclass(frozen=True)
class Plan:
    grasp: Grasp = GRASP
    amplitude: float = 0.001
    frequency: float = 5.0
    duration: float = 1.0
    direction: Array = field(default_factory=lambda: np.array([0, 1.0, 0]))
    press: float = 8.0


def near_plant(joints: Array, plant: SimPlant | None = None, **kind: float) -> Cell:
    """A cell whose arm already stands close to the plant, which saves simulated seconds."""
    back = PLANNER.line(joints, moved(SAWYER.forward(joints), -0.13), 0.3)
    return Cell(plant or straight_plant(**kind), back.positions[-1])


def moved(T: Array, along: float) -> Array:
    out = T.copy()
    out[:3, 3] += along * T[:3, 2]
    return out


def trial_of(cell: Cell, plan: Plan) -> tuple[Trial, Verdict]:
    robot = Robot(SimArm(cell), SimGripper(cell), robot_of(cell).wrist_camera)
    trial = execute(PLANNER, plan, robot, LIMITS)
    times = trial.shake_times
    return trial, judge(cell, (times[0], times[-1]) if len(times) else None, plan.frequency)


@pytest.fixture(scope="module")
def held() -> tuple[Cell, Trial, Verdict]:
    """A cell in which the stem was held in the middle and shaken."""
    cell = near_plant(GRASP.joints)  # type: ignore[arg-type]
    return cell, *trial_of(cell, Plan())


def test_a_stem_in_the_middle_is_held_through_the_shake(held: tuple[Cell, Trial, Verdict]) -> None:
    _, trial, verdict = held
    assert trial.finished, trial.stop_reason
    assert verdict.held, verdict.reason
    assert verdict.unharmed, verdict.harm.words
    assert (verdict.organ_grasped, verdict.failure) == ("stem", None)
    assert verdict.grasp_height == pytest.approx(HEIGHT, abs=0.02)
    assert verdict.slip < 0.002
    assert verdict.push < 0.1
    assert 0.1 < verdict.effort < 0.9
    # the arm really shook as far as it was told
    y = SAWYER.forward(trial.measured)[:, 1, 3]
    assert np.ptp(y) / 2 == pytest.approx(0.001, rel=0.1)
    assert verdict.flower_amplitude[0] > 0.0005
    # a sinusoid of that amplitude needs about this much acceleration; the pedicel rings as well
    steady = verdict.flower_amplitude[0] * (2 * np.pi * 5) ** 2
    assert verdict.flower_acceleration_peak[0] == pytest.approx(steady, rel=0.6)
    # held and unharmed, and yet it freed next to nothing: 3.7 m/s2
    assert (verdict.flowers_moved, verdict.success) == (False, False)


def test_a_shake_that_moves_the_flowers_as_well_is_a_success() -> None:
    cell = near_plant(GRASP.joints)  # type: ignore[arg-type]
    verdict = trial_of(cell, Plan(amplitude=0.002, frequency=6.0, duration=0.6))[1]
    assert verdict.flower_acceleration_peak[0] > 5
    assert verdict.success, (verdict.reason, verdict.harm.loads)


def test_what_this_plant_bears_decides_what_counts_as_damage(
    held: tuple[Cell, Trial, Verdict], monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, trial, verdict = held
    assert min(verdict.harm.loads.values()) > 0, "every kind of organ bears something"
    for kind, load in verdict.harm.loads.items():
        weak = {**verdict.harm.limits, kind: 0.99 * load}
        monkeypatch.setattr(judging, "tolerances", lambda *_, weak=weak: weak)
        again = judge(cell, (trial.shake_times[0], trial.shake_times[-1]), 5.0)
        assert (again.held, again.unharmed, again.failure) == (True, False, "damaged")
        assert again.harm.passed == (kind,)
        assert again.harm.probability == verdict.harm.probability, "it asks what plants bear, not what this one does"


def test_a_motor_at_its_limit_is_limits_exceeded() -> None:
    cell = near_plant(GRASP.joints)  # type: ignore[arg-type]
    there = cell.joints - [0, 0, 0, 0, 0.5, 0, 0]
    n = 100
    cell.run(np.linspace(cell.joints, there, n), np.zeros((n, 7)), np.full(n, cell.grip_command))
    verdict = judge(cell, None, 5.0)
    assert verdict.effort == pytest.approx(1.0, abs=1e-3)
    assert (verdict.failure, verdict.reason) == ("limits_exceeded", "motor 4 was at its torque limit")


def test_a_grasp_beside_the_stem_holds_nothing() -> None:
    aside = horizontal_grasp(np.add(BASE, [0.0, 0.05, HEIGHT - 0.1]), np.zeros(7))
    aside = replace(aside, joints=solve(aside.T_world_flange, GRASP.joints))
    assert aside.joints is not None
    trial, verdict = trial_of(near_plant(aside.joints, side=-1.0), Plan(grasp=aside))
    assert trial.failure == "nothing_grasped"
    assert verdict.failure == "nothing_grasped"
    assert verdict.organ_grasped == ""
    assert np.isnan(verdict.flower_amplitude).all()


def test_a_petiole_between_the_pads_is_a_branch_grasped() -> None:
    plant = straight_plant(leaf=0.001)
    petiole = slice(20, 24)
    point = (plant.start[petiole][2] + plant.end[petiole][2]) / 2
    grasp = horizontal_grasp(point, np.zeros(7), diameter=0.0035)
    T = grasp.T_world_flange.copy()
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # the fingers close up and down: the petiole lies across
    T[:3, :3] = turn @ T[:3, :3]
    T[:3, 3] = point - T[:3, :3] @ TOOL.T_flange_grasp[:3, 3]
    grasp = replace(grasp, T_world_flange=T, approach=T[:3, 2])
    grasp = replace(grasp, joints=solve(T, GRASP.joints))
    assert grasp.joints is not None
    trial, verdict = trial_of(near_plant(grasp.joints, leaf=0.001), Plan(grasp=grasp, duration=0.5, press=5.0))
    assert trial.finished, trial.stop_reason
    assert verdict.failure == "branch_or_leaf_grasped"
    assert verdict.organ_grasped == "petiole"


def test_a_petiole_between_the_pads_beside_the_stem_is_told() -> None:
    fork = horizontal_grasp(np.add(BASE, [0, 0, 0.367]), np.zeros(7), diameter=0.0085)
    fork = replace(fork, joints=solve(fork.T_world_flange, GRASP.joints))
    assert fork.joints is not None
    plant = straight_plant(leaf=0.001)
    soft = replace(plant, youngs=np.where(plant.organ == Organ.PETIOLE, 0.5, 1.0) * plant.youngs)
    verdict = trial_of(near_plant(fork.joints, soft), Plan(grasp=fork, duration=0.5))[1]
    assert verdict.organ_grasped == "stem"
    assert verdict.held_beside == ("petiole",)
    assert "with a petiole" in verdict.reason


def test_a_stem_too_slippery_to_hold_has_slipped() -> None:
    cell = near_plant(GRASP.joints)  # type: ignore[arg-type]
    cell.model.pair_friction[:, :2] = 0.005
    up = Plan(amplitude=0.01, frequency=2.0, duration=1.0, direction=np.array([0, 0, 1.0]))
    trial, verdict = trial_of(cell, up)
    assert trial.finished, trial.stop_reason
    assert verdict.slip > 0.005
    assert verdict.failure == "slipped"


def test_a_leaf_in_the_way_is_felt_but_gives_way() -> None:
    """A blade across the way in, on a petiole: it is pushed, softly, and does not hinder the grasp."""
    assert GRASP.joints is not None
    plant = with_blade(straight_plant(), np.add(BASE, [-0.03, 0.0, HEIGHT]), [1, 0.2, 0], segment=23)
    cell = near_plant(GRASP.joints, plant)
    trial, verdict = trial_of(cell, Plan(duration=0.5))
    assert trial.finished, trial.stop_reason
    log = cell.log()
    assert log.contact_blade.any()
    assert log.contact_force[log.contact_blade].max() > 0.002
    assert verdict.push < 2.0
    assert (verdict.organ_grasped, verdict.failure) == ("stem", None)


@pytest.mark.parametrize("opening", [TOOL.stroke, 0.024])
def test_driving_through_the_plant_is_a_collision(opening: float) -> None:
    assert GRASP.joints is not None
    cell = near_plant(GRASP.joints)
    SimGripper(cell).move(opening)
    side = PLANNER.line(cell.joints, moved(SAWYER.forward(cell.joints), 0.13), 0.3)
    SimArm(cell).follow(side)
    across = SAWYER.forward(cell.joints).copy()
    across[1, 3] += 0.25
    SimArm(cell).follow(PLANNER.line(cell.joints, across, 0.3))
    verdict = judge(cell, None, 5.0)
    assert verdict.push > 2.0
    assert verdict.failure == "collision"
    assert "pushed" in verdict.reason


def test_touching_the_pot_is_a_collision() -> None:
    low = horizontal_grasp(np.add(BASE, [0, 0, -0.05]), np.zeros(7))
    q = solve(low.T_world_flange, GRASP.joints)
    cell = near_plant(q)
    SimArm(cell).follow(PLANNER.line(cell.joints, low.T_world_flange, 0.2))
    verdict = judge(cell, None, 5.0)
    assert (verdict.failure, verdict.reason) == ("collision", "the robot touched the pot or the bench")


def test_touching_the_bench_is_a_collision() -> None:
    beside = horizontal_grasp(np.add(BASE, [0, 0.2, -0.16]), np.zeros(7))
    q = solve(beside.T_world_flange, GRASP.joints)
    cell = near_plant(q)
    SimArm(cell).follow(PLANNER.line(cell.joints, moved(beside.T_world_flange, -0.1), 0.3))
    down = SAWYER.forward(cell.joints).copy()
    down[2, 3] -= 0.05
    SimArm(cell).follow(PLANNER.line(cell.joints, down, 0.1))
    assert BENCH in cell.log().contact_other
    assert judge(cell, None, 5.0).failure == "collision"


def test_holding_a_stem_puts_no_energy_into_it() -> None:
    assert GRASP.joints is not None
    cell = near_plant(GRASP.joints)
    SimArm(cell).follow(PLANNER.line(cell.joints, GRASP.T_world_flange, 0.3))
    SimGripper(cell).move(0.007)

    def speed() -> float:
        n = 200
        cell.run(np.tile(cell.arm_command, (n, 1)), np.zeros((n, 7)), np.full(n, cell.grip_command))
        return float(np.abs(cell.data.qvel[cell.mechanics.dofs]).max())

    first = speed()
    later = [speed() for _ in range(5)]
    assert later[-1] < 0.5 * first + 1e-3
