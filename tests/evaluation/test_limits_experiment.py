"""The experiment on limits: the rods are the simulated plant, and MuJoCo's hinges bear what Anther says they bear."""

from __future__ import annotations

import numpy as np
import pytest
from grown_plants import grown

from evaluation.judge.limit_rods import bare, true_rods
from evaluation.judge.limit_strains import StrainRow, strain_metrics, strain_rows


@pytest.fixture(scope="module")
def rows() -> list[StrainRow]:
    return strain_rows(grown("tomato", 10), 0.01)


def test_the_rods_are_the_simulated_plant() -> None:
    plant = grown("tomato", 10)
    found = true_rods(plant)
    rods, model = found.model.rods, found.model
    tissue = np.asarray(rods.density) * np.pi * np.asarray(rods.edge_radius) ** 2 * rods.lengths
    assert tissue[2:].sum() == pytest.approx(plant.mass.sum(), rel=0.01)  # edge 1 is below the soil
    assert np.asarray(rods.lumped_mass).sum() == pytest.approx(plant.lump_mass.sum())
    assert np.allclose(rods.nodes[found.last], plant.end)
    assert np.allclose(rods.nodes[rods.parent[found.first]], plant.start)
    assert np.linalg.norm(rods.nodes[model.flower_nodes] - plant.flower_position, axis=1).max() < 0.01
    assert set(model.branch_bases) <= set(found.first)
    assert len(bare(plant).faces) < len(plant.faces)


def test_the_hinges_bear_what_the_rods_report(rows: list[StrainRow]) -> None:
    """Below the resonances of leaves and trusses, where pieces of 10 mm are fine enough."""
    slow = [row for row in rows if row.frequency in (1.0, 5.0)]
    assert {row.kind for row in slow} == {"stem", "pedicel", "petiole base", "peduncle base"}
    for row in slow:
        assert abs(row.error) < 0.05, row
        assert np.median(np.abs(row.places)) < 0.03, row


def test_the_metrics_are_those_of_the_rows(rows: list[StrainRow]) -> None:
    found = strain_metrics(rows)
    worst = max(rows, key=lambda row: abs(row.error))
    assert found["strain_error_max"] == pytest.approx(abs(worst.error))
    assert found["strain_error_max_to_5hz"] <= found["strain_error_max"]
