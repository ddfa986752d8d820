"""What each cell of the grid is: ground, green, a brown part of the plant, or a flower. X x Y x Z cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anther.capture import Capture
from anther.masks._components import components, dilated
from anther.masks._light import GREEN, WHITE, YELLOW
from anther.masks._stakes import stake_cells
from anther.masks._survey import Survey
from anther.masks._voting import (
    BESIDE_FLOWER,
    BROWN_CELL,
    EMPTY,
    FLOWER_CELL,
    GREEN_CELL,
    GROUND,
    LAYERS,
    PETAL_VIEWS,
    RIM,
    Grid,
)

GREEN_SHARE, PETAL_SHARE = 0.25, 0.35
"""Least share of votes that makes a cell green, or petal."""

PETAL_COVER = 0.4
"""A petal cell has at least this share of the pixels that one view has on a cell's face, in all views together."""

FLOWER_DISTANCE = 0.02
"""A flower comes at least this close to green cells [m]."""

FLOWER_EXTENT = 0.12
"""Greatest extent of a flower cluster, a truss [m]."""

SEEN_AS_PETAL = 3
"""A petal cell is seen as petal from at least so many views."""

ATTACH_DISTANCE = 0.012
"""A part that is not green belongs to the plant if it comes this close to green ones [m]."""

BROWN_EXTENT = 0.08
"""Greatest second extent of a part that is not green [m]: stems and fruits are slender, walls are not."""

LEAST_PART = 20
"""Flowers are looked for beside green parts of at least this many cells."""


def kinds(seen: Survey, capture: Capture) -> NDArray[np.uint8]:
    """Return what each cell is, (X, Y, Z) uint8: see `voting.EMPTY` and what follows."""
    if len(seen.votes) < LAYERS:
        return _by_geometry(seen)
    return _by_colour(seen, *_enough_petals(capture, seen.grid))


def _by_geometry(seen: Survey) -> NDArray[np.uint8]:
    """Whatever is seen above the ground is a part of the plant."""
    occupied = seen.votes[0] >= 2
    foot = occupied & seen.foot(occupied & ~seen.rim)
    return np.where((seen.below | seen.rim) & ~foot, GROUND, np.where(occupied, BROWN_CELL, EMPTY)).astype(np.uint8)


def _enough_petals(capture: Capture, grid: Grid) -> tuple[float, int]:
    """Return how many petal pixels, and from how many views, a petal cell needs."""
    centre = grid.lower + np.multiply(grid.shape, grid.voxel) / 2
    distance = float(np.median(np.linalg.norm(capture.T_world_cam[:, :3, 3] - centre, axis=1)))
    pixels = (grid.voxel * capture.intrinsics.fx / max(distance, grid.voxel)) ** 2
    return PETAL_COVER * pixels, min(SEEN_AS_PETAL, capture.views)


def _by_colour(seen: Survey, least_votes: float, least_views: int) -> NDArray[np.uint8]:
    """Most cells are empty: all but what needs their neighbours is decided in a list of the occupied ones."""
    at = np.flatnonzero(seen.total >= 2)
    votes, total = seen.votes.reshape(LAYERS, -1)[:, at], seen.total.ravel()[at]
    below, rim = seen.below.ravel()[at], seen.rim.ravel()[at]

    def grid_of(part: NDArray[np.bool_]) -> NDArray[np.bool_]:
        grid = np.zeros(seen.grid.shape, dtype=bool)
        grid.ravel()[at] = part
        return grid

    likely = votes[GREEN - 1] >= np.maximum(2, GREEN_SHARE * total)
    foot = seen.foot(grid_of(likely)).ravel()[at]
    green = likely & (~below | foot)
    free = ~below & ~rim
    if foot.any():  # else a straight brown line may be the stem itself
        free &= ~stake_cells(grid_of(free & (votes[GREEN - 1] <= 0.1 * total)), seen.grid.voxel).ravel()[at]
    petal_votes = votes[YELLOW - 1].astype(np.int32) + votes[WHITE - 1]
    seen_often = (petal_votes >= least_votes) & (votes[PETAL_VIEWS] >= least_views)
    petals = free & seen_often & (petal_votes >= PETAL_SHARE * total)
    leaves = _large_parts(grid_of(green & ~petals), LEAST_PART)
    flowers = _parts_near(
        grid_of(petals), leaves, distance=FLOWER_DISTANCE, extent=FLOWER_EXTENT, axis=0,
        voxel=seen.grid.voxel,
    )  # fmt: skip
    brown = _parts_near(
        grid_of(free & ~green & ~flowers.ravel()[at]), grid_of(green), distance=ATTACH_DISTANCE,
        extent=BROWN_EXTENT, axis=1, voxel=seen.grid.voxel,
    )  # fmt: skip
    cells = np.where(seen.below | seen.rim, np.uint8(GROUND), np.uint8(EMPTY))
    cells.ravel()[at[green]] = GREEN_CELL
    cells.ravel()[at[green & rim]] = RIM
    cells[brown] = BROWN_CELL
    cells[dilated(flowers, 1) & (cells != GROUND)] = BESIDE_FLOWER
    cells[flowers] = FLOWER_CELL
    return cells


def _large_parts(part: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """Return the connected components of `part` (X, Y, Z) with at least `least` cells."""
    cells, number = components(part)
    large = np.zeros_like(part)
    large[tuple(cells[np.bincount(number)[number] >= least].T)] = True
    return large


def _parts_near(
    part: NDArray[np.bool_], plant: NDArray[np.bool_], *, distance: float, extent: float, axis: int, voxel: float
) -> NDArray[np.bool_]:
    """Return the connected components of `part` that come within `distance` [m] of `plant` and are small.

    Args:
        axis: which of the three extents along the bounding box, sorted from the greatest, may not exceed `extent`:
            0 bounds the size, 1 lets through slender parts of any length.
    """
    cells, number = components(part)
    if len(cells) == 0:
        return part
    near = dilated(plant, max(1, round(distance / voxel)))[tuple(cells.T)]
    count = number.max() + 1
    touches = np.bincount(number, weights=near, minlength=count) > 0
    first, last = np.full((count, 3), np.iinfo(cells.dtype).max), np.zeros((count, 3), dtype=cells.dtype)
    np.minimum.at(first, number, cells)
    np.maximum.at(last, number, cells)
    size = np.sort(last - first + 1, axis=1)[:, 2 - axis]
    kept = (touches & (size * voxel <= extent + voxel))[number]
    found = np.zeros_like(part)
    found[tuple(cells[kept].T)] = True
    return found
