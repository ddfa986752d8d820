"""Compiled 3-vector arithmetic on tuples of three floats, and the parallel transport of directors."""

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
    for index in (folder / "__pycache__").glob("*.nbi"):
        with suppress(OSError):
            if index.stat().st_mtime < newest:
                index.unlink()


_drop_stale_kernels()

OPTIONS = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "arcp", "nsz"}}
compiled = numba.njit(**OPTIONS)
"""How every kernel is compiled: kept on disk, sums may be reordered and fused, NaN and infinity keep their meaning."""
merged = numba.njit(inline="always", **OPTIONS)
"""For a large kernel with one caller: compiled as a part of it, not twice."""

Vector = tuple[Any, Any, Any]


@compiled
def load(array: Any, row: int) -> Vector:
    """Return one row of an (N, 3) array."""
    return (array[row, 0], array[row, 1], array[row, 2])


@compiled
def store(array: Any, row: int, v: Vector) -> None:
    """Write `v` into one row of an (N, 3) array."""
    array[row, 0], array[row, 1], array[row, 2] = v


@compiled
def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@compiled
def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@compiled
def scale(s: float, a: Vector) -> Vector:
    """Return s a."""
    return (s * a[0], s * a[1], s * a[2])


@compiled
def combine(s: float, a: Vector, t: float, b: Vector) -> Vector:
    """Return s a + t b."""
    return (s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2])


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@compiled
def norm(a: Vector) -> float:
    """Return |a|."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@compiled
def transport(v: Vector, start: Vector, end: Vector) -> Vector:
    """Return `v` carried by the smallest rotation that takes the unit tangent `start` to the unit tangent `end`."""
    axis = cross(start, end)
    cosine = dot(start, end)
    carried = combine(cosine, v, 1.0, cross(axis, v))
    return combine(1.0, carried, dot(axis, v) / (1.0 + cosine), axis)


@compiled
def spin(director: Vector, tangent: Vector, angle: float) -> Vector:
    """Return a director turned by `angle` [rad] about the unit tangent, made orthonormal to it again."""
    turned = combine(math.cos(angle), director, math.sin(angle), cross(tangent, director))
    flat = combine(1.0, turned, -dot(turned, tangent), tangent)
    return scale(1.0 / norm(flat), flat)


@compiled
def twist_angle(m1e: Vector, m1f: Vector, te: Vector, tf: Vector, previous: float) -> float:
    """Return the twist [rad] from edge e to edge f, on the branch nearest to `previous`."""
    carried = transport(m1e, te, tf)
    angle = math.atan2(dot(cross(carried, m1f), tf), dot(carried, m1f))
    return angle + 2 * np.pi * round((previous - angle) / (2 * np.pi))
