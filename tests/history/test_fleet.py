"""Many robots, one history: twenty write at once, servers die, robots come back from where there was no network."""

from __future__ import annotations

import json
import os
import sqlite3
import sys
import time
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import pytest
from postgresql_server import Server
from sqlalchemy import select
from test_history import numbers_of, writer

from anther.cli.main import main
from anther.core.errors import AntherError, InputError
from anther.history import (
    Outcome,
    count_trials,
    each_trial,
    merge,
    open_reader,
    read_outcomes,
    read_trials,
    record_note,
    record_outcome,
    record_trial,
    starting_material,
)
from anther.history._tables import Note, Plant, VisitRow
from anther.plant import ShakeRecord, Visit
from anther.plant.model import TOMATO

NOON = datetime(2026, 5, 1, 12, tzinfo=UTC)


def visit(plant: str, robot: str, minutes: float, *, clock: float = 0.0, youngs: float = 1.5e8) -> Visit:
    """A visit that teaches; `clock` is by how many minutes the robot's own clock is fast."""
    after = TOMATO.changed(scanned_youngs=youngs, youngs_spread=0.3)
    return Visit(
        "tomato", plant, True, shake=ShakeRecord(8.0, 1e-3, 3.0, "sine", (0, 1, 0)), measured_amplitude=(1e-3, 2e-3),
        believed=TOMATO, material=after, robot=robot, time=NOON + timedelta(minutes=minutes + clock),
    )  # fmt: skip


def names(where: str) -> list[tuple[str, str, datetime]]:
    return sorted((t.plant, t.robot, t.time) for t in read_trials(where))


def test_twenty_robots_write_at_once(where: str) -> None:
    record_trial(visit("first", "", 0), where)
    writers = [writer(where, f"robot {k}", 3) for k in range(20)]
    numbers = numbers_of(writers)
    assert [process.exitcode for process, _ in writers] == [0] * 20
    assert len(set(numbers)) == 60
    assert count_trials(where) == 61


def test_a_visit_is_recorded_again_until_it_is_there_however_often_the_server_dies(server: Server) -> None:
    where, told = server.new(), []
    for k in range(6):
        record = visit("a", "r", k)
        if k % 2:
            server.crash()
        try:
            told.append(record_trial(record, where))
        except AntherError:
            server.start()
            told.append(record_trial(record, where))
        assert record_trial(record, where) == told[-1]
    assert [t.id for t in read_trials(where)] == told


def test_a_robot_that_was_offline_brings_all_of_it_once(where: str, tmp_path: Path) -> None:
    """Its clock is an hour fast; some of it the fleet has already; two robots were at one plant at one time."""
    offline = str(tmp_path / "robot.sqlite")
    both = visit("a", "slow", 0, clock=60)
    for history in (where, offline):
        record_trial(both, history)
    for minutes in range(1, 8):
        record_trial(visit("ab"[minutes % 2], "slow", minutes, clock=60), offline)
        record_trial(visit("a", "right", 60 + minutes), where)  # by the clocks, at the same moments
    record_outcome(Outcome("tomato", "a", 9, 4, date(2026, 6, 1), visit=3), offline)
    record_outcome(Outcome("tomato", "never visited", 9, 2, date(2026, 6, 1)), offline)
    assert merge(offline, where) == (9, 1)
    assert len(set(names(where))) == len(names(where)) == 15
    assert merge(offline, where) == (0, 10)
    (count,) = read_outcomes(where, plant="a")
    of = next(t for t in read_trials(where) if t.id == count.visit)
    assert (of.robot, of.time) == ("slow", read_trials(offline)[2].time)
    assert merge(where, offline) == (7, 10)
    assert names(where) == names(offline)


def test_what_was_learned_does_not_depend_on_who_came_first(tmp_path: Path) -> None:
    records = [visit(f"{k % 4}", f"{k % 3}", k, clock=60 * (k % 3), youngs=1e8 * (1 + k / 9)) for k in range(12)]
    one, other, part = (str(tmp_path / f"{name}.sqlite") for name in ("one", "other", "part"))
    for record in records:
        record_trial(record, one)
    for record in records[:6]:
        record_trial(record, part)
    for record in records[6:]:
        record_trial(record, other)
    merge(part, other)
    for plant in "0123":
        here, there = (starting_material("tomato", plant, where) for where in (one, other))
        assert here.source == there.source == "plant"
        assert here.material == there.material


