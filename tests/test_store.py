"""Trial history: what is written is read back, also when several processes write at once."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anther.errors import InputError
from anther.plant import Material
from anther.store import TrialRecord, read_trials, record_trial

NOON = datetime(2026, 5, 1, 12, tzinfo=UTC)


def full(plant: str = "seed 3", minutes: int = 0) -> TrialRecord:
    return TrialRecord(
        species="tomato",
        plant=plant,
        success=False,
        failure="slipped",
        grasp={"pose7": np.arange(7.0), "arc_length": np.float64(0.31)},
        shake={"frequency": 8.1, "amplitude": 1.3e-3, "direction": [0, 1, 0]},
        predicted_amplitude=(1e-3, 2e-3),
        measured_amplitude=(1.1e-3, float("nan")),
        material=Material(youngs=8e7, youngs_spread=0.2),
        run="runs/7",
        time=NOON + timedelta(minutes=minutes),
    )


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "history.sqlite"
    number = record_trial(full(), path)
    (read,) = read_trials(path)
    assert read.id == number
    assert read.material == full().material
    assert read.time == NOON
    assert read.grasp == {"pose7": list(range(7)), "arc_length": 0.31}
    assert read.predicted_amplitude == (1e-3, 2e-3)
    assert np.isnan(read.measured_amplitude[1])
    assert (read.success, read.failure, read.run) == (False, "slipped", "runs/7")


def test_little_is_needed(tmp_path: Path) -> None:
    record_trial(TrialRecord("pepper", "row 3, 14", True), tmp_path / "h.sqlite")
    (read,) = read_trials(tmp_path / "h.sqlite")
    assert (read.material, read.failure, read.measured_amplitude) == (None, None, ())


def test_oldest_first_and_filtered(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    for plant, minutes in (("b", 5), ("a", 1), ("b", 3)):
        record_trial(full(plant, minutes), path)
    assert [r.time.minute for r in read_trials(path)] == [1, 3, 5]
    assert [r.time.minute for r in read_trials(path, plant="b")] == [3, 5]
    assert read_trials(path, species="pepper") == []
    assert read_trials(tmp_path / "missing.sqlite") == []
    assert not (tmp_path / "missing.sqlite").exists()


WRITER = """
import sys
from anther.store import TrialRecord, read_trials, record_trial
for k in range(20):
    record_trial(TrialRecord("tomato", f"{sys.argv[2]} {k}", True), sys.argv[1])
"""


def test_two_processes_write_at_once(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, str(path), name]) for name in "ab"]
    assert [w.wait(60) for w in writers] == [0, 0]
    trials = read_trials(path)
    assert sorted(t.plant for t in trials) == sorted(f"{name} {k}" for name in "ab" for k in range(20))
    assert len({t.id for t in trials}) == 40


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    path.write_text("not a database " * 100)
    for use in (lambda: record_trial(full(), path), lambda: read_trials(path)):
        with pytest.raises(InputError, match="trial history"):
            use()
    with pytest.raises(InputError, match="trial history"):
        record_trial(full(), path / "inside" / "a" / "file.sqlite")


def test_a_refused_record_leaves_no_trace(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    record_trial(full(), path)
    with pytest.raises(InputError):
        record_trial(TrialRecord("tomato", "x", True, shake={"frequency": float("nan")}), path)
    assert len(read_trials(path)) == 1


@given(st.sampled_from(["species", "plant"]), st.sampled_from(["", "x" * 201]))
def test_labels_are_brief(name: str, value: str) -> None:
    with pytest.raises(InputError, match=name):
        TrialRecord(**({"species": "tomato", "plant": "1", "success": True} | {name: value}))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="time"):
        TrialRecord("tomato", "1", True, time=datetime(2026, 1, 1))
