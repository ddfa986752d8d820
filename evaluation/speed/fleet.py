"""A fleet's history: many robots write at once while writers and server are killed, and how fast a planner is answered.

    python -m evaluation.speed.fleet [--quick]

On a PostgreSQL server of its own where Debian's programs are installed (apt install postgresql), else on SQLite, where
there is no server to kill. First a million visits to 25,000 plants are written as rows. Then 20 processes record
visits, each again and again until the history says that it is there, while one of them is killed (SIGKILL) every
second and the server (pg_ctl -m immediate) as often as asked for. At last a planner's questions are timed, each with
its own connection, as a trial asks them: what is believed of a plant, and its last shake.

Keys of the --json file: writers, killed (writers), crashes (of the server), visits, reported (visits that a writer was
told are recorded), lost (reported but not there), doubled, query_ms_1e6 (95 % of the questions were answered in this
time), query_median_ms, query_cpu_ms (95 %: processor time of who asks, which on SQLite is all there is),
write_median_ms, megabytes (of the database).
"""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import create_engine, text

from anther.core import AntherError, Array
from anther.history import earlier_shake, record_trial, starting_material
from anther.plant import TOMATO, GraspRecord, ShakeRecord, Visit

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from postgresql_server import Server, start

from evaluation.harness import finish, options
from evaluation.tables import measured

NOW = datetime.now(UTC).replace(microsecond=0)
WRITERS, FLOWERS, SEASON = 20, 3, 200
"""Robots; flowers of a visit; days over which the visits are spread."""
FAILURES = ("slipped", "unreachable", "no_stem_found", "branch_or_leaf_grasped")
WORDS = {
    "visits": "visits that are there at the begin",
    "writers": "processes that record visits at once",
    "killed": "writers killed meanwhile",
    "crashes": "crashes of the server meanwhile",
    "reported": "visits that a writer was told are recorded",
    "lost": "of these lost",
    "doubled": "of these doubled",
    "write_median_ms": "recording a visit, all writers at once, median (ms)",
    "query_median_ms": "a planner's question, connecting included, median (ms)",
    "query_ms_1e6": "95 % of the questions, within (ms)",
    "query_cpu_ms": "the same, processor time of who asks (ms)",
    "megabytes": "the database (MB)",
}
COLUMNS = {
    "plants": "id, species, label",
    "visits": "id, plant_id, robot, time, held_unharmed, failure, run, taught, acceleration_ms2, material_before, "
    "material_after",
    "grasps": "visit_id, arc_length_m, stem_diameter_m, confidence, organ",
    "shakes": "visit_id, frequency_hz, amplitude_m, duration_s, waveform, direction",
    "responses": "visit_id, flower, predicted_amplitude_m, measured_amplitude_m, predicted_acceleration_ms2, "
    "measured_acceleration_ms2",
}


def record(plant: str, robot: str, seed: int, when: datetime) -> Visit:
    """Return a visit that taught something."""
    rng = np.random.default_rng(seed)
    after = TOMATO.changed(scanned_youngs=1e8 * float(np.exp(rng.normal(0, 0.4))), youngs_spread=0.3)
    felt = tuple(rng.uniform(2, 12, FLOWERS).tolist())
    return Visit(
        "tomato", plant, True, None, GraspRecord(0.3, 0.009, 0.94, "main stem"),
        ShakeRecord(8.0, 1e-3, 3.0, "sine", (0.0, 1.0, 0.0)), measured_amplitude=(1e-3,) * FLOWERS,
        measured_acceleration=felt, predicted_acceleration=felt, believed=TOMATO, material=after, robot=robot,
        time=when,
    )  # fmt: skip


