"""What a worker does with one task: once, in a folder of its own, and with every try noted before it begins."""

from __future__ import annotations

import errno
import functools
import json
import os
import platform
import socket
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from anther.errors import InputError
from anther.files import json_text, understood
from anther.history import Job
from anther.sweep._places import RESULT, TASKS, UNDER_WAY, Place, empty, place

Function = Callable[[dict[str, Any], Path], Mapping[str, Any] | None]
"""Takes a row and an empty folder to write into; returns what is kept as the row's result."""

ALIKE = ("anther", "distributed", "cloudpickle", "numpy", "scipy", "numba", "mujoco")
"""Packages whose versions a worker and the client must share, or their results could not be told apart."""

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
"""No fault of a task: the next one would fail alike."""


@dataclass(frozen=True, slots=True)
class Order:
    """What all tasks of a sweep have in common.

    Attributes:
        function: is run.
        where: place of the sweep.
        uid: of the sweep.
        tries: how often a task that raises is begun.
        deaths: how many workers may die under a task.
        versions: of the client, see `versions`.
        pinned: keep the worker to one core, the one of its number.
    """

    function: Function
    where: str
    uid: str
    tries: int
    deaths: int
    versions: dict[str, str]
    pinned: bool = False


@functools.cache
def versions() -> dict[str, str]:
    """Return the versions of Python and of `ALIKE` here."""
    found = {"python": ".".join(platform.python_version_tuple()[:2])}
    for name in ALIKE:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "missing"
    return found


def perform(order: Order, job: Job) -> Job:
    """Run a task, unless it is finished already, and return what became of it.

    "waiting" in the result: it raised and may be tried again.

    Raises:
        InputError: no task can be run here: other versions, another folder, a place that cannot be written.
    """
    _prepare(order)
    there = _place(order.where, order.uid)
    with there.attempt(job.key) as folder:
        finished = there.read(f"{TASKS}/{job.key}/{RESULT}")
        if finished is not None:
            _forget(there, job.key)
            with understood(f"{order.where}/{TASKS}/{job.key}/{RESULT}"):
                return replace(job, **json.loads(finished))
        return _try(order, there, job, folder)


def _try(order: Order, there: Place, job: Job, folder: Path) -> Job:
    noted = f"{UNDER_WAY}/{job.key}.json"
    before = json.loads(there.read(noted) or b'{"begun": 0, "raised": 0, "reason": null}')
    begun, raised, reason = before["begun"], before["raised"], before["reason"]
    died = begun - raised
    if died:
        reason = f"its worker died {died} times while it ran" if died > 1 else "its worker died while it ran"
    if died >= order.deaths or raised >= order.tries:  # also if the word of it was lost on the way to the client
        return replace(job, state="poison", tries=begun, reason=reason)
    there.write(noted, json_text({**before, "begun": begun + 1}).encode())
    empty(folder)
    start = time.perf_counter()
    try:
        result = order.function(job.row, folder)
        text = json_text(dict(result or {}))
    except (Exception, SystemExit) as error:
        if _no_fault_of_its_own(error):
            _forget(there, job.key)
            raise InputError(f"{order.where}: {error}. What was finished is kept.") from None
        reason = _told(error)
        there.write(noted, json_text({"begun": begun + 1, "raised": raised + 1, "reason": reason}).encode())
        state = "poison" if raised + 1 >= order.tries else "waiting"
        return replace(job, state=state, tries=begun + 1, reason=reason)
    kept = {"state": "done", "tries": begun + 1, "reason": reason, "seconds": time.perf_counter() - start}
    kept["result"] = json.loads(text)
    there.publish(job.key, folder, json_text(kept))
    _forget(there, job.key)
    return replace(job, **kept)


def forget_tries(where: str, key: str) -> None:
    """Let a task that was set aside be tried anew."""
    _forget(place(where), key)


def _forget(there: Place, key: str) -> None:
    there.remove(f"{UNDER_WAY}/{key}.json")


@functools.cache
def _place(where: str, uid: str) -> Place:
    """Return the sweep's place, once it is certain that it is the client's."""
    there = place(where)
    known = there.read("sweep.json")
    if known is None or json.loads(known).get("uid") != uid:
        raise InputError(
            f"{where}: the worker on {socket.gethostname()} finds another folder there than the client. Give a folder "
            "that all machines see, or an address such as s3://bucket/name."
        )
    return there


def _prepare(order: Order) -> None:
    """Check that this worker fits, and keep it to one thread."""
    here = versions()
    other = [
        f"{name} {here[name]} instead of {wanted}" for name, wanted in order.versions.items() if here[name] != wanted
    ]
    if other:
        raise InputError(
            f"worker on {socket.gethostname()}: has {', '.join(other)}. Install the same versions there, then start "
            "the sweep again: what was finished is kept."
        )
    _keep_to_one_thread(order.pinned)


@functools.cache
def _keep_to_one_thread(pinned: bool) -> None:
    """BLAS and OpenMP read the environment that `cluster` and dask's nannies set; OpenCV is told here, once."""
    from distributed import get_worker  # noqa: PLC0415

    worker = get_worker()
    if worker.state.nthreads != 1:
        raise InputError(
            f"worker on {socket.gethostname()}: has {worker.state.nthreads} threads; allowed: one a worker, as a task "
            "that kills its worker would take others with it. Start it with: dask worker --nthreads 1 --nworkers N"
        )
    import cv2  # noqa: PLC0415

    cv2.setNumThreads(1)
    if pinned and hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker.name) % len(cores)]})


def _no_fault_of_its_own(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, OSError) and error.errno in _FULL:
            return True
        error = error.__cause__ or error.__context__
    return False


def _told(error: BaseException) -> str:
    """Return the error in one line, with the place in the code where it is nobody's clear message."""
    said = " ".join(str(error).split())[:500]
    if isinstance(error, InputError):
        return said
    frames = traceback.extract_tb(error.__traceback__)
    at = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {said}{at}"
