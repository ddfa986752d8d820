"""The ground under a plant: bench, soil and pot, found in a voxel grid by their horizontal extent.

A surface is ground where a horizontal slab holds a disc wider than any stem; a pot whose soil is hidden is found as a
closed ring. Dimensions: X x Y x Z cells, z up.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

WALL_HEIGHT = 0.04
"""A closed ring is a pot's wall if it goes on over this height [m]; leaves close rings over less."""


def ground_cells(
    solid: NDArray[np.bool_], voxel: float, *, radius: float, margin: float, rim_height: float, rings: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which cells belong to the ground.

    Args:
        solid: (X, Y, Z) occupied cells that are not vegetation.
        voxel: edge of a cell [m].
        radius: of the disc that a horizontal surface must hold [m].
        margin: what lies less than this above a surface belongs to it [m].
        rim_height: a pot's rim stands at most this much above its soil [m].
        rings: whether a closed ring counts as a surface (a pot whose soil is hidden by leaves); it needs colour,
            because leaves seen without colour also form rings.

    Returns:
        (below, rim): two (X, Y, Z) masks. Nothing in `below` is plant, whatever its colour; in `rim`, the zone about
        a pot's wall and rim, only what is green is plant.
    """
    height, ring = _surface_heights(solid, voxel, radius)
    if rings:
        hidden = ring - height > rim_height / voxel
        height = np.where(hidden, ring, height)
    levels = np.arange(solid.shape[2])
    below = levels[None, None, :] <= (height + margin / voxel)[:, :, None]
    return below, _rim_zone(height, levels, voxel, rim_height)


def _surface_heights(
    solid: NDArray[np.bool_], voxel: float, radius: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the highest level (X, Y) of a filled surface and of a closed wall around each column; -1 without one."""
    height = np.full(solid.shape[:2], -1)
    ring = np.full(solid.shape[:2], -1)
    run = np.zeros(solid.shape[:2], dtype=np.int64)
    bridge, disc = _disc(0.015 / voxel), _disc(radius / voxel)
    for level in range(solid.shape[2]):
        slab = np.any(solid[:, :, max(0, level - 1) : level + 2], axis=2).astype(np.uint8)
        if slab.sum() < disc.sum() / 4:
            run[:] = 0
            continue
        closed = cv2.morphologyEx(slab, cv2.MORPH_CLOSE, bridge)
        height[cv2.morphologyEx(closed, cv2.MORPH_OPEN, disc) > 0] = level
        filled = np.asarray(ndimage.binary_fill_holes(closed)).astype(np.uint8)
        run = np.where(cv2.morphologyEx(filled, cv2.MORPH_OPEN, disc) > 0, run + 1, 0)
        ring[run >= WALL_HEIGHT / voxel] = level
    return height, ring


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
