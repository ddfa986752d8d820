"""Trial history: what is written is read back, by several processes at once, and after a kill."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from postgresql_server import Server
from sqlalchemy import text

from anther.core.errors import InputError, MissingExtra
from anther.history import (
    Outcome,
    add_missing,
    find_visit,
    hide_password,
    open_reader,
    overview,
    read_outcomes,
    read_plants,
    read_trials,
    record_outcome,
    record_trial,
)
from anther.history._database import _engine, open_writer
from anther.history._jobs import Job, add_jobs, note_jobs, read_jobs
from anther.plant import GraspRecord, ShakeRecord, Visit
from anther.plant.model import Material

KILLS = int(os.environ.get("ANTHER_KILLS", "4"))
NOON = datetime(2026, 5, 1, 12, tzinfo=UTC)


def full(plant: str = "seed 3", minutes: int = 0) -> Visit:
    return Visit(
        species="tomato",
        plant=plant,
        held_unharmed=False,
        failure="slipped",
        grasp=GraspRecord(0.31, 0.008, 0.93, "stem", tuple(range(7))),
        shake=ShakeRecord(8.1, 1.3e-3, 3.2, "sine", (0.0, 1.0, 0.0)),
        predicted_amplitude=(1e-3, 2e-3),
        measured_amplitude=(1.1e-3, float("nan")),
        believed=Material(),
        material=Material(youngs=8e7, youngs_spread=0.2),
        run="runs/7",
        time=NOON + timedelta(minutes=minutes),
    )


def test_round_trip(where: str) -> None:
    number = record_trial(full(), where)
    (read,) = read_trials(where)
    assert read.id == number
    assert (read.material, read.believed) == (full().material, full().believed)
    assert (read.grasp, read.shake, read.time) == (full().grasp, full().shake, NOON)
    assert read.predicted_amplitude == (1e-3, 2e-3)
    assert read.measured_amplitude[0] == 1.1e-3
    assert np.isnan(read.measured_amplitude[1])
    assert np.isnan(read.measured_acceleration).all()
    assert (read.held_unharmed, read.failure, read.run) == (False, "slipped", "runs/7")
    assert find_visit(number, where).grasp == read.grasp  # type: ignore[union-attr]
    assert find_visit(number + 1, where) is None


def test_little_is_needed(where: str) -> None:
    record_trial(Visit("pepper", "row 3, 14", True), where)
    (read,) = read_trials(where)
    assert (read.material, read.failure, read.grasp, read.shake, read.measured_amplitude) == (None,) * 4 + ((),)
    assert read_plants("row 3, 14", where) == [("pepper", "row 3, 14")]


def test_oldest_first_and_filtered(where: str) -> None:
    for plant, minutes in (("b", 5), ("a", 1), ("b", 3)):
        record_trial(full(plant, minutes), where)
    record_trial(Visit("pepper", "b", True, time=NOON + timedelta(days=2, hours=11)), where)

    def minutes_of(**which: object) -> list[int]:
        return [r.time.minute for r in read_trials(where, **which)]  # type: ignore[arg-type]

    assert minutes_of(species="tomato") == [1, 3, 5]
    assert minutes_of(plant="b", species="tomato") == [3, 5]
    assert minutes_of(result="slipped") == minutes_of(result="failed") == [1, 3, 5]
    assert minutes_of(result="held") == minutes_of(since=date(2026, 5, 2)) == [0]
    assert minutes_of(since=date(2026, 5, 3), until=date(2026, 5, 3)) == [0]
    assert minutes_of(until=date(2026, 5, 2)) == [1, 3, 5]
    assert read_trials(where, species="cucumber") == []


def test_a_history_that_is_not_there_is_empty_and_not_made(tmp_path: Path) -> None:
    assert read_trials(tmp_path / "missing.sqlite") == read_outcomes(tmp_path / "missing.sqlite") == []
    assert not (tmp_path / "missing.sqlite").exists()


def test_a_history_on_a_disk_that_is_only_read_is_read(tmp_path: Path) -> None:
    """A disk of its own, mounted so in a namespace of this test alone."""
    path = tmp_path / "a b%" / "h.sqlite"
    record_trial(full(), path)
    alone = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c"]
    mount = 'mount --bind "$1" "$1" && mount -o remount,ro,bind "$1"'
    if subprocess.run([*alone, mount, "sh", path.parent], capture_output=True, check=False).returncode:
        pytest.skip("this machine lets nobody mount: unshare --user --mount")
    code = """if True:
        import sys
        from anther.history import read_trials, record_trial
        from anther.plant import Visit
        print([trial.plant for trial in read_trials(sys.argv[1])])
        try:
            record_trial(Visit("tomato", "row 1", held_unharmed=True, failure=None), sys.argv[1])
        except Exception as error:
            print(error)"""
    command = [*alone, f'{mount} && exec "$2" -c "$3" "$4"', "sh", path.parent, sys.executable, code, path]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.splitlines()[0] == "['seed 3']"
    assert "readonly" in done.stdout
    assert "ask for the right to write there" in done.stdout


def test_a_path_is_of_the_folder_that_is_current(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        record_trial(full(plant=name), "runs/history.sqlite")
        assert [t.plant for t in read_trials("runs/history.sqlite")] == [name]


def test_outcomes(where: str) -> None:
    visit = record_trial(full(), where)
    days = [date(2026, 6, 1), date(2026, 6, 8)]
    record_outcome(Outcome("tomato", "seed 3", 10, 3, days[1]), where)
    record_outcome(Outcome("tomato", "seed 3", 10, 4, days[0], visit=visit, note="hot week"), where)
    record_outcome(Outcome("tomato", "seed 3", 10, 5, days[1]), where)  # counted again: this one holds
    record_outcome(Outcome("tomato", "control", 8, 2, days[1]), where)
    counts = read_outcomes(where)
    assert [(o.plant, o.fruit, o.date) for o in counts] == [
        ("seed 3", 4, days[0]), ("seed 3", 5, days[1]), ("control", 2, days[1]),
    ]  # fmt: skip
    assert (counts[0].visit, counts[0].note) == (visit, "hot week")
    assert [o.plant for o in read_outcomes(where, plant="control")] == ["control"]
    with pytest.raises(InputError, match="visit"):
        record_outcome(Outcome("tomato", "control", 8, 2, days[0], visit=visit), where)
    assert len(read_outcomes(where)) == 3


def test_a_record_survives_as_json_and_is_added_once(where: str) -> None:
    again = Visit.of(full().flat())
    assert json.dumps(again.flat()) == json.dumps(full().flat())
    assert (again.grasp, again.shake, again.material, again.time) == (
        full().grasp, full().shake, full().material, full().time,
    )  # fmt: skip
    assert add_missing(again, where) is not None
    assert add_missing(again, where) is None
    assert len(read_trials(where)) == 1
    assert add_missing(full("seed 4"), where) is not None  # at the same time, but another plant
    with pytest.raises(InputError, match="record of a visit"):
        Visit.of({"species": "tomato"})


def write_on(where: str, name: str, count: int, pipe: int) -> None:
    """Record trials of three plants; report each one's number once it is recorded."""
    for k in range(count):
        record = Visit("tomato", f"{name} {k % 3}", True, shake=ShakeRecord(8.0, 1e-3), robot=f"{os.getpid()}")
        number = record_trial(replace(record, predicted_amplitude=(1e-3, 2e-3, 3e-3, 4e-3, 5e-3)), where)
        os.write(pipe, f"{number}\n".encode())


