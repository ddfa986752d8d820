"""PLY files: writing ours, reading anybody's vertices and edges, also behind or with lists. N points.

And what colours are, in whatever type and under whatever names a file keeps them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.recfunctions import unstructured_to_structured
from numpy.typing import NDArray

from anther.core.compiling import numba
from anther.core.errors import bad_input
from anther.core.files import LARGEST, LARGEST_TEXT, replacing, whole_file
from anther.core.geometry import Array

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_PROPERTIES = {"f8": "double", "f4": "float", "u1": "uchar"}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


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
    """Return a PLY's vertices: points (N, 3), normals, colors, labels where it has them; unused properties, comments.

    Raises:
        InputError: the file is missing, truncated, or not a PLY with vertices x, y, z.
    """
    elements, lists, comments = _read(Path(path), ("vertex",))
    table = elements["vertex"]
    names = {name.lower(): name for name in reversed(table.dtype.names or ())}

    def columns(*wanted: str) -> NDArray[Any] | None:
        return np.stack([table[names[n]] for n in wanted], axis=1) if all(n in names for n in wanted) else None

    points = columns("x", "y", "z")
    if points is None:
        given = f"vertex properties {table.dtype.names}"
        raise bad_input(str(path), given=given, allowed="x, y, z and others", do="Export again.")
    colors, taken = find_colors(list(names), lambda name: table[names[name]])
    known = {*"xyz", "nx", "ny", "nz", "label", "alpha", *taken}
    return {
        "points": points.astype(np.float64),
        "normals": columns("nx", "ny", "nz"),
        "colors": colors,
        "labels": table[names["label"]].astype(np.uint8) if "label" in names else None,
        "comments": comments,
        "unused": (*(own for name, own in names.items() if name not in known), *lists.get("vertex", ())),
    }


_COLOR = re.compile(r"(?:colou?rs?|diffuse|rgb)?[ _.:]*(?:(r|red|0)|(g|green|1)|(b|blue|2))(?:f|8|16)?")


def find_colors(
    names: Sequence[str], column: Callable[[str], NDArray[Any]]
) -> tuple[NDArray[np.uint8] | None, tuple[str, ...]]:
    """Return the colours (N, 3) among named columns, and which these are; None and () if there are none.

    They are called red, r, diffuse_red, Rf, color_r, rgb:0 ...; packed into one `rgb` or `rgba`; or f_dc_0 to 2.

    Args:
        names: of all columns, in lower case.
        column: returns the values (N,) of one.
    """
    splat = tuple(f"f_dc_{k}" for k in range(3))
    if set(splat) <= set(names):
        harmonic = 0.5 / np.sqrt(np.pi) * np.stack([column(n) for n in splat], axis=1)  # a Gaussian splat's first
        return color_bytes(np.clip(0.5 + harmonic, 0, 1)), splat
    found = [(match, name) for name in names if (match := _COLOR.fullmatch(name)) and not name.isdigit()]
    each = [[name for match, name in found if match[k]] for k in (1, 2, 3)]
    if all(each):
        chosen = tuple(min(some, key=len) for some in each)
        return color_bytes(np.stack([column(name) for name in chosen], axis=1)), chosen
    packed = next((name for name in ("rgb", "rgba") if name in names), None)
    return (None, ()) if packed is None else (_unpacked(column(packed)), (packed,))


def color_bytes(values: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Return colours (N, 3) as bytes: they are bytes, of 16 bits, or from 0 to 1; None if they are nothing of these."""
    if values.dtype == np.uint8:
        return values
    numbers = np.nan_to_num(values.astype(np.float64))
    largest = float(numbers.max(initial=0))
    if float(numbers.min(initial=0)) < 0 or largest > 65535:
        return None
    shares = largest <= 1 and values.dtype.kind == "f"
    return np.round(numbers * (255 if shares else 1 if largest <= 255 else 1 / 257)).astype(np.uint8)


def _unpacked(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return (N, 3) of PCL's packed field: 0xAARRGGBB, often stored in the bits of a float; or written as a number."""
    as_bits = values.dtype.kind == "f" and not float(np.nan_to_num(values).max(initial=0)) >= 1
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32) if as_bits else values.astype(np.int64)
    return np.stack([(bits >> shift) & 255 for shift in (16, 8, 0)], axis=1).astype(np.uint8)


def read_elements(path: Path | str, wanted: Sequence[str] = ("vertex", "edge")) -> dict[str, NDArray[Any]]:
    """Return the wanted elements of a PLY by name, as structured arrays; what are lists in them is left out.

    Raises:
        InputError: the file is missing, truncated, not a PLY, or without an element "vertex".
    """
    return _read(Path(path), wanted)[0]


