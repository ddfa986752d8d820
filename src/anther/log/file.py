"""The file under a log: it takes all that is written, and where the disk does not, it says so and raises nothing."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

LARGEST = 256_000_000
"""A log grows no further than about this [bytes]; a simulated trial makes 3 MB."""


class LogFile:
    """Attributes: `size` [bytes]; `error`: why no more is written, "" if nothing is wrong; `broken`: the disk is why.

    Args:
        path: of the file.
        opened: opens it for writing bytes, unbuffered.
    """

    def __init__(self, path: Path, opened: Callable[[Path], Any]) -> None:
        self.size, self.error, self.broken, self._whole, self._raw = 0, "", False, 0, None
        try:
            self._raw = opened(path)
        except OSError as error:
            self._fail(error)

    @property
    def full(self) -> bool:
        """Whether nothing should be added."""
        if not self.error and self.size > LARGEST:
            self.error = f"it would grow beyond {LARGEST / 1e6:.0f} MB"
        return bool(self.error)

    def write(self, data: bytes | bytearray) -> int:
        """Write bytes, or lose them; return how many there were."""
        if self._raw is None:
            return len(data)
        left = memoryview(data)
        try:
            while left:
                done = self._raw.write(left)
                if not done:
                    raise OSError(errno.EIO, os.strerror(errno.EIO))
                self.size += done
                left = left[done:]
        except OSError as error:
            self._fail(error)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Return the place: the writer only asks where it is."""
        return self.size

    def flush(self) -> None:
        """Note that what was written so far ends with a whole record."""
        self._whole = self.size

    def close(self) -> None:
        """Close the file."""
        if self._raw is not None:
            with suppress(OSError):
                self._raw.close()

    def _fail(self, error: OSError) -> None:
        """Keep what was whole, and write no more."""
        self.error, self.broken = error.strerror or str(error), True
        if self._raw is not None:
            with suppress(OSError):
                self._raw.truncate(self._whole)
            self.size = self._whole
            self.close()
            self._raw = None