def writer(where: str, name: str, count: int) -> tuple[Any, IO[str]]:
    """Start another process that writes; return it and what it reports."""
    read, write = os.pipe()
    process = multiprocessing.get_context("fork").Process(target=write_on, args=(where, name, count, write))
    process.start()
    os.close(write)
    return process, os.fdopen(read)


def numbers_of(writers: list[tuple[Any, IO[str]]]) -> list[int]:
    """Wait for writers and return the numbers they reported."""
    numbers = [int(line) for _, reports in writers for line in reports]
    for process, reports in writers:
        process.join(60)
        reports.close()
    return numbers


def test_processes_write_at_once(where: str) -> None:
    """Also the tables are made by whoever is first, and all write the same plants."""
    writers = [writer(where, "same", 8) for _ in range(3)]
    numbers = numbers_of(writers)
    assert [process.exitcode for process, _ in writers] == [0, 0, 0]
    trials = read_trials(where)
    assert sorted(numbers) == sorted(t.id for t in trials if t.id is not None)
    assert len(set(numbers)) == 24
    assert {t.plant for t in trials} == {"same 0", "same 1", "same 2"}
    assert {t.flowers for t in trials} == {5}


def test_a_killed_writer_loses_nothing_it_reported(where: str) -> None:
    """Killed at some moment of its work; what it had reported is there, whole, and nothing else is half there."""
    reported: list[int] = []
    for k in range(KILLS):
        process, reports = writer(where, f"killed {k}", 10_000)
        reported.append(int(reports.readline()))
        time.sleep(0.013 * (k % 7))
        process.kill()
        reported += numbers_of([(process, reports)])
        assert process.exitcode == -signal.SIGKILL
    trials = read_trials(where)
    assert set(reported) <= {t.id for t in trials}
    assert len(trials) <= len(reported) + KILLS
    assert all(t.flowers == 5 and t.shake is not None for t in trials)
    record_trial(full(), where)
    if "://" not in where:
        with sqlite3.connect(where) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_a_crashed_server_loses_nothing(server: Server) -> None:
    where = server.address()
    numbers = [record_trial(full("crash", k), where) for k in range(5)]
    server.crash()
    with pytest.raises(InputError, match="Is the server running"):
        record_trial(full("crash", 6), where)
    server.start()
    assert [t.id for t in read_trials(where, plant="crash")] == numbers


