"""The history as flat tables for other programs: CSV, or Parquet through pyarrow. Units are in the columns' names."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Any, Literal, get_origin

import numpy as np

from anther.core.errors import bad_input
from anther.core.records import flat_columns
from anther.core.tables import write_table
from anther.history._records import Outcome
from anther.plant.visit import MOTIONS, Visit

_NAME = ("time", "species", "plant")
_HISTORY = (
    *_NAME, "result", "held_unharmed", "flowers_moved", "failure", "run", "robot", "acceleration_mean_ms2", "grasp",
    "shake", "flowers", "flowers_measured", "predicted_amplitude_median_m", "measured_amplitude_median_m",
    "predicted_acceleration_median_ms2", "measured_acceleration_median_ms2", "believed", "material",
)  # fmt: skip
"""Fields and properties of a visit that every history knows."""
_MOTIONS = dict(zip(flat_columns(Visit, MOTIONS), MOTIONS, strict=True))


def _columns(*names: str) -> dict[str, type]:
    """Return the columns of fields of a visit: the number of the visit, and what is no list."""
    found = flat_columns(Visit, names).items()
    return {"visit": int} | {name: str if get_origin(of) is Literal else of for name, of in found if not _is_list(of)}


def _is_list(kind: Any) -> bool:
    return get_origin(kind) is tuple


_OUTCOMES: dict[str, type] = {
    "outcome": int,
    "date": date,
    "species": str,
    "plant": str,
    "visit": int,
    "flowers": int,
    "fruit": int,
    "note": str,
}
TABLES: dict[str, dict[str, type]] = {
    "visits": _columns(*_HISTORY),
    "flowers": {**_columns(*_NAME), "flower": int, **dict.fromkeys(_MOTIONS, float)},
    "outcomes": _OUTCOMES,
}
"""Table -> column -> type. "visits": one line a visit; "flowers": one a flower and visit; "outcomes": one a count."""


def export(path: Path, table: str, trials: Iterable[Visit], outcomes: Iterable[Outcome]) -> int:
    """Write one of `TABLES` to a .csv or .parquet, whole or not at all, and return how many lines it has.

    The trials are taken one after another, so that an iterator of more than the memory holds is written as well.

    Raises:
        InputError: unknown table or suffix.
        MissingExtra: Parquet without pyarrow.
    """
    if table not in TABLES:
        raise bad_input("table", given=f"'{table}'", allowed=", ".join(TABLES), do="Choose one.")
    if table == "outcomes":
        lines: Iterator[dict[str, Any]] = ({**asdict(o), "outcome": o.id} for o in outcomes)
    elif table == "flowers":
        lines = (line for trial in trials for line in _flowers(trial))
    else:
        lines = (_line(visit) for visit in trials)
    columns = TABLES[table]
    count = itertools.count()
    lines = ({name: _plain(line.get(name)) for name in columns} for line, _ in zip(lines, count, strict=False))
    write_table(path, columns, lines)
    return next(count)


def _line(visit: Visit) -> dict[str, Any]:
    return visit.flat() | {"visit": visit.id, "time": visit.time}


def _flowers(visit: Visit) -> Iterator[dict[str, Any]]:
    line, motions = _line(visit), visit.motions()
    for k in range(visit.flowers):
        yield {**line, "flower": k, **{column: motions[name][k] for column, name in _MOTIONS.items()}}


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value
