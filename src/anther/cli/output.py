"""Where a command writes: what an earlier start left there stays, unless --overwrite was given."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from anther.core.errors import bad_input


def room_for(args: Any, names: Iterable[str]) -> Path | None:
    """Return the folder `args.out` for files of these names; None where no folder was asked for.

    Raises:
        InputError: one of them is there, and `args.overwrite` was not given.
    """
    if args.out is not None:
        free(*(args.out / name for name in names), overwrite=args.overwrite)
    return args.out


def free(*places: Path, overwrite: bool) -> None:
    """Raise InputError where something is at one of the places already and may not be replaced."""
    there = [place for place in places if place.is_file() or (place.is_dir() and any(place.iterdir()))]
    if there and not overwrite:
        given = f"{there[0]}, which exists" + (f", and {len(there) - 1} more" if len(there) > 1 else "")
        raise bad_input("output", given=given, allowed="a new place", do="Choose another, or add --overwrite.")
