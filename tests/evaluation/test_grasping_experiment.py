"""Parts of evaluation/trials/grasping.py: intervals, the paired test, the table, and going on where it stopped."""

from __future__ import annotations

import re
from argparse import Namespace
from pathlib import Path

import cv2
import numpy as np
import pytest

from evaluation.harness import FOLDER, run_cases
from evaluation.statistics import interval, mcnemar
from evaluation.tables import say
from evaluation.trials import grasping
from evaluation.trials.grasping_pictures import TILE, sheet
from evaluation.trials.grasping_table import as_counted, effects, metrics, report
from evaluation.trials.grasping_trial import crashed


def told(capsys, rows: list) -> str:
    """What is printed of trials, its cells without padding."""
    say(report(rows, metrics(rows)))
    return re.sub(r" {2,}", " ", capsys.readouterr().out)


def row(seed: int, *, ours: bool, paper: bool | None, preset: str = "full", first: bool = False) -> dict:
    """A trial of pepper `seed`; a failed one never shook."""
    shaken = {"stem_held": True, "reach_s": 5.0, "shake_s": 3.0, "retreat_s": 2.0}
    failed = {"success": False, "failure": "slipped", "stem_held": False}
    sides = [{"success": True, "failure": None, **shaken} if won else failed for won in (ours, paper)]
    case = {"species": "pepper", "seed": seed, "viewpoint": 0, "preset": preset, "arm": "sawyer", "first": first}
    times = {"capture_s": 40.0, "compute_s": 4.0 if seed % 2 else 6.0, "plan_s": 0.1 * seed, "plan_cpu_s": 0.1}
    return {**case, **times, "ours": sides[0], "paper": None if paper is None else sides[1]}


@pytest.mark.parametrize(("successes", "trials", "low", "high"), [(37, 40, 0.801, 0.974), (40, 40, 0.912, 1.0)])
def test_wilson_interval_of_known_shares(successes, trials, low, high):
    assert interval(successes, trials) == pytest.approx((low, high), abs=1e-3)


def test_mcnemar_counts_only_pairs_that_differ():
    ours, theirs = [True] * 6 + [True, False], [False] * 6 + [True, False]
    assert mcnemar(ours, theirs) == (6, 0, pytest.approx(2 * 0.5**6))
    assert mcnemar([True], [True]) == (0, 0, 1.0)


def test_table_keeps_groups_apart_and_leaves_cold_starts_out_of_times():
    rows = [row(1, ours=True, paper=False), row(2, ours=False, paper=True), row(4, ours=True, paper=True)]
    rows += [row(1000, ours=True, paper=True, first=True), row(1, ours=True, paper=None, preset="fast")]
    table = metrics(rows)
    assert table["success_40"] == table["paper_rule_success_40"] == pytest.approx(2 / 3)
    assert (table["success_only_ours_40"], table["success_only_paper_rule_40"]) == (1, 1)
    assert (table["success_400"], table["trials_400"], table["failed_40_slipped"]) == (1.0, 1, 1)
    assert (table["plants_40"], table["plants_all_40"]) == (3, 2)
    assert "paper_rule_success_fast" not in table
    assert table["cycle_30_views_s"] == pytest.approx(40 + (4 + 6) / 2 + 5 + 3)  # without the retreat, 1000 was cold
    assert table["plan_30_views_p95_s"] == pytest.approx(np.quantile([0.1, 0.2, 0.4], 0.95))


def judged(*, held: bool, moved: bool, harm: float, felt: float) -> dict:
    """What is kept of a trial that the judge saw."""
    parts = {"held": held, "unharmed": True, "flowers_moved": moved, "success": held and moved}
    numbers = {"harm_probability": harm, "true_flower_acceleration_median_ms2": felt, "pollen_freed_median": 0.1}
    return as_counted(parts | numbers | {"failure": None if held else "slipped"})


