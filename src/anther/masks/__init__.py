"""Masks: which pixels show the plant and its flowers. Dimensions: V views, H x W pixels.

The default needs no weights. Every depth pixel in the workspace votes, with its colour, in a voxel grid that all
views share. There the ground (bench, soil, pot) is found by geometry (`ground.py`), brown stem parts are kept because
they join green ones, and flowers are small yellow or white blobs at the plant. The decision is carried back to the
pixels. Without colour, whatever stands above the ground is plant.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from anther.capture import Capture, viewed_box
from anther.checks import check_array, check_range
from anther.errors import StageFailure
from anther.files import read_npz, write_npz
from anther.geometry import Box
from anther.masks.ground import ground_cells
from anther.masks.voting import (
    BESIDE_FLOWER,
    BROWN_CELL,
    EMPTY,
    FLOWER_CELL,
    GREEN,
    GREEN_CELL,
    GREEN_NO_DEPTH,
    GROUND,
    LAYERS,
    PETAL_VIEWS,
    WHITE,
    YELLOW,
    ColourRule,
    Grid,
    camera_numbers,
    read_back,
    vote,
)

BACKGROUND, PLANT, FLOWER = 0, 1, 2

SCHEMA = 1


@dataclass(frozen=True, slots=True)
class Params:
    """How plant and flowers are told from the rest.

    Attributes:
        voxel: edge of the cells in which the views vote [m]; above the kinematic pose error (3.6 mm RMS, facts:
            perception) so that views agree.
        green: least excess green 2g - r - b (Woebbecke 1995) of certain vegetation, chromaticities 0..1.
        green_share, petal_share: least share of votes that makes a cell green, or petal.
        petal_cover, petal_views: a petal cell has at least this share of the pixels that one view has on a cell's
            face, in all views together, and from so many views.
        yellow_saturation: least saturation of yellow petals, 0..1.
        white_saturation: greatest saturation of white petals, 0..1.
        yellow_gain, white_gain: least brightness of petals, relative to bright leaves.
        flower_extent: greatest extent of a flower cluster (a truss) [m].
        flower_distance: a flower comes at least this close to green cells [m].
        ground_radius: a horizontal surface at least this wide is soil, bench or pot [m].
        bare_ground_radius: the same for the soil without colour, when leaves could be mistaken for it [m].
        ground_margin: what lies less than this above the ground is ground [m].
        rim_height: a pot's rim stands at most this much above its soil [m].
        attach_distance: a part that is not green belongs to the plant if it comes this close to green ones [m].
        brown_extent: greatest second extent of such a part [m]: stems and fruits are slender, walls are not.
        least_part: flowers are looked for beside green parts of at least this many cells.
        least_pixels: with fewer plant pixels in all views together there is no plant.
    """

    voxel: float = 0.005
    green: float = 0.10
    green_share: float = 0.25
    petal_share: float = 0.35
    petal_cover: float = 0.4
    petal_views: int = 3
    yellow_saturation: float = 0.45
    white_saturation: float = 0.25
    yellow_gain: float = 0.5
    white_gain: float = 0.9
    flower_extent: float = 0.12
    flower_distance: float = 0.02
    ground_radius: float = 0.035
    bare_ground_radius: float = 0.06
    ground_margin: float = 0.008
    rim_height: float = 0.05
    attach_distance: float = 0.012
    brown_extent: float = 0.08
    least_part: int = 20
    least_pixels: int = 200

    def __post_init__(self) -> None:
        check_range("mask voxel", self.voxel, 0.001, 0.05, "m")
        check_range("excess green threshold", self.green, 0, 1)
        check_range("ground radius", self.ground_radius, self.voxel, 1, "m")


@dataclass(frozen=True, slots=True, eq=False)
class Masks:
    """A label per pixel: BACKGROUND (pot, soil, bench and all else), PLANT or FLOWER.

    Attributes:
        labels: (V, H, W) uint8.
        source: what made them, for the report ("colour and geometry", "geometry", ...).
    """

    labels: NDArray[Any]
    source: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", check_array("labels", self.labels, (None, None, None), dtype="uint8"))

    def save(self, path: Path | str) -> None:
        """Write a compressed .npz."""
        write_npz(path, "masks", SCHEMA, labels=self.labels, source=self.source)

    @classmethod
    def load(cls, path: Path | str) -> Masks:
        """Read what `save` wrote.

        Raises:
            InputError: the file is missing, truncated or holds something else.
        """
        arrays = read_npz(path, "masks", SCHEMA)
        return cls(arrays["labels"], str(arrays["source"]))


def segment(capture: Capture, workspace: Box | None = None, params: Params | None = None) -> Masks:
    """Return the plant and flower pixels of every view.

    Args:
        capture: the views. Without colour, geometry alone decides and no flowers are told apart.
        workspace: where the plant may stand, world frame [m]; None means around the point where the optical
            axes meet (`capture.viewed_box`).
        params: see `Params`.

    Raises:
        StageFailure: `no_plant_found` when the views show too little plant.
    """
    params = params or Params()
    grid = Grid.over(workspace or viewed_box(capture), params.voxel)
    rule = None if capture.rgb is None else _colour_rule(capture.rgb, params)
    cameras = [camera_numbers(T, capture.intrinsics) for T in capture.T_world_cam]
    threads = 2  # each votes in a grid of its own
    counts = np.zeros((threads, LAYERS if rule else 1, *grid.shape), dtype=np.uint16)
    classes = np.zeros(capture.depth.shape, dtype=np.uint8)
    labels = np.zeros(capture.depth.shape, dtype=np.uint8)

    def vote_views(thread: int) -> None:
        for view in range(thread, capture.views, threads):
            rgb = None if capture.rgb is None else cv2.medianBlur(capture.rgb[view], 3)
            classes[view] = vote(
                rgb, capture.depth[view], camera=cameras[view], grid=grid, rule=rule, counts=counts[thread], view=view
            )

    def label_view(view: int) -> None:
        found = read_back(capture.depth[view], cameras[view], grid, classes[view], cells)
        labels[view] = _add_pixels_without_depth(found, classes[view])

    with ThreadPoolExecutor(max_workers=threads) as pool:
        list(pool.map(vote_views, range(threads)))
        votes = counts.sum(axis=0, dtype=np.uint16)
        if rule:
            cells = _cells_by_colour(votes, params, *_enough_petals(capture, grid, params))
        else:
            cells = _cells_by_geometry(votes[0], params)
        list(pool.map(label_view, range(capture.views)))
    found = int((labels > 0).sum())
    if found < params.least_pixels:
        raise StageFailure(
            "no_plant_found",
            f"masks: {found} plant pixels in {capture.views} views; at least {params.least_pixels} are needed. "
            f"Is the plant within x, y, z = {grid.lower} .. {grid.lower + np.multiply(grid.shape, grid.voxel)} m?",
        )
    return Masks(labels, "colour and geometry" if rule is not None else "geometry")


def _colour_rule(rgb: NDArray[Any], params: Params) -> ColourRule:
    """Return thresholds adapted to the light: shades-of-grey white balance, brightness relative to the leaves.

    Shades of grey with Minkowski norm p = 6: Finlayson and Trezzi 2004.
    """
    sample = rgb[:, ::16, ::16].reshape(-1, 3).astype(np.float64)
    norm = np.power(np.mean(sample**6, axis=0), 1 / 6) + 1e-9
    gains = np.clip(norm.mean() / norm, 0.75, 1.33)
    balanced = sample * gains
    excess = 3 * balanced[:, 1] / (balanced.sum(axis=1) + 1e-9) - 1
    leaves = balanced.max(axis=1)[excess > params.green]
    bright = float(np.percentile(leaves, 90)) if len(leaves) else 128.0
    return ColourRule(
        gains=(float(gains[0]), float(gains[1]), float(gains[2])),
        green=params.green,
        yellow_saturation=params.yellow_saturation,
        yellow_value=float(np.clip(params.yellow_gain * bright, 40, 200)),
        white_saturation=params.white_saturation,
        white_value=float(np.clip(params.white_gain * bright, 80, 220)),
    )


def _cells_by_geometry(votes: NDArray[Any], params: Params) -> NDArray[Any]:
    """Return what each cell is, (X, Y, Z) uint8: whatever is seen above the ground is a part of the plant."""
    below, rim = _ground(votes >= 2, params, params.bare_ground_radius, rings=False)
    return np.where(below | rim, GROUND, np.where(votes >= 2, BROWN_CELL, EMPTY)).astype(np.uint8)


def _enough_petals(capture: Capture, grid: Grid, params: Params) -> tuple[float, int]:
    """Return how many petal pixels, and from how many views, a petal cell needs."""
    centre = grid.lower + np.multiply(grid.shape, grid.voxel) / 2
    distance = float(np.median(np.linalg.norm(capture.T_world_cam[:, :3, 3] - centre, axis=1)))
    pixels = (grid.voxel * capture.intrinsics.fx / max(distance, grid.voxel)) ** 2
    return params.petal_cover * pixels, min(params.petal_views, capture.views)


def _cells_by_colour(counts: NDArray[Any], params: Params, least_votes: float, least_views: int) -> NDArray[Any]:
    """Return what each cell is, (X, Y, Z) uint8, from the votes (LAYERS, X, Y, Z)."""
    total = counts[:PETAL_VIEWS].sum(axis=0, dtype=np.int32)
    green = counts[GREEN - 1] >= np.maximum(2, params.green_share * total)
    occupied = total >= 2
    below, rim = _ground((total >= 5) & (counts[GREEN - 1] <= 0.1 * total), params, params.ground_radius, rings=True)
    rest = occupied & ~green & ~below & ~rim
    cells = np.where(below | (rim & ~green), GROUND, EMPTY).astype(np.uint8)
    green &= ~below
    cells[green] = GREEN_CELL
    petal_votes = counts[YELLOW - 1].astype(np.int32) + counts[WHITE - 1]
    seen_often = (petal_votes >= least_votes) & (counts[PETAL_VIEWS] >= least_views)
    petals = occupied & ~below & ~rim & seen_often & (petal_votes >= params.petal_share * total)
    flowers = _parts_near(
        petals,
        _large_parts(green & ~petals, params.least_part),
        distance=params.flower_distance,
        extent=params.flower_extent,
        axis=0,
        voxel=params.voxel,
    )
    brown = _parts_near(
        rest & ~flowers, green, distance=params.attach_distance, extent=params.brown_extent, axis=1, voxel=params.voxel
    )
    cells[brown] = BROWN_CELL
    cells[(ndimage.maximum_filter(flowers.astype(np.uint8), size=3) > 0) & (cells != GROUND)] = BESIDE_FLOWER
    cells[flowers] = FLOWER_CELL
    return cells


def _ground(
    solid: NDArray[np.bool_], params: Params, sure_radius: float, *, rings: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    return ground_cells(
        solid,
        params.voxel,
        radius=params.ground_radius,
        sure_radius=sure_radius,
        margin=params.ground_margin,
        rim_height=params.rim_height,
        rings=rings,
    )


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


def _add_pixels_without_depth(labels: NDArray[Any], classes: NDArray[Any]) -> NDArray[Any]:
    """Return the labels with green patches without depth added where they hang together with plant pixels."""
    patches = ((labels > 0) | (classes == GREEN_NO_DEPTH)).astype(np.uint8)
    count, patch = cv2.connectedComponents(patches, connectivity=8)
    holds_plant = np.zeros(count, dtype=bool)
    holds_plant[np.unique(patch[labels > 0])] = True
    labels[(classes == GREEN_NO_DEPTH) & holds_plant[patch]] = PLANT
    return labels
