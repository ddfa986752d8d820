"""Measurement files: CSV tables with a unit in every column's name, read into SI. n rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anther.core.errors import InputError, bad_input
from anther.core.files import existing, number, read_rows
from anther.core.geometry import Array

UNITS = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "mass": {"kg": 1.0, "g": 1e-3, "mg": 1e-6},
    "time": {"s": 1.0, "ms": 1e-3},
}
"""Units that a column's name may end in, and their size in SI."""
NOTE = "note"
"""A column of this name is for people and is not read."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column that a table must have.

    Attributes:
        name: without unit, as in `name_mm`.
        quantity: key of UNITS.
        lower, upper: allowed values in SI; a value in the wrong unit mostly falls outside.
        increasing: whether each row must exceed the one before.
        twice: another name under which twice the value may stand instead (a diameter for a radius).
    """

    name: str
    quantity: str
    lower: float
    upper: float
    increasing: bool = False
    twice: str | None = None

    def headers(self) -> dict[str, float]:
        """Return the allowed headers and what one unit of each is in SI."""
        units = UNITS[self.quantity].items()
        once = {f"{self.name}_{unit}": size for unit, size in units}
        return once | ({f"{self.twice}_{unit}": size / 2 for unit, size in units} if self.twice else {})


SAMPLES = (
    Column("mass", "mass", 1e-7, 1.0),
    Column("radius", "length", 1e-5, 0.05, twice="diameter"),
    Column("length", "length", 1e-4, 2.0),
)
"""Cut stem samples: one a row."""
PROFILE = (
    Column("distance", "length", 0.0, 10.0, increasing=True),
    Column("radius", "length", 1e-5, 0.05, twice="diameter"),
)
"""A stem's radius over the distance from the clamp."""
LEAVES = (Column("distance", "length", 0.0, 10.0), Column("mass", "mass", 0.0, 5.0))
"""Leaves, flowers and fruits: where they sit on the stem, from the clamp, and what they weigh."""
TRACE = (
    Column("time", "time", -1e5, 1e5, increasing=True),
    Column("displacement", "length", -2.0, 2.0),
)
"""A free vibration: motion of any place of the stem along one direction."""
DEFLECTION = (Column("mass", "mass", 1e-6, 5.0), Column("deflection", "length", 1e-6, 2.0))
"""Tip masses, and how far each pulls the tip of the horizontal stem below where it was without."""


def read_measurements(path: Path | str, columns: Sequence[Column]) -> dict[str, Array]:
    """Return a table's columns in SI, by their names without unit; each is (n,), n >= 1.

    The first line that is neither empty nor a comment (#) holds the column names, in any order (`files.read_rows`).

    Raises:
        InputError: no such file, not text, a column unknown, missing or given twice, or a cell that is empty, not a
            number, out of range or out of order. The message names file, line and column and what is allowed.
    """
    path = existing(path)
    rows = read_rows(path)
    if not rows:
        raise bad_input(str(path), given="no line", allowed=_wanted(columns), do="Name the columns in the first line.")
    (first, header), *table = rows
    places = _places(path, first, header, columns)
    if not table:
        raise bad_input(str(path), given="no row below the column names", allowed="one or more", do="Add the numbers.")
    for line, row in table:
        if len(row) != len(header):
            given, allowed = f"{len(row)} cells", f"{len(header)}, as in line {first}"
            raise bad_input(f"{path}, line {line}", given=given, allowed=allowed, do="Mend it.")
    values: dict[str, Array] = {}
    for column in columns:
        title, place = places[column.name]
        values[column.name] = _values(path, title, column, [(line, row[place]) for line, row in table])
    return values


def _places(path: Path, line: int, header: list[str], columns: Sequence[Column]) -> dict[str, tuple[str, int]]:
    """Return for each column its header and its place in a row."""
    places: dict[str, tuple[str, int]] = {}
    for place, title in enumerate(header):
        column = next((c for c in columns if title in c.headers()), None)
        if column is None and title != NOTE:
            raise bad_input(
                f"{path}, line {line}, column {place + 1}",
                given=f"'{title}'",
                allowed=_wanted(columns),
                do="Rename it with its unit, remove it, or call it note.",
            )
        if column is not None and column.name in places:
            first = places[column.name][0]
            raise bad_input(
                f"{path}, line {line}, column {place + 1}", given=f"'{title}' and '{first}'", allowed="one of them",
                do="Remove the other.",
            )  # fmt: skip
        if column is not None:
            places[column.name] = (title, place)
    missing = [c for c in columns if c.name not in places]
    if missing:
        raise bad_input(
            f"{path}, line {line}",
            given=f"no column for {missing[0].name}",
            allowed=", ".join(missing[0].headers()),
            do="Add it.",
        )
    return places


def _values(path: Path, title: str, column: Column, cells: list[tuple[int, str]]) -> Array:
    scale = column.headers()[title]
    allowed = f"{column.lower / scale:g} <= {title} <= {column.upper / scale:g}"
    values: list[float] = []
    for line, cell in cells:
        value = number(cell)
        if value is None or not column.lower <= value * scale <= column.upper:
            raise _bad_cell(
                path, line, title, cell, f"a number, {allowed}", "Check the value and the unit in the name."
            )
        if column.increasing and values and value * scale <= values[-1]:
            raise _bad_cell(path, line, title, cell, "more than in the row before", "Sort the rows; merge equal ones.")
        values.append(value * scale)
    return np.array(values)


def _bad_cell(path: Path, line: int, title: str, cell: str, allowed: str, do: str) -> InputError:
    given = f"'{cell}'" if cell else "an empty cell"
    return bad_input(f"{path}, line {line}, column {title}", given=given, allowed=allowed, do=do)


def _wanted(columns: Sequence[Column]) -> str:
    """Return the column names in their usual units, for a message."""
    usual = {"length": "mm", "mass": "g", "time": "s"}
    names = [f"{c.name}_{usual[c.quantity]}" + (f" or {c.twice}_mm" if c.twice else "") for c in columns]
    units = sorted({unit for c in columns for unit in UNITS[c.quantity]})
    return f"columns {', '.join(names)} (units {', '.join(units)}), and note"
