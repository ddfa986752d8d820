"""evaluation/prediction/vibration.py: what it shakes, whose flowers it compares, and how it scores the models."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rich.table import Table
from straight_plant import BASE, straight_plant

from anther.pollination.shake.observables import semi_major
from evaluation.prediction.known_plant import DIRECTION, matched, stem_points
from evaluation.prediction.shaken_plant import ShakenPlant
from evaluation.prediction.vibration import brief
from evaluation.prediction.vibration_models import true_model
from evaluation.prediction.vibration_plant import (
    HEIGHTS,
    MIDDLE,
    Case,
    arm_amplitude,
    plan,
)
from evaluation.prediction.vibration_table import metrics, report, score

CASE = Case("tomato", 0, (1.0, 5.0), (4e-3, 8e-3, 12e-3))


def row(said: Any, seed: int = 0) -> dict[str, Any]:
    """Return a plant of two flowers that swing less the higher it is held, and predictions said(amplitude)."""
    shakes = [{"height": HEIGHTS[g], "amplitude_m": a, "frequency_hz": f} for g, a, f in plan(CASE)]
    true = np.array([[s["amplitude_m"] * (3 - 2 * s["height"]) * k for k in (1.0, 1.5)] for s in shakes])
    return {
        "species": "tomato",
        "seed": seed,
        "flowers": {"true": 3, "seen": 2, "matched": 2},
        "youngs_mpa": {"true": 200.0, "prior": 150.0, "probe": 190.0},
        "paper_soft": 3.0,
        "shakes": shakes,
        "unsteadiness": [0.01] * len(shakes),
        "true_m": true,
        "linear_m": 1.1 * true,
        "nonlinear_m": {},
        "predicted_m": {"paper": said(true), "probe": true, "true plant": true},
    }


def test_a_model_that_says_half_has_full_correlation_and_half_the_amplitude() -> None:
    found = score(row(lambda true: 0.5 * true), "paper", "paper")
    assert found is not None
    assert found.amplitude_r == pytest.approx(1)
    assert (found.error, found.bias) == pytest.approx((0.5, -0.5))


def test_a_model_that_turns_the_trend_over_location_round_is_caught() -> None:
    backward = row(lambda true: 1e-3 / true)
    found = score(backward, "paper", "paper")
    assert found is not None
    assert found.location_r < -0.9
    numbers = metrics([backward, row(lambda true: true, seed=1)])
    assert numbers["reversed_trends_paper_model"] == 1
    assert numbers["reversed_trends_probe"] == 0
    assert numbers["paper_buckles"] == 2
    assert numbers["linear_truth_median"] == pytest.approx(0.1)


def test_a_model_without_a_prediction_has_no_score_and_no_row_in_the_report() -> None:
    rows = [row(lambda true: true, seed=k) for k in range(3)]
    assert score(rows[0], "prior", "paper") is None
    table = report(metrics(rows))[1]
    assert isinstance(table, Table)
    lines = list(zip(*(column.cells for column in table.columns), strict=True))
    assert not any(str(line[0]).startswith("(b)") for line in lines)
    assert ("(c) Anther, one probe shake, 0.7–1.9 Hz", "1.00 (1.00)") in [line[:2] for line in lines]


def test_every_shake_is_within_the_arm_and_every_height_has_the_same_amplitude() -> None:
    for case in (CASE, brief("pepper", 0)):
        shakes = plan(case)
        assert all(a <= arm_amplitude(f) + 1e-9 for _, a, f in shakes)
        for f in case.frequencies:
            at = {g: [a for h, a, q in shakes if (h, q) == (g, f)] for g in range(len(HEIGHTS))}
            assert len(at[MIDDLE]) == len(case.amplitudes)
            assert all(set(at[g]) <= set(at[MIDDLE]) and len(at[g]) == 1 for g in at if g != MIDDLE)


def test_flowers_are_matched_one_to_one_and_only_when_near() -> None:
    true = np.array([[0, 0, 0], [0.05, 0, 0], [1, 0, 0]], dtype=float)
    i, j = matched(true[[1, 0]] + 0.004, true)
    assert dict(zip(i.tolist(), j.tolist(), strict=True)) == {0: 1, 1: 0}
    assert len(matched(np.zeros((0, 3)), true)[0]) == 0


def test_rods_with_a_plants_own_geometry_and_material_answer_as_it_does() -> None:
    plant = straight_plant()
    points = stem_points(plant, (0.3, 0.6))
    assert points[:, 2] == pytest.approx(BASE[2] + np.array([0.15, 0.3]))
    shaken = [ShakenPlant(plant, point, DIRECTION) for point in points]
    frequencies = np.array([0.5, 0.7])  # far from the leaf, which resonates at 1.3 Hz
    said = true_model(plant, 12.0).response(np.array([s.point for s in shaken]), DIRECTION, frequencies)
    assert said == pytest.approx(np.array([semi_major(s.linear(frequencies)) for s in shaken]), rel=0.01)
