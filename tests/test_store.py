"""Trial history: what is written is read back, by several processes at once, after a kill, and from older files."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import create_engine, inspect

from anther.errors import InputError, MissingExtra
from anther.plant import Material
from anther.store import (
    GraspRecord,
    Outcome,
    ShakeRecord,
    TrialRecord,
    add_missing,
    find_plants,
    find_visit,
    read_outcomes,
    read_trials,
    record_outcome,
    record_trial,
    shown,
)
from anther.store.tables import Base

KILLS = int(os.environ.get("ANTHER_KILLS", "4"))
NOON = datetime(2026, 5, 1, 12, tzinfo=UTC)


def full(plant: str = "seed 3", minutes: int = 0) -> TrialRecord:
    return TrialRecord(
        species="tomato",
        plant=plant,
        success=False,
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


class Server:
    """A PostgreSQL server of the tests' own, in a temporary folder, reached by a socket in it."""

    def __init__(self, binaries: Path, user: list[str]) -> None:
        self._as = user
        self.folder = Path(self._run("mktemp", "-d", "/tmp/anther-postgresql-XXXXXX").strip())
        self._control = (str(binaries / "pg_ctl"), "-w", "-D", str(self.folder / "data"))
        self._run(str(binaries / "initdb"), "-D", str(self.folder / "data"), "-U", "anther", "-A", "trust", "-N")
        self.start()

    def _run(self, *words: str) -> str:
        return subprocess.run([*self._as, *words], check=True, stdout=subprocess.PIPE, text=True, cwd="/").stdout

    def start(self) -> None:
        options = f"-c listen_addresses='' -c unix_socket_directories={self.folder}"
        options += " -c recovery_init_sync_method=syncfs"  # else every file is flushed by itself, which takes seconds
        log = str(self.folder / "log")
        subprocess.run([*self._as, *self._control, "-o", options, "-l", log, "start"], check=True, cwd="/",
                       stdout=subprocess.DEVNULL)  # fmt: skip

    def crash(self) -> None:
        """Stop without writing anything more: what counts is what was flushed at every commit."""
        self._run(*self._control, "-m", "immediate", "stop")

    def address(self) -> str:
        return f"postgresql://anther:secret@/postgres?host={self.folder}"


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """A real server, where its programs are installed."""
    pytest.importorskip("psycopg", reason="psycopg is not installed: pip install 'anther[postgresql]'")
    folders = [*sorted(Path("/usr/lib/postgresql").glob("*/bin")), Path(shutil.which("initdb") or "/none").parent]
    binaries = next((folder for folder in folders if (folder / "initdb").exists()), None)
    if binaries is None:
        pytest.skip("no PostgreSQL programs (initdb, pg_ctl): apt install postgresql")
    user = []
    if os.geteuid() == 0:  # PostgreSQL does not run as root
        if subprocess.run(["runuser", "-u", "postgres", "true"], capture_output=True, check=False).returncode:
            pytest.skip("running as root, and PostgreSQL needs another user: there is no user postgres")
        user = ["runuser", "-u", "postgres", "--"]
    running = Server(binaries, user)
    yield running
    running.crash()
    shutil.rmtree(running.folder)


