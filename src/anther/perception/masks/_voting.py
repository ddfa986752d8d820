"""Voxel voting for the masks: each depth pixel in the workspace votes, with its colour class, in a shared grid.

Dimensions: H x W pixels, X x Y x Z cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.compiling import compiled, inlined, read_only
from anther.core.geometry import Array, Box, Intrinsics
from anther.perception.masks._light import GREEN, GREEN_NO_DEPTH, OTHER, STEP, WHITE, YELLOW, ColourRule

EMPTY, GROUND, RIM, GREEN_CELL, BROWN_CELL, FLOWER_CELL, NEAR_FLOWER = range(7)
"""What a cell of the grid was found to be. RIM: green, but about a pot's rim. BROWN_CELL: a part of the plant that is
not green."""

_COUNTING = Lock()
"""Views vote at the same time, in one grid."""
PETAL_VIEWS, LAYERS = 4, 5
"""Layer of the vote grid after the four colours: in how many views petals voted; and the number of all layers."""


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
    rgb: NDArray[Any] | None, depth: NDArray[Any], camera: Array, rule: ColourRule | None, counts: NDArray[Any]
) -> NDArray[Any]:
    """Add one view's pixels to `counts` and return their colour classes (H, W) uint8.

    Args:
        rgb: (H, W, 3) uint8, or None: then every pixel in the workspace is OTHER.
        depth: (H, W) float32 [m].
        camera: (3, 4) from `pixels_to_cells`.
        rule: None without colour.
        counts: (LAYERS, X, Y, Z) uint16, added to in place; without colour the first layer is enough.
    """
    size, (classes, at) = counts[0].size, _classes(rgb, depth, camera, rule, counts.shape[1:])
    at = at[at >= 0]
    petal_cells = at[at >= (YELLOW - OTHER) * size] % size
    with _COUNTING:
        np.add.at(counts.reshape(-1), at, np.uint16(1))
        if len(petal_cells):
            counts[PETAL_VIEWS].ravel()[petal_cells] += 1  # one of each cell, however often it is named
    return classes


def pixels_to_cells(T_world_cam: Array, intrinsics: Intrinsics, grid: Grid) -> Array:
    """Return (3, 4) M: M (u z, v z, z, 1) is where among the cells pixel (u, v) of depth z lies, not yet rounded."""
    k, T = intrinsics, np.asarray(T_world_cam)
    rays = np.array([[1 / k.fx, 0, -k.cx / k.fx], [0, 1 / k.fy, -k.cy / k.fy], [0, 0, 1]])
    return np.column_stack([T[:3, :3] @ rays, T[:3, 3] - grid.lower]) / grid.voxel


def _cell_of(depth: NDArray[Any], camera: Array, shape: tuple[int, ...]) -> NDArray[np.int32]:
    """Return (H, W) the flat number of the cell that each pixel lies in; -1 beyond the grid or without depth."""
    return _classes(None, depth, camera, None, shape)[1]


def _classes(
    rgb: NDArray[Any] | None, depth: NDArray[Any], camera: Array, rule: ColourRule | None, shape: tuple[int, ...]
) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Return (H, W) the colour classes, and where in the layers of votes the pixels count; -1 nowhere. See `vote`."""
    none = np.zeros((0, 0, 0), np.uint8)
    rgb, table, alike = (none, none, 0.0) if rgb is None or rule is None else (rgb, rule.table, rule.alike)
    classes, at = np.zeros(depth.shape, dtype=np.uint8), np.full(depth.shape, -1, dtype=np.int32)
    read = read_only(rgb), read_only(depth), read_only(table)
    _classify(*read, tuple(camera.ravel()), shape, alike, at, classes)
    return classes, at


@compiled
def _classify(rgb, depth, table, m, shape, alike, at, classes):
    """Compiled, because 30 views hold 28 million pixels; `m` is a tuple to stay in registers."""
    size = shape[0] * shape[1] * shape[2]
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z, kind, cell = depth[v, u], OTHER, np.int64(-1)
            x = (m[0] * u + (m[1] * v + m[2])) * z + m[3]
            y = (m[4] * u + (m[5] * v + m[6])) * z + m[7]
            w = (m[8] * u + (m[9] * v + m[10])) * z + m[11]
            if z > 0 and 0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= w < shape[2]:
                cell = (np.int64(x) * shape[1] + np.int64(y)) * shape[2] + np.int64(w)
            if rgb.size > 0 and (cell >= 0 or z <= 0):
                kind = table[rgb[v, u, 0] // STEP, rgb[v, u, 1] // STEP, rgb[v, u, 2] // STEP]
                if cell >= 0 and kind >= YELLOW and _bleeds(rgb, depth, u, v, alike):
                    kind = OTHER
            if cell >= 0:
                classes[v, u], at[v, u] = kind, (kind - OTHER) * size + cell
            elif kind == GREEN:
                classes[v, u] = GREEN_NO_DEPTH


@inlined
def _bleeds(rgb, depth, u, v, alike):
    """Return whether a pixel has the colour of a background near it: then it is that, wrongly placed."""
    height, width = depth.shape
    nearer_than = depth[v, u] + np.float32(0.05)  # [m]
    for dv in (-3, 0, 3):  # [px]
        for du in (-3, 0, 3):
            j, i = v + dv, u + du
            j = 0 if j < 0 else (height - 1 if j >= height else j)
            i = 0 if i < 0 else (width - 1 if i >= width else i)
            if depth[j, i] > nearer_than or depth[j, i] <= 0:
                apart = 0
                for c in range(3):
                    step = abs(np.int64(rgb[j, i, c]) - np.int64(rgb[v, u, c]))
                    apart = step if step > apart else apart
                if apart < alike:
                    return True
    return False


def read_back(depth: NDArray[Any], camera: Array, classes: NDArray[Any], cells: NDArray[Any]) -> NDArray[np.uint8]:
    """Return one view's labels (H, W), 0 background, 1 plant, 2 flower, from what its cells (X, Y, Z) were found to be.

    A green pixel is plant unless its cell is ground. Others need a cell that holds a brown part or a flower: next to
    green parts they are background that the depth sensor's matching window fattened the plant with.
    """
    label = np.zeros((6, 7), dtype=np.uint8)  # by the pixel's colour class and by its cell
    label[GREEN] = 1
    label[GREEN, GROUND] = 0
    label[[[OTHER], [YELLOW], [WHITE]], [BROWN_CELL, FLOWER_CELL]] = 1, 2
    label[YELLOW, GREEN_CELL] = 1
    label[[YELLOW, WHITE], NEAR_FLOWER] = 2
    at = _cell_of(depth, camera, cells.shape).ravel()
    seen, labels = np.flatnonzero(at >= 0), np.zeros(depth.shape, dtype=np.uint8)
    labels.ravel()[seen] = label[classes.ravel()[seen], cells.ravel()[at[seen]]]
    return labels


def clear(
    labels: NDArray[Any], depth: NDArray[Any], camera: Array, classes: NDArray[Any], cells: NDArray[Any]
) -> NDArray[Any]:
    """Return labels (H, W) of any source freed of GROUND, of a pot's RIM and of what lies outside the cells."""
    at = _cell_of(depth, camera, cells.shape)
    cell = cells.ravel()[at]
    gone = (at < 0) | (cell == GROUND) | ((cell == RIM) & (classes == OTHER))
    return np.where((depth > 0) & gone, 0, labels).astype(np.uint8)
