"""The cloud's cross-section at every node: where its middle is, how thick and how broad. J nodes, N points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array
from anther.skeleton._nearby import nearest

_ENOUGH = 200
"""More points than this do not make a cross-section better."""


@dataclass(frozen=True, slots=True, eq=False)
class CrossSections:
    """What the points around each node look like, seen along its tangent.

    Attributes:
        count: (J,) points looked at.
        centre: (J, 3) step from the node to the centre of the fitted circle [m].
        circle: (J,) radius of the circle [m].
        residual: (J,) median distance of the points from the circle [m].
        surface: (J,) median distance of the points from the node [m].
        thin, wide: (J,) half extents along the minor and the major axis [m]; of a circle both are its radius.
    """

    count: NDArray[Any]
    centre: Array
    circle: Array
    residual: Array
    surface: Array
    thin: Array
    wide: Array


def cross_sections(points: Array, nodes: Array, tangent: Array, before: NDArray[Any]) -> CrossSections:
    """Return the cross-section of the points that lie nearest to each node, or to its neighbours along the chain.

    Args:
        points: (N, 3) the cloud [m].
        nodes: (J, 3) [m].
        tangent: (J, 3) unit vectors.
        before: (J,) the node before each on the same chain; -1 at the chain's first.
    """
    after = np.full(len(nodes), -1)
    after[before[before >= 0]] = np.flatnonzero(before >= 0)
    _, owner = nearest(points, nodes)
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(len(nodes) + 1))
    around = np.stack([before, np.arange(len(nodes)), after], axis=1)
    count, table = _sections(points[order], start, nodes, tangent, around)
    return CrossSections(count, table[:, :3], *table[:, 3:].T)


@numba.njit(cache=True, nogil=True)
def _sections(points, start, nodes, tangent, around):
    """Return (J,) counts and (J, 8) rows of `CrossSections`; node j owns the points start[j] to start[j + 1]."""
    counts, out = np.zeros(len(nodes), np.int64), np.zeros((len(nodes), 8))
    flat, away = np.empty((2 * _ENOUGH, 2)), np.empty(2 * _ENOUGH)
    for j in range(len(nodes)):
        total = 0
        for k in around[j]:
            total += start[k + 1] - start[k] if k >= 0 else 0
        step, seen, count = -(-total // _ENOUGH) if total else 1, 0, 0
        one, two = _across(tangent[j])
        for k in around[j]:
            if k < 0:
                continue
            for m in range(start[k], start[k + 1]):
                if seen % step == 0:
                    offset = points[m] - nodes[j]
                    flat[count, 0], flat[count, 1] = offset @ one, offset @ two
                    count += 1
                seen += 1
        counts[j] = count
        if count >= 3:
            x, y, r, residual = _circle(flat[:count], away)
            out[j, :3] = x * one + y * two
            out[j, 3], out[j, 4] = r, residual
            out[j, 5], out[j, 6], out[j, 7] = _extents(flat[:count], away)
    return counts, out


@numba.njit(cache=True, nogil=True)
def _across(tangent):
    """Return two unit vectors across a unit tangent."""
    helper = np.zeros(3)
    helper[np.argmin(np.abs(tangent))] = 1
    one = np.cross(tangent, helper)
    one /= max(np.sqrt(one @ one), 1e-12)
    return one, np.cross(tangent, one)


@numba.njit(cache=True, nogil=True)
def _circle(flat, away):
    """Return (x, y, radius, median residual) of the circle through (M, 2) points (Kasa 1976), trimmed once."""
    limit, x, y, r, residual = np.inf, 0.0, 0.0, 0.0, 0.0
    for _ in range(2):
        matrix, right = np.zeros((3, 3)), np.zeros(3)
        for m in range(len(flat)):
            if limit == np.inf or away[m] <= limit:
                row = np.array((2 * flat[m, 0], 2 * flat[m, 1], 1.0))
                square = flat[m, 0] ** 2 + flat[m, 1] ** 2
                for a in range(3):
                    right[a] += row[a] * square
                    for b in range(3):
                        matrix[a, b] += row[a] * row[b]
        size = matrix[0, 0] + matrix[1, 1]
        matrix[0, 0] += 1e-9 * size + 1e-30
        matrix[1, 1] += 1e-9 * size + 1e-30
        x, y, c = np.linalg.solve(matrix, right)
        r = np.sqrt(max(c + x * x + y * y, 0))
        for m in range(len(flat)):
            away[m] = abs(np.sqrt((flat[m, 0] - x) ** 2 + (flat[m, 1] - y) ** 2) - r)
        residual = np.median(away[: len(flat)])
        limit = 2.5 * residual
    return x, y, r, residual


@numba.njit(cache=True, nogil=True)
def _extents(flat, away):
    """Return (surface, thin, wide) of (M, 2) points about the node; on a circle, median |x| is r / sqrt(2)."""
    n = len(flat)
    for m in range(n):
        away[m] = np.sqrt(flat[m, 0] ** 2 + flat[m, 1] ** 2)
    surface = np.median(away[:n])
    xx = xy = yy = 0.0
    for m in range(n):
        if away[m] <= 2.5 * surface:
            xx, xy, yy = xx + flat[m, 0] ** 2, xy + flat[m, 0] * flat[m, 1], yy + flat[m, 1] ** 2
    turn = 0.5 * np.arctan2(2 * xy, xx - yy)
    c, s = np.cos(turn), np.sin(turn)
    for m in range(n):
        away[m] = abs(c * flat[m, 0] + s * flat[m, 1])
    one = np.median(away[:n])
    for m in range(n):
        away[m] = abs(c * flat[m, 1] - s * flat[m, 0])
    two = np.median(away[:n])
    return surface, np.sqrt(2.0) * min(one, two), np.sqrt(2.0) * max(one, two)
