"""Results of a sweep as one Parquet file for DuckDB, pandas or Polars."""

from __future__ import annotations

import json
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from anther.errors import MissingExtra
from anther.store import Job
from anther.sweep.places import INSTALL, place

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
