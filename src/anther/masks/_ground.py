"""The ground under a plant: bench, soil and pot, found in a voxel grid by their horizontal extent.

A surface is ground where a horizontal slab holds a disc wider than any stem and nothing is seen below it; a pot whose
soil is hidden is found as a closed ring. Dimensions: X x Y x Z cells, z up.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

WALL_HEIGHT = 0.04
"""A closed ring is a pot's wall if it goes on over this height [m]; leaves close rings over less."""

STEM_EXTENT = 0.04
"""The foot of a stem, as the errors of the poses spread it, is at most this wide [m]."""

SEEN_BELOW = 0.3
"""A surface with something seen below a larger share of it is foliage."""


def ground_cells(
    solid: NDArray[np.bool_],
    voxel: float,
    *,
    radius: float,
    sure_radius: float,
    margin: float,
    rim_height: float,
    rings: bool,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which cells belong to the ground.

    Args:
        solid: (X, Y, Z) occupied cells that are not vegetation.
        voxel: edge of a cell [m].
        radius: of the disc that a horizontal surface must hold up to the height of the soil [m].
        sure_radius: of the disc that the soil itself must hold, with little seen below it [m].
        margin: what lies less than this above a surface belongs to it [m].
        rim_height: a pot's rim stands at most this much above its soil [m].
        rings: whether a closed ring counts as a surface (a pot whose soil is hidden by leaves); it needs colour,
            because leaves seen without colour also form rings.

    Returns:
        (below, rim): two (X, Y, Z) masks. Nothing in `below` is plant, whatever its colour; in `rim`, the zone about
        a pot's wall and rim, only what is green is plant.
    """
    slabs = _slabs(solid, voxel)
    lowest = np.where(np.any(solid, axis=2), np.argmax(solid, axis=2), solid.shape[2])
    sure, disc = _disc(sure_radius / voxel), _disc(radius / voxel)
    height = np.full(solid.shape[:2], -1)
    for level, slab in slabs:
        centres = _opaque(_eroded(slab, sure), lowest, level, voxel)
        height[cv2.dilate(centres, sure) > 0] = level
    top = height.max() + rim_height / voxel
    for level, slab in slabs:
        if level <= top:
            height[(cv2.dilate(_eroded(slab, disc), disc) > 0) & (height < level)] = level
    height = _extended(height, radius / voxel)
    if rings:
        wall = _wall_heights(slabs, solid.shape[:2], disc, voxel)
        height = np.where(wall - height > rim_height / voxel, wall, height)
    levels = np.arange(solid.shape[2])
    below = levels[None, None, :] <= (height + margin / voxel)[:, :, None]
    return below, _rim_zone(height, levels, voxel, rim_height)


def foot_cells(plant: NDArray[np.bool_], below: NDArray[np.bool_], voxel: float, margin: float) -> NDArray[np.bool_]:
    """Return the cells just below the top of the ground (X, Y, Z) that carry on a stem above it.

    The margin above the soil belongs to the ground, and a stem would begin above it. What stands on that layer and is
    no wider than `STEM_EXTENT` is a stem, carried on straight down through the margin.

    Args:
        plant: (X, Y, Z) plant cells above the ground.
        below: (X, Y, Z) ground cells, each column filled from its bottom.
        voxel, margin: as in `ground_cells`.
    """
    top = below.sum(axis=2)[:, :, None]
    above = np.minimum(top + np.arange(2), below.shape[2] - 1)
    standing = np.any(np.take_along_axis(plant & ~below, above, axis=2), axis=2)
    _, parts, stats, _ = cv2.connectedComponentsWithStats(np.asarray(standing, dtype=np.uint8), connectivity=8)
    narrow = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) <= STEM_EXTENT / voxel
    narrow[0] = False
    foot = np.zeros_like(below)
    carried = np.maximum(top - 1 - np.arange(1 + int(margin / voxel)), 0)
    np.put_along_axis(foot, carried, narrow[parts][:, :, None], axis=2)
    return foot & below


def _slabs(solid: NDArray[np.bool_], voxel: float) -> list[tuple[int, NDArray[np.uint8]]]:
    """Return (level, occupied columns (X, Y)) of each horizontal slab three cells thick, small gaps closed."""
    layers = np.ascontiguousarray(np.moveaxis(solid, 2, 0)).view(np.uint8)
    slabs, gap = [], _disc(0.015 / voxel)
    for level in range(len(layers)):
        slab = np.bitwise_or.reduce(layers[max(0, level - 1) : level + 2])
        if slab.any():
            closed = cv2.morphologyEx(slab, cv2.MORPH_CLOSE, gap)
            slabs.append((level, np.asarray(closed, dtype=np.uint8)))
    return slabs


def _wall_heights(
    slabs: list[tuple[int, NDArray[np.uint8]]], shape: tuple[int, ...], disc: NDArray[np.uint8], voxel: float
) -> NDArray[np.int64]:
    """Return the highest level (X, Y) of a closed wall around each column; -1 without one."""
    wall, run, last = np.full(shape, -1), np.zeros(shape, dtype=np.int64), -1
    for level, slab in slabs:
        inside = cv2.dilate(_eroded(_filled(slab), disc), disc) > 0
        run = np.where(inside, np.where(level == last + 1, run, 0) + 1, 0)
        wall[run >= WALL_HEIGHT / voxel] = level
        last = level
    return wall


def _filled(slab: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the slab (X, Y) without holes: all that cannot be reached from beyond the grid."""
    around = cv2.copyMakeBorder(slab, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=[0])
    cv2.floodFill(around, None, (0, 0), [2])  # pyright: ignore[reportArgumentType, reportCallIssue]
    return (around[1:-1, 1:-1] != 2).astype(np.uint8)


def _eroded(slab: NDArray[np.uint8], disc: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the centres of the discs that fit into the slab; beyond the grid there is nothing."""
    return np.asarray(cv2.erode(slab, disc, borderType=cv2.BORDER_CONSTANT, borderValue=0), dtype=np.uint8)


def _extended(height: NDArray[Any], reach: float) -> NDArray[np.int64]:
    """Return the surface carried on, at its lowest height near by, into corners that no disc fits into."""
    unknown = np.iinfo(np.int16).max
    around = cv2.erode(np.where(height >= 0, height, unknown).astype(np.int16), _disc(reach))
    return np.where((height < 0) & (around < unknown), around, height)


def _opaque(centres: NDArray[Any], lowest: NDArray[Any], level: int, voxel: float) -> NDArray[np.uint8]:
    """Return the connected patches of `centres` (X, Y) below which little is seen: ground is opaque, foliage is not."""
    seen_below = lowest < level - 0.04 / voxel
    if not centres.any():
        return centres
    count, numbered = cv2.connectedComponents(centres, connectivity=8)
    patch = np.asarray(numbered, dtype=np.int64)
    share = np.bincount(patch.ravel(), weights=seen_below.ravel(), minlength=count) / np.maximum(
        1, np.bincount(patch.ravel(), minlength=count)
    )
    opaque = share < SEEN_BELOW
    opaque[0] = False
    return opaque[patch].astype(np.uint8)


def _rim_zone(height: NDArray[Any], levels: NDArray[Any], voxel: float, rim_height: float) -> NDArray[np.bool_]:
    """Return the cells (X, Y, Z) about the edge of every raised surface, up to `rim_height` above it."""
    reach = _disc(0.025 / voxel)
    around = height.astype(np.float32)
    highest, lowest = cv2.dilate(around, reach), cv2.erode(around, reach)
    step = highest - lowest > 0.02 / voxel
    top = np.where(step, highest + rim_height / voxel, -1.0)
    return levels[None, None, :] <= top[:, :, None]


def _disc(radius: float) -> NDArray[np.uint8]:
    n = max(1, round(radius))
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    return (x * x + y * y <= (n + 0.3) ** 2).astype(np.uint8)
