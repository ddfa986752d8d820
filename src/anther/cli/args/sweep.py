"""Run many trials or reconstructions from a table, on all cores or on a cluster; go on where an earlier start ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from anther.cli.args.shared import EXISTS


@dataclass(frozen=True)
class Args:
    """Attributes: what is run, where the results go, and on which machines."""

    table: Annotated[Path | None, tyro.conf.Positional, EXISTS] = None
    """CSV file: a column for every option of the command, a line for every run. Without it, say how far --out is."""
    kind: Literal["trial", "reconstruct"] = "trial"
    """Which command is run on each line."""
    out: str = "runs/sweep"
    """Folder of the sweep, or an address that fsspec knows (s3://bucket/name). The same folder and table go on."""
    workers: int | None = None
    """Worker processes on this machine; by default one a core."""
    scheduler: str | None = None
    """Run on a cluster instead: the address of its dask scheduler, such as tcp://10.0.0.4:8786."""
    history: str | None = None
    """Where the jobs are noted: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE; by default history.sqlite
    in --out."""
    tries: int = 3
    """How often a line that raises an error is tried before it is set aside."""
    deaths: int = 10
    """How many workers may die under a line before it is set aside."""
    again: bool = False
    """Try once more what was set aside."""
