"""A greenhouse row: stems on strings against closed forms, what is drawn, what is in the way, what cameras see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cache
from itertools import islice
from types import SimpleNamespace as Namespace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import j0, j1, y0, y1
from straight_plant import chain, plant_of

from anther.core.choices import Crop
from anther.core.errors import InputError
from anther.core.geometry import transform
from anther.robot.arm._kinematics import inverse_many
from anther.robot.arm._tours import least_times
from anther.robot.arm.sawyer import SAWYER
from anther.sim.cell import NEIGHBOUR, Cell
from anther.sim.judge import string_pull
from anther.sim.pieces import Params
from anther.sim.plant import GRAVITY, Organ, Pot, SimPlant, Twine
from anther.sim.plant_mechanics import PlantMechanics, alone, mujoco
from anther.sim.row import Row, grow_row
from anther.sim.row_cell import HOOK_ERROR, _waits, before_arm, mapped_others, mapped_string, row_layout, row_world
from anther.sim.row_house import RANGES, Measures
from anther.sim.row_plants import HABIT, held_by_string
from anther.sim.sway import gusts
from anther.sim.true_plant import as_true
from anther.sim.truth import draw

CROPS = ("tomato", "pepper")


@cache
def row(crop: str) -> Row:
    return grow_row(crop, 5, 4)  # type: ignore[arg-type]


@cache
def worked(crop: str) -> SimPlant:
    return held_by_string(row(crop).worked)


def pulled(
    length: float, radius: float, youngs: float, per_metre: float, tension: float, above: float = 0.3, pieces: int = 60
) -> SimPlant:
    """Return a uniform upright stem, clamped at its foot, pulled up by a string of `above` [m]."""
    stem = chain(np.linspace(0, length, pieces + 1)[:, None] * [0, 0, 1.0], radius, youngs=youngs)
    stem["density"][:] = per_metre / (np.pi * radius**2)
    twine = Twine(np.array([0, 0, length + above]), pieces - 1, tension, 1e4)
    return replace(plant_of(stem), pot=Pot(np.zeros(3), 0.0), twines=(twine,), bend_over_twist=1.5)


def string_frequency(length: float, per_metre: float, tension: float, above: float) -> float:
    """Return f1 [Hz] of a heavy string from a fixed foot, with `tension` [N] at its top, on a light one of `above`.

    y(s) = A J0(2 w sqrt(s / g)) + B Y0(...), where s is the length of string whose weight would be the tension.
    """
    low, high = tension / per_metre / GRAVITY - length, tension / per_metre / GRAVITY

    def mismatch(frequency: float) -> float:
        w = 2 * np.pi * frequency
        a, b = 2 * w * np.sqrt(low / GRAVITY), 2 * w * np.sqrt(high / GRAVITY)
        value = j0(b) * y0(a) - j0(a) * y0(b)
        slope = (-j1(b) * y0(a) + j0(a) * y1(b)) * w / np.sqrt(high * GRAVITY)
        return float(slope + value / above)

    tried = np.linspace(0.05, 3, 400)
    first = int(np.flatnonzero(np.diff(np.sign([mismatch(f) for f in tried])))[0])
    return float(brentq(mismatch, tried[first], tried[first + 1]))


def bending_modes(plant: SimPlant) -> PlantMechanics:
    return alone(plant, Params(twisting=()))


@pytest.mark.parametrize("tension", [45.0, 50.0, 60.0])
def test_a_pulled_stem_swings_as_a_hanging_string(tension: float) -> None:
    # so soft that bending does nothing: 1.5 kg/m over 2.8 m hang on 45 to 60 N; facts: rows 0 have 0.6 to 0.8 Hz
    found = bending_modes(pulled(2.8, 0.006, 2e6, 1.5, tension)).frequencies[0]
    expected = string_frequency(2.8, 1.5, tension, 0.3)
    assert 0.55 < expected < 0.85
    assert found == pytest.approx(expected, rel=0.03)


def test_a_stem_without_its_string_would_fall() -> None:
    with pytest.raises(Exception, match="cannot carry its own weight"):
        bending_modes(replace(pulled(2.8, 0.006, 2e6, 1.5, 50.0), twines=()))


@pytest.mark.parametrize(("tension", "youngs", "radius"), [(40.0, 1e8, 0.006), (60.0, 1e8, 0.006), (50.0, 6e7, 0.005)])
def test_bending_dies_out_beside_a_push(tension: float, youngs: float, radius: float) -> None:
    """A long beam under tension that is pushed in its middle bends by exp(-x / sqrt(EI / T))."""
    plant = pulled(1.2, radius, youngs, 0.02, tension, pieces=240)
    mechanics = alone(plant, Params(piece=0.005, twisting=()))
    data, middle = mujoco.MjData(mechanics.model), mechanics.bodies[len(mechanics.bodies) // 2]
    mujoco.mj_forward(mechanics.model, data)
    place = np.zeros((3, mechanics.model.nv))
    mujoco.mj_jac(mechanics.model, data, place, None, data.xpos[middle], middle)
    angles = np.linalg.solve(mechanics.stiffness(data), place[0, mechanics.dofs])
    strain = np.linalg.norm(mechanics.bending(angles), axis=1)
    away = np.abs(data.xpos[mechanics.bodies, 2] - data.xpos[middle, 2])
    expected = np.sqrt(youngs * np.pi / 4 * radius**4 / tension)
    near = (away > 0.01) & (away < 3 * expected)
    assert -1 / np.polyfit(away[near], np.log(strain[near]), 1)[0] == pytest.approx(expected, rel=0.02)


def test_stiffness_is_how_torques_change_with_the_hinges() -> None:
    """Two stems on two strings, bent aside: weight, strings and springs, by central differences of MuJoCo's torques."""
    mechanics, step = alone(worked("pepper"), Params()), 1e-5
    m, data, rng = mechanics.model, mujoco.MjData(mechanics.model), np.random.default_rng(0)
    data.qpos[:] = rng.normal(0, 0.02, m.nq)
    mujoco.mj_forward(m, data)
    columns = rng.choice(m.nv, 25, replace=False)
    found = mechanics.stiffness(data)[:, columns]
    torques = []
    for column in columns:
        for sign in (1, -2):
            data.qpos[mechanics.dofs[column]] += sign * step
            mujoco.mj_forward(m, data)
            torques.append((data.qfrc_bias - data.qfrc_spring)[mechanics.dofs])
        data.qpos[mechanics.dofs[column]] += step
    expected = (np.array(torques[::2]) - np.array(torques[1::2])).T / (2 * step)
    assert len(mechanics.plant.twines) == 2
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def test_a_pulled_stem_stays_where_it_hangs() -> None:
    mechanics = alone(pulled(2.8, 0.006, 1e8, 1.5, 50.0), Params())
    data = mujoco.MjData(mechanics.model)
    for _ in range(500):
        mujoco.mj_step(mechanics.model, data)
    assert np.abs(data.qpos).max() < 1e-6


