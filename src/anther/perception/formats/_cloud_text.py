"""Point clouds as text: what separates the numbers, where their decimals begin, and which column is what. N points.

A line of names, also in a comment, states which columns are x, y, z and colours. Without one the first three are x, y,
z; colours are taken where only one reading of the other columns is possible, and else none are, with a note.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import InputError, bad_input
from anther.core.files import read_lines, understood
from anther.core.geometry import Array
from anther.perception.cloud import ply
from anther.perception.formats._raw_points import RawPoints, places, stated, unit_of, unused_note

_NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf)", re.IGNORECASE)
_WORDS = re.compile(r"[^\s,;]+")
_COMMENT = ("#", "//", "%")
_DO = "Export with decimal points, columns separated by semicolons, tabs or blanks."


def read_text(path: Path) -> RawPoints:
    """Read rows of numbers separated by blanks, commas, semicolons or tabs, with decimal points or commas.

    Raises:
        InputError: no rows, fewer points than the file says, or columns or numbers whose meaning is unclear.
    """
    lines = [line.strip() for line in read_lines(path)]
    begin = next((i for i, line in enumerate(lines) if _is_row(line)), len(lines))
    body = [line for line in lines[begin:] if line and not line.startswith(_COMMENT)]
    if not body:
        raise bad_input(str(path), given="unreadable (no row of numbers)", allowed="rows of x y z", do="Export again.")
    if '"' in body[0]:
        body = [";".join(cells) for cells in csv.reader(body, delimiter=_quoted_separator(body[0]))]
    separator, comma = _layout(path, body[:200])
    names = _names(lines[:begin], body[0], separator)
    table = _table(path, body, separator, comma)
    count = next((int(line) for line in lines[:begin] if line.isdecimal()), None)
    if count is not None and count > len(table):
        given, allowed = f"{len(table)} points", f"{count}, as its first line states"
        raise bad_input(str(path), given=given, allowed=allowed, do="Is it truncated?")
    raw = _by_names(path, table, names) if names else _by_place(path, table, counted=count is not None)
    units, up = stated([line for line in lines if line.startswith(_COMMENT)])
    return raw._replace(units=raw.units or units, up=up)


def _is_row(line: str) -> bool:
    """Separate rows of numbers from names, comments and a leading count."""
    words = _WORDS.findall(line.replace('"', ""))
    numeric = sum(_NUMBER.fullmatch(word) is not None for word in words)
    return numeric > 1 and 2 * numeric > len(words) and not line.startswith(_COMMENT)


def _quoted_separator(line: str) -> str:
    """Return the text between quoted cells."""
    return next((mark for mark in ";\t" if mark in line), "," if re.search(r'"\s*,|,\s*"', line) else " ")


def _layout(path: Path, rows: list[str]) -> tuple[str | None, bool]:
    """Return what separates the columns (None: blanks), and whether commas are decimal.

    Raises:
        InputError: commas could be both, or group thousands.
    """
    text = "\n".join(rows)
    mark = next((mark for mark in ";\t" if mark in text), None)
    cells = [cell.strip() for row in rows for cell in (row.split(mark) if mark else row.split())]
    inside = [cell.rstrip(",") for cell in cells if "," in cell.rstrip(",")]
    grouped = [
        cell for cell in inside if re.fullmatch(r"[+-]?\d{1,3}(?:,\d{3})+\.\d*|[+-]?\d{1,3}(?:\.\d{3})+,\d*", cell)
    ]
    single = [cell for cell in inside if _NUMBER.fullmatch(cell)]
    apart = mark or all(len(row.split()) > 2 for row in rows)
    if apart and inside and len(grouped) == len(inside):
        raise _unclear(path, f"'{grouped[0]}', with marks for thousands")
    if apart and inside and len(single) == len(inside):
        return mark, True
    if mark or not inside:
        return (mark or ("," if "," in text else None)), False
    parts = [part for cell in inside for part in cell.split(",")]
    if "." not in text and any(re.fullmatch(r"0\d+", part) for part in parts):
        raise _unclear(path, f"'{rows[0][:60]}': commas between numbers and, it seems, decimal commas")
    return ("," if not any(re.search(r"[^,\s]\s+[^,\s]", row) for row in rows) else None), False


def _unclear(path: Path, given: str) -> InputError:
    return bad_input(str(path), given=given, allowed="decimal points, or decimal commas between other marks", do=_DO)


def _table(path: Path, body: list[str], separator: str | None, comma: bool) -> Array:
    if comma:
        apart = body if separator else [re.sub(r",(?=\s|$)", " ", line) for line in body]
        body = [line.replace(",", ".") for line in apart]
    elif separator is None:
        body = [line.replace(",", " ") for line in body]
    if separator is not None:
        empty = 2 * separator
        width = body[0].rstrip(separator).count(separator)
        body = [line.rstrip(separator) if line.count(separator) > width else line for line in body]
        while any(empty in line for line in body):
            body = [line.replace(empty, f"{separator}nan{separator}") for line in body]
    with understood(path, "rows of at least three numbers: x y z", "Is it truncated, or another format?"):
        cells = [cell.strip() for cell in body[0].split(separator)]
        numeric = [k for k, cell in enumerate(cells) if _NUMBER.fullmatch(cell)]
        every = len(numeric) == len(cells)
        rows = np.loadtxt(body, dtype=np.float64, ndmin=2, delimiter=separator, usecols=None if every else numeric)
    if rows.shape[1] < 3:
        raise bad_input(str(path), given=f"{rows.shape[1]} columns", allowed="x y z [r g b]", do="Export x, y and z.")
    if every:
        return rows
    table = np.full((len(rows), len(cells)), np.nan)  # words, such as an organ's name, are no number
    table[:, numeric] = rows
    return table


def _names(head: list[str], row: str, separator: str | None) -> list[str] | None:
    """Return the columns' names where a line before the numbers is one of names, as many as columns.

    A line of units below it adds them to the names.
    """
    width = len(row.rstrip(separator).split(separator))
    lines = [_cells(line, width, separator) for line in reversed(head) if line and not line.isdecimal()]
    able = [cells for cells in lines if cells]
    named = next((cells for cells in able if places(cells)[0]), able[0] if able else None)
    below = able[: able.index(named)] if named else []
    if named and below and all(not cell or unit_of(cell.strip("[]()")) for cell in below[-1][:3]):
        return [f"{name} [{unit.strip('[]()')}]" if unit else name for name, unit in zip(named, below[-1], strict=True)]
    return named


def _cells(line: str, width: int, separator: str | None) -> list[str] | None:
    """Return a line's words if they can be the names of that many columns."""
    line = line.lstrip("#/% ").rstrip(separator or " ")
    for mark in dict.fromkeys((separator, ";", "\t", ",", None)):
        cells = [cell.strip(' \t\r",') for cell in line.split(mark)]
        if len(cells) == width - 1 and places(cells)[0]:
            cells = ["", *cells]  # R writes no name above those of the rows
        if len(cells) == width and any(re.search("[A-Za-z]", cell) for cell in cells):
            return cells
    return None


