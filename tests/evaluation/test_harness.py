"""evaluation/harness.py, tables.py and statistics.py: what every evaluation stands on."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation.harness import by_turns, finish, in_processes, options, plants_named
from evaluation.statistics import auc, bootstrap, logistic, mean, median, reliability
from evaluation.tables import by_number, by_part, markdown, measured, number, percent, written

OWN = {
    "--plants": (24, "of both crops"),
    "--ways": (("plan", "motor"), "of shaking", ("plan", "motor", "paper")),
    "--clouds": (Path, "kept here"),
    "--fit": (False, "fit instead"),
    "--drive": {"nargs": 2, "help": "two words"},
}


def asked(monkeypatch: pytest.MonkeyPatch, *words: str) -> Any:
    monkeypatch.setattr(sys, "argv", ["script", *words])
    return options("What is asked.", quick="fewer", seed=(7, "of it"), jobs="plants", out="runs/it", own=OWN)


def test_options_have_the_types_of_their_defaults(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = asked(monkeypatch)
    assert (usual.json, usual.quick, usual.seed, usual.jobs, usual.out) == (None, False, 7, 1, Path("runs/it"))
    assert (usual.plants, usual.ways, usual.clouds, usual.fit) == (24, ("plan", "motor"), None, False)
    words = "--quick --seed 3 --plants 2 --ways paper --clouds here --fit --drive a b"
    told = asked(monkeypatch, *words.split())
    assert (told.quick, told.seed, told.plants, told.ways, told.clouds) == (True, 3, 2, ["paper"], Path("here"))
    assert (told.fit, told.drive) == (True, ["a", "b"])


@pytest.mark.parametrize("words", [("--ways", "slowly"), ("--plants", "few"), ("--figure", "f.png")])
def test_options_refuse_what_they_do_not_know(monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit):
        asked(monkeypatch, *words)


def test_results_are_a_flat_file_and_what_is_printed_keeps_its_units(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    args = asked(monkeypatch, "--json", str(tmp_path / "told.json"))
    finish(args, {"a": np.float64(0.5), "b": np.nan}, "In [m/s²]:", markdown(("x [m]", "y"), [("[red]", 1)]))
    assert json.loads((tmp_path / "told.json").read_text()) == {"a": 0.5, "b": None}
    lines = [line.strip() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert lines[0] == "In [m/s²]:"
    assert lines[1].replace(" ", "") == "|x[m]|y|"
    assert lines[3].replace(" ", "") == "|[red]|1|"


def test_plants_are_named_by_species_and_seed() -> None:
    assert plants_named(["tomato-10", "pepper-3"]) == [("tomato", 10), ("pepper", 3)]
    assert by_turns(3, 5) == [("tomato", 5), ("pepper", 5), ("tomato", 6)]
    for wrong in ("tomato", "tomato-x", "cherry-1"):
        with pytest.raises(SystemExit, match="tomato-SEED or pepper-SEED"):
            plants_named([wrong])


def test_cells_of_tables() -> None:
    assert (percent(0.123, 1), percent(None), percent(np.nan)) == ("12.3%", "–", "–")
    assert (number(1234567), number(0.012345), number(12345.6), number("slow")) == (
        "1,234,567",
        "0.0123",
        "12,346",
        "slow",
    )
    table = measured({"a": 1, "c": 2.5}, {"a": "first", "b": "not there", "c": "third"})
    assert [list(column.cells) for column in table.columns] == [["first", "third"], ["1", "2.5"]]


def test_metrics_of_parts_are_told_by_part_or_by_number() -> None:
    found = {"tomato_error": 0.25, "tomato_n": 3, "pepper_error": np.nan, "bean_n": 2, "error": 1.0}
    parts = {"tomato_": "tomatoes", "pepper_": "peppers", "bean_": "beans", "": "all"}
    numbers = {"error": "*error:.0%", "of": "*n:.0f (*error:+.1f)"}
    lines = [
        ("crop", "error", "of"),
        ("tomatoes", "25%", "3 (+0.2)"),
        ("beans", "–", "2 (–)"),
        ("all", "100%", "– (+1.0)"),
    ]
    rows, columns = by_part(found, "crop", parts, numbers), by_number(found, "crop", parts, numbers)
    assert [(column.header, *column.cells) for column in rows.columns] == list(zip(*lines, strict=True))
    assert [(column.header, *column.cells) for column in columns.columns] == lines
    assert written("b:.1f of a-1:d m", {"a-1": 4}) == "– of 4 m"
    assert written("b:.1f of c:d m", {"a-1": 4}) == "–"


@pytest.mark.slow
def test_cases_in_processes_keep_their_order() -> None:
    assert in_processes(abs, [-3, 2, -1], 2, "numbers") == [3, 2, 1]


def test_scores_of_confidence() -> None:
    claimed, right = np.array([0.1, 0.2, 0.8, 0.9]), np.array([False, False, True, True])
    assert auc(claimed, right) == 1
    assert auc(claimed, ~right) == 0
    assert np.isnan(auc(claimed, right | True))
    assert reliability(np.array([0.11, 0.13, 0.95]), np.array([True, False, True])).tolist() == [
        [pytest.approx(0.12), 0.5, 2],
        [0.95, 1, 1],
    ]
    constant, weight = logistic(claimed[:, None], right)
    assert weight > 0
    assert constant + weight * 0.5 == pytest.approx(0, abs=1e-3)


def test_intervals_and_what_is_known() -> None:
    low, high = bootstrap(np.arange(101.0))
    assert low < 50 < high
    assert np.isnan(bootstrap(np.zeros(0))).all()
    assert (mean([1, None, 3]), median([1, np.nan, 2, 9])) == (2, 2)
    assert np.isnan(mean([]))
