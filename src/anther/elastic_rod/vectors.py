"""Compiled 3-vector arithmetic on tuples of three floats, and the parallel transport of directors.

Eight springs side by side: the buffer through which a loop over springs reaches the processor's vector units.

The buffer is flat; entry `row * LANES + lane` is one number of one spring. With a constant distance between rows the
compiler sees that lanes do not touch each other, and computes four or eight of them with one instruction.
"""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
import numpy as np


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

OPTIONS = {"cache": True, "error_model": "numpy", "nogil": True, "fastmath": {"contract", "reassoc", "arcp", "nsz"}}
compiled: Any = numba.njit(**OPTIONS)
"""How a kernel is compiled: kept on disk, sums may be reordered and fused, NaN and infinity keep their meaning."""
merged: Any = numba.njit(forceinline=True, **OPTIONS)
"""For a part of a kernel: it becomes one with its caller, so that the compiler can vectorise the caller's loop."""

Vector = tuple[Any, Any, Any]


@merged
def load(array: Any, row: Any) -> Vector:
    """Return one row of an (N, 3) array."""
    return (array[row, 0], array[row, 1], array[row, 2])


@merged
def six(array: Any, row: Any) -> Any:
    """Return one row of an (N, 6) array."""
    return (array[row, 0], array[row, 1], array[row, 2], array[row, 3], array[row, 4], array[row, 5])


@merged
def halves(array: Any, row: Any) -> tuple[Vector, Vector]:
    """Return one row of an (N, 6) array as two vectors."""
    return (array[row, 0], array[row, 1], array[row, 2]), (array[row, 3], array[row, 4], array[row, 5])


@merged
def store(array: Any, row: Any, v: Vector) -> None:
    """Write `v` into one row of an (N, 3) array."""
    array[row, 0], array[row, 1], array[row, 2] = v


@merged
def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@merged
def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@merged
def scale(s: float, a: Vector) -> Vector:
    """Return s a."""
    return (s * a[0], s * a[1], s * a[2])


@merged
def combine(s: float, a: Vector, t: float, b: Vector) -> Vector:
    """Return s a + t b."""
    return (s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2])


@merged
def dot(a: Vector, b: Vector) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@merged
def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@merged
def norm(a: Vector) -> float:
    """Return |a|."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@merged
def transport(v: Vector, start: Vector, end: Vector) -> Vector:
    """Return `v` carried by the smallest rotation that takes the unit tangent `start` to the unit tangent `end`."""
    axis = cross(start, end)
    cosine = dot(start, end)
    carried = combine(cosine, v, 1.0, cross(axis, v))
    return combine(1.0, carried, dot(axis, v) / (1.0 + cosine), axis)


@merged
def spin(director: Vector, tangent: Vector, turn: float) -> Vector:
    """Return a director turned by 2 atan(turn / 2) about the unit tangent (Cayley map), orthonormal to it again."""
    square = 0.25 * turn * turn
    cosine, sine = (1 - square) / (1 + square), turn / (1 + square)
    turned = combine(cosine, director, sine, cross(tangent, director))
    flat = combine(1.0, turned, -dot(turned, tangent), tangent)
    return scale(1.0 / norm(flat), flat)


@merged
def twist_angle(sine: float, cosine: float, previous: float) -> float:
    """Return the twist [rad] with this sine and cosine, on the branch nearest to `previous`."""
    angle = math.atan2(sine, cosine)
    return angle + 2 * math.pi * math.floor((previous - angle) / (2 * math.pi) + 0.5)


LANES = 8

EDGE_M, EDGE_J, DIRECTOR_M, DIRECTOR_J, SPEED_M, SPEED_J = 0, 3, 6, 9, 12, 15  # three rows each
SPIN_M, SPIN_J, TWIST = 18, 19, 20
JOINT, VISCOUS, CURVATURE_1, CURVATURE_2, NATURAL_TWIST = 21, 27, 28, 29, 30  # JOINT has six rows
STRETCH, LENGTH, START_J = 31, 32, 33  # START_J has three rows
"""Input rows of a spring between edge m (o to m) and edge j (m to j): geometry, then material."""

FORCE_J, FORCE_M, FORCE_O, MOMENT_J, MOMENT_M = 36, 39, 42, 45, 46
JJ, MM, OO = 47, 53, 59  # symmetric: 00, 01, 11, 02, 12, 22
JM, JO, MO = 65, 74, 83  # nine rows each: rows of the first node, columns of the second
TURN_M_J, TURN_M_M, TURN_M_O, TURN_J_J, TURN_J_M, TURN_J_O = 92, 95, 98, 101, 104, 107  # spin against positions
TURN_MM, TURN_MJ, TURN_JJ = 110, 111, 112
ROWS = 113
"""Output rows: gradient and Hessian in the positions of nodes j, m, o and the spins of edges j, m."""

SINE, COSINE = 36, 37
"""Output rows for the twist: its sine and cosine."""

OLD_EDGE, NEW_EDGE, OLD_DIRECTOR, TURN, NEW_DIRECTOR = 0, 3, 6, 9, 10
"""Rows for moving the frame of an edge: four inputs, one output."""


def new_lanes() -> np.ndarray:
    """Return an empty buffer."""
    return np.zeros(ROWS * LANES)


@merged
def get(buffer: Any, row: int, lane: int) -> float:
    """Return one number."""
    return buffer[row * LANES + lane]


@merged
def put(buffer: Any, row: int, lane: int, value: float) -> None:
    """Write one number."""
    buffer[row * LANES + lane] = value


@merged
def get3(buffer: Any, row: int, lane: int) -> Vector:
    """Return a vector from three rows."""
    return (buffer[row * LANES + lane], buffer[(row + 1) * LANES + lane], buffer[(row + 2) * LANES + lane])


@merged
def get6(buffer: Any, row: int, lane: int) -> Any:
    """Return six numbers from six rows."""
    a, b = get3(buffer, row, lane), get3(buffer, row + 3, lane)
    return (a[0], a[1], a[2], b[0], b[1], b[2])


@merged
def put3(buffer: Any, row: int, lane: int, v: Vector) -> None:
    """Write a vector to three rows."""
    buffer[row * LANES + lane] = v[0]
    buffer[(row + 1) * LANES + lane] = v[1]
    buffer[(row + 2) * LANES + lane] = v[2]


@merged
def put6(buffer: Any, row: int, lane: int, s: Any) -> None:
    """Write six numbers, as the upper triangle of a symmetric 3x3 matrix by columns, to six rows."""
    put3(buffer, row, lane, (s[0], s[1], s[2]))
    put3(buffer, row + 3, lane, (s[3], s[4], s[5]))


@merged
def put9(buffer: Any, row: int, lane: int, rows: Any) -> None:
    """Write a 3x3 matrix, given by its rows, to nine rows."""
    put3(buffer, row, lane, rows[0])
    put3(buffer, row + 3, lane, rows[1])
    put3(buffer, row + 6, lane, rows[2])
