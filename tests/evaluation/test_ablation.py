"""The ablation takes away one feature and leaves the rest, and says so by how much the flowers' motion changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from grown_plants import grown

from anther.rods import Clamp, Rods, natural_frequencies, with_gravity_equilibrium
from anther.sim import plant_mechanics
from evaluation.prediction import ablated, ablation
from evaluation.prediction.shaken_plant import Params, ShakenPlant
from evaluation.prediction.true_rods import Builder
from evaluation.prediction.vibration_models import Model, true_model

BENDING = plant_mechanics.Params(twisting=())
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def plant() -> Model:
    return true_model(grown("tomato", 11), 12.0)


@pytest.fixture(scope="module")
def bar() -> Model:
    """A straight, upright, even stem."""
    nodes = np.zeros((41, 3))
    nodes[:, 2] = 0.008 * np.arange(41)
    rods = Rods(nodes, np.arange(-1, 40), 3e-3, 3e8, 1000.0, bend_over_twist=12.0)
    rods = with_gravity_equilibrium(rods, Clamp.root(rods))
    return Model(rods, np.arange(41), np.array([40]), 0.05)


def gain(model: Model) -> float:
    way = np.array([0.0, 1.0, 0.0])
    return float(model.response(np.array([[0, 0, 0.12]]), way, np.array([5.0]))[0, 0, 0])


def test_rods_of_a_simulated_plant_keep_its_mass_and_place() -> None:
    sim = grown("tomato", 11)
    rods = Builder(sim).rods()
    mass = np.concatenate([sim.mass, sim.lump_mass])
    middles = np.concatenate([(sim.start + sim.end) / 2, sim.lump_centre])
    assert rods.node_mass.sum() == pytest.approx(mass.sum(), rel=1e-3)
    centre = rods.node_mass @ rods.nodes / rods.node_mass.sum()
    np.testing.assert_allclose(centre, mass @ middles / mass.sum(), atol=1e-3)


def test_every_node_is_in_one_organ_and_the_stem_is_one(plant: Model) -> None:
    chains = ablated.organs(plant.rods, plant.stem)
    assert sorted(np.concatenate(chains)) == list(range(1, len(plant.rods.nodes)))
    assert plant.stem[1:].tolist() in [chain.tolist() for chain in chains]
    for chain in chains:
        assert np.all(plant.rods.parent[chain[1:]] == chain[:-1])


def test_a_bar_that_lacks_a_feature_does_not_miss_it(bar: Model) -> None:
    """Even, straight, on the grid, without leaves, bent in one plane."""
    full = gain(bar)
    assert full > 1.01
    for feature in ("no_taper", "one_radius", "no_twist", "round_bar", "straight", "stairs", "no_leaves"):
        assert gain(ablated.CHANGES[feature][1](bar)) == pytest.approx(full, rel=1e-6), feature
    assert gain(ablated.CHANGES["euler"][1](bar)) < full
    assert gain(ablated.CHANGES["stiffer"][1](bar)) < full


def test_what_is_taken_away_is_gone_and_the_rest_is_there(plant: Model) -> None:
    rods = plant.rods
    straight = ablated.straightened(plant).rods
    chains = ablated.organs(rods, plant.stem)
    for chain in chains:
        base = rods.parent[chain[0]]
        chord = straight.nodes[chain[-1]] - straight.nodes[base]
        assert chord == pytest.approx(rods.nodes[chain[-1]] - rods.nodes[base])
        assert straight.lengths[chain].sum() == pytest.approx(np.linalg.norm(chord))
    stairs = ablated.in_steps(plant)
    assert np.abs(stairs.rods.nodes / ablated.VOXEL - np.round(stairs.rods.nodes / ablated.VOXEL)).max() < 1e-9
    assert stairs.rods.lengths[1:].max() <= ablated.VOXEL * np.sqrt(3) * 1.001
    apart = stairs.rods.nodes[stairs.flowers] - rods.nodes[plant.flowers]
    assert np.linalg.norm(apart, axis=1).max() < ablated.VOXEL
    assert np.sum(stairs.rods.lumped_mass) == pytest.approx(np.sum(rods.lumped_mass))
    bare = ablated.without_leaves(plant).rods
    assert bare.lumped_mass[plant.flowers] == pytest.approx(np.asarray(rods.lumped_mass)[plant.flowers])
    assert np.sum(bare.lumped_mass) == pytest.approx(np.sum(np.asarray(rods.lumped_mass)[plant.flowers]))
    assert np.ptp(np.asarray(ablated.with_one_radius(plant).rods.edge_radius)[1:]) == 0
    assert ablated.stress_free(plant).rods.natural is None


def test_what_would_buckle_is_stiffened(bar: Model) -> None:
    soft = ablated.standing(bar, replace(bar.rods, youngs=1e4))
    assert soft.rods.youngs[1] > 1e5


def test_changes_and_errors_are_what_they_are_called() -> None:
    shape = (3, len(ablation.FREQUENCIES), 2)
    full, truth = np.full(shape, 2.0), np.full(shape, 4.0)
    row = {"truth": truth, "full": full, "stiffened": dict.fromkeys(ablated.CHANGES, False)}
    found = ablation.metrics([{"true": row | dict.fromkeys(ablated.CHANGES, 1.5 * full)}])
    assert found["true_no_twist_slow_change_median"] == pytest.approx(0.5)
    assert found["true_no_twist_30hz_change_signed"] == pytest.approx(0.5)
    assert found["true_no_twist_slow_error_p90"] == pytest.approx(0.25)
    assert found["true_full_10hz_error_median"] == pytest.approx(0.5)
    assert "true_full_10hz_change_median" not in found


def test_rods_and_hinges_of_a_grown_plant_have_the_same_lowest_frequencies() -> None:
    """They are two codes. Leaves are stiff and without inertia of their own in the rods, which are a little faster."""
    plant = grown("tomato", 11)
    hinges = ShakenPlant(plant, plant.end[plant.stem_segments()[9]], [0, 1, 0], Params(plant=BENDING)).mechanics
    rods = true_model(plant, 0.0).rods
    found = natural_frequencies(rods, Clamp.root(rods), 8).frequencies
    assert hinges.frequencies[:8] == pytest.approx(found, rel=0.05)
