"""Eight springs side by side: the buffer through which a loop over springs reaches the processor's vector units.

The buffer is flat; entry `row * LANES + lane` is one number of one spring. With a constant distance between rows the
compiler sees that lanes do not touch each other, and computes four or eight of them with one instruction.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from anther.elastic_rod._vectors import Vector, merged

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
