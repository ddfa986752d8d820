"""What all views together saw: the colour class of each pixel, the votes in the grid, and where the ground is.

Dimensions: V views, H x W pixels, X x Y x Z cells.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.capture import Capture, viewed_box
from anther.geometry import Array, Box, Intrinsics
from anther.masks._ground import foot_cells, ground_cells
from anther.masks._light import GREEN, ColourRule, Light, green_rule, learned_rule
from anther.masks._voting import BROWN_CELL, EMPTY, LAYERS, PETAL_VIEWS, Grid, pixels_to_cells, read_back, vote

if TYPE_CHECKING:
    from anther.masks import Params

_THREADS = 2  # each votes in a grid of its own
_MOST_BYTES = 2.5e9  # of the votes, the sums and masks of all cells together
_COARSE = 3  # step of the pixels that the colours are learned from

VOXEL = 0.005
"""Edge of the cells in which the views vote [m]; above the kinematic pose error (3.6 mm RMS, facts: perception) so that
views agree."""
RIM_HEIGHT = 0.05
"""A pot's rim stands at most this much above its soil [m]."""
GROUND_MARGIN = 0.008  # what lies less than this above the ground is ground [m]
BARE_GROUND_RADIUS = 0.06
"""`Params.ground_radius` for the soil without colour, when leaves could be mistaken for it [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What the views saw.

    Attributes:
        grid: the cells.
        cameras: (V, 3, 4) see `pixels_to_cells`.
        classes: (V, H, W) uint8, see `light.OUTSIDE` and what follows.
        votes: (LAYERS, X, Y, Z) uint16, or (1, X, Y, Z) without colour.
        total: (X, Y, Z) votes of every colour.
        below: (X, Y, Z) cells that are ground, whatever their colour.
        rim: (X, Y, Z) cells about a pot's wall and rim, where only what is green is plant.
        source: what told plant from the rest, for `Masks.source`.
    """

    grid: Grid
    cameras: Array
    classes: NDArray[Any]
    votes: NDArray[Any]
    total: NDArray[Any]
    below: NDArray[np.bool_]
    rim: NDArray[np.bool_]
    source: str

    def foot(self, plant: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the ground cells (X, Y, Z) that hold the foot of a stem of `plant` (X, Y, Z)."""
        return foot_cells(plant, self.below, self.grid.voxel, GROUND_MARGIN)


def survey(capture: Capture, workspace: Box | None, params: Params) -> Survey:
    """Let all views vote, and find the ground in the votes."""
    layers = 1 if capture.rgb is None else LAYERS
    grid = Grid.over(workspace or viewed_box(capture), VOXEL, _MOST_BYTES / (2 * _THREADS * layers + 16))
    rule, light = None, None
    if capture.rgb is not None:
        light = Light.on(capture.rgb, params.green)
        rule = green_rule(light, params) if light.holds_green else _learned(capture, grid, params)
    cameras = np.stack([pixels_to_cells(T, capture.intrinsics, grid) for T in capture.T_world_cam])
    classes, votes = _votes(capture, grid, cameras, rule)
    total = votes[:PETAL_VIEWS].sum(axis=0, dtype=np.int32)
    if rule is None or rule.learned:
        below, rim = _ground(total >= 2, params, BARE_GROUND_RADIUS, rings=False)
    else:
        bare = (total >= 5) & (votes[GREEN - 1] <= 0.1 * total)
        below, rim = _ground(bare, params, params.ground_radius, rings=True)
    source = "geometry" if rule is None else "geometry; light without green" if rule.learned else "colour and geometry"
    return Survey(grid, cameras, classes, votes, total, below, rim, source)


def each_view(work: Callable[[int], object], views: int) -> None:
    """Do `work` for every view number, on two threads."""
    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(work, range(views)))


def _votes(
    capture: Capture, grid: Grid, cameras: Array, rule: ColourRule | None
) -> tuple[NDArray[Any], NDArray[np.uint16]]:
    """Return the classes (V, H, W) and the votes of all views."""
    counts = np.zeros((_THREADS, LAYERS if rule else 1, *grid.shape), dtype=np.uint16)
    classes = np.zeros(capture.depth.shape, dtype=np.uint8)

    def vote_views(thread: int) -> None:
        for view in range(thread, capture.views, _THREADS):
            rgb = None if capture.rgb is None else cv2.medianBlur(capture.rgb[view], 3)
            classes[view] = vote(
                rgb, capture.depth[view], camera=cameras[view], rule=rule, counts=counts[thread], view=view
            )

    def add_layer(layer: int) -> None:
        counts[0, layer] += counts[1, layer]

    each_view(vote_views, _THREADS)
    each_view(add_layer, counts.shape[1])
    return classes, counts[0]


def _learned(capture: Capture, grid: Grid, params: Params) -> ColourRule:
    """Learn the colours of plant and surroundings from every third pixel, where geometry is sure."""
    assert capture.rgb is not None
    k, box = capture.intrinsics, Box(grid.lower, grid.lower + np.multiply(grid.shape, grid.voxel))
    depth = np.ascontiguousarray(capture.depth[:, ::_COARSE, ::_COARSE])
    rgb = np.ascontiguousarray(capture.rgb[:, ::_COARSE, ::_COARSE])
    scale = np.array([k.fx, k.fy, k.cx, k.cy]) / _COARSE
    coarse = Intrinsics(depth.shape[2], depth.shape[1], *map(float, scale))
    bare = survey(Capture(depth, coarse, capture.T_world_cam), box, params)
    cells = np.where((bare.votes[0] > 0) & ~bare.below & ~bare.rim, BROWN_CELL, EMPTY).astype(np.uint8)
    window, sure = np.ones((3, 3), np.uint8), ([], [])
    for view in range(capture.views):
        plant = read_back(depth[view], bare.cameras[view], bare.classes[view], cells)
        rest = ((depth[view] > 0) & (plant == 0)).astype(np.uint8)
        for colours, part in zip(sure, (plant, rest), strict=True):
            colours.append(rgb[view][cv2.erode(part, window) > 0])
    return learned_rule(np.concatenate(sure[0]), np.concatenate(sure[1]))


def _ground(
    solid: NDArray[np.bool_], params: Params, sure_radius: float, *, rings: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    return ground_cells(
        solid,
        VOXEL,
        radius=params.ground_radius,
        sure_radius=sure_radius,
        margin=GROUND_MARGIN,
        rim_height=RIM_HEIGHT,
        rings=rings,
    )
