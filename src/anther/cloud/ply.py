"""PLY files: writing ours, reading anybody's vertices, and edges. N points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.recfunctions import unstructured_to_structured
from numpy.typing import NDArray

from anther.errors import bad_input
from anther.files import LARGEST, LARGEST_TEXT, replacing, whole_file
from anther.geometry import Array

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_PROPERTIES = {"f8": "double", "f4": "float", "u1": "uchar"}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 64_000


def write_ply(
    path: Path | str,
    points: Array,
    *,
    normals: Array | None = None,
    colors: NDArray[Any] | None = None,
    labels: NDArray[Any] | None = None,
) -> None:
    """Write points as binary little-endian PLY, atomically.

    Args:
        path: file to write.
        points: (N, 3), written as double x, y, z.
        normals: (N, 3), as float nx, ny, nz.
        colors: (N, 3) uint8, as uchar red, green, blue.
        labels: (N,) uint8, as uchar label.
    """
    columns: list[tuple[tuple[str, ...], str, NDArray[Any] | None]] = [
        (("x", "y", "z"), "f8", points),
        (("nx", "ny", "nz"), "f4", normals),
        (("red", "green", "blue"), "u1", colors),
        (("label",), "u1", None if labels is None else labels[:, None]),
    ]
    given = [(names, kind, values) for names, kind, values in columns if values is not None]
    dtype = np.dtype([(name, "<" + kind) for names, kind, _ in given for name in names])
    table = np.zeros(len(points), dtype=dtype)
    for names, _, values in given:
        for axis, name in enumerate(names):
            table[name] = values[:, axis]
    properties = [f"property {_PROPERTIES[kind]} {name}" for names, kind, _ in given for name in names]
    header = ["ply", "format binary_little_endian 1.0", "comment Anther cloud, metres, z up"]
    header += [f"element vertex {len(points)}", *properties, "end_header", ""]
    with replacing(path) as temporary:
        temporary.write_bytes("\n".join(header).encode("ascii") + table.tobytes())


def read_ply(path: Path | str) -> dict[str, Any]:
    """Return a PLY's vertices: points (N, 3), and normals, colors, labels where it has them.

    Raises:
        InputError: the file is missing, truncated, or not a PLY with vertices x, y, z.
    """
    table = read_elements(path)["vertex"]
    names = table.dtype.names or ()

    def columns(*wanted: str) -> NDArray[Any] | None:
        return np.stack([table[n] for n in wanted], axis=1) if all(n in names for n in wanted) else None

    points, colors = columns("x", "y", "z"), columns("red", "green", "blue")
    if points is None:
        raise bad_input(str(path), given=f"vertex properties {names}", allowed="x, y, z and others", do="Export again.")
    return {
        "points": points.astype(np.float64),
        "normals": columns("nx", "ny", "nz"),
        "colors": None if colors is None or colors.dtype != np.uint8 else colors,
        "labels": table["label"].astype(np.uint8) if "label" in names else None,
    }


def read_elements(path: Path | str) -> dict[str, NDArray[Any]]:
    """Return the elements of a PLY by name, as structured arrays, up to the first that has lists: faces.

    Raises:
        InputError: the file is missing, truncated, not a PLY, or its first element is not "vertex" without lists.
    """
    path = Path(path)
    with whole_file(path).open("rb") as stream:
        ascii_text = b"ascii" in stream.read(64)
    data = whole_file(path, LARGEST_TEXT if ascii_text else LARGEST).read_bytes()
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise bad_input(str(path), given="unreadable (no PLY header)", allowed="a PLY file", do="Is it truncated?")
    try:
        order, kinds = _header(data[:end].decode("ascii", "replace").split("\n"))
        return _ascii(data[data.find(b"\n", end) + 1 :], kinds) if order == "" else _binary(data, end, kinds)
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise bad_input(
            str(path), given=f"unreadable ({error})", allowed="vertices as the first element, scalar properties",
            do="Is it truncated? Export it again.",
        ) from error  # fmt: skip


_Kinds = dict[str, tuple[int, np.dtype[Any]]]
"""Name of an element -> how many there are, and their type."""


def _ascii(body: bytes, kinds: _Kinds) -> dict[str, NDArray[Any]]:
    lines, at, found = body.decode("ascii").splitlines(), 0, {}
    for name, (count, dtype) in kinds.items():
        rows = lines[at : at + count]
        if len(rows) < count:
            raise ValueError(f"{len(rows)} of {count} rows of {name}")
        table = np.loadtxt(rows, ndmin=2) if rows else np.zeros((0, len(dtype.names or ())))
        found[name], at = unstructured_to_structured(table, dtype), at + count
    return found


def _binary(data: bytes, end: int, kinds: _Kinds) -> dict[str, NDArray[Any]]:
    at, found = data.find(b"\n", end) + 1, {}
    for name, (count, dtype) in kinds.items():
        if len(data) < at + count * dtype.itemsize:
            raise ValueError(f"less than {count} rows of {name}")
        found[name], at = np.frombuffer(data, dtype, count, at), at + count * dtype.itemsize
    return found


def _header(lines: list[str]) -> tuple[str, _Kinds]:
    """Return the byte order ("" for ascii), and the elements before the first with lists."""
    words = [line.split() for line in lines]
    order = _FORMATS[next((w[1] for w in words if w[:1] == ["format"]), "none stated")]
    starts = [i for i, w in enumerate(words) if w[:1] == ["element"]]
    kinds: _Kinds = {}
    for start, stop in zip(starts, [*starts[1:], len(words)], strict=True):
        properties = [w for w in words[start:stop] if w[:1] == ["property"]]
        if any(w[1] == "list" for w in properties):
            break
        count = int(words[start][2])
        if count < 0:
            raise ValueError(f"{count} of {words[start][1]}")
        kinds[words[start][1]] = count, np.dtype([(w[2], (order or "<") + _TYPES[w[1]]) for w in properties])
    if next(iter(kinds), None) != "vertex":
        raise ValueError("its first element is not 'vertex'")
    return order, kinds