@pytest.mark.parametrize("crop", CROPS)
def test_a_plant_hangs_on_what_it_weighs_and_rests_as_it_grew(crop: str) -> None:
    plant = worked(crop)
    weight = GRAVITY * float((plant.mass + plant.lump_mass).sum())
    lifts = sum(twine.tension for twine in plant.twines)
    assert weight < lifts < 1.3 * weight
    if crop == "tomato":
        assert 35 < lifts < 65, "4 to 6 kg hang on a string"
    mechanics = alone(plant, Params())
    assert mechanics.frequencies[0] > 0, "it is stable"
    data = mujoco.MjData(mechanics.model)
    mujoco.mj_forward(mechanics.model, data)
    assert np.abs(data.qacc).max() < 1e-3, "at rest"


@pytest.mark.parametrize("crop", CROPS)
def test_a_flower_is_of_the_stem_that_it_grows_on(crop: str) -> None:
    """Of a pepper's two stems the first one's flowers are its visit's; a tomato has one stem."""
    plant = worked(crop)
    first, *others = plant.twines
    own = plant.on_first_string()

    def nearer(place: np.ndarray, twine: Twine) -> float:
        return float(np.linalg.norm(place[:2] - plant.end[twine.segment][:2]))

    for flower, place in enumerate(plant.flower_position):
        assert own[flower] == all(nearer(place, first) < nearer(place, other) for other in others)
    assert own.any()
    assert own.all() == (crop == "tomato")


