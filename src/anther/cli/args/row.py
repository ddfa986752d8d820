"""Work along a greenhouse row: map it, begin a shift, visit its stems one after another; the same again goes on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from anther.cli.args.shared import EXISTS, HISTORY
from anther.core.choices import Crop


@dataclass(frozen=True)
class Args:
    """Attributes: which rows, which robots, and where the visits are kept."""

    simulate: Crop | None = None
    """Crop of the simulated rows. Rows are worked in simulation alone, so it must be given (docs/row.md)."""
    plants: int = 12
    """Plants along one row, on both sides of its path together: 2 to 16."""
    rows: int = 1
    """How many rows."""
    seed: int = 0
    """Which rows; all noise comes from it too."""
    file: Annotated[Path | None, EXISTS] = None
    """File with the names of rows and the places of hooks (docs/row.md), instead of --plants and --rows."""
    house: str | None = None
    """Name of the house in the history; by default it says crop, seed and size, or the file's name."""
    robots: int = 1
    """How many robots share the shift, one to a row."""
    history: str = HISTORY
    """History that keeps map, shift and visits: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE."""
    many: int = 0
    """Run so many such houses, with seeds from --seed on, on all cores by Dask, each with a history of its own."""
    out: str = "runs/rows"
    """Folder for a run folder of each visit; of --many a folder or an address that fsspec knows, which goes on."""
