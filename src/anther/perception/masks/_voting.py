"""Voxel voting for the masks: each depth pixel in the workspace votes, with its colour class, in a shared grid.

Dimensions: H x W pixels, X x Y x Z cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.compiling import compiled, read_only
from anther.core.geometry import Array, Box, Intrinsics
from anther.perception.masks._light import GREEN, GREEN_NO_DEPTH, OTHER, WHITE, YELLOW, ColourRule

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
    at = _cell_of(depth, camera, counts.shape[1:]).ravel()
    seen, classes = np.flatnonzero(at >= 0), np.zeros(depth.shape, dtype=np.uint8)  # OUTSIDE
    cell, kind = at[seen], np.full(len(seen), OTHER, dtype=np.uint8)
    if rgb is not None and rule is not None:
        colours, blind = rgb.reshape(-1, 3), np.flatnonzero(depth <= 0)
        kind = rule.classes(colours[seen])
        petals = np.flatnonzero(kind >= YELLOW)
        kind[petals[_bleeds(rgb, depth, seen[petals], rule.alike)]] = OTHER
        classes.ravel()[blind[rule.classes(colours[blind]) == GREEN]] = GREEN_NO_DEPTH
    classes.ravel()[seen] = kind
    at, petal_cells = (kind - np.int64(1)) * counts[0].size + cell, cell[kind >= YELLOW]
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


def _cell_of(depth: NDArray[Any], camera: Array, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return (H, W) the flat number of the cell that each pixel lies in; -1 beyond the grid or without depth."""
    at = np.full(depth.shape, -1, dtype=np.int64)
    _cells(read_only(depth), tuple(camera.ravel()), shape, at)
    return at


@compiled
def _cells(depth, m, shape, at):
    """Compiled, because 30 views hold 28 million pixels; `m` is a tuple to stay in registers."""
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if z > 0:
                x = (m[0] * u + (m[1] * v + m[2])) * z + m[3]
                y = (m[4] * u + (m[5] * v + m[6])) * z + m[7]
                w = (m[8] * u + (m[9] * v + m[10])) * z + m[11]
                if 0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= w < shape[2]:
                    at[v, u] = (np.int64(x) * shape[1] + np.int64(y)) * shape[2] + np.int64(w)


def _bleeds(rgb: NDArray[Any], depth: NDArray[Any], pixels: NDArray[np.int64], alike: float) -> NDArray[np.bool_]:
    """Return (n,) which pixels have the colour of a background near them: then they are that, wrongly placed.

    The pixels (n,) are counted along the rows of an image.
    """
    (height, width), colours, depths = depth.shape, rgb.reshape(-1, 3), depth.ravel()
    v, u = np.divmod(pixels, width)
    bleeding, steps, nearer_than = np.zeros(len(pixels), dtype=bool), (-3, 0, 3), depths[pixels] + np.float32(0.05)
    for dv, du in product(steps, steps):  # [px], [m]
        near = np.clip(v + dv, 0, height - 1) * width + np.clip(u + du, 0, width - 1)
        behind = np.flatnonzero((depths[near] > nearer_than) | (depths[near] <= 0))
        apart = np.abs(colours[near[behind]].astype(np.int16) - colours[pixels[behind]])
        bleeding[behind] |= apart.max(axis=1, initial=0) < alike
    return bleeding


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
