"""The jobs of a sweep: one row each, written by the sweep's client alone, in one transaction a batch."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from sqlalchemy import bindparam, select, update
from sqlalchemy.orm import Session

from anther.history._database import insert, open_reader, open_writer
from anther.history._tables import Sweep, SweepJob

State = Literal["waiting", "done", "poison"]


@dataclass(frozen=True, slots=True)
class Job:
    """One run of a sweep's function.

    Attributes:
        key: names its folder; made from the row.
        row: what the function is given.
        state: "waiting"; "done"; or "poison": set aside because it raised, or its worker died, too often.
        tries: how often it was begun.
        reason: why it is poison, or why it was begun more than once.
        result: what the function returned.
        seconds: wall time of the try that ended well [s].
    """

    key: str
    row: dict[str, Any]
    state: State = "waiting"
    tries: int = 0
    reason: str | None = None
    result: dict[str, Any] | None = None
    seconds: float | None = None


def add_jobs(jobs: Iterable[Job], where: Path | str, *, uid: str, folder: str, function: str) -> None:
    """Note jobs that are to be run; those that are noted already stay as they are."""
    with open_writer(where) as session:
        named = {"folder": folder, "function": function, "began": datetime.now(UTC)}
        session.execute(insert(session, Sweep).values(uid=uid, **named).on_conflict_do_nothing())
        sweep = _sweep(session, uid)
        rows = [{"sweep_id": sweep, "key": job.key, "row": job.row, "state": job.state, "tries": 0} for job in jobs]
        if rows:
            session.connection().execute(insert(session, SweepJob).on_conflict_do_nothing(), rows)


def note_jobs(jobs: Sequence[Job], where: Path | str, *, uid: str) -> None:
    """Note what became of jobs."""
    if not jobs:
        return
    now = datetime.now(UTC)
    names = ("state", "tries", "reason", "result", "seconds")
    with open_writer(where) as session:
        of_job = (SweepJob.sweep_id == _sweep(session, uid), SweepJob.key == bindparam("of"))
        statement = update(SweepJob).where(*of_job).values({name: bindparam(name) for name in (*names, "ended")})
        rows = [{"of": job.key, "ended": now, **{name: getattr(job, name) for name in names}} for job in jobs]
        session.connection().execute(statement, rows)


def read_jobs(where: Path | str, uid: str) -> list[Job]:
    """Return the jobs of a sweep, in the order they were added; none when there is no such sweep or file."""
    columns = [getattr(SweepJob, name) for name in Job.__slots__]
    query = select(*columns).join(Sweep, Sweep.id == SweepJob.sweep_id).where(Sweep.uid == uid).order_by(SweepJob.id)
    with open_reader(where) as session:
        return [] if session is None else [Job(*row) for row in session.execute(query)]


def _sweep(session: Session, uid: str) -> int:
    return session.execute(select(Sweep.id).where(Sweep.uid == uid)).scalar_one()
