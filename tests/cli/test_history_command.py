"""`anther history` and its actions, from what a trial leaves behind to what was learned."""

from __future__ import annotations

import csv
import json
import os
import sys
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from anther.cli.args.trial import Args
from anther.cli.main import main
from anther.cli.run_folder import SUMMARY, remember
from anther.cli.trial import _belief
from anther.core.errors import InputError
from anther.core.files import write_json
from anther.history import read_outcomes, read_trials, record_trial
from anther.plant import GraspRecord, ShakeRecord, Visit
from anther.plant.model import TOMATO

BEGIN = datetime(2026, 5, 1, 23, 30, tzinfo=UTC)


def trial(plant: str, days: float = 0, species: str = "tomato") -> Visit:
    return Visit(
        species=species,
        plant=plant,
        held_unharmed=True,
        grasp=GraspRecord(0.21, organ="stem"),
        shake=ShakeRecord(9.0, 6e-4, 3.0),
        predicted_amplitude=(1e-3, 2e-3),
        measured_amplitude=(1.5e-3, float("nan")),
        measured_acceleration=(4.8, float("nan")),
        believed=TOMATO,
        material=replace(TOMATO, youngs=2e8, youngs_spread=0.3),
        run="runs/x",
        time=BEGIN + timedelta(days=days),
    )


