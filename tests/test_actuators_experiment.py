"""The experiment on actuators: its model is the simulated plant, and its means count plants without a shake."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments"))
import actuators

from anther.sim.pepper import grow_pepper
from anther.vibration import Params


def test_the_model_is_the_simulated_plant() -> None:
    plant = grow_pepper(10)
    model = actuators.true_model(plant)
    nodes = model.rods.nodes
    tissue = np.sum(np.pi * plant.density * plant.length * (plant.radius_start + plant.radius_end) ** 2 / 4)
    carried = np.asarray(model.rods.lumped_mass)
    assert model.rods.node_mass.sum() == pytest.approx(tissue + plant.lump_mass.sum(), rel=0.02)
    assert np.linalg.norm(nodes[model.flower_nodes] - plant.flower_position, axis=1).max() < 0.01
    assert carried[model.flower_nodes] == pytest.approx(plant.lump_mass[plant.flower_segment])
    assert np.all(np.diff(nodes[model.stem_nodes, 2]) > 0)
    assert not set(model.stem_nodes) & set(np.flatnonzero(model.is_pedicel))
    heights = [grasp.arc_length for grasp in actuators.grasps_on(model)]
    assert heights == sorted(heights)


def test_a_plant_without_a_shake_gains_nothing() -> None:
    rows = [
        (name, strain, "a", "no shake. It binds. Allow more.", 4)
        for name in actuators.ACTUATORS
        for strain in actuators.STRAINS
    ]
    found = actuators.metrics(rows, Params())
    assert found["plants"] == 1
    assert found["arm_5_permille_planned"] == 0
    assert found["arm_5_permille_added_share"] == 0
    assert "arm_5_permille_frequency" not in found
