"""Shake planning: observables are right, limits hold, the choice does not depend on the frame, and it is explained."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_plants import branched, grasps_on, read_paper_plant, turned
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Array
from anther.perception.flowers import Flowers
from anther.plant.belief import EarlierShake
from anther.plant.limits import PEAKS
from anther.plant.model import TOMATO, Material, PlantModel, build_plant
from anther.pollination.grasp import Grasp
from anther.pollination.shake import (
    SAWYER,
    VIBRATING_GRIPPER,
    Params,
    ShakePlan,
    arm_shaker,
    moved_plan,
    plan_shake,
    sawyer_limit,
)
from anther.pollination.shake.choice import DIRECTIONS
from anther.pollination.shake.observables import observables, semi_major
from anther.pollination.shake.params import MOST_DURATION
from anther.rods import Drive, equilibrium, frequency_response
from evaluation.prediction.steady import steadily_shaken

QUICK = Params(frequencies=12)


@pytest.fixture(scope="module")
def plant() -> PlantModel:
    skeleton, stem, flowers = branched()
    return build_plant(skeleton, stem, flowers, None, TOMATO)


@pytest.fixture(scope="module")
def grasps() -> list[Grasp]:
    skeleton, stem, _ = branched()
    return grasps_on(skeleton, stem, [8, 14, 20])


@pytest.fixture(scope="module")
def plan(plant: PlantModel, grasps: list[Grasp]) -> ShakePlan:
    return plan_shake(plant, grasps, params=QUICK)


@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6))
def test_semi_major_is_the_largest_excursion(parts: list[float]) -> None:
    v = np.array(parts[:3]) + 1j * np.array(parts[3:])
    phase = np.exp(1j * np.linspace(0, 2 * np.pi, 2001))
    sampled = np.linalg.norm((phase[:, None] * v).real, axis=1).max()
    assert semi_major(v[None])[0] == pytest.approx(sampled, rel=1e-5, abs=1e-12)


def seen_sizes(plant: PlantModel, moved: Array) -> dict[str, Array]:
    """Return what is seen of displacements and spins (N, 4)."""
    seen = observables(plant)
    size = np.linalg.norm((seen.operator @ moved.ravel()).reshape(-1, 3), axis=1)
    return {
        name: size[getattr(seen, name)]
        for name in ("flowers", "stem_strain", "joint_strain", "base_strain", "leaf_load")
    }


def test_rigid_motion_strains_nothing_and_loads_a_leaf_with_its_acceleration(plant: PlantModel) -> None:
    x = plant.rods.nodes - plant.rods.nodes[0]
    moved = seen_sizes(plant, np.tile([1.0, 0.0, 0.0, 0.0], (len(x), 1)))
    for kind in ("stem_strain", "joint_strain", "base_strain"):
        assert moved[kind].max() < 1e-9
    assert moved["flowers"] == pytest.approx(1.0)
    assert np.all((moved["leaf_load"] > 0.3) & (moved["leaf_load"] <= 1 + 1e-9))
    along = x - x[np.maximum(plant.rods.parent, 0)]
    along[1:] /= np.linalg.norm(along[1:], axis=1)[:, None]
    rocked = seen_sizes(plant, np.column_stack([np.cross([0.0, 1.0, 0.0], x), along[:, 1]]))
    assert np.sort(rocked["stem_strain"])[:-1].max() < 1e-9
    assert rocked["stem_strain"].max() > 0.1  # the soil does not rock along


def test_stem_strain_is_moment_over_section_modulus() -> None:
    skeleton, stem, flowers = branched(radius=(4e-3, 4e-3))
    plant = build_plant(skeleton, stem, flowers, None, TOMATO)
    top, push = int(plant.stem_nodes[-1]), 1e-4  # [N], sideways
    load = np.zeros(len(plant.rods.nodes))
    load[top] = push / 10
    pushed = replace(plant.rods, density=1e-3, lumped_mass=load, natural=None)
    moved = np.zeros((len(load), 4))
    moved[:, :3] = equilibrium(pushed, plant.clamp, gravity=(10, 0, 0)) - plant.rods.nodes
    joints = plant.rods.nodes[plant.stem_nodes[2:-1], 2]
    youngs = np.asarray(plant.rods.youngs)[plant.stem_nodes[1]]
    strain = push * (plant.rods.nodes[top, 2] - joints) * 4e-3 / (youngs * np.pi * 4e-3**4 / 4)
    rows = [list(observables(plant).edges).index(j) for j in plant.stem_nodes[3:]]
    seen = seen_sizes(plant, moved)["stem_strain"][rows]
    np.testing.assert_allclose(seen, strain, rtol=2e-3, atol=1e-3 * strain.max())


def test_nonlinear_amplitude_agrees_with_linear_theory_for_small_shakes(plant: PlantModel) -> None:
    node, way, frequency = int(plant.stem_nodes[14]), np.array([1.0, 0.2, 0.0]), 6.0
    response = frequency_response(plant.rods_at(frequency), plant.clamp, node, way, [frequency])[0]
    linear = 1e-4 * semi_major(response[plant.flower_nodes])
    found = steadily_shaken(plant, Drive(node, way, 1e-4, frequency)).amplitude
    assert found == pytest.approx(linear, rel=0.03)


def test_the_plan_keeps_what_the_machine_manages_and_says_what_flowers_do(plan: ShakePlan, plant: PlantModel) -> None:
    shares = {name: share for name, *_, share in plan.limits}
    assert max(shares[name] for name in set(shares) - set(PEAKS.values())) <= 1 + 1e-9
    assert 0 < plan.score < 1
    arm = sawyer_limit(plan.grasp, plan.direction, np.array([plan.frequency]))[0]
    assert plan.amplitude <= arm * (1 + 1e-9)
    assert np.linalg.norm(plan.direction) == pytest.approx(1.0)
    assert plan.duration <= MOST_DURATION
    low, high = plan.predicted_amplitude_interval.T
    assert np.all((low <= plan.predicted_amplitude) & (plan.predicted_amplitude <= high))
    assert len(plan.predicted_amplitude) == len(plant.flower_nodes)
    omega2 = (2 * np.pi * plan.frequency) ** 2
    assert plan.predicted_acceleration == pytest.approx(omega2 * plan.predicted_amplitude)


def test_the_plan_explains_itself(plan: ShakePlan) -> None:
    for word in ("Hz", "mm", "limit", "Runner-up"):
        assert word in plan.reason
    assert plan.runner_up is not None
    assert plan.runner_up.score <= plan.score
    shown = plan.response_map
    assert shown.acceleration.shape == (len(shown.arc_length), QUICK.frequencies)
    assert np.all(np.diff(shown.arc_length) > 0)
    allowed = shown.amplitude >= SAWYER.least_amplitude
    assert np.array_equal(shown.acceleration > 0, allowed)
    assert allowed.any()


def test_turning_plant_and_grasps_turns_the_plan(plan: ShakePlan) -> None:
    skeleton, stem, flowers = branched()
    moved, blooms = turned(skeleton, flowers, np.pi / 2)
    other = plan_shake(
        build_plant(moved, stem, blooms, None, TOMATO), grasps_on(moved, stem, [8, 14, 20], np.pi / 2), params=QUICK
    )
    assert (other.grasp_index, other.frequency) == (plan.grasp_index, plan.frequency)
    assert other.amplitude == pytest.approx(plan.amplitude, rel=1e-6)
    assert other.predicted_amplitude == pytest.approx(plan.predicted_amplitude, rel=1e-6)
    assert abs(other.direction @ [-plan.direction[1], plan.direction[0], 0]) == pytest.approx(1, abs=1e-6)


def test_a_plan_made_before_its_plant_was_moved_is_the_one_made_there(plan: ShakePlan) -> None:
    skeleton, stem, flowers = branched()
    T, root = np.eye(4), skeleton.nodes[0]
    T[:3, :3] = Rotation.from_euler("z", np.pi / 2).as_matrix()
    T[:3, 3] = root - T[:3, :3] @ root
    there, blooms = turned(skeleton, flowers, np.pi / 2)
    grasps = grasps_on(there, stem, [8, 14, 20], np.pi / 2)
    anew = plan_shake(build_plant(there, stem, blooms, None, TOMATO), grasps, params=QUICK)
    moved = moved_plan(plan, T, grasps, SAWYER)
    assert moved is not None
    assert (moved.grasp, moved.grasp_index, moved.frequency) == (
        grasps[plan.grasp_index],
        anew.grasp_index,
        anew.frequency,
    )
    assert moved.amplitude == pytest.approx(anew.amplitude, rel=1e-6)
    assert abs(moved.direction @ anew.direction) == pytest.approx(1, abs=1e-6)
    assert moved.tones.reach == pytest.approx(anew.tones.reach, rel=1e-6)
    assert moved.predicted_acceleration == pytest.approx(anew.predicted_acceleration, rel=1e-6)
    without = [one for i, one in enumerate(grasps) if i != plan.grasp_index]
    assert moved_plan(plan, T, without, SAWYER) is None, "its grasp is out of reach"
    last = moved_plan(plan, T, grasps[plan.grasp_index :], SAWYER)
    assert last is not None
    assert last.grasp_index == 0, "into the grasps that are reached"


@pytest.mark.parametrize(("share", "kept"), [(0.9, True), (0.5, False)])
def test_a_moved_plan_is_what_the_arm_manages_there_or_made_anew(
    plan: ShakePlan, grasps: list[Grasp], share: float, kept: bool
) -> None:
    weaker = arm_shaker(lambda _, __, hertz: np.full(len(hertz), share * plan.amplitude))
    moved = moved_plan(plan, np.eye(4), grasps, weaker)
    assert (moved is not None) == kept
    if moved is not None:
        assert moved.amplitude == pytest.approx(share * plan.amplitude)
        assert moved.tones.reach.max() <= share * plan.amplitude * (1 + 1e-9)
        assert np.all(moved.tones.amplitudes <= moved.tones.reach)
        assert moved.predicted_amplitude == pytest.approx(share * plan.predicted_amplitude)


def test_a_stronger_arm_never_does_worse_and_a_dearer_flower_never_better(
    plant: PlantModel, grasps: list[Grasp], plan: ShakePlan
) -> None:
    strong = plan_shake(plant, grasps, arm_shaker(lambda g, d, f: 3 * sawyer_limit(g, d, f)), QUICK)
    gentle = plan_shake(plant, grasps, params=replace(QUICK, price=10 * QUICK.price))
    assert strong.score >= plan.score * 0.98, "amplitudes are weighed in steps"
    assert gentle.score < plan.score


def test_a_second_visit_begins_with_what_the_first_ended_with(
    plant: PlantModel, grasps: list[Grasp], plan: ShakePlan
) -> None:
    other = plan.runner_up
    assert other is not None
    arc = grasps[other.grasp_index].arc_length + 0.01  # as it is seen anew
    earlier = EarlierShake(arc, -plan.direction, other.frequency * 1.02, 0.4 * other.amplitude)
    again = plan_shake(plant, grasps, params=QUICK, earlier=earlier)
    assert (again.grasp_index, again.frequency) == (other.grasp_index, pytest.approx(other.frequency))
    assert abs(again.direction @ plan.direction) > np.cos(np.pi / DIRECTIONS)
    assert again.tones.frequencies == pytest.approx([other.frequency])
    assert again.tones.amplitudes == pytest.approx(np.array([[earlier.amplitude]]))
    assert len(plan.tones.frequencies) > 1
    assert "earlier visit" in again.notes[-1]
    elsewhere = replace(earlier, arc_length=arc + 0.5)
    for stranger in (elsewhere, replace(earlier, frequency=500.0)):
        assert plan_shake(plant, grasps, params=QUICK, earlier=stranger).frequency == plan.frequency


def test_tones_may_be_tried_along_every_line_across_the_stem(
    plant: PlantModel, grasps: list[Grasp], plan: ShakePlan
) -> None:
    tones = plan.tones
    assert tones.directions.shape == (DIRECTIONS, 3)
    assert tones.directions[0] == pytest.approx(plan.direction)
    assert tones.frequencies[0] == plan.frequency
    assert tones.amplitudes.shape == tones.reach.shape == (len(tones.frequencies), DIRECTIONS)
    alike = np.abs(np.triu(tones.directions @ tones.directions.T, 1))
    assert alike.max() < 0.99, "each is another line"
    assert tones.probed[0] == 0
    assert abs(tones.directions[0] @ tones.directions[tones.probed[1]]) == pytest.approx(alike[0, 1:].min())
    for line, reach in zip(tones.directions, tones.reach.T, strict=True):
        allowed = SAWYER.amplitude(plan.grasp, line, tones.frequencies)
        assert np.all(reach <= allowed * (1 + 1e-9))
    along = plan.direction
    narrow = arm_shaker(lambda grasp, line, f: sawyer_limit(grasp, line, f) if abs(line @ along) > 0.5 else 0.0 * f)
    kept = plan_shake(plant, grasps, narrow, QUICK)
    assert kept.tones.directions == pytest.approx(kept.direction[None]), "no room across: along its own line alone"
    alone = plan_shake(plant, grasps, VIBRATING_GRIPPER, QUICK).tones
    assert (alone.directions.shape, alone.probed) == ((1, 3), (0,)), "a motor moves the pads along one line"


def test_an_earlier_shake_is_no_larger_than_the_arm_manages(
    plant: PlantModel, grasps: list[Grasp], plan: ShakePlan
) -> None:
    earlier = EarlierShake(plan.grasp.arc_length, plan.direction, plan.frequency, 1.0)
    tones = plan_shake(plant, grasps, params=QUICK, earlier=earlier).tones
    assert tones.amplitudes == pytest.approx(tones.reach)
    assert tones.reach[0, 0] < 0.2


def test_the_choice_is_among_the_grasps(plant: PlantModel, grasps: list[Grasp], plan: ShakePlan) -> None:
    alone = plan_shake(plant, [grasps[plan.grasp_index]], params=QUICK)
    assert alone.frequency == plan.frequency
    assert alone.grasp_index == 0


def test_nothing_to_shake_for_nothing_to_hold_nothing_allowed(plant: PlantModel, grasps: list[Grasp]) -> None:
    skeleton, stem, _ = branched()
    barren = build_plant(skeleton, stem, Flowers(np.zeros((0, 3)), np.zeros(0, dtype=int)), None, TOMATO)
    for args, kind in (((barren, grasps), "no_flowers_found"), ((plant, []), "no_grasp_found")):
        with pytest.raises(StageFailure) as failure:
            plan_shake(*args, params=QUICK)
        assert failure.value.kind == kind
    with pytest.raises(StageFailure, match="closest limit is arm amplitude") as failure:
        plan_shake(plant, grasps, arm_shaker(lambda g, d, f: np.zeros(len(f))), QUICK)
    assert failure.value.kind == "limits_exceeded"


def test_a_plan_that_is_read_back_holds_the_grasp_as_it_was(plan: ShakePlan, tmp_path: Path) -> None:
    held = replace(plan.grasp, opening=0.024, squeezed=0.003, confidence=0.9, joints=np.arange(7.0))
    replace(plan, grasp=held).save(tmp_path / "plan.json")
    again = ShakePlan.load(tmp_path / "plan.json").grasp
    for name in Grasp.__dataclass_fields__:
        assert np.all(getattr(again, name) == pytest.approx(getattr(held, name))), name


def test_round_trip(plan: ShakePlan, tmp_path: Path) -> None:
    plan.save(tmp_path / "plan.json")
    again = ShakePlan.load(tmp_path / "plan.json")
    assert again.limits == plan.limits
    assert again.runner_up == plan.runner_up
    assert (again.reason, again.notes, again.grasp_index) == (plan.reason, plan.notes, plan.grasp_index)
    assert np.array_equal(again.predicted_amplitude_interval, plan.predicted_amplitude_interval)
    assert np.array_equal(again.response_map.acceleration, plan.response_map.acceleration)
    assert again.grasp.T_world_flange == pytest.approx(plan.grasp.T_world_flange)
    for text in ("{", "[]", '{"kind": "shake plan", "schema": 6}'):
        (tmp_path / "broken.json").write_text(text)
        with pytest.raises(InputError):
            ShakePlan.load(tmp_path / "broken.json")


@pytest.mark.parametrize("part", ["tones", "pads", "response_map", "grasp"])
def test_only_a_runner_up_may_be_missing_in_a_plan(plan: ShakePlan, tmp_path: Path, part: str) -> None:
    path = tmp_path / "plan.json"
    replace(plan, runner_up=None).save(path)
    assert ShakePlan.load(path).runner_up is None
    path.write_text(json.dumps(json.loads(path.read_text()) | {part: None}))
    with pytest.raises(InputError):
        ShakePlan.load(path)


def test_default_arm_limit_is_the_tabulated_one(grasps: list[Grasp]) -> None:
    f = np.array([1.0, 5.0, 10.0, 30.0, 60.0])
    approach, lateral = (sawyer_limit(grasps[0], np.array(d), f) for d in ([1.0, 0, 0], [0, 1.0, 0]))
    assert approach == pytest.approx([0.111, 4.4e-3, 1.1e-3, 0.12e-3, 0.03e-3])
    assert lateral == pytest.approx([0.180, 7.2e-3, 1.8e-3, 0.20e-3, 0.05e-3])


@given(st.floats(-1.4, 1.4))
def test_default_arm_limit_turns_with_the_approach(pitch: float) -> None:
    """The tables are of the approach, the line across it, and what is across both, however steep the approach is."""
    skeleton, stem, _ = branched()
    level, f = grasps_on(skeleton, stem, [8])[0], np.array([1.0, 5.0, 30.0])
    turn = Rotation.from_euler("y", pitch).as_matrix()
    steep = replace(level, approach=turn @ level.approach)
    for axis in np.eye(3):
        assert sawyer_limit(steep, turn @ axis, f) == pytest.approx(sawyer_limit(level, axis, f))


@given(st.floats(0, 6.28), st.floats(-1, 1))
def test_default_arm_limit_is_below_every_axis_share(angle: float, rise: float) -> None:
    skeleton, stem, _ = branched()
    grasp = grasps_on(skeleton, stem, [8])[0]
    d = np.array([np.cos(angle), np.sin(angle), rise])
    d /= np.linalg.norm(d)
    f = np.array([1.0, 3.0, 12.0, 40.0])
    found = sawyer_limit(grasp, d, f)
    assert np.all(np.diff(found) < 0)
    for axis in np.eye(3):
        assert np.all(found * abs(d @ axis) <= sawyer_limit(grasp, axis, f) * (1 + 1e-9))


@given(
    st.sampled_from(["lowest", "frequencies", "price", "duration"]),
    st.sampled_from([-1.0, float("nan")]),
)
def test_impossible_parameters_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError):
        Params(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(("name", "flower"), [("tomato2", 73), ("pepper0", 143)])
def test_the_papers_plants_can_be_planned_for(data: Path, name: str, flower: int) -> None:
    skeleton, stem, flowers = read_paper_plant(data / "skeletons" / f"{name}.txt", flower)
    plant = build_plant(skeleton, stem, flowers, None, Material(youngs=3e8))
    plan = plan_shake(plant, grasps_on(skeleton, stem, [10, 25]), params=replace(QUICK, frequencies=6))
    assert np.all(plan.predicted_amplitude > 0)
    assert max(share for *_, share in plan.limits) <= 1 + 1e-9
