"""What each cell of the grid is: ground, green, a brown part of the plant, or a flower. X x Y x Z cells.

Stakes and strings near a plant are long straight upright lines of cells that are not green.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from anther.core.opencv import cv2
from anther.perception.capture import Capture
from anther.perception.masks._light import GREEN, WHITE, YELLOW
from anther.perception.masks._survey import Survey
from anther.perception.masks._voting import (
    BROWN_CELL,
    EMPTY,
    FLOWER_CELL,
    GREEN_CELL,
    GROUND,
    LAYERS,
    NEAR_FLOWER,
    PETAL_VIEWS,
    RIM,
    Grid,
)


def kinds(seen: Survey, capture: Capture) -> NDArray[np.uint8]:
    """Return what each cell is, (X, Y, Z) uint8: see `_voting.EMPTY` and what follows."""
    if len(seen.votes) < LAYERS:
        return _by_geometry(seen)
    return _by_colour(seen, *_enough_petals(capture, seen.grid))


def _by_geometry(seen: Survey) -> NDArray[np.uint8]:
    """Whatever is seen above the ground is a part of the plant."""
    occupied = seen.votes[0] >= 2
    foot = occupied & seen.foot(occupied & ~seen.rim)
    return np.where((seen.below | seen.rim) & ~foot, GROUND, np.where(occupied, BROWN_CELL, EMPTY)).astype(np.uint8)


def _enough_petals(capture: Capture, grid: Grid) -> tuple[float, int]:
    """Return how many petal pixels, and from how many views, a petal cell needs.

    In all views together 0.4 of the pixels that one view has on a cell's face, from two views; of more than 20 views,
    from a tenth of them, since each adds its own gleams. Of 10 views, three lose a fifth to half of the flowers.
    """
    centre = grid.lower + np.multiply(grid.shape, grid.voxel) / 2
    distance = float(np.median(np.linalg.norm(capture.T_world_cam[:, :3, 3] - centre, axis=1)))
    pixels = (grid.voxel * capture.intrinsics.fx / max(distance, grid.voxel)) ** 2
    return 0.4 * pixels, min(max(2, round(capture.views / 10)), capture.views)


def _by_colour(seen: Survey, least_votes: float, least_views: int) -> NDArray[np.uint8]:
    """Return the kinds of cells (X, Y, Z); most are empty, and what needs no neighbours is decided in a list.

    A quarter of its votes make a cell green, 0.35 petal. A flower, or a truss of them, measures 0.12 m at most and
    comes within 20 mm of a green part of 20 cells. Another part belongs to the plant where it comes within 12 mm of
    green and is slender, 80 mm at most, as stems and fruits are and walls are not.
    """
    at = np.flatnonzero(seen.total >= 2)
    votes, total = seen.votes.reshape(LAYERS, -1)[:, at], seen.total.ravel()[at]
    below, rim = seen.below.ravel()[at], seen.rim.ravel()[at]

    def grid_of(part: NDArray[np.bool_]) -> NDArray[np.bool_]:
        grid = np.zeros(seen.grid.shape, dtype=bool)
        grid.ravel()[at] = part
        return grid

    likely = votes[GREEN - 1] >= np.maximum(2, 0.25 * total)
    foot = seen.foot(grid_of(likely)).ravel()[at]
    green = likely & (~below | foot)
    free = ~below & ~rim
    if foot.any():  # else a straight brown line may be the stem itself
        free &= ~stake_cells(grid_of(free & (votes[GREEN - 1] <= 0.1 * total)), seen.grid.voxel).ravel()[at]
    petal_votes = votes[YELLOW - 1].astype(np.int32) + votes[WHITE - 1]
    seen_often = (petal_votes >= least_votes) & (votes[PETAL_VIEWS] >= least_views)
    petals = free & seen_often & (petal_votes >= 0.35 * total)
    leaves = _large_parts(grid_of(green & ~petals), 20)
    flowers = _parts_near(
        grid_of(petals), leaves, distance=0.02, extent=0.12, axis=0,
        voxel=seen.grid.voxel,
    )  # fmt: skip
    brown = _parts_near(
        grid_of(free & ~green & ~flowers.ravel()[at]), grid_of(green), distance=0.012,
        extent=0.08, axis=1, voxel=seen.grid.voxel,
    )  # fmt: skip
    cells = np.where(seen.below | seen.rim, np.uint8(GROUND), np.uint8(EMPTY))
    cells.ravel()[at[green]] = GREEN_CELL
    cells.ravel()[at[green & rim]] = RIM
    cells[brown] = BROWN_CELL
    cells[dilated(flowers, 1) & (cells != GROUND)] = NEAR_FLOWER
    cells[flowers] = FLOWER_CELL
    return cells


def _numbered(part: NDArray[np.bool_]) -> tuple[tuple[slice, ...], NDArray[np.int32]]:
    """Return the box that holds `part` (X, Y, Z), and the number there of each cell's connected component, corners
    connect; 0 outside."""
    wide = [np.flatnonzero(part.any(axis=others)) for others in ((1, 2), (0, 2), (0, 1))]
    box = tuple(slice(at[0], at[-1] + 1) if len(at) else slice(0, 1) for at in wide)
    number = np.zeros(part[box].shape, dtype=np.int32)  # labelling the whole grid would take longer
    ndimage.label(part[box], np.ones((3, 3, 3)), output=number)
    return box, number


def _large_parts(part: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """Return the connected components of `part` (X, Y, Z) with at least `least` cells."""
    box, number = _numbered(part)
    return _of_components(part, box, number, np.bincount(number[part[box]], minlength=1) >= least)


def _parts_near(
    part: NDArray[np.bool_], plant: NDArray[np.bool_], *, distance: float, extent: float, axis: int, voxel: float
) -> NDArray[np.bool_]:
    """Return the connected components of `part` that come within `distance` [m] of `plant` and are small.

    Of the three extents of the bounding box, sorted from the greatest, number `axis` may not exceed `extent` [m]: 0
    bounds the size, 1 lets through slender parts of any length.
    """
    box, number = _numbered(part)
    cells = np.nonzero(part[box])
    owner = number[cells]
    lower, upper = np.full((2, owner.max(initial=0) + 1, 3), [[[number.size]], [[-1]]])
    for along, low, high in zip(cells, lower.T, upper.T, strict=True):  # `ndimage.find_objects` reads the whole grid
        np.minimum.at(low, owner, along)
        np.maximum.at(high, owner, along)
    kept = np.sort(upper - lower + 1, axis=1)[:, 2 - axis] * voxel <= extent + voxel
    near = np.zeros_like(kept)
    near[number[dilated(plant, max(1, round(distance / voxel)))[box]]] = True
    return _of_components(part, box, number, kept & near)


def _of_components(
    part: NDArray[np.bool_], box: tuple[slice, ...], number: NDArray[np.int32], kept: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the cells of `part` in components, `_numbered`, that are `kept`, by their number."""
    found = np.zeros_like(part)
    found[box] = part[box] & kept[number]
    return found