class _Element(NamedTuple):
    """An element of a PLY: how many there are, and its properties: name -> (type of a list's count or "", type)."""

    rows: int
    properties: dict[str, tuple[str, str]]

    @property
    def lists(self) -> tuple[str, ...]:
        return tuple(name for name, (counts, _) in self.properties.items() if counts)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of its single values."""
        return np.dtype([(name, kind) for name, (counts, kind) in self.properties.items() if not counts])


def _read(
    path: Path, wanted: Sequence[str]
) -> tuple[dict[str, NDArray[Any]], dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Return the wanted elements, which of their properties are lists, and the comments of the head."""
    with whole_file(path).open("rb") as stream:
        ascii_text = b"ascii" in stream.read(64)
    data = whole_file(path, LARGEST_TEXT if ascii_text else LARGEST).read_bytes()
    end = data.find(b"end_header", 0, 64_000)  # a longer head is none
    if not data.startswith(b"ply") or end < 0:
        raise bad_input(str(path), given="unreadable (no PLY header)", allowed="a PLY file", do="Is it truncated?")
    try:
        head = data[:end].decode("utf-8", "replace").splitlines()
        order, elements = _header(head)
        if "vertex" not in elements:
            raise ValueError(f"it has no element 'vertex', only {', '.join(elements) or 'none'}")
        last = max(i for i, name in enumerate(elements) if name in wanted)
        needed = dict(list(elements.items())[: last + 1])
        body = data.find(b"\n", end) + 1 or data.find(b"\r", end) + 1
        found = _ascii(data[body:], needed) if order == "" else _binary(data, body, needed)
        comments = tuple(line for line in head if line.startswith(("comment", "obj_info")))
        return {n: found[n] for n in wanted if n in found}, {n: e.lists for n, e in needed.items()}, comments
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise bad_input(
            str(path), given=f"unreadable ({error})", allowed="an element 'vertex' with x, y, z",
            do="Is it truncated? Export it again.",
        ) from error  # fmt: skip


def _ascii(body: bytes, elements: dict[str, _Element]) -> dict[str, NDArray[Any]]:
    lines, at, found = [line for line in body.decode("ascii").splitlines() if line.strip()], 0, {}
    for name, element in elements.items():
        rows, at = lines[at : at + element.rows], at + element.rows
        if len(rows) < element.rows:
            raise ValueError(f"{len(rows)} of {element.rows} rows of {name}")
        rows = [_without_lists(row, element) for row in rows] if element.lists else rows
        width = len(element.dtype.names or ())
        table = np.loadtxt(rows, ndmin=2, comments=None) if rows and width else np.zeros((len(rows), width))
        found[name] = unstructured_to_structured(table, element.dtype) if width else np.zeros(len(rows), [])
    return found


def _without_lists(row: str, element: _Element) -> str:
    words, at, kept = row.split(), 0, []
    for counts, _ in element.properties.values():
        if not counts:
            kept.append(words[at])
        at += 1 + (int(words[at]) if counts else 0)
    return " ".join(kept)


def _binary(data: bytes, at: int, elements: dict[str, _Element]) -> dict[str, NDArray[Any]]:
    found, whole = {}, np.frombuffer(data, np.uint8)
    for name, element in elements.items():
        dtype = element.dtype
        if not element.lists:
            if len(data) < at + element.rows * dtype.itemsize:
                raise ValueError(f"less than {element.rows} rows of {name}")
            found[name], at = np.frombuffer(data, dtype, element.rows, at), at + element.rows * dtype.itemsize
            continue
        sizes = np.array(
            [[np.dtype(c).itemsize if c else 0, np.dtype(k).itemsize] for c, k in element.properties.values()]
        )
        big = any(c.startswith(">") for c, _ in element.properties.values() if c)
        if element.rows * int(np.where(sizes[:, 0], sizes[:, 0], sizes[:, 1]).sum()) > len(data) - at:
            raise ValueError(f"less than {element.rows} rows of {name}")
        starts, at = _starts(whole, at, element.rows, sizes, big)
        if at > len(data):
            raise ValueError(f"less than {element.rows} rows of {name}")
        table = np.zeros(element.rows, dtype)
        for k, (field, (counts, kind)) in enumerate(element.properties.items()):
            if not counts:
                places = starts[:, k : k + 1] + np.arange(np.dtype(kind).itemsize)
                table[field] = whole[places].view(kind)[:, 0]
        found[name] = table
    return found


@numba.njit(cache=True)
def _starts(data: Any, at: int, count: int, sizes: Any, big: bool) -> Any:
    """Return where each of (count, properties) begins in the bytes, and where the last ends.

    Args:
        data: (B,) the file's bytes.
        at: where the element begins.
        count: of the element.
        sizes: (properties, 2) bytes of a list's count, 0 where it is no list, and of a value.
        big: whether the first byte of a number is its greatest.
    """
    starts = np.zeros((count, len(sizes)), np.int64)
    for row in range(count):
        for k in range(len(sizes)):
            starts[row, k] = at
            many = 1
            if sizes[k, 0] > 0:
                many = 0
                if at + sizes[k, 0] > len(data):
                    return starts, len(data) + 1
                for byte in range(sizes[k, 0]):
                    many |= int(data[at + byte]) << (8 * (sizes[k, 0] - 1 - byte if big else byte))
                at += sizes[k, 0]
            at += many * sizes[k, 1]
            if at > len(data):
                return starts, len(data) + 1
    return starts, at


def _header(lines: list[str]) -> tuple[str, dict[str, _Element]]:
    """Return the byte order ("" for ascii) and the elements."""
    words = [line.split() for line in lines]
    order = _FORMATS[next((w[1] for w in words if w[:1] == ["format"]), "none stated")]
    starts = [i for i, w in enumerate(words) if w[:1] == ["element"]]
    elements: dict[str, _Element] = {}
    for start, stop in zip(starts, [*starts[1:], len(words)], strict=True):
        properties = {}
        for w in (w for w in words[start:stop] if w[:1] == ["property"]):
            counts, kind, name = w[2:5] if w[1] == "list" else ("", *w[1:3])
            many = _TYPES[counts] if counts else ""
            if many[:1] == "f" or name in properties:
                raise ValueError(f"a list of {counts} values" if many[:1] == "f" else f"two properties '{name}'")
            properties[name] = (many and (order or "<") + many, (order or "<") + _TYPES[kind])
        count = int(words[start][2])
        if count < 0:
            raise ValueError(f"{count} of {words[start][1]}")
        elements[words[start][1]] = _Element(count, properties)
    return order, elements
