"""Where a sweep's folders are: on a disk that all workers see, or in a store that fsspec can reach (S3, GCS, ...).

PLACE/sweep.json          which sweep this is
PLACE/tasks/KEY/          what a finished task left; task.json is written last, or with all the rest at once
PLACE/under_way/KEY.json  tries of a task that has not finished
PLACE/under_way/KEY/      (on a disk) what it has written so far
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from anther.errors import AntherError, InputError, MissingExtra
from anther.files import replacing

TASKS, UNDER_WAY, RESULT = "tasks", "under_way", "task.json"
INSTALL = "pip install 'anther[sweep]'"


class Place(Protocol):
    """Files by their names below the place. All of it raises InputError where it cannot be read or written."""

    def read(self, name: str) -> bytes | None:
        """Return a file, None if there is none."""
        ...

    def write(self, name: str, data: bytes) -> None:
        """Write a file, whole or not at all."""
        ...

    def remove(self, name: str) -> None:
        """Remove a file if it is there."""
        ...

    def attempt(self, key: str) -> AbstractContextManager[Path]:
        """Yield a folder on this machine for one try of a task; on a disk no other process is in it."""
        ...

    def publish(self, key: str, folder: Path, result: str) -> None:
        """Make the folder of a try the task's own, with its result."""
        ...


def place(where: Path | str) -> Place:
    """Return the place of a path, or of an address such as s3://bucket/night-12.

    Raises:
        MissingExtra: fsspec, or its part for this kind of store, is not installed.
        InputError: no such kind of store.
    """
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
    """A folder that all workers see. A try is renamed to the task's folder: it is there whole, or not at all."""

    root: Path

    def read(self, name: str) -> bytes | None:
        """Return a file."""
        with _reached(self.root / name):
            try:
                return (self.root / name).read_bytes()
            except FileNotFoundError:
                return None

    def write(self, name: str, data: bytes) -> None:
        """Write a file."""
        with _reached(self.root / name), replacing(self.root / name) as temporary:
            temporary.write_bytes(data)

    def remove(self, name: str) -> None:
        """Remove a file."""
        with _reached(self.root / name):
            (self.root / name).unlink(missing_ok=True)

    @contextmanager
    def attempt(self, key: str) -> Iterator[Path]:
        """Yield under_way/KEY, locked: a process that died has let go of it, one that lives on is waited for."""
        folder = self.root / UNDER_WAY / key
        with _reached(folder):
            handle = _locked(folder)
        try:
            yield folder
        finally:
            with suppress(OSError):  # what a task left stays, to be looked at
                folder.rmdir()
            os.close(handle)

    def publish(self, key: str, folder: Path, result: str) -> None:
        """Write the result and rename the folder."""
        target = self.root / TASKS / key
        with _reached(target):
            (folder / RESULT).write_text(result)
            target.parent.mkdir(exist_ok=True)
            folder.rename(target)


def _locked(folder: Path) -> int:
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
        """Return an object."""
        with self._reached(name):
            try:
                return self.files.cat_file(f"{self.root}/{name}")
            except FileNotFoundError:
                return None

    def write(self, name: str, data: bytes) -> None:
        """Write an object."""
        with self._reached(name):
            self.files.pipe_file(f"{self.root}/{name}", data)

    def remove(self, name: str) -> None:
        """Remove an object."""
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


def empty(folder: Path) -> None:
    """Remove what a try that died has left."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
