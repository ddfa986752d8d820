"""What libraries read once, when they are imported, so that it is set before any of them is; and what they print."""

import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

MOST_PIXELS = 2**27
"""Largest image that OpenCV may decode [px], as a small file can state any size. A guess: few cameras have more."""


def may_write(folder: Path) -> bool:
    """Return whether files can be made in a folder, or in the nearest there is above it."""
    try:
        there = next(path for path in (folder, *folder.parents) if path.is_dir())
        with tempfile.TemporaryFile(dir=there):
            return True
    except OSError:
        return False


def compiled_code(folders: Iterable[Path]) -> str | None:
    """Return a private temporary folder for numba's compiled code, or None where one of numba's own will do.

    Numba cannot even be imported from where neither the package's folder nor the user's cache may be written. It loads
    code from what it finds, so that nobody else may write there.
    """
    if any(may_write(folder) for folder in folders):
        return None
    folder = Path(tempfile.gettempdir()) / f"anther-numba-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        private = not folder.is_symlink() and found.st_uid == os.getuid() and not found.st_mode & 0o077
    except OSError:
        private = False
    return str(folder) if private else tempfile.mkdtemp(prefix="anther-numba-")


def prepare_libraries() -> None:
    """Set what numba and OpenCV read once, when they are imported."""
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))
    caches = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - Path's raises
    if "NUMBA_CACHE_DIR" not in os.environ:
        folder = compiled_code((Path(__file__).parent / "__pycache__", Path(caches) / "numba"))
        if folder is not None:
            os.environ["NUMBA_CACHE_DIR"] = folder


@contextmanager
def silent_stdout() -> Iterator[None]:
    """Drop what compiled code prints to the process's standard output, which may be somebody's JSON."""
    try:
        kept = os.dup(1)
    except OSError:  # it is closed
        yield
        return
    if sys.stdout is not None:
        sys.stdout.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
