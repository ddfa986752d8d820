"""The independent MuJoCo plant: against beam theory, at rest, and its two ways to the answer against each other."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments"))

from hinged.pieces import linearise, pieces_of, shake
from hinged.plants import (
    BEND_OVER_TWIST,
    DENSITY,
    MASS_DAMPING,
    PLANTS,
    VISCOUS_TIME,
    YOUNGS,
    cut,
    five_branches,
    straight,
    y_shape,
)
from hinged_plant import SOIL, phasors, rods_of

from anther.elastic_rod import frequency_response

WEIGHTLESS = (0.0, 0.0, 0.0)
LENGTH, RADIUS, STEP = 0.5, 3e-3, 2e-4


def modes(segments: int) -> np.ndarray:
    tree = cut(straight(), segments)
    return linearise(pieces_of(straight(), tree, STEP, WEIGHTLESS), tree).frequencies(held=False)


def test_a_stem_bends_at_the_frequencies_of_euler_and_bernoulli():
    wave = np.array([1.87510, 4.69409, 7.85476]) / LENGTH
    exact = wave**2 * np.sqrt(YOUNGS * RADIUS**2 / 4 / DENSITY) / (2 * np.pi)
    coarse, middle, fine = (modes(n)[[0, 2, 4]] / exact - 1 for n in (10, 20, 40))
    assert np.abs(fine).max() < 4e-3
    np.testing.assert_allclose((coarse - middle) / (middle - fine), 4, rtol=0.1)


def test_a_stem_twists_at_the_frequency_of_a_bar_in_torsion():
    speed = np.sqrt(YOUNGS / BEND_OVER_TWIST / 2 / DENSITY)  # GJ = EI / ratio; polar moment of area 2 I
    found = modes(20)
    assert np.abs(found / (speed / 4 / LENGTH) - 1).min() < 2e-3


@pytest.mark.parametrize("make", PLANTS)
def test_both_codes_carry_the_same_mass_and_volume(make):
    plant, tree = make(), cut(make(), 20)
    volume = sum(np.linalg.norm(np.subtract(m.end, m.start)) * np.pi * m.radius**2 for m in plant.members)
    model = pieces_of(plant, tree, STEP)
    first = 0.5 * np.linalg.norm(tree.nodes[1]) * np.pi * RADIUS**2 * DENSITY
    ids = [model.body(f"node_{j}").id for j in range(1, len(tree.nodes))]
    assert model.body_mass[ids].sum() + first == pytest.approx(volume * DENSITY, rel=1e-9)
    assert rods_of(tree).node_mass[2:].sum() + first == pytest.approx(volume * DENSITY, rel=1e-9)


@pytest.mark.parametrize("make", PLANTS)
def test_the_mesh_keeps_joints_grip_and_tips(make):
    plant, tree = make(), cut(make(), 13)
    assert np.all(tree.parent[1:] < np.arange(1, len(tree.nodes)))
    np.testing.assert_allclose(tree.nodes[tree.grip], plant.grip, atol=1e-12)
    np.testing.assert_allclose(tree.nodes[tree.tips], [m.end for m in plant.members], atol=1e-12)
    lengths = np.linalg.norm(tree.nodes[1:] - tree.nodes[tree.parent[1:]], axis=1)
    assert lengths.max() < 1.5 * LENGTH / 13
    assert lengths.sum() == pytest.approx(sum(np.linalg.norm(np.subtract(m.end, m.start)) for m in plant.members))


def test_the_hanging_plant_stays_where_it_is():
    plant, tree = five_branches(), cut(five_branches(), 10)
    still = shake(pieces_of(plant, tree, STEP), tree, np.zeros(1000))
    np.testing.assert_allclose(still.positions, np.tile(tree.nodes[[tree.grip, *tree.tips]], (1000, 1, 1)), atol=1e-9)


def test_the_plant_softens_under_its_weight():
    tree = cut(straight(), 20)
    hanging = linearise(pieces_of(straight(), tree, STEP), tree).frequencies(held=False)
    assert hanging[0] < 0.9 * modes(20)[0]


def test_shaking_in_time_gives_the_small_vibration_response():
    plant, tree, frequency, amplitude = straight(), cut(straight(), 10), 10.0, 2e-4
    times = np.arange(round(5.0 / STEP)) * STEP
    rise = 0.5 - 0.5 * np.cos(np.pi * np.clip(times / 2.0, 0, 1))
    model = pieces_of(plant, tree, STEP)
    shaken = shake(model, tree, amplitude * rise * np.sin(2 * np.pi * frequency * times))
    found = phasors(shaken.times, shaken.positions, frequency)
    assert abs(found[0, 0]) == pytest.approx(amplitude, rel=2e-3)
    expected = linearise(model, tree).response(plant.axis, [frequency], STEP)[0]
    np.testing.assert_allclose(found[1:] / found[0, 0], expected, atol=2e-4 * np.abs(expected).max())


def test_the_error_of_the_time_step_is_of_first_order():
    plant, tree = y_shape(), cut(y_shape(), 10)
    linear = linearise(pieces_of(plant, tree, STEP), tree)
    exact, *stepped = (linear.response(plant.axis, [30.0], dt) for dt in (0.0, 4e-4, 2e-4))
    errors = [np.abs(s - exact).max() for s in stepped]
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.1)


def test_the_damping_is_the_one_asked_for():
    tree = cut(straight(), 20)
    linear = linearise(pieces_of(straight(), tree, STEP), tree)
    second = linear.frequencies(held=True)[2]
    bare = replace(linear, damping=0 * linear.damping)
    damped, free = (abs(s.response(straight().axis, [second])[0, 0, 0]) for s in (linear, bare))
    ratios = MASS_DAMPING / (4 * np.pi * second), np.pi * second * VISCOUS_TIME
    assert damped / free == pytest.approx(ratios[0] / sum(ratios), rel=0.1)


@pytest.mark.parametrize("make", PLANTS)
def test_rods_and_hinges_converge_to_the_same_response_with_the_second_order(make):
    plant, hertz = make(), [2.0, 10.0]
    hinges, rods = [], []
    for segments in (20, 40, 80):
        tree = cut(plant, segments)
        hinges.append(linearise(pieces_of(plant, tree, STEP), tree).response(plant.axis, hertz))
        rods.append(frequency_response(rods_of(tree), SOIL, tree.grip + 1, plant.direction, hertz)[:, tree.tips + 1])
    truth = (4 * hinges[2] - hinges[1]) / 3
    np.testing.assert_allclose((4 * rods[2] - rods[1]) / 3, truth, atol=3e-3 * np.abs(truth).max())
    errors = [np.abs(r - truth).max() for r in rods]
    assert errors[0] > 2.8 * errors[1] > 2.8**2 * errors[2]


def test_phasors_find_amplitude_and_phase():
    times = np.arange(3000) * 1e-3
    motion = np.zeros((3000, 1, 3))
    motion[:, 0, 1] = 0.7 * np.sin(2 * np.pi * 5 * times + 0.4)
    motion -= motion[0]
    np.testing.assert_allclose(phasors(times, motion, 5.0)[0], [0, 0.7 * np.exp(0.4j), 0], atol=1e-12)