def test_a_pepper_turned_to_its_other_string_has_its_other_stem_for_its_main_one() -> None:
    plant = worked("pepper")
    turned = plant.turned_to(1)
    assert [twine.hook.tolist() for twine in turned.twines] == [twine.hook.tolist() for twine in plant.twines[::-1]]
    assert (turned.on_first_string() == ~plant.on_first_string()).all()
    stem, other = turned.stem_segments(), plant.stem_segments()
    assert turned.twines[0].segment in stem
    assert turned.twines[0].segment not in other
    assert np.isin(stem, other).sum() == 5, "below the fork"
    assert (plant.parent[stem[1:]] == stem[:-1]).all(), "one way from the foot to the head"
    for name in ("organ", "face_organ"):
        assert not np.array_equal(getattr(turned, name), getattr(plant, name))
        np.testing.assert_array_equal(getattr(turned.turned_to(1), name), getattr(plant, name))


@pytest.mark.parametrize("crop", CROPS)
def test_nothing_bends_a_stem_on_its_string(crop: str) -> None:
    """What the springs of the main stem must carry is a small share of what they would without the string."""
    plant = row(crop).worked
    bound = 0.25  # N m, of a truss of 0.6 kg that hangs 4 cm beside the stem
    stem = plant.stem_segments()
    top = plant.twines[0]
    above = [k for k in stem if plant.end[k, 2] < plant.end[top.segment, 2] and plant.start[k, 2] > 1.4]
    own = plant.mass + plant.lump_mass
    centre = plant.mass[:, None] * (plant.start + plant.end) / 2 + plant.lump_mass[:, None] * plant.lump_centre
    pull = top.tension * (top.hook - plant.end[top.segment]) / np.linalg.norm(top.hook - plant.end[top.segment])
    carried, moment = plant.carried(own), plant.carried(centre)
    found = []
    for k in above:
        here = plant.start[k]
        weights = -GRAVITY * np.cross(moment[k] - carried[k] * here, [0, 0, 1.0])
        found.append(np.linalg.norm((weights + np.cross(plant.end[top.segment] - here, pull))[:2]))
    assert np.median(found) < bound
    assert np.max(found) < 3 * bound


@pytest.mark.parametrize("crop", CROPS)
def test_the_same_seed_grows_the_same_row_and_another_another(crop: str) -> None:
    again, other = grow_row(crop, 5, 4), grow_row(crop, 6, 4)  # type: ignore[arg-type]
    assert again.measures == row(crop).measures != other.measures
    np.testing.assert_array_equal(again.worked.vertices, row(crop).worked.vertices)


def test_measures_are_drawn_from_their_ranges() -> None:
    names = {part.name for part in fields(Measures)}
    assert names == set(RANGES)
    drawn = [grow_row("pepper", seed, 3).measures for seed in range(3)]
    for name, spread in RANGES.items():
        assert all(spread.low <= getattr(m, name) <= spread.high for m in drawn)
    assert all(spread.low < spread.high for habit in HABIT.values() for spread in habit.values())


@pytest.mark.parametrize("crop", CROPS)
def test_hooks_hang_in_order_at_the_wire_and_flowers_below_them(crop: str) -> None:
    grown = row(crop)
    hooks = np.array([plant.twines[0].hook for plant in grown.plants])
    assert hooks[:, 2] == pytest.approx(grown.measures.wire)
    near = np.array([np.mean([twine.hook[1] for twine in plant.twines]) for plant in grown.plants[: grown.near]])
    assert np.all(np.diff(near) > 0)
    assert grown.asked < grown.near
    for plant in grown.plants:
        assert len(plant.twines) == (2 if crop == "pepper" else 1)
        assert len(plant.flower_segment) > 0
        assert plant.flower_position[:, 2].max() < grown.measures.wire + 0.5


