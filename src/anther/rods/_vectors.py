"""Compiled arithmetic on tuples of three floats, parallel transport, and eight numbers side by side.

Lanes are the flat buffer through which a loop over springs reaches the processor's vector units: entry
`row * LANES + lane` is one number of one spring. With a constant distance between rows the compiler sees that lanes do
not touch each other, and computes four or eight of them with one instruction.
"""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

from numba.extending import register_jitable

from anther.core import compiling
from anther.core.compiling import numba


def _drop_stale_kernels() -> None:
    """Delete compiled kernels older than any source file here.

    Numba looks only at the file of the kernel itself, so that an edit to a kernel it calls would go unnoticed.
    """
    folder = Path(__file__).parent
    newest = max(file.stat().st_mtime for file in folder.glob("*.py"))
    for kernel in (folder / "__pycache__").glob("*.nb[ci]"):
        with suppress(OSError):
            if kernel.stat().st_mtime < newest:
                kernel.unlink()


_drop_stale_kernels()

OPTIONS: dict[str, Any] = compiling.OPTIONS | {"fastmath": {"contract", "reassoc", "arcp", "nsz"}}
"""How kernels are compiled here: sums may be reordered and fused, NaN and infinity keep their meaning."""

compiled: Any = numba.njit(**OPTIONS)
"""As `core.compiling.compiled`, with these options."""

merged: Any = register_jitable(forceinline=True, **OPTIONS)
"""For a part of a kernel: it becomes one with its caller, so that the compiler can vectorise the caller's loop."""

inner: Any = register_jitable(**OPTIONS)
"""For a part of several kernels that is too long to be merged with each."""

inlined: Any = numba.njit(inline="always", **OPTIONS)
"""For a part of a kernel that stands in few places: it is only ever compiled there."""

Vector = tuple[Any, Any, Any]

LANES = 8


@inlined
def load(array: Any, row: Any) -> Vector:
    """Return one row of an (N, 3) array."""
    return (array[row, 0], array[row, 1], array[row, 2])


@inlined
def peak(rows: Any) -> float:
    """Return the largest size of the first three numbers of all rows."""
    worst = 0.0
    for j in range(len(rows)):
        for i in range(3):
            size = abs(rows[j, i])
            worst = size if size > worst else worst
    return worst


@inlined
def apart(array: Any, row: Any, other: Any) -> Vector:
    """Return one row of an (N, 3) array less another one."""
    return (
        array[row, 0] - array[other, 0],
        array[row, 1] - array[other, 1],
        array[row, 2] - array[other, 2],
    )


@inlined
def six(array: Any, row: Any) -> Any:
    """Return one row of an (N, 6) array."""
    return (array[row, 0], array[row, 1], array[row, 2], array[row, 3], array[row, 4], array[row, 5])


@inlined
def halves(array: Any, row: Any) -> tuple[Vector, Vector]:
    """Return one row of an (N, 6) array as two vectors."""
    return (array[row, 0], array[row, 1], array[row, 2]), (array[row, 3], array[row, 4], array[row, 5])


@inlined
def store(array: Any, row: Any, v: Vector) -> None:
    """Write `v` into one row of an (N, 3) array."""
    array[row, 0], array[row, 1], array[row, 2] = v


@inlined
def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inlined
def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@inlined
def scale(s: float, a: Vector) -> Vector:
    """Return s a."""
    return (s * a[0], s * a[1], s * a[2])


@merged
def combine(s: float, a: Vector, t: float, b: Vector) -> Vector:
    """Return s a + t b."""
    return (s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2])


@inlined
def mix(u: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    """Return u_0 a + u_1 b + u_2 c."""
    return (
        u[0] * a[0] + u[1] * b[0] + u[2] * c[0],
        u[0] * a[1] + u[1] * b[1] + u[2] * c[1],
        u[0] * a[2] + u[1] * b[2] + u[2] * c[2],
    )


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@merged
def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inlined
def norm(a: Vector) -> float:
    """Return |a|."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@inlined
def transport(v: Vector, start: Vector, end: Vector) -> Vector:
    """Return `v` carried by the smallest rotation that takes the unit tangent `start` to the unit tangent `end`."""
    axis = cross(start, end)
    cosine = dot(start, end)
    carried = combine(cosine, v, 1.0, cross(axis, v))
    return combine(1.0, carried, dot(axis, v) / (1.0 + cosine), axis)


@inlined
def spin(director: Vector, tangent: Vector, turn: float) -> Vector:
    """Return a director turned by 2 atan(turn / 2) about the unit tangent (Cayley map), orthonormal to it again."""
    square = 0.25 * turn * turn
    cosine, sine = (1 - square) / (1 + square), turn / (1 + square)
    turned = combine(cosine, director, sine, cross(tangent, director))
    flat = combine(1.0, turned, -dot(turned, tangent), tangent)
    return scale(1.0 / norm(flat), flat)


@inlined
def twist_angle(sine: Any, cosine: Any, previous: Any) -> Any:
    """Return the twist [rad] with this sine and cosine, on the branch nearest to `previous`."""
    angle = math.atan2(sine, cosine)
    return angle + 2 * math.pi * math.floor((previous - angle) / (2 * math.pi) + 0.5)


@inlined
def filled(rows: Any, first: Any) -> Any:
    """Return how many lanes the rows from `first` on fill; `min` would be a kernel more to compile."""
    return LANES if rows - first > LANES else rows - first


@inlined
def get(buffer: Any, row: int, lane: int) -> Any:
    """Return one number."""
    return buffer[row * LANES + lane]


@inlined
def put(buffer: Any, row: int, lane: int, value: Any) -> None:
    """Write one number."""
    buffer[row * LANES + lane] = value


@inlined
def get3(buffer: Any, row: int, lane: int) -> Vector:
    """Return a vector from three rows."""
    return (buffer[row * LANES + lane], buffer[(row + 1) * LANES + lane], buffer[(row + 2) * LANES + lane])


@inlined
def get6(buffer: Any, row: int, lane: int) -> Any:
    """Return six numbers from six rows."""
    a, b = get3(buffer, row, lane), get3(buffer, row + 3, lane)
    return (a[0], a[1], a[2], b[0], b[1], b[2])


@inlined
def put3(buffer: Any, row: int, lane: int, v: Vector) -> None:
    """Write a vector to three rows."""
    buffer[row * LANES + lane] = v[0]
    buffer[(row + 1) * LANES + lane] = v[1]
    buffer[(row + 2) * LANES + lane] = v[2]


@inlined
def put6(buffer: Any, row: int, lane: int, s: Any) -> None:
    """Write six numbers, as the upper triangle of a symmetric 3x3 matrix by columns, to six rows."""
    put3(buffer, row, lane, (s[0], s[1], s[2]))
    put3(buffer, row + 3, lane, (s[3], s[4], s[5]))
