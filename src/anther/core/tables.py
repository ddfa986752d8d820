"""Flat tables for other programs: CSV, or Parquet through pyarrow."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterable, Mapping
from datetime import date, datetime
from pathlib import Path
from typing import Any

from anther.core.errors import MissingExtra, bad_input
from anther.core.files import replacing

INSTALL = "pip install 'anther[parquet]'"


def write_table(path: Path, columns: Mapping[str, type], lines: Iterable[Mapping[str, Any]]) -> None:
    """Write a .csv or .parquet, whole or not at all.

    Args:
        path: of the file.
        columns: name -> int, float, str, bool, date or datetime.
        lines: column -> value or None; taken one after another.

    Raises:
        InputError: unknown suffix.
        MissingExtra: Parquet without pyarrow.
    """
    if path.suffix not in (".csv", ".parquet"):
        raise bad_input("table", given=str(path), allowed="a name that ends in .csv or .parquet", do="Choose one.")
    with replacing(path) as temporary:
        (_csv if path.suffix == ".csv" else _parquet)(temporary, columns, lines)


def _csv(path: Path, columns: Mapping[str, type], lines: Iterable[Mapping[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(columns))
        writer.writeheader()
        writer.writerows({name: _cell(v) for name, v in line.items()} for line in lines)


def _cell(value: Any) -> Any:
    """Return what a CSV cell holds: a text that a spreadsheet would take for a formula begins with an apostrophe."""
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return f"'{value}"
    return value.isoformat() if isinstance(value, date) else value


def _parquet(path: Path, columns: Mapping[str, type], lines: Iterable[Mapping[str, Any]]) -> None:
    try:
        import pyarrow as pa  # noqa: PLC0415 # pyright: ignore[reportMissingImports]
        from pyarrow import parquet  # noqa: PLC0415 # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtra(f"Parquet needs pyarrow. Install it with: {INSTALL}") from error
    kinds = {
        int: pa.int64(),
        float: pa.float64(),
        str: pa.string(),
        bool: pa.bool_(),
        date: pa.date32(),
        datetime: pa.timestamp("us", tz="UTC"),
    }
    schema = pa.schema([(name, kinds[kind]) for name, kind in columns.items()])
    rest = iter(lines)
    group_size = 50_000  # lines of a row group of Parquet: what of a table is in memory at a time
    with parquet.ParquetWriter(path, schema) as writer:
        while group := list(itertools.islice(rest, group_size)):
            writer.write_table(pa.Table.from_pylist([dict(line) for line in group], schema=schema))