def test_jobs_of_a_sweep(where: str) -> None:
    jobs = [Job(f"k{n}", {"seed": n}) for n in range(3)]
    named = {"uid": "u", "folder": "runs/night", "function": "trial"}
    add_jobs(jobs[:2], where, **named)
    done = replace(jobs[1], state="done", tries=2, result={"success": True}, seconds=1.5, reason="its worker died")
    note_jobs([done], where, uid="u")
    add_jobs(jobs, where, **named)  # what is noted stays
    add_jobs(jobs, where, uid="v", folder="runs/other", function="trial")
    assert read_jobs(where, "u") == [jobs[0], done, jobs[2]]
    assert read_jobs(where, "none") == []
    with open_reader(where) as session:
        assert session is not None
        second, first = overview.sweeps(session)
    assert (first.folder, first.function, first.jobs) == ("runs/night", "trial", {"waiting": 2, "done": 1})
    assert second.jobs == {"waiting": 3}
    record_trial(full(), where)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    path.write_text("not a database " * 100)
    for use in (lambda: record_trial(full(), path), lambda: read_trials(path)):
        with pytest.raises(InputError, match="trial history"):
            use()
    with pytest.raises(InputError, match="trial history"):
        record_trial(full(), path / "inside" / "a" / "file.sqlite")


def test_who_reads_cannot_write(where: str) -> None:
    record_trial(full(), where)

    def spoil() -> None:
        with open_reader(where) as session:
            assert session is not None
            session.execute(text("UPDATE plants SET species = 'spoilt'"))
            session.commit()

    with pytest.raises(InputError, match=r"Nothing was changed|read-only"):
        spoil()
    assert [trial.species for trial in read_trials(where)] == ["tomato"]


