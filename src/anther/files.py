"""Files that are never half-written: write to a temporary name, then rename."""

from __future__ import annotations

import csv
import errno
import json
import math
import secrets
import struct
import zipfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.errors import InputError, bad_input

_UNWRITABLE = (
    errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS, errno.EPERM, errno.EEXIST, errno.ENOTDIR, errno.EISDIR,
    errno.ENAMETOOLONG, errno.EFBIG,
)  # fmt: skip

_UNFIT = (
    ArithmeticError, AttributeError, LookupError, RecursionError, StopIteration, TypeError, ValueError, csv.Error,
    struct.error,
)  # fmt: skip

LARGEST, LARGEST_TEXT = 2**30, 2**28
"""Most bytes of a file that is read whole, and of one whose text takes ten times as much once read. A guess: a thousand
views of a D455 are less, as is a cloud of twenty million points."""


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` on success, delete it on error.

    The temporary name keeps the suffix, so that writers which look at the suffix work.

    Raises:
        InputError: the disk is full, or the folder may not be written.
    """
    path = Path(path)
    with written(path, "a file that can be written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{secrets.token_hex(8)}{path.suffix}")
        temporary.touch(exist_ok=False)  # who may read it is as the umask says; tempfile's are the writer's alone
        try:
            yield temporary
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def written(path: Path | str, allowed: str) -> Iterator[None]:
    """Turn what the disk or its owner does not allow into one clear error.

    Args:
        path: of the file or folder that is written.
        allowed: see `errors.bad_input`.

    Raises:
        InputError: the disk is full, the place may not be written, or is a file where a folder is wanted.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in _UNWRITABLE:
            raise
        do = "What was there is unchanged: free some space or choose another folder."
        raise bad_input(str(path)[:300], given=error.strerror, allowed=allowed, do=do) from error


def made_folder(path: Path | str) -> Path:
    """Make a folder if it is missing, and those above it.

    Raises:
        InputError: it cannot be made, or is a file.
    """
    with written(path, "a folder that can be written"):
        Path(path).mkdir(parents=True, exist_ok=True)
    return Path(path)


def write_text(path: Path | str, text: str) -> None:
    """Write UTF-8 text atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path | str, value: Any) -> None:
    """Write JSON atomically, see `json_text`."""
    write_text(path, json_text(value))


def json_text(value: Any) -> str:
    """Return a value as JSON; numpy scalars and arrays become numbers and lists, NaN becomes null."""
    return json.dumps(_plain(value), indent=2, allow_nan=False) + "\n"


def read_json(path: Path | str) -> Any:
    """Read a JSON file.

    Raises:
        InputError: the file is missing or is not JSON, is nested too deeply or has a number of more than 18 digits.
    """
    path = whole_file(path, LARGEST_TEXT // 4)
    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_int=_integer)
    except (ValueError, RecursionError) as error:
        raise bad_input(str(path), given=f"not JSON ({error})", allowed="a JSON file", do="Is it truncated?") from error


def read_lines(path: Path | str) -> list[str]:
    """Read the lines of a text, UTF-8 with or without its mark.

    Raises:
        InputError: the file is missing, too large, or no text.
    """
    path = whole_file(path, LARGEST_TEXT)
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        given, do = f"unreadable, no text ({error})", "Export it again."
        raise bad_input(str(path), given=given, allowed="a text file, such as a CSV file, UTF-8", do=do) from error


def read_object(path: Path | str) -> dict[str, Any]:
    """Read a JSON file that holds an object.

    Raises:
        InputError: see `read_json`; or it holds a list, a number or a text.
    """
    value = read_json(path)
    if not isinstance(value, dict):
        raise bad_input(str(path), given=f"a {type(value).__name__}", allowed="a JSON object", do="Restore the file.")
    return value


def _integer(digits: str) -> int:
    if len(digits) > 18:  # neither a float nor an int64 is sure to hold it
        raise ValueError(f"an integer of {len(digits)} digits")
    return int(digits)


def write_npz(path: Path | str, kind: str, schema: int, **arrays: Any) -> None:
    """Write arrays atomically to a compressed .npz that names its kind and schema number."""
    with replacing(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, kind=kind, schema=schema, **{k: v for k, v in arrays.items() if v is not None})


def read_npz(path: Path | str, kind: str, schema: int) -> dict[str, NDArray[Any]]:
    """Read an .npz written by `write_npz`, without pickle.

    Raises:
        InputError: missing, truncated, of another kind, or of another schema number.
    """
    arrays = load_npz(path, f"an .npz holding a {kind}")
    found = (str(arrays.pop("kind", "")), str(arrays.pop("schema", "unknown")))
    if found != (kind, str(schema)):
        raise bad_input(
            str(path),
            given=f"kind '{found[0][:40]}', schema {found[1][:40]}",
            allowed=f"kind '{kind}', schema {schema}",
            do="Write it again with this version of Anther.",
        )
    return arrays


def load_npz(path: Path | str, allowed: str, names: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """Read the arrays of an .npz, without pickle and only if they have room.

    Args:
        path: the file.
        allowed: what it should hold, for the message.
        names: of the arrays that are wanted; None: all.

    Raises:
        InputError: missing, damaged, or its arrays take more than LARGEST bytes.
    """
    path = whole_file(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            wanted = {name: info for name, info in members.items() if names is None or name in names}
            size = sum(info.file_size for info in wanted.values())
            if size > LARGEST:
                raise ValueError(f"arrays of {size / 1e9:.1f} GB, more than {LARGEST / 1e9:.1f} GB")
            return {name: _array(archive, info) for name, info in wanted.items()}
    except Exception as error:  # zipfile, zlib and numpy raise whatever the bytes provoke
        raise bad_input(str(path), given=f"unreadable ({error})", allowed=allowed, do="Is it truncated?") from error


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    """Return one array; numpy would make room for the shape it states before it finds out that the bytes are few."""
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with archive.open(info) as stream:
        shape, _, dtype = headers[np.lib.format.read_magic(stream)](stream)
    if math.prod(shape) * max(dtype.itemsize, 1) > info.file_size:
        raise ValueError(f"{info.filename} states the shape {shape} and has {info.file_size} bytes")
    with archive.open(info) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


@contextmanager
def understood(
    path: Path | str, allowed: str = "what Anther wrote", do: str = "Restore the file, or make it again."
) -> Iterator[None]:
    """Turn what goes wrong while values read from a file are made use of into one clear error.

    Args:
        path: the file, for the message.
        allowed, do: see `errors.bad_input`.

    Raises:
        InputError: something is missing, of another type or of another value than expected.
    """
    try:
        yield
    except InputError as error:
        if str(error).startswith(str(path)):
            raise
        raise InputError(f"{path}: {error}") from error
    except _UNFIT as error:
        raise bad_input(str(path), given=f"unreadable ({error!r})", allowed=allowed, do=do) from error


def existing(path: Path | str) -> Path:
    """Return the path as `Path` if it is a file or a folder.

    Raises:
        InputError: there is no such file or folder, or it is a pipe or a device, which could be read for ever.
    """
    path = Path(path)
    try:
        if path.is_file() or path.is_dir():
            return path
        there = path.exists()
    except (OSError, ValueError) as error:  # a name too long, a null character, a folder that may not be entered
        raise bad_input(str(path)[:200], given=str(error), allowed="a file or folder", do="Check the path.") from error
    if there:
        raise bad_input(str(path), given="a pipe or device", allowed="a file or folder", do="Save it to a file first.")
    raise InputError(f"{path}: no such file or folder. Check the path; the current folder is {Path.cwd()}.")


def whole_file(path: Path | str, largest: int = LARGEST) -> Path:
    """Return the path as `Path` if it is a file that may be read whole.

    Raises:
        InputError: there is no such file, or it is larger than `largest` [bytes].
    """
    path = existing(path)
    if not path.is_file():
        raise bad_input(str(path), given="a folder", allowed="a file", do="Name a file in it.")
    size = path.stat().st_size
    if size > largest:
        allowed, do = f"at most {largest / 1e6:.0f} MB", "Is it the right file? Thin it out or split it."
        raise bad_input(str(path), given=f"{size / 1e6:.0f} MB", allowed=allowed, do=do)
    return path


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
