"""Parts of evaluation/prediction/wide_truth.py: what its rows say, the ranking, the trials, and the flat table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.table import Table

from evaluation.prediction import wide_table, wide_truth
from evaluation.prediction.wide_plant import FAST, HEIGHTS, HELD, KINDS, SLOW, TONES
from evaluation.trials import wide_grasping

GRIPS, PITCHES, FLOWERS = len(HEIGHTS), len(SLOW) + len(FAST), 2


def around(true: Any, factor: Any = 1.0) -> Any:
    """Quantiles whose middle is `factor` times the truth, 20 % to either side."""
    return (np.asarray(true) * factor)[..., None] * np.array([0.8, 1.0, 1.25])


def row(
    species: str = "tomato", *, after: Any = 1.0, before: float = 1.0, loads: float = 1.0, held: float = 1.0
) -> Any:
    """A plant that was predicted by these factors; its second flower was hidden in every tone."""
    true = np.arange(1.0, 1 + GRIPS * PITCHES * FLOWERS).reshape(GRIPS, PITCHES, FLOWERS) * 1e-3
    strain = true[:, :, 0]
    moved = np.array([2e-3, 3e-3])
    tone = {"true": moved, "said": [held * moved[0], 3 * moved[1]], "measured": [True, False]}
    tone["interval"] = np.stack([np.array(tone["said"]) * 0.9, np.array(tone["said"]) * 1.1], axis=1)
    return {
        "species": species,
        "seed": 1,
        "true": true,
        "after": around(true, after),
        "before": around(true, before),
        "loads": dict.fromkeys(KINDS, strain),
        "loads after": dict.fromkeys(KINDS, around(strain, loads)),
        "held": [tone] * len(TONES),
    }


def test_a_perfect_prediction_errs_nowhere_and_is_always_covered() -> None:
    table = wide_table.metrics([row(), row("pepper")])
    assert all(value == pytest.approx(0) for key, value in table.items() if key.startswith(("error_o", "error_b")))
    assert table["error_held_seen"] == pytest.approx(0)
    assert all(value == 1 for key, value in table.items() if key.startswith("coverage_"))
    assert all(value == pytest.approx(0) for key, value in table.items() if key.startswith(("bias_", "spread_")))
    assert (table["plants"], table["plants_lost"], table["measured_share"]) == (2, 0, 0.5)


def test_intervals_that_miss_cover_nothing_whichever_way_they_miss() -> None:
    low, high = (wide_table.metrics([row(after=f, before=f, loads=f, held=f)]) for f in (0.5, 2.0))
    for table in (low, high):
        assert all(value == 0 for key, value in table.items() if key.startswith("coverage_"))
    assert (low["error_other_tomato"], high["error_other_tomato"]) == pytest.approx((0.5, 1.0))
    assert (low["bias_stem_strain"], high["bias_amplitude"]) == pytest.approx((np.log(2), -np.log(2)))


def test_each_coverage_is_of_its_own_and_the_whole_is_the_mean_of_held_amplitude_and_strains() -> None:
    table = wide_table.metrics([row(before=2.0, loads=2.0)])
    assert [table[f"coverage_{k}"] for k in ("held", "amplitude", "before", *KINDS)] == [1, 1, 0, *[0] * len(KINDS)]
    assert table["coverage_90"] == pytest.approx(2 / (2 + len(KINDS)))


def test_flowers_that_were_hidden_are_counted_apart_and_do_not_cover() -> None:
    table = wide_table.metrics([row(held=1.05)])
    assert table["error_held_seen"] == pytest.approx(0.05)
    assert table["error_held_hidden"] == pytest.approx(2.0)
    assert table["coverage_held"] == 1  # of the one that was seen


def test_the_held_grip_is_not_another_one_and_the_bands_and_crops_are_apart() -> None:
    factor = np.ones((GRIPS, PITCHES, 1))
    factor[:, len(SLOW) :] = 1.3
    factor[HELD - 1, : len(SLOW)] = 1.2
    factor[HELD] = 7.0
    table = wide_table.metrics([row(after=factor, before=1.1), row("pepper", after=2.0)])
    assert table["error_other_tomato"] == pytest.approx(0.1)  # the median of two grips
    assert table["error_other_tomato_fast"] == pytest.approx(0.3)
    assert table["error_before_tomato"] == table["error_before_tomato_fast"] == pytest.approx(0.1)
    assert table["error_other_pepper"] == table["error_other_pepper_fast"] == pytest.approx(1.0)
    assert np.isnan(wide_table.metrics([row()])["error_other_pepper"])


def test_lost_plants_are_counted_and_left_out() -> None:
    lost = {"species": "tomato", "seed": 2, "lost": "no stem"}
    empty = row(after=9.0) | {"true": np.zeros((GRIPS, PITCHES, 0))}
    with_lost, alone = wide_table.metrics([row(after=1.1), lost, empty]), wide_table.metrics([row(after=1.1)])
    assert (with_lost.pop("plants_lost"), alone.pop("plants_lost")) == (1, 0)
    assert with_lost == pytest.approx(alone, nan_ok=True)


def test_the_ranking_begins_with_nothing_and_everything_and_then_has_the_worst_first() -> None:
    by_truth = {name: {"error": value} for name, value in {"drag": 0.1, "wide": 0.3, "pads": 0.5, "wind": 0.2}.items()}
    keys = {"error": "an error", "other": "another"}
    table = wide_table.ranking(by_truth | {"nominal": {"error": 0.05, "other": 2.0}}, keys)
    names, error, other = ([str(cell) for cell in column.cells] for column in table.columns)
    assert names == ["nothing", "**everything**", "pads", "wind", "drag"]
    assert error == ["0.05", "0.3", "0.5", "0.2", "0.1"]
    assert other == ["2", *["–"] * 4]


def test_what_is_told_of_predictions_has_errors_by_crop_and_every_interval() -> None:
    _, errors, _, intervals = wide_table.told(
        wide_table.metrics([row(after=1.1, held=1.05), row("pepper", before=2.0)])
    )
    assert isinstance(errors, Table)
    assert isinstance(intervals, Table)
    told = dict(zip(*([str(cell) for cell in column.cells] for column in errors.columns), strict=True))
    assert told["two other grips, 0.7 to 1.9 Hz, tomato"] == "10.0%"
    assert told["all grips, nothing measured, 0.7 to 1.9 Hz, pepper"] == "100.0%"
    assert told["held grip, flowers that the camera measured, 1.5 times the measured shake"] == "2.5%"
    assert [str(cell) for cell in intervals.columns[1].cells] == ["100.0%"] * len(wide_table.QUANTITIES)


def test_where_nothing_was_predicted_no_table_is_told() -> None:
    assert len(wide_table.told({"plants": 0.0, "plants_lost": 2.0})) == 1


def test_trials_are_of_both_species_by_turns_from_four_sides_each() -> None:
    cases = wide_grasping.cases(10, 2, "fast", "wide")
    first = wide_grasping.FIRST + 2
    assert [(c.species, c.seed) for c in cases[::4]] == [("tomato", first), ("pepper", first), ("tomato", first + 1)]
    assert [c.viewpoint for c in cases] == [0, 90, 180, 270, 0, 90, 180, 270, 0, 90]
    assert {(c.preset, c.truth) for c in cases} == {("fast", "wide")}
    many = wide_grasping.cases(400, 0, "fast", "wide")
    assert len({(c.species, c.seed, c.viewpoint) for c in many}) == len(many) == 400


def test_the_flat_table_names_what_each_truth_did(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    predicted = {"wide": {"coverage_90": 0.9, "plants": 200.0}, "camera poses": {"coverage_90": 0.8, "plants": 24.0}}
    grasped = {"wide": {"success": 0.95}, "nominal": {"success": 1.0, "moved_share": 0.7}}
    table = wide_truth.flat(predicted, grasped)
    wide = {"coverage_90": 0.9, "plants": 200.0, "grasp_success": 0.95, "grasp_400_wide": 0.95}
    assert {key: value for key, value in table.items() if "__" not in key} == wide
    alone = {f"{key}__camera_poses" for key in wide_truth.PREDICTED} | {f"{k}__nominal" for k in wide_truth.GRASPED}
    assert {key for key in table if "__" in key} == alone
    assert (table["coverage_90__camera_poses"], table["moved_share__nominal"]) == (0.8, 0.7)
    assert np.isnan(table["harm_probability_mean__nominal"])
    Path("docs/results").mkdir(parents=True)
    Path("docs/results/second_judge.json").write_text(json.dumps({"metrics": {"second_judge_error_max": 0.01}}))
    assert wide_truth.flat({}, {}) == {"second_judge_error_max": 0.01}


def test_every_group_that_is_tried_exists() -> None:
    assert set(wide_grasping.GROUPS) <= set(wide_truth.WIDE)


def test_where_every_plant_is_lost_only_that_is_told() -> None:
    assert wide_table.metrics([{"species": "tomato", "seed": 1, "lost": "it fell over"}]) == {
        "plants": 0.0,
        "plants_lost": 1.0,
    }