@pytest.mark.parametrize(("count", "crop"), [(2, "tomato"), (13, "pepper")])
def test_a_row_of_too_few_or_too_many_plants_is_refused(count: int, crop: str) -> None:
    with pytest.raises(InputError, match="3"):
        grow_row(crop, 1, count)  # type: ignore[arg-type]


def test_a_moved_row_takes_its_hooks_and_parts_along() -> None:
    way = np.array([0.1, -0.4, -2.0])
    moved, before = row("tomato").at(way), row("tomato")
    np.testing.assert_allclose(moved.hooks, before.hooks + way)
    np.testing.assert_allclose(moved.flowers, before.flowers + way)
    for a, b in zip(moved.obstacles(), before.obstacles(), strict=True):
        place = (a.start - b.start) if hasattr(a, "start") else (a.box.lower - b.box.lower)  # type: ignore[union-attr]
        np.testing.assert_allclose(place, way, atol=1e-12)


def test_an_arm_that_strikes_a_neighbour_is_seen_to() -> None:
    """A neighbour's stem through the arm's fingers is a contact with a neighbour; without it there is none."""
    plant = pulled(1.0, 0.006, 1e8, 0.2, 20.0).moved([2.5, 2.5, -1.0])
    assert not np.any(Cell(plant).log().contact_other == NEIGHBOUR)
    base = Cell(plant)
    tip = base.flange_pose()[:3, 3] + 0.06 * base.flange_pose()[:3, 2]
    stem = next(part for part in row("tomato").obstacles() if part.name == "neighbour")
    up = 0.2 * np.eye(3)[2]
    stem = replace(stem, start=tip - up, end=tip + up)  # type: ignore[arg-type]
    struck = Cell(plant, obstacles=[stem])
    struck.run(np.tile(struck.joints, (4, 1)), np.zeros((4, 7)), np.full(4, struck.opening))
    assert np.any(struck.log().contact_other == NEIGHBOUR)


@pytest.mark.parametrize("fallen", [0.0, 0.02])
def test_a_string_pulls_harder_the_farther_its_stem_is_pulled_off(fallen: float) -> None:
    plant, log = pulled(1.0, 0.006, 1e8, 0.2, 20.0), Namespace(qpos=np.zeros((11, 1)))
    pose = np.tile(transform(np.eye(3), [0, 0, -fallen]), (len(plant.end), 1, 1))
    cell, free = (Namespace(plant=p, segment_poses=lambda _: pose) for p in (plant, replace(plant, twines=())))
    twine = plant.twines[0]
    assert string_pull(cell, log) == pytest.approx(1 + twine.stiffness * fallen / twine.tension, rel=1e-3)  # type: ignore[arg-type]
    assert string_pull(free, log) == 0  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_breeze_does_not_blow_a_stem_off_its_string() -> None:
    """Damping lagged a step behind the inertia of thin pieces that twist: hinges of this stem ran away in 0.2 s."""
    grown, truth = before_arm(grow_row("tomato", 6100)), draw(6100)
    plant = held_by_string(as_true(held_by_string(grown.worked, Params()), truth), Params())
    for mechanics, data in islice(gusts(plant, truth.wind), 200):
        assert np.abs(data.qvel[mechanics.dofs]).max() < 5


def test_leaves_were_cut_below_and_the_head_is_young() -> None:
    plant = row("tomato").worked
    petioles = plant.start[plant.organ == Organ.PETIOLE, 2]
    foot, top = plant.pot.centre[2], plant.end[:, 2].max()
    assert petioles.min() > foot + 0.25 * (top - foot), "the foot is bare"
    lengths = plant.vertices[plant.faces[plant.face_organ == Organ.LEAF].ravel(), 2]
    assert lengths.max() > top - 0.05, "leaves to the tip"


