"""What a breeze does to a plant: nothing where the air is still, more where it blows more, each load where it acts."""

from __future__ import annotations

import numpy as np
import pytest
from grown_plants import grown

from anther.sim.plant import SimPlant
from evaluation.judge import breezes  # pyright: ignore[reportMissingImports]


@pytest.fixture
def plant() -> SimPlant:
    return grown("tomato", 11)


def test_still_air_does_nothing(plant: SimPlant) -> None:
    found = breezes.blown(plant, 0.0, 2.0)
    assert found == dict.fromkeys(found, pytest.approx(0.0, abs=1e-3))


def test_loads_grow_with_the_square_of_the_wind_or_so(plant: SimPlant) -> None:
    slow, fast = (breezes.blown(plant, wind, 2.5) for wind in (1.0, 2.0))
    for what, value in slow.items():
        assert 2 * value < fast[what] < 8 * value, what
    assert fast["pedicel"] <= fast["pedicel_worst"]


def test_each_leaf_has_its_own_mass_about_its_own_base(plant: SimPlant) -> None:
    base, moment = breezes._leaves(plant)
    assert len(base) == len(np.unique(base)) > 3
    assert np.all(moment > 0)
    middle = np.where(plant.lump_mass[:, None] > 0, plant.lump_centre, (plant.start + plant.end) / 2)
    total = np.sum((plant.mass + plant.lump_mass) * np.linalg.norm(middle - plant.start[0], axis=1))
    assert moment.sum() < total


def test_the_metrics_are_medians_over_plants() -> None:
    rows = [
        {"flower": f, "pedicel": f, "pedicel_worst": f / 100, "stem": f, "base": f, "leaf": f} for f in (1.0, 3.0, 2.0)
    ]
    found = breezes.breeze_metrics(
        {("tomato", 4.0): rows, ("pepper", 4.0): [{k: 2 * v for k, v in r.items()} for r in rows]}
    )
    assert found["breeze_flower_tomato_4ms"] == 2.0
    assert found["breeze_flower_pepper_4ms"] == 4.0
    assert found["breeze_pedicel_4ms"] == pytest.approx(0.025)
