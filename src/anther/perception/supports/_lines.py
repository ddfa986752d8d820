"""Long straight lines through occupied cells. L lines, N points."""

from __future__ import annotations

import numpy as np

from anther.core.compiling import compiled, inlined
from anther.core.geometry import Array
from anther.perception.cloud._fusion import voxel_means


def straight_lines(points: Array, cell: float, shortest: float, gap: float) -> Array:
    """Return lines (L, 2, 3) through the points (N, 3), one a cell, the longest first.

    Random pairs of places are joined; what is occupied along nine tenths of the way is followed beyond both ends.

    Args:
        points: [m].
        cell: edge of a cell [m].
        shortest: of such a pair [m].
        gap: over which a line may be hidden [m].
    """
    rng = np.random.default_rng(0)
    pairs = 400_000  # drawn: a string with 0.5 % of them is hit ten times
    lower = points.min(axis=0) - 2 * cell
    ends = voxel_means(points - lower, 3 * cell)  # fewer on what is broad
    chosen = rng.integers(0, len(ends), (pairs, 2))
    place = np.floor((points - lower) / cell).astype(np.int64)
    grid = np.zeros(place.max(axis=0) + 3, dtype=bool)
    for step in (*np.eye(3, dtype=int), *-np.eye(3, dtype=int), np.zeros(3, dtype=int)):
        grid[tuple((place + step).T)] = True  # what touches a point's cell by a face too
    lines = np.empty((pairs, 2, 3))
    order = (np.arange(40) * 0.618) % 1  # evenly spread, whichever first few are taken
    found = _follow_pairs(ends / cell, chosen, grid, shortest / cell, int(gap / cell), order, lines, np.empty(3))
    lines = lines[:found]
    length = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    return lower + cell * lines[np.argsort(-length)]


@compiled
def _follow_pairs(points, chosen, grid, shortest, gap, order, lines, along):
    """Fill in lines (pairs, 2, 3) through pairs whose way is occupied, and return how many; lengths in cells."""
    found = 0
    for i, j in chosen:
        a, length = points[i], 0.0
        for n in range(3):
            along[n] = points[j, n] - a[n]
            length += along[n] ** 2
        length = np.sqrt(length)
        if length < shortest:
            continue
        for n in range(3):
            along[n] /= length
        missed, looked = 0, 0
        while looked < len(order) and missed <= 0.15 * len(order):
            missed += not _occupied(grid, a, along, order[looked] * length)
            looked += 1
            if looked <= 6 and missed > 1:
                break
        if looked < len(order) or missed > 0.15 * len(order):
            continue
        for end, begin, way in ((0, 0.0, -1.0), (1, length, 1.0)):
            reach, hidden, step = begin, 0, begin
            while hidden <= gap:
                step += way
                if _occupied(grid, a, along, step):
                    reach, hidden = step, 0
                else:
                    hidden += 1
            for n in range(3):
                lines[found, end, n] = a[n] + reach * along[n]
        found += 1
    return found


@inlined
def _occupied(grid, start, along, at):
    x, y, z = start[0] + at * along[0], start[1] + at * along[1], start[2] + at * along[2]
    if x < 0 or y < 0 or z < 0 or x >= grid.shape[0] or y >= grid.shape[1] or z >= grid.shape[2]:
        return False
    return grid[np.int64(x), np.int64(y), np.int64(z)]