def test_an_arm_before_a_row_has_the_asked_plant_at_hand_and_touches_nothing() -> None:
    before = before_arm(row("pepper"))
    place = row_layout(before)
    assert before.flowers[2] == pytest.approx(0.15)
    stem = before.worked.end[before.worked.stem_segments()]
    assert abs(stem[np.argmin(np.abs(stem[:, 2] - 0.15)), 1]) < 1e-9
    assert place.workspace.contains(before.flowers[None]).all()
    far = place.solids[0]
    assert far.upper[0] == pytest.approx(before.origin[0] - before.measures.corridor / 2), "the other side"
    cell = row_world(before)
    cell.run(np.tile(cell.joints, (20, 1)), np.zeros((20, 7)), np.full(20, cell.opening))
    assert len(cell.log().contact_other) == 0
    assert np.abs(cell.segment_poses() - np.eye(4)).max() < 1e-4, "the plant rests"
    assert cell.model.ntendon >= len(before.worked.twines)


@pytest.mark.parametrize("crop", ["tomato", "pepper"])
def test_what_the_map_keeps_clear_of_are_the_neighbours_and_not_the_asked_stem(crop: Crop) -> None:
    before = before_arm(grow_row(crop, 3))
    kept = row_layout(before).solids

    def share_kept(plants: Sequence[SimPlant]) -> float:
        stems = np.vstack([plant.end[plant.stem_segments()] for plant in plants])
        reached = stems[np.linalg.norm(stems, axis=1) < 1.2]
        return float(np.any([box.contains(reached) for box in kept], axis=0).mean())

    assert share_kept([before.worked]) < 0.05
    assert share_kept([p for k, p in enumerate(before.plants[: before.near]) if k != before.asked]) > 0.9


def test_far_below_the_flowers_a_stem_is_cut_coarsely_and_swings_alike() -> None:
    stem = pulled(2.8, 0.006, 1e8, 1.5, 50.0, pieces=140)
    fine, coarse = alone(stem, Params()), alone(stem, Params(fine_above=1.8))
    assert len(coarse.bodies) < 0.6 * len(fine.bodies)
    np.testing.assert_allclose(coarse.frequencies[:6], fine.frequencies[:6], rtol=0.02)
    rests = mujoco.MjData(coarse.model)
    mujoco.mj_forward(coarse.model, rests)
    assert np.abs(rests.qacc).max() < 1e-3


def test_an_arm_waits_out_of_the_leaves_and_soon_at_a_grasp() -> None:
    """Its tip is 0.37 m from the stems, it faces them, and waits nearer to grasps than where it is ready."""
    before = before_arm(row("tomato"))
    place = row_layout(before)
    waits, stems = _waits(place, SAWYER), before.origin[0] + before.measures.near
    flange = SAWYER.forward(waits)
    tip = flange[:3, 3] + SAWYER.tool.tip * flange[:3, 2]
    assert 0.34 < stems - tip[0] < 0.38
    assert flange[0, 2] > 0.7
    middle = (stems, 0.0, 0.0)
    turned = [transform(Rotation.from_euler("z", angle).as_matrix(), middle) for angle in (-0.6, 0.0, 0.6)]
    grasps = np.array(turned) @ transform([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]], [-SAWYER.tool.tip - 0.12, 0, 0])
    branches = inverse_many(SAWYER, grasps)
    seconds = [[least_times(SAWYER, joints[None], q).min() for q in branches] for joints in (waits, SAWYER.ready)]
    assert np.mean(seconds[0]) < np.mean(seconds[1])


@pytest.mark.parametrize(("crop", "strings"), [("tomato", 1), ("pepper", 2)])
def test_the_map_has_the_other_strings_beside_the_asked_one(crop: Crop, strings: int) -> None:
    """All of the near line but the asked one, each about where it hangs."""
    asked = row(crop)
    there = before_arm(asked)
    others, (own, own_foot) = mapped_others(asked), mapped_string(asked)
    assert len(others) == strings * there.near - 1
    hooks = np.array([twine.hook for plant in there.plants[: there.near] for twine in plant.twines])
    found = np.array([hook for hook, _ in others])
    apart = np.linalg.norm(found[:, None] - hooks, axis=2)
    assert apart.min(axis=1).max() < 5 * HOOK_ERROR
    assert np.linalg.norm(found - own, axis=1).min() > 0.05
    for hook, foot in (*others, (own, own_foot)):  # where a lowered tomato rises no map knows
        assert foot is None if crop == "tomato" else foot is not None and foot[2] < hook[2]
