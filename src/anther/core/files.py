"""Files that are never half-written: write to a temporary name, then rename."""

from __future__ import annotations

import codecs
import csv
import errno
import json
import math
import os
import re
import secrets
import struct
import zipfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import InputError, bad_input

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
    try:
        return json.loads(read_text(path, LARGEST_TEXT // 4), parse_int=_integer)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise bad_input(str(path), given=f"not JSON ({error})", allowed="a JSON file", do="Is it truncated?") from error


_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
)  # fmt: skip
_WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""How .xlsx, .ods and .zip begin, and how .xls does."""
_CONTROLS = re.compile("[\x00-\x08\x0e-\x1f]")


def read_text(path: Path | str, largest: int = LARGEST_TEXT) -> str:
    """Return a text as people's programs write it: UTF-8 or UTF-16, with or without its mark, or Windows' cp1252.

    Raises:
        InputError: the file is missing, larger than `largest` [bytes], or no text.
    """
    data = whole_file(path, largest).read_bytes()
    if data.startswith(_WORKBOOKS):
        given, do = "a workbook or an archive, no text", "Save it from the spreadsheet as CSV, or unpack it."
        raise bad_input(str(path), given=given, allowed="a text file, such as a CSV file", do=do)
    wide = "utf-16-le" if data[1:2] == b"\0" else "utf-16-be"  # of a text that begins with ASCII
    unmarked = [wide] if data[:2].count(0) == 1 else ["utf-8", "cp1252"]
    reasons = []
    for encoding in next(([name] for mark, name in _MARKS if data.startswith(mark)), unmarked):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError as error:
            reasons.append(str(error))
            continue
        if encoding == "utf-8" or not _CONTROLS.search(text):
            return text
    given, allowed = f"unreadable, no text ({' '.join(reasons) or 'control characters'})", "a text file, such as a CSV"
    raise bad_input(str(path), given=given, allowed=f"{allowed} file, UTF-8", do="Export it again.")


def read_lines(path: Path | str) -> list[str]:
    """Read the lines of a text, see `read_text`."""
    return read_text(path).splitlines()


class Row(NamedTuple):
    """The cells of a table's row, and the number of its line from 1 on."""

    line: int
    cells: list[str]


_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_FAULT = re.compile(r"#(?:[A-ZÄÖÜ/0]+[!?]?|#+)\s*[,;\t]")
"""A row whose first cell is a spreadsheet's #DIV/0!, #REF! or ####, which is no comment."""
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")


def read_rows(path: Path | str, *, comment: str | None = "#") -> list[Row]:
    """Read a table as a spreadsheet saves it; the first row names the columns.

    Cells are separated by what a first line `sep=;` says, else by tabs or semicolons where the first row has some, else
    by commas. Numbers get a decimal point where tabs or semicolons separate (`number` does it where cells are quoted).
    Rows with nothing in them, and cells at the end of a row that belong to no column and hold nothing, are left out.

    Args:
        path: the file.
        comment: how lines begin that are left out too; None: there are none.

    Raises:
        InputError: the file is missing or no text; a quote is not closed; quoted numbers may be decimals or thousands.
    """
    lines = [(n, line) for n, line in enumerate(read_lines(path), 1) if line.strip()]
    lines = [
        (n, line) for n, line in lines if comment is None or not line.lstrip().startswith(comment) or _FAULT.match(line)
    ]
    said = re.fullmatch(r'"?sep=(.)"?\s*', lines[0][1], re.IGNORECASE) if lines else None
    lines = lines[1:] if said else lines
    if not lines:
        return []
    separator = said[1] if said else next((mark for mark in "\t;" if mark in lines[0][1]), ",")
    reader = csv.reader((f"{line}\n" for _, line in lines), delimiter=separator, skipinitialspace=True, strict=True)
    rows = []
    try:
        for cells in reader:
            rows.append(Row(lines[reader.line_num - 1][0], [cell.strip() for cell in cells]))
    except csv.Error as error:
        at = f"{path}, line {lines[reader.line_num - 1][0]}"
        raise bad_input(at, given=str(error), allowed="a row of cells", do="Mend it, or export it again.") from error
    return _tidied(path, [row for row in rows if any(row.cells)], separator)


def _tidied(path: Path | str, rows: list[Row], separator: str) -> list[Row]:
    """Return rows without empty cells behind the last named column, decimal commas turned into points."""
    width = max((i for i, cell in enumerate(rows[0].cells, 1) if cell), default=0) if rows else 0
    for row in rows:
        while len(row.cells) > width and not row.cells[-1]:
            row.cells.pop()
    numbers = [(row.line, cell) for row in rows[1:] for cell in row.cells if _DECIMAL_COMMA.fullmatch(cell)]
    if separator != ",":
        return [Row(line, [_point(cell) for cell in cells]) for line, cells in rows]
    if numbers and all(_THOUSANDS.fullmatch(cell) for _, cell in numbers):
        line, cell = numbers[0]
        do = "Separate the columns by semicolons if it is a decimal comma; leave the comma out if it is for thousands."
        raise bad_input(f"{path}, line {line}", given=f"'{cell}'", allowed="a decimal point", do=do)
    return rows


def _point(cell: str) -> str:
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell


def number(cell: str) -> float | None:
    """Return the finite number in a table's cell, which may have a decimal comma; None if it holds none."""
    try:
        value = float(_point(cell))
    except ValueError:
        return None
    return value if math.isfinite(value) and "_" not in cell else None


def named_file(folder: Path, name: str) -> Path:
    """Return the file in a folder that another file names, perhaps as Windows or another machine does.

    There backslashes separate folders, upper and lower case are one, and a path may begin at a disk that is not here:
    then it is sought by its last parts. Without its suffix a PNG or JPEG is meant.
    """
    path = folder / name
    if _exists(path):
        return path
    parts = [part for part in re.split(r"[\\/]+", name) if part not in ("", ".")]
    elsewhere = re.match(r"[\\/]|[A-Za-z]:", name) is not None
    tails = (_alike(folder, parts[k:]) for k in range(len(parts) if elsewhere else 1))
    return next((found for found in tails if found is not None), path)


def _exists(path: Path) -> bool:
    return os.path.exists(path)  # noqa: PTH110 - Path raises of a name that is too long for a disk


def _alike(folder: Path, parts: list[str]) -> Path | None:
    """Return what lies in a folder under these names, of whatever case; None if it is not there, or twice."""
    for part in parts:
        if _exists(folder / part):
            folder = folder / part
            continue
        names = [part.lower() + suffix for suffix in ("", *([] if part != parts[-1] else (".png", ".jpg", ".jpeg")))]
        found = [other for other in folder.iterdir() if other.name.lower() in names] if folder.is_dir() else []
        if len(found) != 1:
            return None
        folder = found[0]
    return folder if parts else None


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
