"""Stakes and strings beside a plant: long straight upright lines of cells that are not green. X x Y x Z cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.masks._components import cells_of, dilated

LENGTH = 0.20
"""Least length of a stake [m]."""

COVERED = 0.6
"""Least share of the heights along a stake at which it is seen."""

_TRIALS, _TAN_TILT, _RADIUS = 400, 0.35, 1.3  # lines tried, tangent of the greatest tilt, half width [cells]
_MOST = 4  # stakes and strings looked for


def stake_cells(bare: NDArray[np.bool_], voxel: float) -> NDArray[np.bool_]:
    """Return the cells (X, Y, Z) in and beside a stake or string, from `bare` ones: seen, above ground, not green.

    Lines through random pairs of cells, that through most heights is kept (RANSAC, Fischler and Bolles 1981).
    """
    cells, found = cells_of(bare).astype(np.float64), np.zeros_like(bare)
    rng = np.random.default_rng(0)
    for _ in range(_MOST):
        inside = _longest(cells, LENGTH / voxel, rng)
        if not inside.any():
            break
        found[tuple(cells[inside].astype(int).T)] = True
        cells = cells[~inside]
    return dilated(found, 1)


def _longest(cells: NDArray[Any], least: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which cells (n, 3) lie on the upright line that is seen at most heights; none if it is too short."""
    best, most = np.zeros(len(cells), dtype=bool), COVERED * least
    if len(cells) < most:
        return best
    for a, b in cells[rng.integers(len(cells), size=(_TRIALS, 2))]:
        rise = b[2] - a[2]
        if abs(rise) < 0.3 * least or np.hypot(*(b - a)[:2]) > _TAN_TILT * abs(rise):
            continue
        on_line = a[:2] + (cells[:, 2:] - a[2]) * ((b - a)[:2] / rise)
        near = np.hypot(*(cells[:, :2] - on_line).T) <= _RADIUS
        heights = np.unique(cells[near, 2])
        span = _longest_run(heights, gap=0.25 * least)
        if span is not None and span[1] - span[0] >= least:
            inside = near & (cells[:, 2] >= span[0]) & (cells[:, 2] <= span[1])
            seen = int(((heights >= span[0]) & (heights <= span[1])).sum())
            if seen > most and seen >= COVERED * (span[1] - span[0]):
                best, most = inside, seen
    return best


def _longest_run(heights: NDArray[Any], gap: float) -> tuple[float, float] | None:
    """Return first and last of the longest stretch of sorted heights without a gap."""
    if len(heights) == 0:
        return None
    runs = np.split(heights, np.nonzero(np.diff(heights) > gap)[0] + 1)
    longest = max(runs, key=lambda run: run[-1] - run[0])
    return float(longest[0]), float(longest[-1])
