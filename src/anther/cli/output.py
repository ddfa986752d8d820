"""Where a command writes: what an earlier start left there stays, unless --overwrite was given; and what it says."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

from anther.core.errors import bad_input

LOG = "log.txt"


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


@contextmanager
def kept_log(folder: Path) -> Iterator[None]:
    """Keep what a command says in a file: many speak at once."""
    said = StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            yield
    finally:
        (folder / LOG).write_text(said.getvalue(), encoding="utf-8")
