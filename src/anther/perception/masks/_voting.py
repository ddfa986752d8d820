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
from anther.core.geometry import Array, Box
from anther.core.opencv import cv2
from anther.perception.capture import View
from anther.perception.masks._light import GREEN, GREEN_NO_DEPTH, OTHER, STEP, STEPS, WHITE, YELLOW, ColourRule

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


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """What one view shows of a grid, whatever the light. N pixels with depth in the grid, B without depth.

    Attributes:
        shape: (H, W).
        pixels: (N,) int32 where in the image, counted along the rows.
        cells: (N,) int32 where in the grid, its flat number.
        colours: (N,) int32 where in a `ColourRule.table`, its flat number; 0 without colour.
        apart: (N,) uint8 how much the colour differs from that of a background near the pixel; 255 without any.
        blind: (B,) int32 pixels without depth; none without colour.
        blind_colours: (B,) int32 of these.
    """

    shape: tuple[int, ...]
    pixels: NDArray[np.int32]
    cells: NDArray[np.int32]
    colours: NDArray[np.int32]
    apart: NDArray[np.uint8]
    blind: NDArray[np.int32]
    blind_colours: NDArray[np.int32]

    def classes(self, rule: ColourRule | None) -> NDArray[np.uint8]:
        """Return the colour classes (N,); without a rule they are OTHER."""
        if rule is None:
            return np.full(len(self.pixels), OTHER, dtype=np.uint8)
        found = rule.table.ravel()[self.colours]
        found[(found >= YELLOW) & (self.apart < rule.alike)] = OTHER  # the background's colour, wrongly placed
        return found

    def image(self, classes: NDArray[np.uint8], rule: ColourRule | None) -> NDArray[np.uint8]:
        """Return the colour classes (H, W) of all pixels, of which these (N,) have depth in the grid."""
        image = np.zeros(self.shape, dtype=np.uint8)
        image.ravel()[self.pixels] = classes
        if rule is not None:
            image.ravel()[self.blind[rule.table.ravel()[self.blind_colours] == GREEN]] = GREEN_NO_DEPTH
        return image


def observe(view: View, grid: Grid) -> Observation:
    """Return what a view shows of a grid."""
    depth, none = view.depth, np.zeros((0, 0, 0), np.uint8)
    rgb = none if view.rgb is None else np.asarray(cv2.medianBlur(view.rgb, 3), dtype=np.uint8)
    near, blind = (np.empty((2, depth.size), dtype=np.int32) for _ in range(2))
    colours, apart = np.zeros(depth.size, dtype=np.int32), np.empty(depth.size, dtype=np.uint8)
    camera = tuple(_pixels_to_cells(view, grid).ravel())
    n, b = _observe(read_only(rgb), read_only(depth), camera, grid.shape, near, colours, apart, blind)
    pixels, cells = near[:, :n].copy()  # not held with room for all
    return Observation(depth.shape, pixels, cells, colours[:n].copy(), apart[:n].copy(), *blind[:, :b].copy())


def _pixels_to_cells(view: View, grid: Grid) -> Array:
    """Return (3, 4) M: M (u z, v z, z, 1) is where among the cells pixel (u, v) of depth z lies, not yet rounded."""
    k, T = view.intrinsics, np.asarray(view.T_world_cam)
    rays = np.array([[1 / k.fx, 0, -k.cx / k.fx], [0, 1 / k.fy, -k.cy / k.fy], [0, 0, 1]])
    return np.column_stack([T[:3, :3] @ rays, T[:3, 3] - grid.lower]) / grid.voxel


@compiled
def _observe(rgb, depth, m, shape, near, colours, apart, blind):
    """Fill the columns of an `Observation`, and return how many pixels there are with depth in the grid, and without.

    Compiled, because 30 views hold 28 million pixels; `m` is a tuple to stay in registers.
    """
    n = b = 0
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if z > 0:
                x = (m[0] * u + (m[1] * v + m[2])) * z + m[3]
                y = (m[4] * u + (m[5] * v + m[6])) * z + m[7]
                w = (m[8] * u + (m[9] * v + m[10])) * z + m[11]
                if 0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= w < shape[2]:
                    near[0, n] = v * depth.shape[1] + u
                    near[1, n] = (np.int64(x) * shape[1] + np.int64(y)) * shape[2] + np.int64(w)
                    if rgb.size > 0:
                        colours[n], apart[n] = _colour(rgb, u, v), _apart(rgb, depth, u, v)
                    n += 1
            elif rgb.size > 0:
                blind[0, b], blind[1, b] = v * depth.shape[1] + u, _colour(rgb, u, v)
                b += 1
    return n, b


@inlined
def _colour(rgb, u, v):
    """Return where in a flat table the colour of a pixel stands."""
    return (rgb[v, u, 0] // STEP * STEPS + rgb[v, u, 1] // STEP) * STEPS + rgb[v, u, 2] // STEP


@inlined
def _apart(rgb, depth, u, v):
    """Return by how much a pixel's colour differs from those of a background near it, in the channel where most."""
    height, width = depth.shape
    nearer_than, least = depth[v, u] + np.float32(0.05), 255  # [m], [grey levels]
    for dv in (-3, 0, 3):  # [px]
        for du in (-3, 0, 3):
            j, i = v + dv, u + du
            j = 0 if j < 0 else (height - 1 if j >= height else j)
            i = 0 if i < 0 else (width - 1 if i >= width else i)
            if depth[j, i] > nearer_than or depth[j, i] <= 0:
                most = 0
                for c in range(3):
                    step = abs(np.int64(rgb[j, i, c]) - np.int64(rgb[v, u, c]))
                    most = step if step > most else most
                least = most if most < least else least
    return least


def vote(observed: Observation, classes: NDArray[np.uint8], counts: NDArray[np.uint16]) -> None:
    """Add one view's pixels, of these colour classes (N,), to `counts`, in place.

    Those are (LAYERS, X, Y, Z); without colour the first layer is enough.
    """
    at = (classes - np.int32(OTHER)) * np.int32(counts[0].size) + observed.cells
    petal_cells = observed.cells[classes >= YELLOW]
    with _COUNTING:
        np.add.at(counts.reshape(-1), at, np.uint16(1))
        if len(petal_cells):
            counts[PETAL_VIEWS].ravel()[petal_cells] += 1  # one of each cell, however often it is named


def read_back(observed: Observation, classes: NDArray[np.uint8], cells: NDArray[Any]) -> NDArray[np.uint8]:
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
    labels = np.zeros(observed.shape, dtype=np.uint8)
    labels.ravel()[observed.pixels] = label.ravel()[classes * label.shape[1] + cells.ravel()[observed.cells]]
    return labels


def clear(
    labels: NDArray[Any], depth: NDArray[Any], observed: Observation, classes: NDArray[np.uint8], cells: NDArray[Any]
) -> NDArray[Any]:
    """Return labels (H, W) of any source freed of GROUND, of a pot's RIM and of what lies outside the cells."""
    cell, kept = cells.ravel()[observed.cells], np.where(depth > 0, np.uint8(0), labels)
    plant = observed.pixels[(cell != GROUND) & ((cell != RIM) | (classes != OTHER))]
    kept.ravel()[plant] = labels.ravel()[plant]
    return kept