def fill(where: str, visits: int, plants: int) -> None:
    """Write rows as `record_trial` would, but by the thousand: `visits` spread over the season and the plants."""
    record_trial(record("first", "robot 01", 0, NOW - timedelta(days=SEASON)), where)  # makes the tables
    rng = random.Random(1)
    before = json.dumps(record("x", "", 0, NOW).plain()["believed"])
    afters = [json.dumps(record("x", "", k, NOW).plain()["material"]) for k in range(50)]
    step = timedelta(days=SEASON) / visits

    def moment(k: int) -> str:
        return (NOW - (visits - k) * step).strftime("%Y-%m-%d %H:%M:%S.%f")

    def of_plants() -> Iterator[tuple[Any, ...]]:
        for k in range(plants):
            yield 10 + k, "pepper" if k % 4 == 0 else "tomato", f"row {k // 250}, {k % 250}"

    def of_visits() -> Iterator[tuple[Any, ...]]:
        for k in range(visits):
            good = k % 21 != 7
            why = None if good else FAILURES[k % 4]
            robot, run = f"robot {k % WRITERS + 1:02}", f"runs/visit-{k}"
            plant, felt = 10 + (k * 7919 + k // plants) % plants, rng.uniform(2, 12) if good else None
            after = afters[k % 50] if good else before
            yield 10 + k, plant, robot, moment(k), good, why, run, good, felt, before, after

    def of_responses() -> Iterator[tuple[Any, ...]]:
        for k in range(visits):
            for flower in range(FLOWERS):
                yield 10 + k, flower, 1e-3, 1.2e-3, 6.0, rng.uniform(2, 12)

    rows = {
        "plants": of_plants(),
        "visits": of_visits(),
        "grasps": ((10 + k, 0.3, 0.009, 0.94, "main stem") for k in range(visits)),
        "shakes": ((10 + k, 8.0, 1e-3, 3.0, "sine", "[0, 1, 0]") for k in range(visits) if k % 21 != 7),
        "responses": of_responses(),
    }
    engine = engine_of(where)
    connection = engine.raw_connection()
    cursor = connection.cursor()
    for table, lines in rows.items():
        if engine.dialect.name == "sqlite":
            marks = ", ".join("?" * len(COLUMNS[table].split(",")))
            cursor.executemany(f"INSERT INTO {table} ({COLUMNS[table]}) VALUES ({marks})", lines)
            continue
        with cursor.copy(f"COPY {table} ({COLUMNS[table]}) FROM STDIN") as copy:  # type: ignore[attr-defined]
            for line in lines:
                copy.write_row(line)
        connection.commit()
        cursor.execute(f"SELECT setval(pg_get_serial_sequence('{table}', 'id'), (SELECT max(id) FROM {table}))")
    connection.commit()
    connection.close()
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as tidy:
        tidy.execute(text("ANALYZE" if engine.dialect.name == "sqlite" else "VACUUM ANALYZE"))
    engine.dispose()


def engine_of(where: str) -> Any:
    """Return SQLAlchemy's engine of a history."""
    return create_engine(where.replace("://", "+psycopg://") if "://" in where else f"sqlite:///{where}")


def write_on(where: str, robot: str, pipe: int) -> None:
    """Record visits; each again until it is there, then say so: its time and how long the last attempt took."""
    random.seed(os.getpid())
    while True:
        plant, when = f"row {random.randrange(100)}, {random.randrange(250)}", datetime.now(UTC)
        visit = record(plant, robot, random.randrange(1000), when)
        while True:
            begin = time.perf_counter()
            try:
                record_trial(visit, where)
                break
            except AntherError:
                time.sleep(0.1)
        os.write(pipe, f"{when.isoformat()} {1e3 * (time.perf_counter() - begin):.1f}\n".encode())


def write_under_fire(where: str, server: Server | None, seconds: float, crashes: int) -> dict[str, Any]:
    """Let the robots write, kill one every second and the server now and then; return what became of the visits."""
    fork, reports, killed = multiprocessing.get_context("fork"), [], 0

    def launch(robot: str) -> Any:
        read, write = os.pipe()
        process = fork.Process(target=write_on, args=(where, robot, write))
        process.start()
        os.close(write)
        reports.append((robot, os.fdopen(read)))
        return process

    robots = [f"writer {k + 1:02}" for k in range(WRITERS)]
    running = {robot: launch(robot) for robot in robots}
    begin, crashed = time.monotonic(), 0
    while time.monotonic() - begin < seconds or crashed < (crashes if server else 0):
        time.sleep(1.0)
        victim = robots[killed % WRITERS]
        os.kill(running[victim].pid, signal.SIGKILL)
        running[victim].join()
        running[victim], killed = launch(victim), killed + 1
        if server is not None and crashed < crashes:
            server.crash()
            server.start()
            crashed += 1
    for process in running.values():
        process.kill()
        process.join()
    said = [(robot, *line.split()) for robot, stream in reports for line in stream if line.endswith("\n")]
    engine = engine_of(where)
    with engine.connect() as connection:
        query = "SELECT robot, time, plant_id FROM visits WHERE robot LIKE 'writer%'"
        there = [(robot, stamp(moment), plant) for robot, moment, plant in connection.execute(text(query))]
    engine.dispose()
    known = {(robot, moment) for robot, moment, _ in there}
    return {
        "killed": killed,
        "crashes": crashed,
        "reported": len(said),
        "lost": sum((robot, stamp(moment)) not in known for robot, moment, _ in said),
        "doubled": len(there) - len(known),
        "write_median_ms": float(np.median([float(ms) for *_, ms in said])),
    }


def stamp(moment: str | datetime) -> float:
    """Return a time as seconds, from either database."""
    parsed = datetime.fromisoformat(moment) if isinstance(moment, str) else moment
    return (parsed.replace(tzinfo=UTC) if parsed.tzinfo is None else parsed).timestamp()


def time_queries(where: str, plants: int, count: int) -> Array:
    """Return how long a planner waited for what is known of a plant and its crop, and its work (Q, 2) [ms]."""
    rng, waited = random.Random(2), []
    for k in range(count + 5):
        number = rng.randrange(plants)
        species, plant = "pepper" if number % 4 == 0 else "tomato", f"row {number // 250}, {number % 250}"
        questions: tuple[Callable[[], object], ...] = (
            lambda s=species, p=plant: starting_material(s, p, where),
            lambda s=species: starting_material(s, "never visited", where),
            lambda s=species, p=plant: earlier_shake(s, p, where),
        )
        for ask in questions:
            begin, work = time.perf_counter(), time.process_time()
            answer = ask()
            if k >= 5:  # the first ones load libraries
                waited.append((1e3 * (time.perf_counter() - begin), 1e3 * (time.process_time() - work)))
            assert answer is not None
    return np.array(waited)


def main() -> None:
    """Fill, write under fire, ask; print, and write --json."""
    own = {
        "--visits": (1_000_000, "that are there at the begin"),
        "--seconds": (60.0, "how long the robots write at least"),
        "--crashes": (20, "of the server"),
        "--sqlite": (False, "also where PostgreSQL is installed"),
    }
    args = options(__doc__, quick="10,000 visits, 5 seconds, 2 crashes", own=own)
    visits, seconds, crashes = (10_000, 5.0, 2) if args.quick else (args.visits, args.seconds, args.crashes)
    plants = max(visits // 40, 100)
    found = "--sqlite was given." if args.sqlite else start()
    server = found if isinstance(found, Server) else None
    with history_in(server) as where:
        fill(where, visits, plants)
        table = {"writers": WRITERS, "visits": visits} | write_under_fire(where, server, seconds, crashes)
        waited = time_queries(where, plants, 20 if args.quick else 200)
        table |= {
            "query_ms_1e6": float(np.percentile(waited[:, 0], 95)),
            "query_median_ms": float(np.median(waited[:, 0])),
            "query_cpu_ms": float(np.percentile(waited[:, 1], 95)),
            "megabytes": _megabytes(where),
        }
    finish(args, table, *([] if server else [f"On SQLite: {found}"]), measured(table, WORDS))


@contextmanager
def history_in(server: Server | None) -> Iterator[str]:
    """Give the address of a new history, on a server or in a folder that is removed; the server is removed too."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            yield server.new() if server else str(Path(folder) / "history.sqlite")
        finally:
            if server:
                server.remove()


def _megabytes(where: str) -> float:
    if "://" not in where:
        return Path(where).stat().st_size / 1e6
    with engine_of(where).connect() as connection:
        return float(connection.execute(text("SELECT pg_database_size(current_database())")).scalar_one()) / 1e6


if __name__ == "__main__":
    main()