def test_a_merge_that_was_cut_off_is_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    offline, where = str(tmp_path / "robot.sqlite"), str(tmp_path / "fleet.sqlite")
    for minutes in range(7):
        record_trial(visit("a", "r", minutes), offline)
    module, calls = sys.modules["anther.history._merge"], []
    monkeypatch.setattr(module, "BATCH", 2)
    add = module.add

    def cut_off(session: object, record: Visit) -> tuple[int, bool]:
        calls.append(record)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return add(session, record)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "add", cut_off)
    with pytest.raises(KeyboardInterrupt):
        merge(offline, where)
    assert count_trials(where) == 2
    assert merge(offline, where) == (5, 2)
    assert names(where) == names(offline)


def test_notes_go_over_once_each_with_its_visit_though_written_at_once(tmp_path: Path) -> None:
    offline, where = str(tmp_path / "robot.sqlite"), str(tmp_path / "fleet.sqlite")
    record_trial(visit("b", "s", 1), where)  # so that visits have other numbers there
    for minutes in (0, 5):
        record_note(record_trial(visit("a", "r", minutes), offline), f"after {minutes}", offline)
    with sqlite3.connect(offline) as connection:
        connection.execute("UPDATE notes SET recorded = (SELECT min(recorded) FROM notes)")
    assert merge(offline, where) == (4, 0)
    assert merge(offline, where) == (0, 4)
    with open_reader(where) as session:
        assert session is not None
        rows = session.execute(
            select(VisitRow.time, Note.text).join(Note, Note.visit_id == VisitRow.id).order_by(VisitRow.time)
        )
        assert [tuple(row) for row in rows] == [(NOON + timedelta(minutes=m), f"after {m}") for m in (0, 5)]


def test_merge_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    offline, where = str(tmp_path / "robot.sqlite"), str(tmp_path / "fleet.sqlite")
    record_trial(visit("a", "r", 0), offline)
    assert main(["history", where, "--merge", offline]) == 0
    assert "1 visits, counts, notes, sides and shifts added, 0 were there already" in capsys.readouterr().out
    assert main(["history", where, "--merge", str(tmp_path / "none.sqlite")]) == 2
    assert "which is not there" in capsys.readouterr().err


def test_however_many_there_are_they_come_in_order(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("anther.history._trials.BATCH", 3)
    for minutes in (5, 1, 4, 2, 3, 3):
        record_trial(visit("a", f"{minutes}" if minutes != 3 else os.urandom(4).hex(), minutes), where)
    record_trial(visit("b", "r", 9), where)
    assert [t.time.minute for t in each_trial(where, plant="a")] == [1, 2, 3, 3, 4, 5]
    assert [t.id for t in each_trial(where)] == [t.id for t in read_trials(where)]
    assert [t.time.minute for t in read_trials(where, last=2)] == [5, 9]


def test_a_reader_that_takes_long_holds_up_no_writer(where: str) -> None:
    record_trial(visit("a", "r", 0), where)
    with open_reader(where) as session:
        assert session is not None
        assert session.get(Plant, 1) is not None  # its transaction has begun
        begin = time.monotonic()
        for minutes in range(1, 4):
            record_trial(visit("a", "r", minutes), where)
        assert time.monotonic() - begin < 20  # a writer that waits for a reader would wait for 30 s
    assert count_trials(where) == 4


def test_a_backup_is_the_history(tmp_path: Path) -> None:
    """docs/history.md: sqlite3's own command, while a robot writes."""
    where, copy = str(tmp_path / "h.sqlite"), str(tmp_path / "copy.sqlite")
    record_trial(visit("a", "r", 0), where)
    process, reports = writer(where, "busy", 3)
    with sqlite3.connect(where) as connection:
        connection.execute("VACUUM INTO ?", (copy,))
    numbers_of([(process, reports)])
    assert set(names(copy)) <= set(names(where))
    assert ("a", "r", NOON) in names(copy)


def test_a_server_is_backed_up_and_restored(server: Server) -> None:
    where = server.new()
    for minutes in range(3):
        record_trial(visit("a", "r", minutes), where)
    schema = where.rsplit("%3D", 1)[1]
    dump = str(server.folder / f"{schema}.dump")
    reach = ("-h", str(server.folder), "-U", "anther")
    server.run(str(server.binaries / "pg_dump"), *reach, "-Fc", "-n", schema, "-f", dump, "postgres")
    server.run(str(server.binaries / "createdb"), *reach, schema)
    server.run(str(server.binaries / "pg_restore"), *reach, "-d", schema, dump)
    restored = where.replace("/postgres?", f"/{schema}?")
    assert names(restored) == names(where)
    assert record_trial(visit("b", "r", 9), restored) == 4


def test_a_visit_without_a_robot_is_read() -> None:
    plain = json.loads(json.dumps(visit("a", "r", 0).flat()))
    del plain["robot"]
    assert Visit.of(plain).robot == ""
    with pytest.raises(InputError, match="robot"):
        replace(visit("a", "r", 0), robot="x" * 201)