def _by_names(path: Path, table: Array, names: list[str]) -> RawPoints:
    at, units = places(names)
    if at is None:
        given = f"columns {', '.join(name or 'without name' for name in names)}"
        raise bad_input(str(path), given=given, allowed="x, y and z among them", do="Name the columns in line 1.")
    keys = [re.sub(r"\W*[\[(].*", "", name.lower()).strip() for name in names]
    words = np.atleast_1d(np.isnan(table).all(axis=0))
    rest = [key for k, key in enumerate(keys) if k not in at and not words[k]]
    colors, taken = ply.find_colors(rest, lambda key: _whole(table[:, keys.index(key)]))
    unused = [names[k] or "a column without name" for k, key in enumerate(keys) if k not in at and key not in taken]
    return RawPoints(table[:, at], colors, units, notes=unused_note(unused))


def _by_place(path: Path, table: Array, *, counted: bool) -> RawPoints:
    words = np.atleast_1d(np.isnan(table).all(axis=0))
    words &= (~words).sum() >= 3  # else there are no words, but points that are no numbers
    notes = unused_note([f"column {k + 1}" for k in np.flatnonzero(words)])
    table = table[:, ~words]
    if table.shape[1] > 3 and _counts(table[:, 0]):
        table, notes = table[:, 1:], (*notes, *unused_note(["column 1, which counts the rows"]))
    whole = [np.array_equal(column, np.round(column)) for column in table[np.isfinite(table[:, :3]).all(axis=1), :3].T]
    if len(set(whole)) > 1 and table.shape[1] > 3:
        numbers = [str(k + 1) for k in range(3) if whole[k]]
        given, allowed = f"whole numbers in column {', '.join(numbers)}, not in the others", "x, y, z in columns 1 to 3"
        raise bad_input(str(path), given=given, allowed=allowed, do="Name the columns in line 1, as x y z intensity.")
    extra = table[:, 3:]
    begin = _colour_columns(extra, counted=counted)
    colors = None if begin is None else ply.color_bytes(_whole(extra[:, begin : begin + 3]))
    left = [k for k in range(extra.shape[1]) if begin is None or not begin <= k < begin + 3]
    if left:
        numbers = ", ".join(str(k + 4) for k in left)
        say = "; to use them as r, g, b, name the columns in line 1" if begin is None else ""
        notes += unused_note([f"column{'s' if len(left) > 1 else ''} {numbers}{say}"])
    return RawPoints(table[:, :3], colors, notes=notes)


def _counts(column: Array) -> bool:
    """Return whether numbers are whole and rise or fall all along, as those of rows do."""
    steps = np.diff(column)
    return bool(np.array_equal(column, np.round(column)) and len(steps) and (np.all(steps > 0) or np.all(steps < 0)))


def _colour_columns(extra: Array, *, counted: bool) -> int | None:
    """Return where the columns r, g, b begin; None if there are none, or several places could be meant.

    A file that begins with a count is Leica's PTS: x y z intensity r g b.
    """
    width = extra.shape[1]
    normal = [k for k in range(width - 2) if _is_normal(extra[:, k : k + 3])]
    able = [k for k in range(width - 2) if _is_colour(extra[:, k : k + 3]) and not any(abs(k - n) < 3 for n in normal)]
    if counted and width == 4:
        return 1 if 1 in able else None
    if width == 4 and able == [0, 1]:  # with alpha, before or behind
        constant = [np.ptp(extra[:, k]) == 0 for k in (0, 3)]
        able = [1] if constant == [True, False] else [0] if constant == [False, True] else able
    return able[0] if len(able) == 1 else None


def _is_normal(three: Array) -> bool:
    """Return whether most rows (N, 3) have the length one, to within 2 %."""
    return bool((np.abs(np.linalg.norm(three, axis=1) - 1) < 0.02).mean() > 0.5)


def _is_colour(three: Array) -> bool:
    low, high = float(np.nanmin(three, initial=0)), float(np.nanmax(three, initial=0))
    whole = np.array_equal(three, np.round(three))
    return low >= 0 and (1 < high <= 255 if whole else high <= 1)


def _whole(values: Array) -> NDArray[np.generic]:
    """Return numbers that a text wrote without decimals as integers, unless they are all 0 or 1."""
    whole = np.array_equal(values, np.round(values)) and float(values.max(initial=0)) > 1
    return values.astype(np.int64) if whole else values
