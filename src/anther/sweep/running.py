"""Hand the jobs that wait to the workers, a few at a time, and tell what becomes of them as it is known."""

from __future__ import annotations

from asyncio import CancelledError
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError as Cancelled
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from anther.errors import AntherError, InputError
from anther.store import Job
from anther.sweep import cluster
from anther.sweep.working import Order, perform

if TYPE_CHECKING:
    from distributed import Client

AHEAD, MOST = 0.5, 200
"""Tasks handed over besides those under way: for so long [s], and how many at most. A worker keeps what it was handed,
so that of long tasks none is handed over before somebody has time for it."""


class _SchedulerLost(Exception):
    """The connection is gone; tasks under way may still be finished by their workers."""


def carry_out(jobs: Sequence[Job], order: Order, *, workers: int | None, scheduler: str | None) -> Iterator[list[Job]]:
    """Run jobs and yield them in batches as they end, until none waits.

    A scheduler that goes away is waited for, and what had not ended is handed over again.

    Raises:
        InputError: see `cluster.connected` and `working.perform`.
    """
    remaining, patience = {job.key: job for job in jobs}, cluster.PATIENCE
    while remaining:
        try:
            with cluster.connected(workers, scheduler, patience) as client:
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
            patience = cluster.RETURN


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
    return workers + min(int(workers * AHEAD / max(seconds, 1e-6)), MOST)


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
