"""Masks: which pixels show the plant and its flowers. Dimensions: V views, H x W pixels.

The default needs no weights. Every depth pixel in the workspace votes, with its colour, in a voxel grid that all
views share. There the ground (bench, soil, pot) is found by geometry, brown stem parts are kept because
they join green ones, and flowers are small yellow or white blobs at the plant. The decision is carried back to the
pixels. Without colour, whatever rises above the ground is plant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_array
from anther.core.errors import StageFailure
from anther.core.geometry import Box
from anther.core.opencv import cv2
from anther.core.records import Range, Record, Shape, Share, Stored
from anther.perception.capture import Capture, View, in_threads
from anther.perception.masks._cells import kinds
from anther.perception.masks._light import GREEN, GREEN_NO_DEPTH, Light, green_rule
from anther.perception.masks._survey import VOXEL, grid_over, survey
from anther.perception.masks._voting import EMPTY, GROUND, RIM, Observation, clear, observe, read_back

__all__ = [
    "BACKGROUND", "FLOWER", "PLANT", "Masks", "Observation", "Params", "green_pixels", "observed", "segment",
    "without_ground",
]  # fmt: skip

BACKGROUND, PLANT, FLOWER = range(3)

LEAST_PIXELS = 200
"""With fewer plant pixels in all views together there is no plant."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How plant and flowers are separated from the rest.

    Attributes:
        green: least excess green 2g - r - b (Woebbecke 1995) of certain vegetation, chromaticities 0..1.
        white_petals: whether petals may be white, as of most peppers, besides yellow. Of tomatoes they are not, and
            leaves that shine are then not taken for them.
        ground_radius: a horizontal surface at least this wide is soil, bench or pot [m].
    """

    green: Share = 0.10
    white_petals: bool = True
    ground_radius: Annotated[float, Range(VOXEL, 1, "m")] = 0.035


@dataclass(frozen=True, slots=True, eq=False)
class Masks(Stored):
    """A label per pixel: BACKGROUND (pot, soil, bench and all else), PLANT or FLOWER.

    Attributes:
        labels: (V, H, W) uint8.
        source: what made them, for the report ("colour and geometry", "geometry", ...).
    """

    KIND, SCHEMA = "masks", 2
    labels: Annotated[NDArray[np.uint8], Shape("V", "H", "W")]
    source: str


def observed(view: View, workspace: Box) -> Observation:
    """Return what a view shows of the workspace: what `segment` can know of it before it knows the others."""
    return observe(view, grid_over(workspace, coloured=view.rgb is not None))


def segment(
    capture: Capture,
    workspace: Box | None = None,
    params: Params | None = None,
    observations: Sequence[Observation] = (),
) -> Masks:
    """Return the plant and flower pixels of every view.

    Args:
        capture: the views. Without colour, geometry alone decides and no flowers are found.
        workspace: where the plant may be, world frame [m]; None means around the point where the optical
            axes meet (`capture.viewed_box`).
        params: see `Params`.
        observations: of each view in this workspace, where they were made as it came; none: they are made now.

    Raises:
        StageFailure: `no_plant_found` when the views show too little plant.
    """
    params = params or Params()
    seen = survey(capture, workspace, params, observations)
    cells = kinds(seen, capture)
    labels = np.empty(capture.depth.shape, dtype=np.uint8)

    def label_view(view: int) -> None:
        found = read_back(seen.observed[view], seen.classes[view], cells)
        labels[view] = _add_pixels_without_depth(found, seen.image(view))

    in_threads(label_view, range(capture.views))
    found = int(np.count_nonzero(labels))
    if found < LEAST_PIXELS:
        lower, size = seen.grid.lower, np.multiply(seen.grid.shape, seen.grid.voxel)
        raise StageFailure(
            "no_plant_found",
            f"masks: {found} plant pixels in {len(labels)} views; at least {LEAST_PIXELS} are needed. "
            f"Is the plant within x, y, z = {lower} .. {lower + size} m?",
        )
    return Masks(labels, seen.source)


def green_pixels(rgb: NDArray[Any], params: Params | None = None) -> NDArray[np.bool_]:
    """Return (H, W) which pixels of one colour image (H, W, 3) uint8 are as green as leaves; none without green light.

    Colour alone does not tell a plant from others behind it; `segment` does.
    """
    params = params or Params()
    light = Light.on(rgb[None], params.green)
    classes = green_rule(light, params).classes(rgb)
    return (classes == GREEN) & light.holds_green


def without_ground(masks: Masks, capture: Capture, workspace: Box | None = None, params: Params | None = None) -> Masks:
    """Return masks of any source freed of pot, soil, bench and all that lies outside the workspace.

    Segmentation networks bleed into the pot (the paper's first weakness). The ground is found as `segment` finds it,
    by geometry; about the pot's rim colour decides, if there is any. The foot of a stem is kept.

    Args:
        masks: of the same views.
        capture, workspace, params: as in `segment`.

    Raises:
        InputError: masks and capture differ in shape.
    """
    params = params or Params()
    labels = check_array("mask labels", masks.labels, capture.depth.shape, dtype="uint8")
    seen = survey(capture, workspace, params)
    masked = np.zeros(seen.grid.shape, dtype=np.uint16)
    for view, one in enumerate(seen.observed):
        np.add.at(masked.reshape(-1), one.cells[labels[view].ravel()[one.pixels] > 0], np.uint16(1))
    foot = seen.foot((masked >= 2) & ~seen.rim)
    rim = RIM if capture.rgb is not None else GROUND
    cells = np.where(seen.below & ~foot, GROUND, np.where(seen.rim & ~foot, rim, EMPTY)).astype(np.uint8)
    kept = np.empty_like(labels)

    def clear_view(view: int) -> None:
        depth = capture.depth[view]
        kept[view] = clear(labels[view], depth, seen.observed[view], seen.classes[view], cells)
        _drop_pixels_without_depth(kept[view], labels[view], depth, seen.image(view))

    in_threads(clear_view, range(capture.views))
    return Masks(kept, masks.source)


def _add_pixels_without_depth(labels: NDArray[Any], classes: NDArray[Any]) -> NDArray[Any]:
    """Return the labels with green patches without depth added where they border the plant and not green ground.

    What is nearer than the sensor's least range has no depth, and neither has the stereo shadow next to a leaf: in
    light without green that may be soil, as dark as a leaf.
    """
    ground = (labels == 0) & (classes == GREEN)
    labels.ravel()[_patches_of(classes == GREEN_NO_DEPTH, labels > 0, ground)] = PLANT
    return labels


def _drop_pixels_without_depth(
    kept: NDArray[Any], labels: NDArray[Any], depth: NDArray[Any], classes: NDArray[Any]
) -> None:
    """Drop patches without depth (in place) that are not green and border more of what was dropped than of the rest."""
    blind = (labels > 0) & (depth <= 0) & (classes != GREEN_NO_DEPTH)
    stayed = _patches_of(blind, (kept > 0) & ~blind, (labels > 0) & (kept == 0))
    blind.ravel()[stayed] = False
    kept[blind] = 0


def _patches_of(blind: NDArray[np.bool_], plant: NDArray[np.bool_], ground: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the pixels (n,), counted along the rows, of connected patches of `blind` (H, W) that border `plant`, and
    `ground` at most 0.6 times as long."""
    count, numbered = cv2.connectedComponents(blind.view(np.uint8), connectivity=8)
    pixels, window = np.flatnonzero(blind), np.ones((5, 5), np.uint8)
    patch = np.asarray(numbered, dtype=np.int32).ravel()[pixels]
    near_plant, near_ground = (
        np.bincount(patch, cv2.dilate(part.view(np.uint8), window).ravel()[pixels], minlength=count)
        for part in (plant, ground)
    )
    return pixels[((near_plant > 0) & (near_ground <= 0.6 * near_plant))[patch]]