def dilated(part: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Return the cells (X, Y, Z) within `reach` cells along every axis of one in `part`."""
    square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    layers = np.stack([cv2.dilate(layer, square) for layer in np.ascontiguousarray(part).view(np.uint8)])
    grown = cv2.dilate(layers.reshape(len(part), -1), square[:, :1])
    return np.asarray(grown).reshape(part.shape).view(np.bool_)


def stake_cells(bare: NDArray[np.bool_], voxel: float) -> NDArray[np.bool_]:
    """Return the cells (X, Y, Z) of up to four stakes or strings, and those around them.

    They are found in the `bare` cells: seen, above the ground, not green. A stake is 0.2 m long or more. Of lines
    through random pairs of cells, that through most heights is kept (RANSAC, Fischler and Bolles 1981).
    """
    cells = np.stack(np.unravel_index(np.flatnonzero(bare), bare.shape), axis=1).astype(np.float64)
    found = np.zeros_like(bare)
    rng = np.random.default_rng(0)
    for _ in range(4):
        inside = _longest(cells, 0.2 / voxel, rng)
        if not inside.any():
            break
        found[tuple(cells[inside].astype(int).T)] = True
        cells = cells[~inside]
    return dilated(found, 1)


def _longest(cells: NDArray[Any], least: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which cells (n, 3) lie on the upright line that is seen at most heights; none if it is too short.

    Of 400 lines tried, those count that tilt by 19 degrees at most and are seen at 0.6 of their heights.
    """
    best, covered = np.zeros(len(cells), dtype=bool), 0.6
    most = covered * least
    if len(cells) < most:
        return best
    for a, b in cells[rng.integers(len(cells), size=(400, 2))]:
        rise = b[2] - a[2]
        if abs(rise) < 0.3 * least or np.hypot(*(b - a)[:2]) > 0.35 * abs(rise):
            continue
        on_line = a[:2] + (cells[:, 2:] - a[2]) * ((b - a)[:2] / rise)
        near = np.hypot(*(cells[:, :2] - on_line).T) <= 1.3  # [cells]
        heights = np.unique(cells[near, 2])
        span = _longest_run(heights, gap=0.25 * least)
        if span is not None and span[1] - span[0] >= least:
            inside = near & (cells[:, 2] >= span[0]) & (cells[:, 2] <= span[1])
            seen = int(((heights >= span[0]) & (heights <= span[1])).sum())
            if seen > most and seen >= covered * (span[1] - span[0]):
                best, most = inside, seen
    return best


def _longest_run(heights: NDArray[Any], gap: float) -> tuple[float, float] | None:
    """Return first and last of the longest stretch of sorted heights without a gap."""
    if len(heights) == 0:
        return None
    runs = np.split(heights, np.nonzero(np.diff(heights) > gap)[0] + 1)
    longest = max(runs, key=lambda run: run[-1] - run[0])
    return float(longest[0]), float(longest[-1])
