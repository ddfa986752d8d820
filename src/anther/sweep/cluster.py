"""The machines a sweep runs on: worker processes here, or any cluster whose dask scheduler has an address."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from anther.errors import InputError, MissingExtra
from anther.sweep.places import INSTALL

if TYPE_CHECKING:
    from distributed import Client

PATIENCE, RETURN = 30.0, 600.0
"""How long a scheduler may take to answer at first, and to come back after it went away [s]."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a worker. MuJoCo steps in the thread that calls it, unless given a pool, which Anther never does."""

_SETTINGS = {
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,  # a worker that has grown would wait for ever; at 95 % it is replaced
    "distributed.worker.daemon": True,
    "distributed.worker.profile.enabled": False,  # would ask every worker a hundred times a second what it is at
    "distributed.admin.system-monitor.interval": "5s",
    "logging.distributed": "critical",
}


@contextmanager
def connected(workers: int | None, scheduler: str | None, patience: float) -> Iterator[Client]:
    """Yield a client of the scheduler at an address, or of a cluster of worker processes here that ends with it.

    Args:
        workers: processes; by default one a core.
        scheduler: e.g. tcp://10.0.0.4:8786.
        patience: how long it may take to answer [s].

    Raises:
        MissingExtra: dask.distributed is not installed.
        InputError: nobody answers at the address.
    """
    try:
        from dask import config  # noqa: PLC0415
        from distributed import Client, LocalCluster  # noqa: PLC0415
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