@pytest.fixture(params=["sqlite", "postgresql"])
def where(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A new history: a SQLite file, or a schema of a real PostgreSQL server."""
    if request.param == "sqlite":
        return str(tmp_path / "deep" / "history.sqlite")
    server: Server = request.getfixturevalue("server")
    name = f"t{time.monotonic_ns()}"
    admin = create_engine(server.address().replace("://", "+psycopg://"))
    with admin.begin() as connection:
        connection.exec_driver_sql(f"CREATE SCHEMA {name}")
    admin.dispose()
    return server.address() + f"&options=-csearch_path%3D{name}"


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
    assert (read.success, read.failure, read.run) == (False, "slipped", "runs/7")
    assert find_visit(number, where).grasp == read.grasp  # type: ignore[union-attr]
    assert find_visit(number + 1, where) is None


def test_little_is_needed(where: str) -> None:
    record_trial(TrialRecord("pepper", "row 3, 14", True), where)
    (read,) = read_trials(where)
    assert (read.material, read.failure, read.grasp, read.shake, read.measured_amplitude) == (None,) * 4 + ((),)
    assert find_plants("row 3, 14", where) == [("pepper", "row 3, 14")]


def test_oldest_first_and_filtered(where: str) -> None:
    for plant, minutes in (("b", 5), ("a", 1), ("b", 3)):
        record_trial(full(plant, minutes), where)
    record_trial(TrialRecord("pepper", "b", True, time=NOON + timedelta(days=2, hours=11)), where)

    def minutes_of(**which: object) -> list[int]:
        return [r.time.minute for r in read_trials(where, **which)]  # type: ignore[arg-type]

    assert minutes_of(species="tomato") == [1, 3, 5]
    assert minutes_of(plant="b", species="tomato") == [3, 5]
    assert minutes_of(result="slipped") == minutes_of(result="failure") == [1, 3, 5]
    assert minutes_of(result="success") == minutes_of(since=date(2026, 5, 2)) == [0]
    assert minutes_of(since=date(2026, 5, 3), until=date(2026, 5, 3)) == [0]
    assert minutes_of(until=date(2026, 5, 2)) == [1, 3, 5]
    assert read_trials(where, species="cucumber") == []


def test_a_history_that_is_not_there_is_empty_and_not_made(tmp_path: Path) -> None:
    assert read_trials(tmp_path / "missing.sqlite") == read_outcomes(tmp_path / "missing.sqlite") == []
    assert not (tmp_path / "missing.sqlite").exists()


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
    again = TrialRecord.of(full().plain())
    assert (again.grasp, again.shake, again.material, again.time) == (
        full().grasp, full().shake, full().material, full().time,
    )  # fmt: skip
    assert add_missing(again, where) is not None
    assert add_missing(again, where) is None
    assert len(read_trials(where)) == 1
    with pytest.raises(InputError, match="record of a trial"):
        TrialRecord.of({"species": "tomato"})


def write_on(where: str, name: str, count: int, pipe: int) -> None:
    """Record trials of three plants; report each one's number once it is recorded."""
    for k in range(count):
        record = TrialRecord("tomato", f"{name} {k % 3}", True, shake=ShakeRecord(8.0, 1e-3))
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


OLD_TABLE = """
CREATE TABLE trials (id INTEGER NOT NULL, time VARCHAR NOT NULL, species VARCHAR NOT NULL, plant VARCHAR NOT NULL,
  success BOOLEAN NOT NULL, failure VARCHAR, run VARCHAR, grasp JSON NOT NULL, shake JSON NOT NULL,
  predicted_amplitude JSON NOT NULL, measured_amplitude JSON NOT NULL, material JSON, PRIMARY KEY (id));
CREATE INDEX ix_trials_time ON trials (time)
"""
OLD_INSERT = "INSERT INTO trials VALUES (?, ?, 'tomato', ?, ?, ?, 'runs/x', ?, ?, ?, ?, ?)"


def old_history(path: Path) -> None:
    """A file of version 0, whose rows are those that its program wrote."""
    with sqlite3.connect(path) as connection:
        connection.executescript(OLD_TABLE)
        grasp, shake = '{"pose7": [0.6, 0, -0.1, 0, 0, 0, 1], "arc_length_m": 0.14}', '{"amplitude_m": 4e-4, '
        shake += '"frequency_hz": 9.8, "direction": [0, 1, 0]}'
        material = '{"youngs": 9e8, "density": 1050.0, "damping_ratio": 0.05, "youngs_spread": 0.4, "of_later": 1}'
        time_ = "2026-11-21T17:19:43.150547+00:00"
        rows = [
            (4, time_, "simulated 0", 1, None, grasp, shake, "[0.001, 0.002]", "[0.001, null]", material),
            (9, time_, "simulated 0", 0, "no_stem_found", '{"pose7": null, "arc_length_m": null}',
             '{"amplitude_m": null, "frequency_hz": null, "direction": null}', "[]", "[]", "null"),
        ]  # fmt: skip
        connection.executemany(OLD_INSERT, rows)


def test_an_old_file_is_brought_up_to_date(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    old_history(path)
    first, second = read_trials(path)
    assert (first.id, second.id) == (4, 9)
    assert first.time == datetime(2026, 11, 21, 17, 19, 43, 150547, tzinfo=UTC)
    assert first.grasp == GraspRecord(arc_length=0.14, pose7=(0.6, 0, -0.1, 0, 0, 0, 1))
    assert first.shake == ShakeRecord(9.8, 4e-4, direction=(0, 1, 0))
    assert first.predicted_amplitude == (1e-3, 2e-3)
    assert np.isnan(first.measured_amplitude[1])
    assert first.material == Material(youngs=9e8, youngs_spread=0.4)
    assert (second.failure, second.grasp, second.shake, second.material) == ("no_stem_found", None, None, None)
    assert record_trial(full(), path) == 10
    assert len(read_trials(path)) == 3
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT count(*) FROM trials_version_0").fetchone() == (2,)
        assert connection.execute("SELECT count(*) FROM trials").fetchone() == (3,)
        with pytest.raises(sqlite3.OperationalError, match="view"):  # a program of version 0 is told, not ignored
            connection.execute(OLD_INSERT, (11, "t", "p", 1, None, "{}", "{}", "[]", "[]", None))


def test_processes_bring_an_old_file_up_to_date_at_once(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    old_history(path)
    assert len(numbers_of([writer(str(path), name, 2) for name in "abc"])) == 6
    assert len(read_trials(path)) == 2 + 6


def test_the_tables_are_those_of_the_classes(where: str) -> None:
    record_trial(full(), where)
    url = where.replace("postgresql://", "postgresql+psycopg://") if "://" in where else f"sqlite:///{where}"
    engine = create_engine(url)
    there = inspect(engine)
    for table in Base.metadata.sorted_tables:
        columns = {c["name"]: c["nullable"] for c in there.get_columns(table.name)}
        columns["id"] = False  # SQLite says that a primary key may be null
        assert columns == {c.name: c.nullable for c in table.columns}, table.name
        indexed = {tuple(i["column_names"]) for i in there.get_indexes(table.name)}
        assert {tuple(i.columns.keys()) for i in table.indexes} <= indexed, table.name
    engine.dispose()


def test_a_newer_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    record_trial(full(), path)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE schema_version SET version = 99")
    with pytest.raises(InputError, match="newer Anther"):
        read_trials(path)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    path.write_text("not a database " * 100)
    for use in (lambda: record_trial(full(), path), lambda: read_trials(path)):
        with pytest.raises(InputError, match="trial history"):
            use()
    with pytest.raises(InputError, match="trial history"):
        record_trial(full(), path / "inside" / "a" / "file.sqlite")


def test_locked_and_full_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "h.sqlite"
    record_trial(full(), path)
    monkeypatch.setattr("anther.store.database.PATIENCE", 0.2)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(InputError, match="Another program has held it"):
        record_trial(full(), path)
    assert len(read_trials(path)) == 1  # readers need not wait
    other.execute("ROLLBACK")

    def no_more_pages(connection: sqlite3.Connection, _: object) -> None:
        connection.isolation_level = None
        connection.execute("PRAGMA max_page_count=1")

    monkeypatch.setattr("anther.store.database._configure_sqlite", no_more_pages)
    with pytest.raises(InputError, match="free some space"):
        record_trial(replace(full(), run="x" * 100_000), path)
    monkeypatch.undo()
    assert all(t.flowers == 2 for t in read_trials(path))


@pytest.mark.parametrize("address", ["mysql://a@b/c", "postgresql://[", "postgresql://u:secret@127.0.0.1:1/none"])
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
    assert shown("postgresql://me:secret@host/db") == "postgresql+psycopg://me:***@host/db"
    assert shown(Path("runs/history.sqlite")) == "runs/history.sqlite"


@given(st.sampled_from(["species", "plant"]), st.sampled_from(["", "x" * 201]))
def test_labels_are_brief(name: str, value: str) -> None:
    with pytest.raises(InputError, match=name):
        TrialRecord(**({"species": "tomato", "plant": "1", "success": True} | {name: value}))  # type: ignore[arg-type]
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
        lambda: TrialRecord("t", "1", True, time=datetime(2026, 1, 1)),
        lambda: TrialRecord("t", "1", True, predicted_amplitude=(1e-3,), measured_amplitude=(1e-3, 1e-3)),
    ):
        with pytest.raises(InputError):
            make()
