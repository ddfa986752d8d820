"""Voxel voting for the masks: each depth pixel in the workspace votes, with its colour class, in a shared grid.

Dimensions: H x W pixels, X x Y x Z cells. The loops are compiled because 30 views hold 28 million pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array, Box, Intrinsics
from anther.masks._light import GREEN, GREEN_NO_DEPTH, OTHER, OUTSIDE, YELLOW, ColourRule

EMPTY, GROUND, RIM, GREEN_CELL, BROWN_CELL, FLOWER_CELL, BESIDE_FLOWER = range(7)
"""What a cell of the grid was found to be. RIM: green, but about a pot's rim. BROWN_CELL: a part of the plant that is
not green."""

PETAL_VIEWS, LAST_PETAL_VIEW = 4, 5
"""Layers of the vote grid after the four colours: in how many views petals voted, and the last of these plus one."""

LAYERS = 6
"""Number of layers of the vote grid."""

_BLEED_REACH, _BLEED_DEPTH = 3, 0.05  # [px], [m]


@dataclass(frozen=True, slots=True)
class Grid:
    """A grid of cubic cells over the workspace.

    Attributes:
        lower: (3,) lower corner [m].
        voxel: edge of a cell [m].
        shape: number of cells along x, y, z.
    """

    lower: Array
    voxel: float
    shape: tuple[int, int, int]

    @classmethod
    def over(cls, box: Box, voxel: float, most: float) -> Grid:
        """Return the grid that covers a box; more than `most` cells are refused."""
        counts = box.cells(voxel, most)
        return cls(box.lower, voxel, (int(counts[0]), int(counts[1]), int(counts[2])))


def vote(
    rgb: NDArray[Any] | None,
    depth: NDArray[Any],
    *,
    camera: Array,
    rule: ColourRule | None,
    counts: NDArray[Any],
    view: int = 0,
) -> NDArray[Any]:
    """Add one view's pixels to `counts` and return their colour classes (H, W) uint8.

    Args:
        rgb: (H, W, 3) uint8, or None: then every pixel in the workspace is OTHER.
        depth: (H, W) float32 [m].
        camera: (3, 4) from `pixels_to_cells`.
        rule: None without colour.
        counts: (LAYERS, X, Y, Z) uint16, votes for OTHER, GREEN, YELLOW, WHITE and the petal layers; added to in
            place. Without colour the first layer is enough.
        view: its number.
    """
    classes = np.zeros(depth.shape, dtype=np.uint8)
    if rgb is None or rule is None:
        _vote_depth(depth, tuple(camera.ravel()), classes, counts)
    else:
        _vote_colour(rgb, depth, tuple(camera.ravel()), rule.table, rule.alike, classes, counts, view)
    return classes


def pixels_to_cells(T_world_cam: Array, intrinsics: Intrinsics, grid: Grid) -> Array:
    """Return (3, 4) M: M (u z, v z, z, 1) is where among the cells pixel (u, v) of depth z lies, not yet rounded."""
    k, T = intrinsics, np.asarray(T_world_cam)
    rays = np.array([[1 / k.fx, 0, -k.cx / k.fx], [0, 1 / k.fy, -k.cy / k.fy], [0, 0, 1]])
    return np.column_stack([T[:3, :3] @ rays, T[:3, 3] - grid.lower]) / grid.voxel


@numba.njit(nogil=True, cache=True, inline="always")
def _cell(u, v, z, m, shape):
    """Return the cell (i, j, k) that a pixel's point lies in, or (-1, -1, -1); `m` is a tuple to stay in registers."""
    x = (m[0] * u + (m[1] * v + m[2])) * z + m[3]
    y = (m[4] * u + (m[5] * v + m[6])) * z + m[7]
    w = (m[8] * u + (m[9] * v + m[10])) * z + m[11]
    if 0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= w < shape[2]:
        return int(x), int(y), int(w)
    return -1, -1, -1


