"""One function over many rows: on the cores of this machine or on a cluster, going on after whatever is killed.

`run` hands every row and an empty folder to the function, once, and returns what became of each; `read_table` reads the
rows of a CSV file, `export` writes results as Parquet. docs/sweep.md says what is kept where.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any
from uuid import uuid4

from anther.core.checks import check_range
from anther.core.errors import InputError, MissingExtra, bad_input
from anther.core.files import json_text, read_rows, understood
from anther.history._jobs import Job, add_jobs, note_jobs, read_jobs
from anther.history.sweep._running import carry_out, counted
from anther.history.sweep._working import INSTALL, Function, Order, Place, forget_tries, place, versions

__all__ = ["Function", "Job", "export", "read", "read_table", "run"]

SWEEP = "sweep.json"


def run(
    function: Function,
    rows: Iterable[Mapping[str, Any]],
    folder: Path | str,
    *,
    name: str | None = None,
    history: Path | str | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    tries: int = 3,
    deaths: int = 10,
    again: bool = False,
    quiet: bool = False,
) -> list[Job]:
    """Run a function on every row that was not finished before, and return what became of each, in the rows' order.

    Args:
        function: takes a row and an empty folder; returns a mapping that JSON can hold, or None. Workers must be able
            to import it.
        rows: names and values that JSON can hold; no two alike.
        folder: a folder that all workers see, or an address such as s3://bucket/name.
        name: of the function, for people; a folder keeps to one.
        history: where the jobs are noted; by default history.sqlite in the folder.
        workers: processes on this machine, of one thread each; by default one a core.
        scheduler: run on a cluster instead: the address of its dask scheduler.
        tries: how often a row whose function raises is begun before it is set aside.
        deaths: how many workers may die under a row before it is set aside. More than `tries`: workers die of other
            causes too.
        again: try once more what was set aside.
        quiet: draw no progress.

    Raises:
        InputError: rows, folder, history or scheduler that cannot be used, workers with other versions, a full disk.
            What was finished is kept, and the same call goes on.
        MissingExtra: dask.distributed is not installed.
    """
    check_range("workers", workers or 1, 1, 1024)
    check_range("tries", tries, 1, 1000)
    check_range("deaths", deaths, 1, 1000)
    name = name or f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', 'function')}"
    jobs = _jobs(rows)
    where = place(folder)
    noted_in = _history(folder, history)
    uid = _uid(where, folder, name)
    add_jobs(jobs.values(), noted_in, uid=uid, folder=str(folder), function=name)
    jobs |= {job.key: job for job in read_jobs(noted_in, uid) if job.key in jobs}
    for job in jobs.values():
        if again and job.state == "poison":
            forget_tries(where, job.key)
            jobs[job.key] = replace(job, state="waiting", tries=0, reason=None)
    order = Order(function, _absolute(folder), uid, tries, deaths, versions(), pinned=scheduler is None)
    with counted(jobs.values(), quiet=quiet) as ended:
        waiting = [job for job in jobs.values() if job.state == "waiting"]
        for batch in carry_out(waiting, order, workers=workers, scheduler=scheduler):
            note_jobs(batch, noted_in, uid=uid)
            jobs |= {job.key: job for job in batch}
            ended(batch)
    return list(jobs.values())


def read(folder: Path | str, *, history: Path | str | None = None) -> list[Job]:
    """Return what became of every row that a sweep was ever given, also while it runs.

    Raises:
        InputError: no sweep there, or its history cannot be read.
    """
    found = place(folder).read(SWEEP)
    if found is None:
        given = f"{folder}, where no sweep is"
        raise bad_input("folder", given=given, allowed="a sweep's folder", do="Check the path.")
    with understood(f"{folder}/{SWEEP}"):
        return read_jobs(_history(folder, history), json.loads(found)["uid"])


def _jobs(rows: Iterable[Mapping[str, Any]]) -> dict[str, Job]:
    """Return the jobs of rows by their keys."""
    jobs: dict[str, Job] = {}
    for number, given in enumerate(rows, 1):
        try:
            row = json.loads(json_text(dict(given)))
        except (TypeError, ValueError) as error:
            allowed = "names with numbers, texts, lists"
            raise bad_input(f"row {number}", given=str(error), allowed=allowed, do="Convert it.") from error
        key = hashlib.sha256(json.dumps(row, sort_keys=True).encode()).hexdigest()[:16]
        if key in jobs:
            do = "Remove it, or tell them apart by a seed."
            raise bad_input(f"row {number}", given="the same as an earlier row", allowed="rows that differ", do=do)
        jobs[key] = Job(key, row)
    return jobs


def _history(folder: Path | str, history: Path | str | None) -> Path | str:
    if history is not None:
        return history
    if "://" in str(folder):
        allowed = "a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE"
        do = "A store holds no database: name one."
        raise bad_input("history", given=f"none, for a sweep in {folder}", allowed=allowed, do=do)
    return Path(folder) / "history.sqlite"


def _uid(where: Place, folder: Path | str, function: str) -> str:
    """Return the identity of the sweep in a folder; a new folder becomes one."""
    found = where.read(SWEEP)
    if found is None:
        known = {"uid": uuid4().hex, "function": function, "began": datetime.now(UTC).isoformat(timespec="seconds")}
        where.write(SWEEP, json_text(known | versions()).encode())
        return known["uid"]
    with understood(f"{folder}/{SWEEP}"):
        known = json.loads(found)
        uid, before = str(known["uid"]), known["function"]
    if before != function:
        raise InputError(f"{folder}: holds a sweep of {before}, not of {function}. Choose another folder.")
    return uid


def _absolute(folder: Path | str) -> str:
    """Workers have other current folders."""
    return str(folder) if "://" in str(folder) else str(Path(folder).absolute())


def read_table(path: Path | str) -> list[dict[str, str]]:
    """Return a line as names and texts; an empty cell is left out. Any spreadsheet's table will do (`files.read_rows`).

    Raises:
        InputError: no such file, no text, names that are missing or alike, or a line with too many cells.
    """
    (_, names), *table = read_rows(path, comment=None) or [(0, [])]
    if not names or len(set(names)) < len(names) or "" in names:
        given = f"first line {', '.join(names) or 'without names'}"
        raise bad_input(str(path), given=given, allowed="a name for every column, no two alike", do="Name them.")
    rows = []
    for line, cells in table:
        if len(cells) > len(names):
            at, given = f"{path}, line {line}", f"{len(cells)} cells"
            raise bad_input(at, given=given, allowed=f"{len(names)}, one a name", do="Is there a comma too many?")
        rows.append({name: cell for name, cell in zip(names, cells, strict=False) if cell})
    if not rows:
        raise bad_input(str(path), given="no rows", allowed="a line for every run", do="Add some.")
    return rows


_OF_JOB = ("key", "state", "tries", "seconds", "reason")


RESULTS = "results.parquet"


def export(folder: Path | str, jobs: Sequence[Job]) -> str:
    """Write results.parquet into a sweep's folder and return its path or address.

    One line a job: `_OF_JOB`, then the row's columns, then the result's. A column of the row or result whose name is
    taken by one before it is called row_NAME or result_NAME. What is no number, text or truth value, or not the same in
    all lines, is text: JSON.

    Raises:
        MissingExtra: pyarrow is not installed.
        InputError: the file cannot be written.
    """
    try:
        import pyarrow as pa  # noqa: PLC0415 # pyright: ignore[reportMissingImports]
        from pyarrow import parquet  # noqa: PLC0415 # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtra(f"Parquet needs pyarrow. Install it with: {INSTALL}") from error
    kinds = {str: pa.string(), bool: pa.bool_(), int: pa.int64(), float: pa.float64()}
    arrays = {}
    for name, values in _columns(jobs).items():
        kind, alike = _alike(values)
        arrays[name] = pa.array(alike, type=pa.null() if kind is None else kinds[kind])
    written = BytesIO()
    parquet.write_table(pa.table(arrays), written)
    place(folder).write(RESULTS, written.getvalue())
    return f"{str(folder).rstrip('/')}/{RESULTS}"


def _columns(jobs: Sequence[Job]) -> dict[str, list[Any]]:
    columns: dict[str, list[Any]] = {name: [getattr(job, name) for job in jobs] for name in _OF_JOB}
    for kind in ("row", "result"):
        parts, taken = [getattr(job, kind) or {} for job in jobs], set(columns)
        for name in dict.fromkeys(name for part in parts for name in part):
            columns[f"{kind}_{name}" if name in taken else name] = [part.get(name) for part in parts]
    return columns


def _alike(values: list[Any]) -> tuple[type | None, list[Any]]:
    """Return the type of all values and the values, as JSON where they have none in common."""
    found = {type(value) for value in values if value is not None}
    if not found:
        return None, values
    if found <= {int, float} and len(found) == 2:
        return float, values
    if len(found) == 1 and found <= {str, bool, int, float}:
        return found.pop(), values
    return str, [value if value is None else json.dumps(value) for value in values]
