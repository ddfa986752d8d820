"""What a worker does with one task: once, in a folder of its own, and with every try noted before it begins.

A sweep's folders are on a disk that all workers see, or in a store that fsspec can reach (S3, GCS, ...):

PLACE/sweep.json          which sweep this is
PLACE/tasks/KEY/          what a finished task left; task.json is written last, or with all the rest at once
PLACE/under_way/KEY.json  tries of a task that has not finished
PLACE/under_way/KEY/      (on a disk) what it has written so far
"""

from __future__ import annotations

import errno
import fcntl
import functools
import importlib.util
import json
import os
import platform
import shutil
import socket
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from anther.core.errors import AntherError, InputError, MissingExtra
from anther.core.files import json_text, replacing, understood
from anther.core.opencv import cv2
from anther.history._jobs import Job

TASKS, UNDER_WAY, RESULT = "tasks", "under_way", "task.json"
INSTALL = "pip install 'anther[sweep]'"


def place(where: Path | str) -> Place:
    """Return the place of a path, or of an address such as s3://bucket/night-12 that fsspec, with its part for it,
    knows."""
    if "://" not in str(where):
        return Disk(Path(where))
    try:
        from fsspec.core import url_to_fs  # noqa: PLC0415

        files, root = url_to_fs(str(where), use_listings_cache=False)
    except ImportError as error:
        raise MissingExtra(f"{where}: {error}. Besides that: {INSTALL}") from error
    except Exception as error:  # every store has errors of its own
        raise InputError(f"{where}: {error}. Allowed: a folder, or an address that fsspec knows.") from error
    return Store(str(where), files, root.rstrip("/"))


@contextmanager
def _reached(where: object, kinds: type[Exception] = OSError) -> Iterator[None]:
    try:
        yield
    except AntherError:
        raise
    except kinds as error:
        said = " ".join(str(getattr(error, "strerror", None) or error or type(error).__name__).split())
        raise InputError(
            f"{where}: cannot be read or written ({said}). Check the place, its rights and its space, then start the "
            "sweep again: what was finished is kept."
        ) from error


@dataclass(frozen=True, slots=True)
class Disk:
    """A folder that all workers see. A try is renamed to the task's folder: it is there whole, or not at all.

    Files have names below the place. What cannot be read or written raises InputError.
    """

    root: Path

    def read(self, name: str) -> bytes | None:
        """Return a file, None if there is none."""
        with _reached(self.root / name):
            try:
                return (self.root / name).read_bytes()
            except FileNotFoundError:
                return None

    def write(self, name: str, data: bytes) -> None:
        """Write a file, whole or not at all."""
        with _reached(self.root / name), replacing(self.root / name) as temporary:
            temporary.write_bytes(data)

    def remove(self, name: str) -> None:
        """Remove a file if it is there."""
        with _reached(self.root / name):
            (self.root / name).unlink(missing_ok=True)

    @contextmanager
    def attempt(self, key: str) -> Iterator[Path]:
        """Yield a folder for one try of a task, under_way/KEY.

        It is locked: a process that died has let go of it, one that lives on is waited for."""
        folder = self.root / UNDER_WAY / key
        with _reached(folder):
            handle = _lock_folder(folder)
        try:
            yield folder
        finally:
            with suppress(OSError):  # what a task left stays, to be looked at
                folder.rmdir()
            os.close(handle)

    def publish(self, key: str, folder: Path, result: str) -> None:
        """Make the folder of a try the task's own, with its result."""
        target = self.root / TASKS / key
        with _reached(target):
            (folder / RESULT).write_text(result)
            target.parent.mkdir(exist_ok=True)
            folder.rename(target)


def _lock_folder(folder: Path) -> int:
    """Return a handle of a folder, made if missing, that is locked until the handle is closed or its process dies."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            handle = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:
            continue
        fcntl.flock(handle, fcntl.LOCK_EX)
        if folder.exists() and os.path.samestat(os.fstat(handle), folder.stat()):
            return handle
        os.close(handle)  # another process has finished it meanwhile


@dataclass(frozen=True, slots=True)
class Store:
    """Objects in a store. Tries are made in a temporary folder and copied; the result comes last."""

    where: str
    files: Any
    root: str

    def read(self, name: str) -> bytes | None:
        """See `Disk`."""
        with self._reached(name):
            try:
                return self.files.cat_file(f"{self.root}/{name}")
            except FileNotFoundError:
                return None

    def write(self, name: str, data: bytes) -> None:
        """See `Disk`."""
        with self._reached(name):
            self.files.pipe_file(f"{self.root}/{name}", data)

    def remove(self, name: str) -> None:
        """See `Disk`."""
        with self._reached(name), suppress(FileNotFoundError):
            self.files.rm_file(f"{self.root}/{name}")

    @contextmanager
    def attempt(self, key: str) -> Iterator[Path]:
        """Yield a temporary folder."""
        with tempfile.TemporaryDirectory(prefix=f"anther-{key}-") as folder:
            yield Path(folder)

    def publish(self, key: str, folder: Path, result: str) -> None:
        """Copy the folder, its result last."""
        target = f"{self.root}/{TASKS}/{key}"
        with self._reached(f"{TASKS}/{key}"):
            for file in sorted(folder.rglob("*")):
                if file.is_file():
                    self.files.put_file(str(file), f"{target}/{file.relative_to(folder).as_posix()}")
            self.files.pipe_file(f"{target}/{RESULT}", result.encode())

    def _reached(self, name: str) -> AbstractContextManager[None]:
        return _reached(f"{self.where}/{name}", Exception)  # every store has errors of its own


Place = Disk | Store


def empty(folder: Path) -> None:
    """Remove what a try that died has left."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


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
    """
    _prepare(order)
    there = _place(order.where, order.uid)
    with there.attempt(job.key) as folder:
        finished = there.read(f"{TASKS}/{job.key}/{RESULT}")
        if finished is not None:
            forget_tries(there, job.key)
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
            forget_tries(there, job.key)
            raise InputError(f"{order.where}: {error}. What was finished is kept.") from None
        reason = _error_words(error)
        there.write(noted, json_text({"begun": begun + 1, "raised": raised + 1, "reason": reason}).encode())
        state = "poison" if raised + 1 >= order.tries else "waiting"
        return replace(job, state=state, tries=begun + 1, reason=reason)
    kept = {"state": "done", "tries": begun + 1, "reason": reason, "seconds": time.perf_counter() - start}
    kept["result"] = json.loads(text)
    there.publish(job.key, folder, json_text(kept))
    forget_tries(there, job.key)
    return replace(job, **kept)


def forget_tries(there: Place, key: str) -> None:
    """Let a task be tried anew, as if it never had been."""
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
    if importlib.util.find_spec("cv2"):
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


def _error_words(error: BaseException) -> str:
    """Return the error in one line, with the place in the code where it is nobody's clear message."""
    said = " ".join(str(error).split())[:500]
    if isinstance(error, InputError):
        return said
    frames = traceback.extract_tb(error.__traceback__)
    at = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {said}{at}"
