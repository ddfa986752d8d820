"""Hand the jobs that wait to the workers, a few at a time, and tell what becomes of them as it is known."""

from __future__ import annotations

import logging
import os
from asyncio import CancelledError
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError as Cancelled
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
from rich import progress
from rich.console import Console

from anther.core.errors import AntherError, InputError, MissingExtra
from anther.history._jobs import Job
from anther.history.sweep._working import INSTALL, Order, perform

if TYPE_CHECKING:
    from distributed import Client


@contextmanager
def counted(jobs: Iterable[Job], *, quiet: bool) -> Iterator[Callable[[list[Job]], None]]:
    """Draw a bar on stderr: how many of the rows have ended, time spent and left, and how many were set aside.

    Yields what counts jobs that have ended. The time left is estimated from the last hour.
    """
    states = Counter(job.state for job in jobs)
    columns = (
        progress.TextColumn("sweep{task.fields[aside]}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TextColumn("left"),
        progress.TimeRemainingColumn(),
    )
    on, poison = Console(stderr=True), states["poison"]

    def aside() -> str:
        return f", {poison} set aside" if poison else ""

    with progress.Progress(
        *columns, console=on, disable=quiet, speed_estimate_period=3600, refresh_per_second=1
    ) as bars:
        bar = bars.add_task("", total=states.total(), completed=states.total() - states["waiting"], aside=aside())

        def ended(batch: list[Job]) -> None:
            nonlocal poison
            poison += sum(job.state == "poison" for job in batch)
            bars.update(bar, advance=len(batch), aside=aside())

        yield ended


class _SchedulerLost(Exception):
    """The connection is gone; tasks under way may still be finished by their workers."""


def carry_out(jobs: Sequence[Job], order: Order, *, workers: int | None, scheduler: str | None) -> Iterator[list[Job]]:
    """Run jobs and yield them in batches as they end, until none waits.

    A scheduler that goes away is waited for, and what had not ended is handed over again.
    """
    remaining, patience = {job.key: job for job in jobs}, PATIENCE
    while remaining:
        try:
            with connected(workers, scheduler, patience) as client:
                for batch in _handed_over(client, list(remaining.values()), order):
                    for job in batch:
                        del remaining[job.key]
                    yield batch
        except (_SchedulerLost, OSError) as error:
            if scheduler is None:
                why = f" ({error})" if str(error) else ""
                raise InputError(
                    f"the sweep's own scheduler has ended{why}. Start the sweep again to go on."
                ) from error
            patience = 600.0  # [s]: it may come back


def _handed_over(client: Client, jobs: Sequence[Job], order: Order) -> Iterator[list[Job]]:
    from distributed import as_completed  # noqa: PLC0415

    waiting, under_way = deque(jobs), dict[str, Job]()
    lost, seconds = Counter[str](), np.inf
    completed: Any = as_completed(loop=client.loop, with_results=True, raise_errors=False)
    while waiting or under_way:
        room = _room(client, seconds) - len(under_way)
        new = [waiting.popleft() for _ in range(min(room, len(waiting)))]
        if new:
            names = [f"{job.key}-{uuid4().hex[:8]}" for job in new]
            under_way |= zip(names, new, strict=True)
            completed.update(client.map(partial(perform, order), new, key=names, pure=False))
        ended = []
        for future, result in completed.next_batch():
            job = _outcome(result, under_way.pop(future.key), lost, order)
            if job.seconds is not None:
                seconds = job.seconds if np.isinf(seconds) else 0.9 * seconds + 0.1 * job.seconds
            (waiting if job.state == "waiting" else ended).append(job)
        yield ended


def _room(client: Client, seconds: float) -> int:
    """Return how many tasks of so many seconds are to be in the cluster's hands."""
    threads: Any = client.nthreads()  # by worker, which has one; a coroutine only of clients that are asynchronous
    workers = max(len(threads), 1)
    # Besides those under way, for 0.5 s: a worker keeps what it was handed, so that of long tasks none is handed over
    # before somebody has time for it.
    return workers + min(int(workers * 0.5 / max(seconds, 1e-6)), 200)


def _outcome(result: Any, job: Job, lost: Counter[str], order: Order) -> Job:
    """Return what became of a task; it waits again where only its worker, or the way to it, was lost."""
    from distributed import KilledWorker  # noqa: PLC0415

    if isinstance(result, Job):
        return result
    if isinstance(result, CancelledError | Cancelled):
        raise _SchedulerLost
    error = result[1]
    if isinstance(error, AntherError):
        raise error
    if not isinstance(error, KilledWorker):
        raise InputError(
            f"a worker cannot begin a task ({type(error).__name__}: {error}). Install there what is installed here, "
            "and give a function of a module that can be imported there. What was finished is kept."
        ) from error
    lost[job.key] += 1
    if lost[job.key] < order.deaths:  # those that died while it ran are counted by the workers: it may be innocent
        return job
    return replace(job, state="poison", reason="its workers died before it began")


PATIENCE = 30.0
"""How long a scheduler may take to answer at first [s]."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a worker. MuJoCo steps in the thread that calls it, unless given a pool, which Anther never does."""

_SETTINGS = {
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,  # a worker that has grown would wait for ever; at 95 % it is replaced
    "distributed.worker.daemon": True,
    "distributed.worker.profile.enabled": False,  # would ask every worker a hundred times a second what it is at
    "distributed.scheduler.http.routes": [],  # pages for whoever asks
    "distributed.worker.http.routes": [],
    "distributed.admin.system-monitor.interval": "5s",
    "logging.distributed": "critical",
}


@contextmanager
def connected(workers: int | None, scheduler: str | None, patience: float) -> Iterator[Client]:
    """Yield a client of the scheduler at an address, which answers within `patience` [s], or of a cluster of worker
    processes here, by default one a core, that ends with it."""
    try:
        from dask import config  # noqa: PLC0415
        from distributed import Client, LocalCluster, Security  # noqa: PLC0415

        keys = None if scheduler else Security.temporary()  # needs cryptography
    except ImportError as error:
        raise MissingExtra(f"a sweep needs dask.distributed. Install it with: {INSTALL}") from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what goes wrong is said by the sweep
    if scheduler is not None:
        with _answering(Client, scheduler, patience) as client:
            yield client
        return
    with config.set(_SETTINGS):
        here: dict[str, Any] = {"processes": True, "threads_per_worker": 1, "dashboard_address": None}
        here |= {"silence_logs": logging.CRITICAL, "env": ONE_THREAD}
        here |= {"security": keys}  # who reaches a scheduler without keys runs code as its user
        with (
            LocalCluster(n_workers=workers or cores(), **here) as cluster,
            Client(cluster, set_as_default=False) as client,
        ):
            yield client


def _answering(client: type[Client], scheduler: str, patience: float) -> Client:
    try:
        return client(scheduler, timeout=patience, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is an OSError
        raise InputError(
            f"scheduler: got {scheduler}, where nobody answers within {patience:.0f} s; allowed: the address of a dask "
            "scheduler, such as tcp://10.0.0.4:8786. Start it with `dask scheduler`, and its workers with "
            "`dask worker ADDRESS --nthreads 1`. What was finished is kept."
        ) from error


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
