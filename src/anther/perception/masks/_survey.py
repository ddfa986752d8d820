"""What all views together saw: the colour class of each pixel, the votes in the grid, and where the ground is.

The ground, that is bench, soil and pot, is found by its horizontal extent: where a horizontal slab holds a disc wider
than any stem and nothing is seen below it; a pot whose soil is hidden is found as a closed ring.
Dimensions: V views, H x W pixels, X x Y x Z cells, z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Box, Intrinsics
from anther.core.opencv import cv2
from anther.perception.capture import Capture, in_threads, viewed_box
from anther.perception.masks._light import GREEN, ColourRule, Light, green_rule, learned_rule
from anther.perception.masks._voting import (
    BROWN_CELL,
    EMPTY,
    LAYERS,
    PETAL_VIEWS,
    Grid,
    Observation,
    observe,
    read_back,
    vote,
)

if TYPE_CHECKING:
    from anther.perception.masks import Params

VOXEL = 0.005
"""Edge of the cells in which the views vote [m]; above the kinematic pose error (3.6 mm RMS, facts: perception) so that
views agree."""
GROUND_MARGIN = 0.008  # what lies less than this above the ground is ground [m]


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What the views saw.

    Attributes:
        grid: the cells.
        observed: of each view, what it shows of the cells.
        classes: of each view, the colour classes (N,) of its pixels in the cells (`_light.OUTSIDE` and what follows).
        rule: which classed the colours; None without colour.
        votes: (LAYERS, X, Y, Z) uint16, or (1, X, Y, Z) without colour.
        total: (X, Y, Z) votes of every colour.
        below: (X, Y, Z) cells that are ground, whatever their colour.
        rim: (X, Y, Z) cells about a pot's wall and rim, where only what is green is plant.
        source: what separated plant from the rest, for `Masks.source`.
    """

    grid: Grid
    observed: Sequence[Observation]
    classes: list[NDArray[np.uint8]]
    rule: ColourRule | None
    votes: NDArray[Any]
    total: NDArray[Any]
    below: NDArray[np.bool_]
    rim: NDArray[np.bool_]
    source: str

    def image(self, view: int) -> NDArray[np.uint8]:
        """Return the colour classes (H, W) of a view's pixels."""
        return self.observed[view].image(self.classes[view], self.rule)

    def foot(self, plant: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the ground cells (X, Y, Z) that hold the foot of a stem of `plant` (X, Y, Z)."""
        return foot_cells(plant, self.below, self.grid.voxel)


def grid_over(workspace: Box, *, coloured: bool) -> Grid:
    """Return the grid in which views of a workspace vote."""
    layers = LAYERS if coloured else 1
    return Grid.over(workspace, VOXEL, 2.5e9 / (2 * layers + 16))  # bytes in all


def survey(capture: Capture, workspace: Box | None, params: Params, observations: Sequence[Observation] = ()) -> Survey:
    """Let all views vote, and find the ground in the votes; without `observations` of the views, these are made."""
    grid = grid_over(workspace or viewed_box(capture), coloured=capture.rgb is not None)
    observed = observations or in_threads(lambda view: observe(capture.view(view), grid), range(capture.views))
    rule = None
    if capture.rgb is not None:
        light = Light.on(capture.rgb, params.green)
        rule = green_rule(light, params) if light.holds_green else _learned(capture, grid, params)
    votes = np.zeros((LAYERS if rule else 1, *grid.shape), dtype=np.uint16)

    def voted(view: int) -> NDArray[np.uint8]:
        classes = observed[view].classes(rule)
        vote(observed[view], classes, votes)
        return classes

    classes = in_threads(voted, range(capture.views))
    total = votes[0].astype(np.int32)
    for layer in votes[1:PETAL_VIEWS]:  # NumPy's `sum` over so few takes five times as long
        total += layer
    seen = total >= 2
    if rule is None or rule.learned:
        soil = 0.06  # [m]: without colour, a leaf of 35 mm could be mistaken for it
        below, rim = ground_cells(seen, seen, VOXEL, params.ground_radius, soil, rings=False)
    else:
        bare = total >= 5
        bare[bare] = votes[GREEN - 1][bare] <= 0.1 * total[bare]
        below, rim = ground_cells(bare, seen, VOXEL, params.ground_radius, params.ground_radius, rings=True)
    source = "geometry" if rule is None else "geometry; light without green" if rule.learned else "colour and geometry"
    return Survey(grid, observed, classes, rule, votes, total, below, rim, source)


def _learned(capture: Capture, grid: Grid, params: Params) -> ColourRule:
    """Learn the colours of plant and surroundings from every third pixel, where geometry is sure."""
    assert capture.rgb is not None
    step, k, box = 3, capture.intrinsics, Box(grid.lower, grid.lower + np.multiply(grid.shape, grid.voxel))
    depth = np.ascontiguousarray(capture.depth[:, ::step, ::step])
    rgb = np.ascontiguousarray(capture.rgb[:, ::step, ::step])
    scale = np.array([k.fx, k.fy, k.cx, k.cy]) / step
    coarse = Intrinsics(depth.shape[2], depth.shape[1], *map(float, scale))
    bare = survey(Capture(depth, coarse, capture.T_world_cam), box, params)
    cells = np.where((bare.votes[0] > 0) & ~bare.below & ~bare.rim, BROWN_CELL, EMPTY).astype(np.uint8)
    window, sure = np.ones((3, 3), np.uint8), ([], [])
    for view in range(capture.views):
        plant = read_back(bare.observed[view], bare.classes[view], cells)
        rest = ((depth[view] > 0) & (plant == 0)).astype(np.uint8)
        for colours, part in zip(sure, (plant, rest), strict=True):
            colours.append(rgb[view][cv2.erode(part, window) > 0])
    return learned_rule(np.concatenate(sure[0]), np.concatenate(sure[1]))


def ground_cells(
    solid: NDArray[np.bool_], seen: NDArray[np.bool_], voxel: float, radius: float, sure_radius: float, *, rings: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which cells belong to the ground.

    Args:
        solid: (X, Y, Z) occupied cells that are not vegetation.
        seen: (X, Y, Z) occupied cells; where plants hang below a surface, as below a wire's spool, it is no ground.
        voxel: edge of a cell [m].
        radius: of the disc that a horizontal surface must hold up to the height of the soil [m].
        sure_radius: of the disc that the soil itself must hold, with little seen below it [m].
        rings: whether a closed ring counts as a surface (a pot whose soil is hidden by leaves); it needs colour,
            because leaves seen without colour also form rings.

    Returns:
        (below, rim): two (X, Y, Z) masks. Nothing in `below` is plant, whatever its colour; in `rim`, the zone about
        a pot's wall and rim, only what is green is plant.
    """
    slabs = _slabs(solid, voxel)
    lowest = np.where(np.any(seen, axis=2), np.argmax(seen, axis=2), seen.shape[2])
    sure, disc = (_disc(r / voxel) for r in (sure_radius, radius))
    height = np.full(solid.shape[:2], -1)
    for level, slab in slabs:
        opaque = _opaque(_eroded(slab, sure), lowest, level, voxel)
        height[cv2.dilate(opaque, sure) > 0] = level
    rim = 0.05 / voxel  # cells; m, at most so far is a pot's rim above its soil
    top = height.max() + rim
    for level, slab in slabs:
        if level <= top:
            height[(cv2.dilate(_eroded(slab, disc), disc) > 0) & (height < level)] = level
    height = _extended(height, radius / voxel)
    if rings:
        wall = _wall_heights(slabs, solid.shape[:2], disc, voxel)
        height = np.where(wall - height > rim, wall, height)
    levels = np.arange(solid.shape[2])
    below = levels[None, None, :] <= (height + GROUND_MARGIN / voxel)[:, :, None]
    return below, _rim_zone(height, levels, voxel, rim)


def foot_cells(plant: NDArray[np.bool_], below: NDArray[np.bool_], voxel: float) -> NDArray[np.bool_]:
    """Return the cells just below the top of the ground (X, Y, Z) that carry on a stem above it.

    The margin above the soil belongs to the ground, and a stem would begin above it. What rises from that layer and is
    no wider than 40 mm, as the errors of the poses spread it, is a stem, carried on straight down through the margin.
    """
    top = below.sum(axis=2)[:, :, None]
    above = np.minimum(top + np.arange(2), below.shape[2] - 1)
    standing = np.any(np.take_along_axis(plant & ~below, above, axis=2), axis=2)
    _, parts, stats, _ = cv2.connectedComponentsWithStats(np.asarray(standing, dtype=np.uint8), connectivity=8)
    narrow = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) <= 0.04 / voxel
    narrow[0] = False
    foot = np.zeros_like(below)
    carried = np.maximum(top - 1 - np.arange(1 + int(GROUND_MARGIN / voxel)), 0)
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
    """Return the highest level (X, Y) of a closed wall around each column; -1 without one.

    A closed ring is a wall if it goes on over 40 mm; leaves close rings over less.
    """
    wall, run, last = np.full(shape, -1), np.zeros(shape, dtype=np.int64), -1
    for level, slab in slabs:
        inside = cv2.dilate(_eroded(_filled(slab), disc), disc) > 0
        run = np.where(inside, np.where(level == last + 1, run, 0) + 1, 0)
        wall[run >= 0.04 / voxel] = level
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
    """Return the patches of `centres` (X, Y) with something seen below less than 0.3 of them: others are foliage, or
    hang above some. Of a patch that is narrower than 20 mm, what is around it counts too."""
    if not centres.any():
        return centres
    seen_below, disc = lowest < level - 0.04 / voxel, _disc(0.01 / voxel)
    around = cv2.dilate(centres, disc)
    count, numbered = cv2.connectedComponents(around, connectivity=8)
    patch = np.asarray(numbered, dtype=np.int64)
    wide = np.bincount(patch[centres > 0], minlength=count) >= disc.sum()
    counts = np.where(wide[patch], centres, around).ravel() > 0
    share = np.bincount(patch.ravel()[counts], weights=seen_below.ravel()[counts], minlength=count)
    opaque = share < 0.3 * np.bincount(patch.ravel()[counts], minlength=count)
    return centres * opaque[patch]


def _rim_zone(height: NDArray[Any], levels: NDArray[Any], voxel: float, rim: float) -> NDArray[np.bool_]:
    """Return the cells (X, Y, Z) about the edge of every raised surface, up to so many cells above it."""
    reach = _disc(0.025 / voxel)
    around = height.astype(np.float32)
    highest, lowest = cv2.dilate(around, reach), cv2.erode(around, reach)
    step = highest - lowest > 0.02 / voxel
    top = np.where(step, highest + rim, -1.0)
    return levels[None, None, :] <= top[:, :, None]


def _disc(radius: float) -> NDArray[np.uint8]:
    n = max(1, round(radius))
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    return (x * x + y * y <= (n + 0.3) ** 2).astype(np.uint8)
