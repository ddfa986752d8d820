"""What each cell of the grid is: ground, green, a brown part of the plant, or a flower. X x Y x Z cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from anther.capture import Capture
from anther.masks.light import GREEN, WHITE, YELLOW
from anther.masks.stakes import stake_cells
from anther.masks.survey import Survey
from anther.masks.voting import (
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

if TYPE_CHECKING:
    from anther.masks import Params


def kinds(seen: Survey, capture: Capture, params: Params) -> NDArray[np.uint8]:
    """Return what each cell is, (X, Y, Z) uint8: see `voting.EMPTY` and what follows."""
    if len(seen.votes) < LAYERS:
        return _by_geometry(seen, params)
    return _by_colour(seen, params, *_enough_petals(capture, seen.grid, params))


def _by_geometry(seen: Survey, params: Params) -> NDArray[np.uint8]:
    """Whatever is seen above the ground is a part of the plant."""
    occupied = seen.votes[0] >= 2
    foot = occupied & seen.foot(occupied & ~seen.rim, params)
    return np.where((seen.below | seen.rim) & ~foot, GROUND, np.where(occupied, BROWN_CELL, EMPTY)).astype(np.uint8)


def _enough_petals(capture: Capture, grid: Grid, params: Params) -> tuple[float, int]:
    """Return how many petal pixels, and from how many views, a petal cell needs."""
    centre = grid.lower + np.multiply(grid.shape, grid.voxel) / 2
    distance = float(np.median(np.linalg.norm(capture.T_world_cam[:, :3, 3] - centre, axis=1)))
    pixels = (grid.voxel * capture.intrinsics.fx / max(distance, grid.voxel)) ** 2
    return params.petal_cover * pixels, min(params.petal_views, capture.views)


def _by_colour(seen: Survey, params: Params, least_votes: float, least_views: int) -> NDArray[np.uint8]:
    votes, total = seen.votes, seen.total
    below, rim, occupied = seen.below, seen.rim, total >= 2
    likely = votes[GREEN - 1] >= np.maximum(2, params.green_share * total)
    foot = seen.foot(likely, params)
    green = likely & (~below | foot)
    free = occupied & ~below & ~rim
    if foot.any():  # else a straight brown line may be the stem itself
        free &= ~stake_cells(free & (votes[GREEN - 1] <= 0.1 * total), params.voxel)
    petal_votes = votes[YELLOW - 1].astype(np.int32) + votes[WHITE - 1]
    seen_often = (petal_votes >= least_votes) & (votes[PETAL_VIEWS] >= least_views)
    petals = free & seen_often & (petal_votes >= params.petal_share * total)
    leaves = _large_parts(green & ~petals, params.least_part)
    flowers = _parts_near(
        petals, leaves, distance=params.flower_distance, extent=params.flower_extent, axis=0, voxel=params.voxel
    )
    brown = _parts_near(
        free & ~green & ~flowers,
        green,
        distance=params.attach_distance,
        extent=params.brown_extent,
        axis=1,
        voxel=params.voxel,
    )
    cells = np.where(below | rim, GROUND, EMPTY).astype(np.uint8)
    cells[green] = GREEN_CELL
    cells[green & rim] = RIM
    cells[brown] = BROWN_CELL
    cells[(ndimage.maximum_filter(flowers.astype(np.uint8), size=3) > 0) & (cells != GROUND)] = BESIDE_FLOWER
    cells[flowers] = FLOWER_CELL
    return cells


def _large_parts(part: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """Return the connected components of `part` (X, Y, Z) with at least `least` cells."""
    parts = np.zeros(part.shape, dtype=np.int32)
    ndimage.label(part, structure=np.ones((3, 3, 3)), output=parts)
    large = np.bincount(parts.ravel()) >= least
    large[0] = False
    return large[parts]


def _parts_near(
    part: NDArray[np.bool_], plant: NDArray[np.bool_], *, distance: float, extent: float, axis: int, voxel: float
) -> NDArray[np.bool_]:
    """Return the connected components of `part` that come within `distance` [m] of `plant` and are small.

    Args:
        axis: which of the three extents along the bounding box, sorted from the greatest, may not exceed `extent`:
            0 bounds the size, 1 lets through slender parts of any length.
    """
    parts = np.zeros(part.shape, dtype=np.int32)
    count = int(np.asarray(ndimage.label(part, structure=np.ones((3, 3, 3)), output=parts)))
    if count == 0:
        return part
    reach = 2 * max(1, round(distance / voxel)) + 1
    near = ndimage.maximum_filter(plant.astype(np.uint8), size=reach) > 0
    touches = np.zeros(count + 1, dtype=bool)
    touches[np.unique(parts[near])] = True
    for number, slices in enumerate(ndimage.find_objects(parts), start=1):
        sizes = sorted((s.stop - s.start for s in slices), reverse=True)
        touches[number] &= sizes[axis] * voxel <= extent + voxel
    touches[0] = False
    return touches[parts]
