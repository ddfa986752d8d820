"""What a campaign of rows counts."""

from __future__ import annotations

from typing import Any

import pytest

from evaluation.tables import say
from evaluation.trials.rows import ACCELERATION, harmful, held, metrics, report

TIMES = {"thought_s": 5.0, "approach_s": 8.0, "shake_s": 4.0, "retreat_s": 3.0, "ahead_s": 9.0}
PHASES = {"early reach": 2.0, "reach": 0.1, "approach": 6.0}


def row(**values: Any) -> dict[str, Any]:
    usual = {
        "species": "tomato",
        "seed": 1,
        "held": True,
        "true_held_beside": "",
        ACCELERATION: 9.0,
        **TIMES,
        "phases_s": PHASES,
    }
    return usual | {"neighbour_force": 0.0, "part_force": 0.0, "string_pull": 1.1} | values


@pytest.mark.parametrize(
    ("change", "is_held", "is_harmful"),
    [
        ({}, True, False),
        ({"held": False}, False, False),
        ({"true_held_beside": "petiole"}, False, False),
        ({"neighbour_force": 0.1}, False, True),
        ({"part_force": 3.0}, False, True),
        ({"string_pull": 2.02}, False, True),
    ],
)
def test_a_stem_is_held_when_nothing_else_is_held_touched_or_pulled(
    change: dict[str, Any], is_held: bool, is_harmful: bool
) -> None:
    assert (held(row(**change)), harmful(row(**change))) == (is_held, is_harmful)


def test_shares_and_times_are_of_the_rows_that_they_are_of() -> None:
    crashed = {"species": "pepper", "seed": 1, "success": False, "failure": "crashed", "message": "why"}
    rows = [row(), row(**{ACCELERATION: 1.0}), row(held=False, thought_s=7.0), row(thought_s=5.0), crashed]
    found = metrics(rows)
    assert found["rows"] == 5
    assert found["held_row"] == pytest.approx(3 / 5)
    assert found["held_row_tomato"] == pytest.approx(3 / 4)
    assert found["held_row_pepper"] == 0
    assert found["moved_row"] == pytest.approx(2 / 3)
    assert found["neighbour_harm"] == 0
    assert found["cycle_s"] == pytest.approx(22.0), "one that crashed took no time, nor does what is thought ahead"
    assert found["ahead_s"] == pytest.approx(9.0)
    assert found["thought_s"] == pytest.approx(5.0)
    say(report(rows, found))


def test_rows_of_the_second_generator_count_by_themselves() -> None:
    rows = [row(held=False), row(generator="helios"), row(generator="helios", **{ACCELERATION: 1.0}, thought_s=50.0)]
    found = metrics(rows)
    assert (found["rows"], found["rows_helios"]) == (1, 2)
    assert (found["held_row"], found["held_row_tomato"], found["held_row_helios"]) == (0, 0, 1)
    assert found["moved_row_helios"] == pytest.approx(1 / 2)
    assert found["held_row_helios_low"] < 1 == pytest.approx(found["held_row_helios_high"])
    assert found["thought_s"] == pytest.approx(5.0)
    say(report(rows, found))


def test_no_visit_at_all_is_no_share() -> None:
    found = metrics([row(species="tomato", held=False)])
    assert found["held_row"] == 0
    assert found["moved_row"] != found["moved_row"], "NaN: none was held"


def test_flowers_that_were_lost_stand_beside_those_that_were_expected_to_be() -> None:
    ten = {"true_flower_acceleration_peak_ms2": [5.0] * 10}
    rows = [
        row(**ten, flowers_lost=1, expected_lost_share=0.02),
        row(true_flower_acceleration_peak_ms2=[5.0] * 30, flowers_lost=3, expected_lost_share=0.06),
        row(**ten, flowers_lost=2),
        row(**ten, flowers_lost=9, expected_lost_share=0.9, held=False),
    ]
    found = metrics(rows)
    assert found["lost_row"] == pytest.approx(6 / 50)
    assert found["lost_row_expected"] == pytest.approx((0.2 + 1.8) / 40), "of a visit that did not say, nothing counts"