def test_a_commit_is_on_the_disk_when_it_returns(tmp_path: Path) -> None:
    """SQLite flushes the write-ahead log at every commit (2, FULL); else a power cut takes the last visits."""
    with open_writer(tmp_path / "h.sqlite") as session:
        assert session.execute(text("PRAGMA synchronous")).scalar() == 2


def test_locked_and_full_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "h.sqlite"
    record_trial(full(), path)
    monkeypatch.setattr("anther.history._database.PATIENCE", 0.2)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(InputError, match="Another program has held it"):
        record_trial(full(), path)
    assert len(read_trials(path)) == 1  # readers need not wait
    other.execute("ROLLBACK")

    def no_more_pages(connection: sqlite3.Connection, _: object) -> None:
        connection.isolation_level = None
        connection.execute("PRAGMA max_page_count=1")

    monkeypatch.setattr("anther.history._database._configure_sqlite", no_more_pages)
    _engine.cache_clear()
    with pytest.raises(InputError, match="free some space"):
        record_trial(replace(full(minutes=1), run="x" * 100_000), path)
    monkeypatch.undo()
    _engine.cache_clear()
    assert all(t.flowers == 2 for t in read_trials(path))


@pytest.mark.parametrize(
    "address",
    [
        "mysql://a@b/c",
        "my sql://u:secret@b/c",
        "postgresql://[",
        "postgresql://u:secret@b:port/c",
        "postgresql://u:secret@127.0.0.1:1/none",
    ],
)
def test_addresses_that_cannot_serve(address: str) -> None:
    if address.startswith("postgresql"):
        pytest.importorskip("psycopg")
    with pytest.raises(InputError, match="histor") as refused:
        read_trials(address)
    assert "secret" not in str(refused.value)


def test_without_psycopg_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(MissingExtra, match=r"anther\[postgresql\]"):
        read_trials("postgresql://u@localhost/none")


def test_passwords_are_not_shown() -> None:
    assert hide_password("postgresql://me:secret@host/db") == "postgresql+psycopg://me:***@host/db"
    assert hide_password(Path("runs/history.sqlite")) == "runs/history.sqlite"


@given(st.sampled_from(["species", "plant"]), st.sampled_from(["", "x" * 201]))
def test_labels_are_brief(name: str, value: str) -> None:
    with pytest.raises(InputError, match=name):
        Visit(**({"species": "tomato", "plant": "1", "held_unharmed": True} | {name: value}))  # type: ignore[arg-type]
    with pytest.raises(InputError, match=name):
        Outcome(**({"species": "t", "plant": "1", "flowers": 2, "fruit": 1, "date": date.today()} | {name: value}))  # type: ignore[arg-type]


@given(st.integers(-3, 12), st.integers(-3, 12))
def test_more_fruit_than_flowers_is_refused(flowers: int, fruit: int) -> None:
    if flowers >= 1 and 0 <= fruit <= flowers:
        assert Outcome("t", "1", flowers, fruit, date.today()).fruit == fruit
    else:
        with pytest.raises(InputError, match=r"flowers|fruit"):
            Outcome("t", "1", flowers, fruit, date.today())


@given(st.sampled_from([float("nan"), float("inf")]))
def test_what_is_not_a_number_is_refused(value: float) -> None:
    for make in (
        lambda: ShakeRecord(value, 1e-3),
        lambda: ShakeRecord(1.0, value),
        lambda: ShakeRecord(1.0, 1e-3, direction=(0, 0, value)),
        lambda: GraspRecord(arc_length=value),
        lambda: GraspRecord(pose7=(0, 0, 1)),
        lambda: Visit("t", "1", True, time=datetime(2026, 1, 1)),
        lambda: Visit("t", "1", True, predicted_amplitude=(1e-3,), measured_amplitude=(1e-3, 1e-3)),
    ):
        with pytest.raises(InputError):
            make()