@numba.njit(nogil=True, cache=True, inline="always")
def _bleeds(rgb, depth, v, u, like):
    """Return whether a pixel has the colour of a background near it: then it is that background, wrongly placed."""
    for dv in (-_BLEED_REACH, 0, _BLEED_REACH):
        for du in (-_BLEED_REACH, 0, _BLEED_REACH):
            j = min(max(v + dv, 0), depth.shape[0] - 1)
            i = min(max(u + du, 0), depth.shape[1] - 1)
            if depth[j, i] > depth[v, u] + _BLEED_DEPTH or depth[j, i] <= 0:
                alike = True
                for c in range(3):
                    alike = alike and abs(float(rgb[j, i, c]) - float(rgb[v, u, c])) < like
                if alike:
                    return True
    return False


@numba.njit(nogil=True, cache=True)
def _vote_colour(rgb, depth, camera, table, like, classes, counts, view):
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            i, j, k = _cell(u, v, depth[v, u], camera, counts.shape[1:])
            if depth[v, u] > 0 and i < 0:
                continue
            kind = table[rgb[v, u, 0] >> 2, rgb[v, u, 1] >> 2, rgb[v, u, 2] >> 2]
            if depth[v, u] <= 0:
                classes[v, u] = GREEN_NO_DEPTH if kind == GREEN else OUTSIDE
            else:
                if kind >= YELLOW and _bleeds(rgb, depth, v, u, like):
                    kind = OTHER
                classes[v, u] = kind
                counts[kind - 1, i, j, k] += 1
                if kind >= YELLOW and counts[LAST_PETAL_VIEW, i, j, k] != view + 1:
                    counts[LAST_PETAL_VIEW, i, j, k] = view + 1
                    counts[PETAL_VIEWS, i, j, k] += 1


@numba.njit(nogil=True, cache=True)
def _vote_depth(depth, camera, classes, counts):
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if depth[v, u] > 0:
                i, j, k = _cell(u, v, depth[v, u], camera, counts.shape[1:])
                if i >= 0:
                    classes[v, u] = OTHER
                    counts[0, i, j, k] += 1


@numba.njit(nogil=True, cache=True)
def _read_back(depth, camera, classes, cells, labels):
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            kind = classes[v, u]
            if kind in (OUTSIDE, GREEN_NO_DEPTH):
                continue
            i, j, k = _cell(u, v, depth[v, u], camera, cells.shape)
            cell = cells[i, j, k]
            if kind == GREEN:
                labels[v, u] = 1 if cell != GROUND else 0
            elif cell == FLOWER_CELL or (cell == BESIDE_FLOWER and kind != OTHER):
                labels[v, u] = 2
            elif cell == BROWN_CELL or (cell == GREEN_CELL and kind == YELLOW):
                labels[v, u] = 1


def read_back(depth: NDArray[Any], camera: Array, classes: NDArray[Any], cells: NDArray[Any]) -> NDArray[Any]:
    """Return one view's labels (H, W) uint8 (0 background, 1 plant, 2 flower) from what its cells were found to be.

    A green pixel is plant unless its cell is ground. Others need a cell that holds a brown part or a flower: beside
    green parts they are background that the depth sensor's matching window fattened the plant with.

    Args:
        depth, camera: as in `vote`.
        classes: (H, W) from `vote`.
        cells: (X, Y, Z) uint8, see EMPTY and what follows.
    """
    labels = np.zeros(depth.shape, dtype=np.uint8)
    _read_back(depth, tuple(camera.ravel()), classes, cells, labels)
    return labels


@numba.njit(nogil=True, cache=True)
def _clear(depth, camera, classes, cells, labels):
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if labels[v, u] == 0 or depth[v, u] <= 0:
                continue
            i, j, k = _cell(u, v, depth[v, u], camera, cells.shape)
            if i < 0 or cells[i, j, k] == GROUND or (cells[i, j, k] == RIM and classes[v, u] == OTHER):
                labels[v, u] = 0


def clear(
    labels: NDArray[Any],
    depth: NDArray[Any],
    camera: Array,
    classes: NDArray[Any],
    cells: NDArray[Any],
) -> NDArray[Any]:
    """Return labels (H, W) of any source freed of the ground, of the pot and of what lies outside the grid.

    Args:
        labels: (H, W) uint8, 0 = background.
        depth, camera: as in `vote`.
        classes: (H, W) from `vote`.
        cells: (X, Y, Z) uint8, of which GROUND and RIM count.
    """
    kept = labels.copy()
    _clear(depth, tuple(camera.ravel()), classes, cells, kept)
    return kept
