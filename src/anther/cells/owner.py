"""One owner for a cell: two processes of this machine cannot command one arm."""

from __future__ import annotations

import importlib
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from anther.devices import DeviceError


@contextmanager
def owned(arm: str, folder: Path | None = None) -> Iterator[None]:
    """Own an arm within the block. Its lock ends with the process, however that ends.

    Args:
        arm: which; the same words name the same arm.
        folder: of the lock files; None: the machine's folder for temporary files.

    Raises:
        DeviceError: another process owns it.
    """
    fcntl: Any = importlib.import_module("fcntl")
    path = (folder or Path(tempfile.gettempdir())) / f"anther-{re.sub(r'[^A-Za-z0-9.-]+', '-', arm)}.lock"
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner = os.pread(handle, 40, 0).decode(errors="replace").strip() or "unknown"
            do = "Wait until it ends, or end it."
            raise DeviceError(f"the arm {arm} is commanded by another process, number {owner}. {do}") from error
        os.ftruncate(handle, 0)
        os.pwrite(handle, str(os.getpid()).encode(), 0)
        yield
    finally:
        os.close(handle)
