"""The rows of a sweep from a CSV file."""

from __future__ import annotations

import csv
from pathlib import Path

from anther.errors import bad_input
from anther.files import read_lines


def read_table(path: Path | str) -> list[dict[str, str]]:
    """Return a line as names and texts; an empty cell is left out.

    Raises:
        InputError: no such file, no text, names that are missing or alike, or a line with too many cells.
    """
    lines = csv.reader(read_lines(path), strict=True)
    try:
        names = [name.strip() for name in next(lines, [])]
        if not names or len(set(names)) < len(names) or "" in names:
            given = f"first line {', '.join(names) or 'without names'}"
            raise bad_input(str(path), given=given, allowed="a name for every column, no two alike", do="Name them.")
        rows = []
        for cells in lines:
            if len(cells) > len(names):
                raise bad_input(
                    f"{path}, line {lines.line_num}",
                    given=f"{len(cells)} cells",
                    allowed=f"{len(names)}, one a name",
                    do="Is there a comma too many?",
                )
            row = {name: cell.strip() for name, cell in zip(names, cells, strict=False) if cell.strip()}
            if row:
                rows.append(row)
    except csv.Error as error:
        raise bad_input(
            f"{path}, line {lines.line_num}", given=str(error), allowed="a CSV file", do="Export it again."
        ) from error
    if not rows:
        raise bad_input(str(path), given="no rows", allowed="a line for every run", do="Add some.")
    return rows