@pytest.fixture
def history(tmp_path: Path) -> str:
    """Three visits to two tomato plants, one to a pepper of the same label, and one that failed."""
    where = str(tmp_path / "h.sqlite")
    for record in (trial("row 1"), trial("7", 2), trial("row 1", 4), trial("row 1", 5, "pepper")):
        record_trial(record, where)
    record_trial(Visit("tomato", "row 2", False, "no_stem_found", time=BEGIN + timedelta(days=6)), where)
    return where


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """Run a command and return (exit code, what it printed)."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words: object) -> tuple[int, str]:
        code = main([str(word) for word in words])
        caught = capsys.readouterr()
        return code, caught.out + caught.err

    return run


def test_the_list_and_its_filters(history: str, say) -> None:
    code, text = say("history", history)
    assert code == 0
    for part in (
        "0.60 mm, 9.0 Hz",
        "1.00 -> 1.50 (1 of 2)",
        "failed: no stem found",
        "nothing was learned of this plant yet",
    ):
        assert part in text, part
    assert "no_stem_found" not in say("history", history, "--result", "held")[1]
    assert "row 1" not in say("history", history, "--plant", "7")[1]
    assert "its own" not in text
    assert "7's own" in say("history", history, "--plant", "7")[1]
    only = say("history", history, "--since", "2026-05-03", "--until", "2026-05-03", "--species", "tomato")[1]
    assert "2026-05-03 23:30" in only
    assert "2026-05-01" not in only
    assert "3 earlier" in say("history", history, "--last", 2)[1]
    assert "no trial" in say("history", history, "--species", "cucumber")[1]
    code, text = say("history", history, "--result", "sad")
    assert code == 2
    assert "no_stem_found" in text


def test_a_narrow_terminal_shows_whole_words(history: str, say, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = say("history", history)[1]
    lines = text.splitlines()
    assert max(len(line) for line in lines) <= 80
    for words in ("2026-05-01 23:30", "failed: no stem found", "0.60 mm, 9.0 Hz", "row 1"):
        assert any(words in line for line in lines), words


def test_an_export_replaces_nothing_unasked(history: str, say, tmp_path: Path) -> None:
    out = tmp_path / "visits.csv"
    out.write_text("mine")
    code, text = say("history", history, "--export", out)
    assert (code, out.read_text()) == (2, "mine")
    assert "--overwrite" in text
    assert say("history", history, "--export", out, "--overwrite")[0] == 0
    assert out.read_text() != "mine"


def test_labels_are_text_whatever_they_look_like(tmp_path: Path, say) -> None:
    where = str(tmp_path / "h.sqlite")
    record_trial(replace(trial("row 3 [/bed]"), run="=cmd|' /C calc'!A0"), where)
    code, text = say("history", where)
    assert code == 0
    assert "row 3 [/bed]" in text
    assert "grasp [cm]" in text
    out = tmp_path / "visits.csv"
    assert say("history", where, "--export", out)[0] == 0
    cells = next(iter(csv.DictReader(out.open())))
    assert cells["run"] == "'=cmd|' /C calc'!A0"


@pytest.mark.parametrize("where", ["", ":memory:", "sqlite://", "pipe", "folder"])
def test_a_history_that_is_no_file_is_refused_at_once(where: str, tmp_path: Path, say, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("folder").mkdir()
    code, text = say("history", where)
    assert code == 2
    assert "Name a file" in text


def test_csv(history: str, say, tmp_path: Path) -> None:
    out = tmp_path / "t" / "visits.csv"
    assert say("history", history, "--export", out)[0] == 0
    rows = list(csv.DictReader(out.open()))
    assert len(rows) == 5
    assert float(rows[0]["measured_amplitude_median_m"]) == 1.5e-3
    assert (rows[0]["time"], rows[-1]["shake_frequency_hz"]) == ("2026-05-01T23:30:00+00:00", "")
    flowers = tmp_path / "flowers.csv"
    say("history", history, "--export", flowers, "--table", "flowers", "--plant", "7")
    assert [r["measured_acceleration_ms2"] for r in csv.DictReader(flowers.open())] == ["4.8", ""]
    assert say("history", history, "--export", tmp_path / "x.xlsx")[0] == 2


@pytest.mark.parametrize("table", ["visits", "flowers", "outcomes"])
def test_parquet_and_csv_say_the_same(history: str, say, tmp_path: Path, table: str) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed: pip install 'anther[parquet]'")
    say("history", "outcome", "row 2", "--flowers", 9, "--fruit", 4, "--history", history)
    for suffix in ("csv", "parquet"):
        assert say("history", history, "--export", tmp_path / f"t.{suffix}", "--table", table)[0] == 0
    columns = parquet.read_table(tmp_path / "t.parquet")
    rows = list(csv.DictReader((tmp_path / "t.csv").open()))
    assert columns.column_names == list(rows[0])
    for name, values in columns.to_pydict().items():
        texts = ["" if v is None else v.isoformat() if hasattr(v, "isoformat") else str(v) for v in values]
        assert texts == [row[name] for row in rows], name


def test_parquet_without_pyarrow_says_what_to_install(
    history: str, say, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    code, text = say("history", history, "--export", tmp_path / "t.parquet")
    assert (code, list(tmp_path.glob("*.parquet"))) == (2, [])
    assert "pip install 'anther[parquet]'" in text


@pytest.mark.parametrize(
    ("words", "plant", "visit"),
    [
        (["row 2"], "row 2", None),
        (["row 1", "--species", "tomato"], "row 1", None),
        (["visit:1"], "row 1", 1),
        (["3"], "row 1", 3),
        (["7"], "7", None),
        (["row 9", "--control", "--species", "tomato"], "row 9", None),
    ],
)
def test_outcomes_of_plants_visits_and_controls(history: str, say, words: list[str], plant: str, visit: int) -> None:
    code, text = say(
        "history", "outcome", *words, "--flowers", 8, "--fruit", 6, "--date", "2026-06-01", "--history", history
    )
    assert (code, "75%" in text) == (0, True), text
    (outcome,) = read_outcomes(history)
    assert (outcome.plant, outcome.visit, str(outcome.date)) == (plant, visit, "2026-06-01")
    assert plant in say("history", history)[1]


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["row 1"], "--species"),
        (["row 8"], "--control"),
        (["99"], "anther history"),
        (["row 9", "--control"], "--species"),
        (["row 2", "--control", "--species", "tomato"], "never was"),
        (["visit:99"], "anther history"),
    ],
)
def test_what_is_unclear_is_refused(history: str, say, words: list[str], hint: str) -> None:
    code, text = say("history", "outcome", *words, "--flowers", 8, "--fruit", 6, "--history", history)
    assert code == 2
    assert hint in text
    assert read_outcomes(history) == []


def test_a_number_that_is_a_plant_and_a_visit(history: str, say) -> None:
    record_trial(trial("2"), history)
    assert "plant:2 or visit:2" in say("history", "outcome", "2", "--flowers", 8, "--fruit", 9, "--history", history)[1]
    assert "allowed" in say("history", "outcome", "plant:2", "--flowers", 8, "--fruit", 9, "--history", history)[1]
    assert say("history", "outcome", "visit:2", "--flowers", 9, "--fruit", 8, "--history", history)[0] == 0
    assert [o.visit for o in read_outcomes(history)] == [2]


def test_fruit_set_from_the_history(history: str, say, tmp_path: Path) -> None:
    assert "No count" in say("history", "fruit-set", history)[1]
    say("history", "outcome", "row 1", "--species", "tomato", "--flowers", 20, "--fruit", 15, "--history", history)
    say(
        "history",
        "outcome",
        "row 9",
        "--species",
        "tomato",
        "--control",
        "--flowers",
        20,
        "--fruit",
        9,
        "--history",
        history,
    )
    code, text = say("history", "fruit-set", history, "--figure", tmp_path / "f.png")
    assert (code, (tmp_path / "f.png").stat().st_size > 5000) == (0, True)
    assert "2 counts (1 without a shake), 40 flowers, 24 fruit" in text
    assert "extrapolated" in text  # two shakes of 4.8 m/s2 free next to nothing
    result = json.loads(say("history", "fruit-set", history, "--json")[1])
    assert result["unshaken_learned"] > result["half_dose_learned"]
    assert result["probability"]["0"][0] < result["probability"]["200"][0]
    assert "0 counts" in say("history", "fruit-set", history, "--species", "pepper")[1]


def test_a_history_out_of_reach_loses_no_trial(tmp_path: Path, say) -> None:
    run, blocked = tmp_path / "run", tmp_path / "file"
    blocked.write_text("")
    told = remember(trial("a"), run, str(blocked / "h.sqlite"))
    assert told is not None
    assert f"--add {run}" in told
    where = str(tmp_path / "h.sqlite")
    assert say("history", where, "--add", run) == (0, f"{run}: visit 1\n")
    assert "already" in say("history", where, "--add", run)[1]
    (read,) = read_trials(where)
    assert (read.material, read.time) == (trial("a").material, BEGIN)
    assert np.isnan(read.measured_amplitude[1])
    (run / SUMMARY).unlink()
    assert say("history", where, "--add", run)[0] == 2
    write_json(run / SUMMARY, {"plant": 3})
    assert "kind 'visit'" in say("history", where, "--add", run)[1]


def test_a_trial_begins_with_what_was_learned(tmp_path: Path) -> None:
    where = str(tmp_path / "h.sqlite")
    args = Args(plant="tomato", seed=3, history=where)
    assert _belief(args).material == TOMATO
    record_trial(trial("simulated 2"), where)
    assert _belief(args).source == "facts", "another plant's"
    record_trial(replace(trial("simulated 3", 1), material=replace(TOMATO, youngs=3e8)), where)
    assert (_belief(args).source, _belief(args).material.youngs) == ("plant", 3e8)
    assert _belief(replace(args, material="facts")).material == TOMATO
    assert _belief(replace(args, plant="pepper")).source == "facts"
    (tmp_path / "no.sqlite").write_text("something else" * 500)
    with pytest.raises(InputError, match="trial history"):  # before anything moves
        _belief(replace(args, history=str(tmp_path / "no.sqlite")))
