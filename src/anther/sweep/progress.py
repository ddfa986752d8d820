"""How far a sweep is, and how long it may still take."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from rich import progress
from rich.console import Console

from anther.store import Job


class Progress:
    """A bar on stderr: how many of the rows have ended, time spent and time left, and how many were set aside.

    Use as a context manager; the time left is estimated from the last hour.
    """

    def __init__(self, jobs: Iterable[Job], *, quiet: bool) -> None:
        states = Counter(job.state for job in jobs)
        columns = (
            progress.TextColumn("{task.description}"),
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            progress.TimeElapsedColumn(),
            progress.TextColumn("left"),
            progress.TimeRemainingColumn(),
        )
        self._bars = progress.Progress(
            *columns, console=Console(stderr=True), disable=quiet, speed_estimate_period=3600, refresh_per_second=1
        )
        self._poison = states["poison"]
        total, ended = states.total(), states.total() - states["waiting"]
        self._bar = self._bars.add_task(self._said(), total=total, completed=ended)

    def __enter__(self) -> Progress:
        self._bars.start()
        return self

    def __exit__(self, *reason: object) -> None:
        self._bars.stop()

    def ended(self, batch: list[Job]) -> None:
        """Count jobs that have ended."""
        self._poison += sum(job.state == "poison" for job in batch)
        self._bars.update(self._bar, advance=len(batch), description=self._said())

    def _said(self) -> str:
        return f"sweep, {self._poison} set aside" if self._poison else "sweep"
