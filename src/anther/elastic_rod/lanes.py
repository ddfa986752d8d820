"""Eight springs side by side: the buffer through which a loop over springs reaches the processor's vector units.

The buffer is flat; entry `row * LANES + lane` is one number of one spring. With a constant distance between rows the
compiler sees that lanes do not touch each other, and computes four or eight of them with one instruction.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from anther.elastic_rod.vectors import Vector, merged

LANES = 8

EDGE_M, EDGE_J, DIRECTOR_M, DIRECTOR_J, SPEED_M, SPEED_J = 0, 3, 6, 9, 12, 15  # three rows each
SPIN_M, SPIN_J, TWIST = 18, 19, 20
BEND_11, BEND_12, BEND_22, TORSION, VISCOUS, CURVATURE_1, CURVATURE_2, NATURAL_TWIST = range(21, 29)
STRETCH, LENGTH, STRETCH_VISCOUS, START_J = range(29, 33)
"""Input rows of a spring between edge m (o to m) and edge j (m to j): geometry, then material; START_J has three."""

FORCE_J, FORCE_M, FORCE_O, MOMENT_J, MOMENT_M = 35, 38, 41, 44, 45
JJ, MM, OO = 46, 52, 58  # symmetric: 00, 01, 11, 02, 12, 22
JM, JO, MO = 64, 73, 82  # nine rows each: rows of the first node, columns of the second
TURN_M_J, TURN_M_M, TURN_M_O, TURN_J_J, TURN_J_M, TURN_J_O = 91, 94, 97, 100, 103, 106  # spin against positions
TURN_MM, TURN_MJ, TURN_JJ = 109, 110, 111
ROWS = 112
"""Output rows: gradient and Hessian in the positions of nodes j, m, o and the spins of edges j, m."""

SINE, COSINE = 35, 36
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
def put3(buffer: Any, row: int, lane: int, v: Vector) -> None:
    """Write a vector to three rows."""
    buffer[row * LANES + lane] = v[0]
    buffer[(row + 1) * LANES + lane] = v[1]
    buffer[(row + 2) * LANES + lane] = v[2]


@merged
def put6(buffer: Any, row: int, lane: int, s: Any) -> None:
    """Write a symmetric 3x3 matrix, its upper triangle by columns, to six rows."""
    put3(buffer, row, lane, (s[0], s[1], s[2]))
    put3(buffer, row + 3, lane, (s[3], s[4], s[5]))


@merged
def put9(buffer: Any, row: int, lane: int, rows: Any) -> None:
    """Write a 3x3 matrix, given by its rows, to nine rows."""
    put3(buffer, row, lane, rows[0])
    put3(buffer, row + 3, lane, rows[1])
    put3(buffer, row + 6, lane, rows[2])
