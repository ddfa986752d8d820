"""The rows of a greenhouse in a file: which rows there are, and where the hooks hang on each side.

Hooks are a plant's address: weekly lowering slides stems along the row, hooks stay in their order.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from anther.core.choices import SIDES
from anther.core.errors import bad_input
from anther.robot.cells._reading import Keys, TomlFile, build, read_toml


@dataclass(frozen=True, slots=True)
class Side:
    """One side of a path.

    Attributes:
        hooks: where each hook hangs, along the rails, in order [m]; none: nothing grows there.
    """

    hooks: list[float]


@dataclass(frozen=True, slots=True)
class RowOfFile:
    """A path between plants, and its two sides.

    Attributes:
        name: as people call it; no two rows have the same.
        left, right: its sides.
    """

    name: str
    left: Side
    right: Side


def read_rows(path: Path | str) -> tuple[RowOfFile, ...]:
    """Read and check a file of rows.

    Raises:
        InputError: the first thing that is wrong, with its line: no row, a row without a side, two rows with one name,
            hooks that are out of order or none at all on both sides.
    """
    source = read_toml(path)
    tables = source.table.get("row")
    if not isinstance(tables, list) or not tables:
        raise bad_input(str(path), given="no [[row]]", allowed="one or more", do="docs/row.md has one.")
    if others := sorted(set(source.table) - {"row"}):
        raise source.error((others[0],), given=f"an unknown key '{others[0]}'", allowed="row", do="Remove it.")
    rows = tuple(_row(source, ("row", str(i)), table) for i, table in enumerate(tables))
    for i, row in enumerate(rows):
        if row.name in [other.name for other in rows[:i]]:
            given = f"two rows called '{row.name}'"
            raise source.error(("row", str(i), "name"), given=given, allowed="a name of its own", do="Rename one.")
    return rows


def _row(source: TomlFile, keys: Keys, table: dict[str, Any]) -> RowOfFile:
    for side in SIDES:
        if side not in table:
            do = "Write hooks = [] where nothing grows."
            given, allowed = f"a row without its {side} side", f"[row.left] and [row.right] with hooks = [{0.4}, ...]"
            raise source.error(keys, given=given, allowed=allowed, do=do)
    sides = {side: build(source, (*keys, side), table[side], Side) for side in SIDES}
    for side, found in sides.items():
        _check_order(source, (*keys, side, "hooks"), found.hooks)
    if not any(side.hooks for side in sides.values()):
        raise source.error(keys, given="a row without hooks", allowed="a hook on either side", do="Remove the row.")
    return build(source, keys, {key: value for key, value in table.items() if key not in SIDES}, RowOfFile, **sides)


def _check_order(source: TomlFile, keys: Keys, hooks: list[float]) -> None:
    for number, (before, after) in enumerate(pairwise(hooks), start=2):
        if not before < after:
            given = f"hook {number} at {after:g} m after one at {before:g} m"
            raise source.error(keys, given=given, allowed="hooks in order along the rails", do="Sort them.")
