"""Run many trials or reconstructions from a table, on all cores or on a cluster; go on where an earlier start ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from anther.sweep import Job


Kind = Literal["trial", "reconstruct"]


@dataclass(frozen=True)
class Args:
    """Attributes: what is run, where the results go, and on which machines."""

    table: Annotated[Path | None, tyro.conf.Positional] = None
    """CSV file: a column for every option of the command, a line for every run. Without it, say how far --out is."""
    kind: Kind = "trial"
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


def run(args: Args) -> int:
    """Sweep, write results.parquet and say how it went.

    Returns:
        0 if every line ended, 1 if some were set aside or still wait.
    """
    from anther import sweep
    from anther.commands import sweep_kinds

    if args.table is None:
        jobs = sweep.read(args.out, history=args.history)
    else:
        rows = sweep_kinds.typed(args.kind, sweep.read_table(args.table))
        function = sweep_kinds.trial if args.kind == "trial" else sweep_kinds.reconstruct
        jobs = sweep.run(
            function,
            rows,
            args.out,
            name=args.kind,
            history=args.history,
            workers=args.workers,
            scheduler=args.scheduler,
            tries=args.tries,
            deaths=args.deaths,
            again=args.again,
        )
    file = sweep.export(args.out, jobs)
    _say(jobs)
    print(f"{file}: read it with  duckdb -c \"SELECT * FROM '{file}'\"")
    return 0 if all(job.state == "done" for job in jobs) else 1


def _say(jobs: list[Job]) -> None:
    """Print the counts, and every line that was set aside with its reason."""
    states = [job.state for job in jobs]
    print(f"{states.count('done')} done, {states.count('poison')} set aside, {states.count('waiting')} waiting")
    for job in jobs:
        if job.state == "poison":
            given = ", ".join(f"{name} {value}" for name, value in job.row.items())
            print(f"set aside after {job.tries} tries: {given} ({job.key}): {job.reason}")
