"""Files that are never half-written: write to a temporary name, then rename."""

from __future__ import annotations

import errno
import json
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.errors import InputError, bad_input

_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS)


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` on success, delete it on error.

    The temporary name keeps the suffix, so that writers which look at the suffix work.

    Raises:
        InputError: the disk is full, or the folder may not be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            temporary.chmod(0o644)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        if error.errno not in _UNWRITABLE:
            raise
        do = "What was there is unchanged: free some space or choose another folder."
        raise bad_input(str(path), given=error.strerror, allowed="a file that can be written", do=do) from error


def write_text(path: Path | str, text: str) -> None:
    """Write UTF-8 text atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path | str, value: Any) -> None:
    """Write JSON atomically; numpy scalars and arrays become numbers and lists, NaN becomes null."""
    write_text(path, json.dumps(_plain(value), indent=2, allow_nan=False) + "\n")


def read_json(path: Path | str) -> Any:
    """Read a JSON file.

    Raises:
        InputError: the file is missing or is not JSON.
    """
    path = existing(path)
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise bad_input(str(path), given=f"not JSON ({error})", allowed="a JSON file", do="Is it truncated?") from error


def write_npz(path: Path | str, kind: str, schema: int, **arrays: Any) -> None:
    """Write arrays atomically to a compressed .npz that names its kind and schema number."""
    with replacing(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, kind=kind, schema=schema, **{k: v for k, v in arrays.items() if v is not None})


def read_npz(path: Path | str, kind: str, schema: int) -> dict[str, NDArray[Any]]:
    """Read an .npz written by `write_npz`, without pickle.

    Raises:
        InputError: missing, truncated, of another kind, or of another schema number.
    """
    path = existing(path)
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise bad_input(
            str(path), given=f"unreadable ({error})", allowed=f"an .npz holding a {kind}", do="Is it truncated?"
        ) from error
    found = (str(arrays.pop("kind", "")), int(arrays.pop("schema", -1)))
    if found != (kind, schema):
        raise bad_input(
            str(path),
            given=f"kind '{found[0]}', schema {found[1]}",
            allowed=f"kind '{kind}', schema {schema}",
            do="Write it again with this version of Anther.",
        )
    return arrays


def existing(path: Path | str) -> Path:
    """Return the path as `Path` if it exists.

    Raises:
        InputError: there is no such file or folder.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder. Check the path; the current folder is {Path.cwd()}.")
    return path


def _plain(value: Any) -> Any:
    converters: list[tuple[type | tuple[type, ...], Callable[[Any], Any]]] = [
        (dict, lambda v: {str(k): _plain(x) for k, x in v.items()}),
        ((list, tuple), lambda v: [_plain(x) for x in v]),
        (np.ndarray, lambda v: _plain(v.tolist())),
        (np.generic, lambda v: _plain(v.item())),
        (float, lambda v: v if np.isfinite(v) else None),
        (Path, str),
    ]
    for kind, convert in converters:
        if isinstance(value, kind):
            return convert(value)
    return value
