"""The truth of a simulated plant: what is drawn, what each part of it changes and what it leaves alone."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from grown_plants import grown
from straight_plant import BASE, chain, plant_of, straight_plant

from anther.core.errors import InputError
from anther.pollination.shake.observables import semi_major
from anther.sim.growth import buckling_factor
from anther.sim.pieces import Params
from anther.sim.plant import Organ, SimPlant
from anther.sim.plant_mechanics import alone
from anther.sim.sway import swaying
from anther.sim.true_plant import as_true, branches
from anther.sim.truth import NOMINAL, WIDE, Truth, draw
from evaluation.prediction.shaken_plant import ShakenPlant

UP, SIDEWAYS = np.eye(3)[2], np.eye(3)[1]


@pytest.fixture(scope="module")
def tomato() -> SimPlant:
    return grown("tomato", 5002)


def test_every_doubt_is_drawn_in_one_group_and_within_its_range() -> None:
    names = [name for group in WIDE.values() for name in group]
    assert sorted(names) == sorted(field.name for field in fields(Truth))
    for seed in range(50):
        truth = draw(seed)
        for group in WIDE.values():
            for name, spread in group.items():
                assert spread.low <= getattr(truth, name) <= spread.high


def test_a_group_drawn_alone_is_what_it_is_among_all_and_the_rest_is_nominal() -> None:
    whole, alone = draw(4), draw(4, "twist")
    assert alone.bend_over_twist == whole.bend_over_twist != NOMINAL.bend_over_twist
    assert replace(alone, bend_over_twist=NOMINAL.bend_over_twist) == NOMINAL
    with pytest.raises(InputError, match=r"twits.*stiffness"):
        draw(4, "twits")


def test_the_nominal_truth_is_the_plant_as_it_grew(tomato: SimPlant) -> None:
    assert as_true(tomato, NOMINAL) is tomato


@pytest.mark.parametrize("support", [1.8, 4.0])
def test_a_plant_supports_itself_as_the_truth_says(tomato: SimPlant, support: float) -> None:
    assert buckling_factor(as_true(tomato, Truth(self_support=support))) == pytest.approx(support, rel=0.1)


def test_weak_plants_are_tied_and_all_stand() -> None:
    for seed in (5000, 5003):
        plant = as_true(grown("pepper", seed), draw(seed))
        assert draw(seed).self_support < 1.5
        assert plant.tie is not None
        assert alone(plant, Params(twist_every=1)).frequencies[0] >= 0.3
    assert as_true(grown("tomato", 5002), Truth(self_support=2.0)).tie is None


def test_a_tie_holds_the_stem_sideways_with_its_stiffness() -> None:
    plant = plant_of(chain(BASE + np.linspace(0, 0.5, 26)[:, None] * UP, 0.004, youngs=1e9), flower=24)
    free, tied = (ShakenPlant(p, BASE + 0.2 * UP, SIDEWAYS) for p in (plant, replace(plant, tie=(24, 1e6))))
    assert np.abs(free.linear([0.01])[0, 0, 1]) == pytest.approx(1, abs=1e-3)
    assert np.abs(tied.linear([0.01])[0, 0, 1]) < 0.01


def test_leaves_swing_with_their_own_damping_and_flowers_with_theirs(tomato: SimPlant) -> None:
    plant = as_true(tomato, Truth(wood_damping=0.02, leaf_damping=0.2, stalk_damping=0.1))
    by_organ = {organ: set(plant.damping_ratio[plant.organ == organ].tolist()) for organ in set(plant.organ.tolist())}
    assert by_organ[Organ.STEM] == {0.02}
    assert by_organ[Organ.PETIOLE] == by_organ[Organ.RACHIS] == {0.2}
    assert by_organ[Organ.PEDICEL] == by_organ[Organ.PEDUNCLE] == {0.1}


def test_masses_follow_their_factors_and_the_plant_looks_the_same(tomato: SimPlant) -> None:
    plant = as_true(tomato, Truth(leaf_density=1.5, flower_mass=0.5))
    flower = np.isin(np.arange(len(plant.start)), plant.flower_segment)
    assert plant.lump_mass[flower] == pytest.approx(0.5 * tomato.lump_mass[flower])
    assert plant.lump_mass[~flower] == pytest.approx(1.5 * tomato.lump_mass[~flower])
    assert np.array_equal(plant.vertices, tomato.vertices)


def test_longer_pedicels_take_their_flowers_along_and_nothing_else(tomato: SimPlant) -> None:
    plant = as_true(tomato, Truth(pedicel_length=1.3))
    pedicel = plant.organ == Organ.PEDICEL
    assert plant.length[pedicel] == pytest.approx(1.3 * tomato.length[pedicel])
    assert np.array_equal(plant.start[~pedicel], tomato.start[~pedicel])
    assert plant.start[1:] == pytest.approx(plant.end[plant.parent[1:]])
    moved = plant.flower_position - tomato.flower_position
    assert moved == pytest.approx((plant.end - tomato.end)[plant.flower_segment])
    seen = plant.faces[plant.face_organ == Organ.FLOWER]
    shift = (plant.vertices - tomato.vertices)[seen]
    assert shift.std(axis=1) == pytest.approx(np.zeros((len(seen), 3)), abs=1e-12)
    rest = plant.faces[~np.isin(plant.face_organ, (Organ.FLOWER, Organ.PEDICEL))]
    assert np.array_equal(plant.vertices[rest], tomato.vertices[rest])


def test_branches_differ_in_stiffness_and_the_top_is_softer(tomato: SimPlant) -> None:
    base = as_true(tomato, Truth(self_support=3.0))
    scattered = as_true(tomato, Truth(self_support=3.0, branch_scatter=0.5))
    ratio, branch = scattered.youngs / base.youngs, branches(tomato)
    assert np.ptp(ratio[branch == -1]) < 1e-12
    own = [ratio[(branch == b) & (tomato.organ != Organ.PEDICEL)] for b in np.unique(branch[branch >= 0])]
    assert all(np.ptp(values) < 1e-12 for values in own if len(values))
    assert np.std([np.log(values[0]) for values in own if len(values)]) > 0.2
    graded = as_true(tomato, Truth(self_support=3.0, stiffness_gradient=-1.0)).youngs[tomato.stem_segments()]
    assert np.all(np.diff(graded) < 0)


def test_an_oval_stem_bends_more_easily_across_its_wider_axis() -> None:
    stem = plant_of(chain(BASE + np.linspace(0, 0.5, 26)[:, None] * UP, 0.004, youngs=1e9), flower=24)
    oval = replace(stem, oval=np.tile(np.log(1.6) * SIDEWAYS, (25, 1)))
    slow, fast = alone(oval, Params()).frequencies[:2]
    middle = alone(stem, Params()).frequencies[0]
    assert fast / slow == pytest.approx(np.sqrt(1.6), rel=0.01)
    assert np.sqrt(fast * slow) == pytest.approx(middle, rel=0.01)


def test_sections_and_side_branches_turn_with_the_plant() -> None:
    truth = Truth(oval=1.5)
    straight, turned = (as_true(grown("tomato", 5002, viewpoint=angle), truth) for angle in (0.0, 90.0))
    x, y, z = straight.oval.T
    assert turned.oval == pytest.approx(np.stack([-y, x, z], axis=1), abs=1e-9)


def test_a_soft_foot_and_a_soft_joint_give_way_as_their_springs_say() -> None:
    """A stiff rod on a foot: a pendulum upside down of the foot's stiffness less its weight's moment."""
    rod = plant_of(chain(BASE + np.linspace(0, 0.3, 7)[:, None] * UP, 0.01, youngs=1e12), flower=5)
    foot, mass, length = 5.0, np.pi * 1e-4 * 0.3 * 1000, 0.3
    theory = np.sqrt((foot - mass * 9.81 * length / 2) / (mass * length**2 / 3 + mass * 1e-4 / 4)) / (2 * np.pi)
    assert alone(replace(rod, foot=foot), Params()).frequencies[0] == pytest.approx(theory, rel=0.01)
    joint = np.zeros(6)
    joint[0] = 1 / foot
    assert alone(replace(rod, joint_compliance=joint), Params()).frequencies[0] == pytest.approx(theory, rel=0.01)


def test_soft_pads_give_way_by_force_over_stiffness() -> None:
    plant = plant_of(chain(BASE + np.linspace(0, 0.5, 26)[:, None] * UP, 0.004, youngs=1e9), flower=24)
    rigid, soft = (
        ShakenPlant(plant, BASE + 0.2 * UP, SIDEWAYS, truth=Truth(pad_stiffness=k, pad_rotation=r))
        for k, r in ((1e12, 1e12), (500.0, 1e-3))
    )
    held = ShakenPlant(plant, BASE + 0.2 * UP, SIDEWAYS)
    assert semi_major(rigid.linear([5.0])) == pytest.approx(semi_major(held.linear([5.0])), rel=1e-6)
    height, bending = soft.point[2] - BASE[2], 1e9 * np.pi / 4 * 0.004**4
    stiffness = 3 * bending / height**3  # of the stem below a grip that lets it turn
    moved = np.abs(soft.linear([0.01])[0, 0, 1])
    top = 1 + 1.5 * (BASE[2] + 0.5 - soft.point[2]) / height  # the free end follows the slope at the grip
    assert moved == pytest.approx(top * 500 / (500 + stiffness), rel=0.03)


def test_a_shake_through_soft_pads_and_air_is_what_its_linear_equations_say() -> None:
    plant = replace(straight_plant(), drag_area=np.full(len(straight_plant().start), 2e-2))
    shaken = ShakenPlant(plant, BASE + 0.25 * UP, SIDEWAYS, truth=Truth(pad_stiffness=2e3, pad_rotation=0.2))
    amplitude, frequency = 1e-3, 5.0
    found = shaken.steady(amplitude, frequency)
    still, dragged = (amplitude * semi_major(shaken.linear([frequency], a))[0] for a in (0.0, amplitude))
    assert found.amplitude == pytest.approx(dragged, rel=0.01)
    assert still[0] > 1.02 * dragged[0]  # the air counts, or this says nothing


def test_wind_bends_the_plant_by_the_square_of_its_speed_and_still_air_does_not() -> None:
    plant = replace(straight_plant(), drag_area=np.full(len(straight_plant().start), 1e-5))
    top = [np.linalg.norm(swaying(plant, wind, [5.0])[0, 8, :3, 3]) for wind in (0.0, 0.4, 0.8)]
    assert top[0] < 1e-9
    assert 2 < top[2] / top[1] < 8


def test_what_the_wind_does_is_the_seed_s() -> None:
    plant = replace(straight_plant(), drag_area=np.full(len(straight_plant().start), 1e-4))
    first, again, other = (swaying(replace(plant, seed=seed), 0.5, [0.0, 0.5]) for seed in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)
