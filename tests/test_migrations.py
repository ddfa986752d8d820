"""Older histories are brought up to date with all that is in them; newer ones are refused."""

from __future__ import annotations

import json
import multiprocessing
import sqlite3
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, create_engine, inspect, text

import anther.history.migrations as versions
from anther.errors import InputError
from anther.history import (
    GraspRecord,
    ShakeRecord,
    TrialRecord,
    earlier_shake,
    read_outcomes,
    read_trials,
    record_trial,
    starting_material,
)
from anther.history._database import Base
from anther.history.migrations import HEAD, migrate
from anther.plant import LEARNED, TOMATO, Material

BEGIN = datetime(2026, 5, 1, 12, tzinfo=UTC)


def engine_of(where: str) -> Any:
    url = where.replace("postgresql://", "postgresql+psycopg://") if "://" in where else f"sqlite:///{where}"
    if "://" not in where:
        Path(where).parent.mkdir(parents=True, exist_ok=True)
    return create_engine(url)


def visits() -> list[TrialRecord]:
    """Three visits to two plants: one taught, one failed and was not measured, one was at the same time as another."""
    shake, grasp = ShakeRecord(9.0, 6e-4, 3.0, "sine", (0, 1, 0)), GraspRecord(0.21)
    after = TOMATO.changed(scanned_youngs=2e8, youngs_spread=0.3, damping_spread=0.1)
    motion: dict[str, Any] = {"predicted_amplitude": (1e-3, 2e-3), "measured_amplitude": (1.5e-3, float("nan"))}
    motion["measured_acceleration"] = (4.8, float("nan"))
    taught = TrialRecord("tomato", "a", True, None, grasp, shake, **motion, believed=TOMATO, material=after, time=BEGIN)
    failed = TrialRecord("tomato", "a", False, "slipped", shake=shake, predicted_amplitude=(1e-3,), believed=TOMATO,
                         material=TOMATO, time=BEGIN + timedelta(hours=1))  # fmt: skip
    return [taught, failed, TrialRecord("tomato", "b", True, shake=shake, predicted_amplitude=(1e-3,), time=BEGIN)]


def old(where: str, *, doubled: bool = False) -> None:
    """Make a history of the first version, which counted its versions in a table of its own, with `visits` in it."""
    engine = engine_of(where)
    with engine.begin() as connection:
        migrate(connection, "0001")
        connection.execute(text("DROP TABLE alembic_version"))
        connection.execute(text("CREATE TABLE schema_version (version INTEGER NOT NULL)"))
        connection.execute(text("INSERT INTO schema_version VALUES (1)"))
        plants = {"a": 1, "b": 2}
        for label, number in plants.items():
            write(connection, "plants", id=number, species="tomato", label=label)
        for number, record in enumerate([*visits(), *(visits()[2:] if doubled else [])], 1):
            write_visit(connection, number, plants[record.plant], record)
        write(connection, "outcomes", id=1, plant_id=1, visit_id=1, date="2026-06-01", flowers=5, fruit=4, note="",
              recorded="2026-06-01 10:00:00.000000")  # fmt: skip
        if connection.dialect.name == "postgresql":  # numbers go on after those given here
            for table in ("plants", "visits", "outcomes"):
                count = f"(SELECT max(id) FROM {table})"
                connection.execute(text(f"SELECT setval(pg_get_serial_sequence('{table}', 'id'), {count})"))
    engine.dispose()


def write_visit(connection: Connection, number: int, plant: int, record: TrialRecord) -> None:
    time = record.time.replace(tzinfo=None).isoformat(" ", "microseconds")
    time += "" if connection.dialect.name == "sqlite" else "+00"
    materials = {
        f"material_{when}": None if m is None else json.dumps(asdict(m))
        for when, m in (("before", record.believed), ("after", record.material))
    }
    write(connection, "visits", id=number, plant_id=plant, time=time, success=record.success, failure=record.failure,
          run="runs/x", **materials)  # fmt: skip
    if record.grasp is not None:
        write(connection, "grasps", visit_id=number, arc_length_m=record.grasp.arc_length)
    if record.shake is not None:
        write(connection, "shakes", visit_id=number, frequency_hz=record.shake.frequency, waveform="sine",
              amplitude_m=record.shake.amplitude, duration_s=record.shake.duration, direction="[0, 1, 0]")  # fmt: skip
    for flower in range(record.flowers):
        motions = {name: None if v[flower] != v[flower] else v[flower] for name, v in record.motions().items()}
        columns = {f"{n}_{'ms2' if n.endswith('acceleration') else 'm'}": v for n, v in motions.items()}
        write(connection, "responses", visit_id=number, flower=flower, **columns)


