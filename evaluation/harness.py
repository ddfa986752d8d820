"""Cases of an experiment through a sweep: each once, in a folder of its own, going on after whatever stops it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from anther.history import sweep
from anther.history.sweep import Function, Job

Row = dict[str, Any]
FOLDER = "folder"
"""Key of a row under which the folder is that its function wrote into."""


def swept(
    function: Function, cases: Iterable[Mapping[str, Any]], out: Path, jobs: int, crashed: Callable[[str], Row]
) -> list[Row]:
    """Return what a function made of every case, in their order. What was done before is not done again.

    Args:
        function: takes a case and an empty folder and returns its row; it stands in a module, which workers import.
        cases: as mappings.
        out: folder of the sweep; after a change of the code, delete it.
        jobs: cases at a time, a process each.
        crashed: reason -> what the row of a case holds whose function raised. It is said, and tried again next time:
            one trial's bug must not end a run of hours.
    """
    done = sweep.run(function, cases, out, workers=jobs, tries=1, again=True)
    for job in (job for job in done if job.result is None):
        print(f"crashed: {job.row}: {job.reason}")
    return _rows(done, out, crashed)


def kept(out: Path, crashed: Callable[[str], Row]) -> list[Row]:
    """Return what became of every case that was ever done in a sweep's folder; `crashed` as above."""
    return _rows([job for job in sweep.read(out) if job.state != "waiting"], out, crashed)


def _rows(jobs: list[Job], out: Path, crashed: Callable[[str], Row]) -> list[Row]:
    told = [crashed(str(job.reason)) if job.result is None else job.result for job in jobs]
    return [{**job.row, **row, FOLDER: str(out / "tasks" / job.key)} for job, row in zip(jobs, told, strict=True)]


def failed(reason: str) -> Row:
    """Return what stands for a trial whose program crashed."""
    return {"success": False, "failure": "crashed", "message": reason}