def test_success_stays_held_and_unharmed_and_what_the_flowers_felt_stands_beside_it(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    hardly, moved = (
        judged(held=True, moved=False, harm=0.02, felt=2.0),
        judged(held=True, moved=True, harm=0.1, felt=6.0),
    )
    slipped = judged(held=False, moved=True, harm=0.0, felt=7.0)
    refused = {"held": False, "unharmed": None, "flowers_moved": None, "success": False, "failure": "no_stem_found"}
    assert [one["success"] for one in (hardly, moved, slipped, as_counted(refused))] == [True, True, False, False]
    assert as_counted({"success": True, "failure": None})["success"], "an earlier trial"
    table = effects([hardly, moved, slipped, as_counted(refused)])
    assert (table["moved_share"], table["all_three_share"]) == (0.5, 0.25)
    assert table["harm_probability_mean"] == pytest.approx(0.04)
    assert table["flower_acceleration_median_ms2"] == 6.0
    rows = [row(seed, ours=True, paper=None) for seed in (1, 2)]
    assert "moved_share_40" not in metrics(rows), "earlier trials were not asked"
    rows = [one | {"ours": one["ours"] | ours} for one, ours in zip(rows, (hardly, moved), strict=True)]
    table = metrics(rows)
    assert (table["success_40"], table["moved_share_40"], table["pepper_all_three_share_40"]) == (1.0, 0.5, 0.5)
    assert "| 100.0% | 6.0% | 50.0% | 4.0 | – | 10.0% |" in told(capsys, rows)


def test_what_is_printed_has_shares_pairs_units_and_every_failure(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    rows = [
        row(1, ours=True, paper=False),
        row(2, ours=False, paper=True),
        row(3, ours=True, paper=None, preset="fast"),
    ]
    for one in rows:
        for who in ("ours", "paper"):
            one[who] = one[who] and {**one[who], "message": "6 mm"}
    text = told(capsys, rows)
    assert "| ten plants, 30 views | held and unharmed |" in text
    assert "| pepper (the paper held 31/32 = 96.9 %) | 1/2 = 50.0% |" in text
    assert "| pepper 2 from 0°, sawyer, full | slipped | 6 mm |" in text
    assert "slipped 1" in text
    assert "median flower [m/s²] |" in text


def test_protocol_is_ten_plants_from_four_sides():
    asked = Namespace(quick=False, plants=None, further=3, seed=0, viewpoints=grasping.VIEWPOINTS, presets=["full"])
    cases = grasping.chosen(asked)
    assert len(cases) == len(set(cases)) == 40 + 12
    assert sum(case.seed < 1000 and case.species == "tomato" for case in cases) == 8
    assert len(set(grasping.FURTHER)) == 100


def unlucky(row, folder):
    """Crash until there is a file of the row's name, and count the calls beside it."""
    luck = Path(row["luck"])
    (luck.parent / f"{row['seed']}-{len(list(luck.parent.glob('*')))}").touch()
    if not luck.exists():
        raise RuntimeError("out of luck")
    (folder / "picture.png").write_bytes(b"seen")
    return {"ours": {"success": True}}


@pytest.mark.slow
def test_finished_trials_are_read_back_and_crashes_are_tried_again(tmp_path):
    (tmp_path / "there").mkdir()
    luck = tmp_path / "there" / "luck"
    cases = [{"seed": 1, "luck": str(luck)}]
    (row,) = run_cases(unlucky, cases, tmp_path / "out", 1, crashed)
    assert row["ours"]["failure"] == "crashed"
    assert "out of luck" in row["ours"]["message"]
    luck.touch()
    (row,) = run_cases(unlucky, cases, tmp_path / "out", 1, crashed)
    assert row["ours"]["success"]
    assert (Path(row[FOLDER]) / "picture.png").read_bytes() == b"seen"
    calls = len(list(luck.parent.glob("1-*")))
    luck.unlink()
    (row,) = run_cases(unlucky, cases, tmp_path / "out", 1, crashed)
    assert row["ours"]["success"]
    assert len(list(luck.parent.glob("1-*"))) == calls == 2
    file = tmp_path / "done" / "it.jsonl"
    for folder in ("out", "elsewhere"):  # the second time from the file alone
        (row,) = run_cases(unlucky, cases, tmp_path / folder, 1, crashed, file)
        assert (row["seed"], row["ours"]["success"]) == (1, True)
    assert len(list(luck.parent.glob("1-*"))) == calls
    assert not (tmp_path / "elsewhere").exists()


def test_a_sheet_has_room_for_every_tile(tmp_path):
    cv2.imwrite(str(tmp_path / "one.png"), np.zeros((TILE, TILE, 3), np.uint8))
    sheet([(tmp_path / "one.png", "p1 0", True), (tmp_path / "missing.png", "p1 90", False)] * 2, 3, tmp_path / "s.png")
    height, width = cv2.imread(str(tmp_path / "s.png")).shape[:2]
    assert height >= 2 * TILE
    assert width >= 3 * TILE
