"""The experiment on what is believed of a shake: its numbers from values that were drawn from a known belief."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from anther.plant.limits import STALK_SPREAD, stalk_strain
from anther.pollination.decision import believed
from evaluation.prediction import belief  # pyright: ignore[reportMissingImports]

COUNT = 2000


def drawn(kind: str, when: str, tone: float, *, wide: float = 1.0, shift: float = 0.0) -> list[Any]:
    """Return values of which the truth is drawn from what is believed, so many times as wide, and so much higher."""
    rng = np.random.default_rng(0)
    members = rng.normal(np.log((2 * np.pi * tone) ** 2), 1.0, (COUNT, 1)) + rng.normal(0.0, 0.2, (COUNT, 8))
    logs, spread = believed(kind.replace("pedicels", "flowers"), np.exp(members.T), tone, belief.WHEN[when])
    if kind == "pedicels":
        logs, spread = logs + np.log(stalk_strain(tone)), np.hypot(spread, STALK_SPREAD)
    one = logs[rng.integers(8, size=COUNT), np.arange(COUNT)]
    truth = one + shift + wide * spread * rng.normal(size=COUNT)
    return [[kind, when, tone, [*row, true]] for row, true in zip(members.tolist(), truth.tolist(), strict=True)]


def plants(values: list[Any]) -> list[list[Any]]:
    """Return the values as those of 50 plants."""
    return [values[k::50] for k in range(50)]


@pytest.mark.parametrize("tone", [6.4, 16.9, 34.0, 80.0])
@pytest.mark.parametrize(("kind", "when"), list(product(belief.WORDS, belief.WHEN)))
def test_truths_that_come_from_what_is_believed_are_found_calibrated_each_in_its_band(
    kind: str, when: str, tone: float
) -> None:
    found = belief.metrics(plants(drawn(kind, when, tone)))
    (band,) = (name for name, (low, high) in belief.BANDS.items() if low < tone <= high)
    assert found.keys() == {
        "plants", f"pit_error_{kind}_{when}_{band}", f"passed_95_{kind}_{when}_{band}", "pit_error_max", "passed_95",
        f"pit_chance_{kind}_{when}_{band}", "pit_cells", "pit_beyond",
    }  # fmt: skip
    assert (found["plants"], found["pit_cells"]) == (50, 1)
    assert found["pit_error_max"] < 1.6 * found[f"pit_chance_{kind}_{when}_{band}"]
    assert found["pit_error_max"] < 0.04
    assert found["passed_95"] == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize(
    ("wrong", "least", "most"), [({"wide": 0.3}, 0.0, 0.01), ({"wide": 3.0}, 0.1, 0.5), ({"shift": 1.0}, 0.1, 0.9)]
)
def test_a_belief_that_is_too_wide_or_too_narrow_or_too_low_is_found_so(
    wrong: dict[str, float], least: float, most: float
) -> None:
    """Where 5 % should pass: hardly any, or more than twice as many."""
    found = belief.metrics(plants(drawn("flowers", "before", 6.4, **wrong)))
    assert found["pit_error_max"] > 0.1
    assert found["pit_beyond"] == 1
    assert least <= found["passed_95"] <= most


def test_plants_not_values_are_what_chance_draws() -> None:
    """Values that are alike in each plant say no more than one of them."""
    rng = np.random.default_rng(2)
    shares = rng.uniform(size=40)
    alone = belief.by_chance(shares, np.arange(40))
    assert belief.by_chance(np.repeat(shares, 25), np.repeat(np.arange(40), 25)) == pytest.approx(alone)
    assert belief.by_chance(rng.uniform(size=1000), np.arange(1000)) < 0.3 * alone
    assert alone == pytest.approx(1.36 / np.sqrt(40), rel=0.3)  # Kolmogorov's


def test_of_few_values_no_distribution_is_told() -> None:
    few = drawn("flowers", "before", 6.4)[: belief.FEWEST - 1]
    assert np.isnan(belief.metrics([few])["pit_error_max"])
    assert np.isnan(belief.metrics([])["passed_95"])


def test_what_a_motor_moves_is_told_apart_by_crop_and_tone() -> None:
    motor = [[belief.MOTOR, "tomato", 34.0, [felt]] for felt in (1.0, 7.0, 9.0)]
    motor += [[belief.MOTOR, "pepper", 34.0, [2.0]]]
    values = drawn("flowers", "before", 6.4)
    found = belief.metrics([[*motor, *values]])
    assert (found["motor_tomato_34_ms2"], found["motor_pepper_34_ms2"]) == (7.0, 2.0)
    assert belief.metrics([values]) == {key: value for key, value in found.items() if not key.startswith("motor")}


def test_a_fit_finds_the_regression_that_values_were_drawn_with() -> None:
    rng, tone = np.random.default_rng(1), 8.5
    inertia = 2 * np.log(2 * np.pi * tone)
    members = rng.normal(-1.0, 1.0, (COUNT, 1)) + rng.normal(0.0, 0.2, (COUNT, 8))
    truth = -0.4 + 0.7 * members[:, 0] + 0.5 * rng.normal(size=COUNT)
    values = [
        ["flowers", "after", tone, (np.append(m, t) + inertia).tolist()] for m, t in zip(members, truth, strict=True)
    ]
    told = [float(part) for part in belief._likeliest(values).split(",")]
    assert told == pytest.approx([-0.4, 0.7, 0.5], abs=0.05)
    assert belief._likeliest(values[:1]) == "–"
