"""List the trial history, export it as CSV or Parquet, or add what was recorded elsewhere: a run, another history."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Literal

import tyro

from anther.cli.args.shared import HISTORY, Overwrite


@dataclass(frozen=True)
class Args(Overwrite):
    """Attributes: which history, which of its trials, and what to do with them."""

    history: Annotated[str, tyro.conf.Positional] = HISTORY
    """A SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE."""
    species: str | None = None
    """Only this crop."""
    plant: str | None = None
    """Only the plant with this label."""
    since: date | None = None
    """Only trials of this day and later, UTC (YYYY-MM-DD)."""
    until: date | None = None
    """Only trials of this day and earlier, UTC."""
    result: str | None = None
    """Only 'pollinated', 'held' (flowers hardly moved, or not measured), 'failed', or a kind of failure: 'slipped'."""
    last: int = 40
    """List at most so many, the last ones. An export always has all."""
    export: Path | None = None
    """Write a table instead of listing: a name that ends in .csv or .parquet."""
    table: Literal["visits", "flowers", "outcomes"] = "visits"
    """Which table to export: a line a visit, a line a flower and visit, or the counts of fruit set."""
    add: tuple[Path, ...] = ()
    """Run folders whose trial is not in the history yet, because it could not be reached."""
    merge: tuple[Path, ...] = ()
    """Histories of robots that were offline: what the history lacks of them is added. Doing it again adds nothing."""