def write(connection: Connection, table: str, **values: Any) -> None:
    names = ", ".join(values)
    connection.execute(text(f"INSERT INTO {table} ({names}) VALUES (:{', :'.join(values)})"), values)


def derived(where: str) -> dict[str, list[tuple[Any, ...]]]:
    """What is worked out from the visits and kept beside them."""
    engine = engine_of(where)
    with engine.connect() as connection:
        plants = connection.execute(text("SELECT label, learned, taught FROM plants ORDER BY label")).fetchall()
        rows = connection.execute(text("SELECT plant_id, taught, acceleration_ms2 FROM visits ORDER BY time, plant_id"))
        found = {"visits": [(p, bool(t), a and float(f"{a:.9g}")) for p, t, a in rows]}
    engine.dispose()
    sums = [(label, json.loads(v) if isinstance(v, str) else v, str(t)[:19]) for label, v, t in plants]
    rounded = [(label, v and {q: [f"{x:.9g}" for x in s] for q, s in v.items()}, t) for label, v, t in sums]
    return found | {"plants": rounded}


def test_an_older_history_keeps_all_and_equals_a_new_one(where: str, tmp_path: Path) -> None:
    old(where)
    new = str(tmp_path / "new.sqlite")
    for record in visits():
        record_trial(record, new)
    before, now = read_trials(where), read_trials(new)
    for a, b in zip(before, now, strict=True):
        assert (a.plant, a.time, a.success, a.failure, a.grasp, a.shake) == (
            b.plant, b.time, b.success, b.failure, b.grasp, b.shake,
        )  # fmt: skip
        assert (a.material, a.believed, a.run) == (b.material, b.believed, "runs/x")
        assert str(a.motions()) == str(b.motions())
    assert derived(where) == derived(new)
    assert derived(where)["visits"] == [(1, True, pytest.approx((4.8 + 3198 * 2e-3) / 2, rel=1e-3)),
                                        (2, False, pytest.approx(3.198, rel=1e-3)), (1, False, None)]  # fmt: skip
    for plant in "ab":
        assert starting_material("tomato", plant, where) == starting_material("tomato", plant, new)
        assert str(earlier_shake("tomato", plant, where)) == str(earlier_shake("tomato", plant, new))
    (count,) = read_outcomes(where)
    assert (count.visit, count.fruit) == (1, 4)
    assert record_trial(TrialRecord("pepper", "c", True), where) == 4


def test_visits_that_would_have_one_name_are_told_apart(where: str) -> None:
    old(where, doubled=True)
    assert sorted(t.robot for t in read_trials(where, plant="b")) == ["", "unnamed 4"]
    assert len(read_trials(where)) == 4


def read(where: str) -> None:
    assert len(read_trials(where)) == 3


def test_processes_bring_an_older_history_up_to_date_at_once(where: str) -> None:
    old(where)
    processes = [multiprocessing.get_context("fork").Process(target=read, args=(where,)) for _ in range(4)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60)
    assert [process.exitcode for process in processes] == [0] * 4


def test_a_migration_that_fails_changes_nothing(where: str) -> None:
    old(where)
    with engine_of(where).begin() as connection:
        connection.execute(text("UPDATE visits SET material_after = '{}' WHERE id = 1"))
    with pytest.raises(InputError, match="trial history"):
        read_trials(where)
    with engine_of(where).connect() as connection:
        assert inspect(connection).has_table("schema_version")
        assert "robot" not in {c["name"] for c in inspect(connection).get_columns("visits")}
        assert connection.execute(text("SELECT count(*) FROM visits")).scalar() == 3


def test_the_tables_are_those_of_the_classes(where: str) -> None:
    record_trial(visits()[0], where)
    with engine_of(where).connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
        assert connection.execute(text("SELECT plant FROM trials")).scalar() == "a"


def test_the_head_is_the_newest_version() -> None:
    assert ScriptDirectory(str(Path(versions.__file__).parent)).get_current_head() == HEAD


def test_a_newer_history_is_refused(where: str) -> None:
    record_trial(visits()[0], where)
    with engine_of(where).begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(InputError, match="newer Anther"):
        read_trials(where)


def test_a_file_from_before_versions_were_counted_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE trials (id INTEGER, plant VARCHAR)")
    with pytest.raises(InputError, match="trials already exists"):
        read_trials(path)
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT name FROM sqlite_master").fetchall() == [("trials",)]


def test_what_was_learned_has_the_quantities_of_the_material() -> None:
    """The migration says them again, because it may never change."""
    script = ScriptDirectory(str(Path(versions.__file__).parent)).get_revision("0002").module
    assert script.QUANTITIES == LEARNED
    assert {name: getattr(Material(), name) for name in script.UNKNOWN} == script.UNKNOWN
