"""Plant and flowers in colour images without depth: the colour rule, then only what hangs together. H x W pixels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.core import StageFailure
from anther.core.checks import check_array
from anther.perception import Masks
from anther.perception.masks import LEAST_PIXELS, Params
from anther.perception.masks._light import GREEN, WHITE, YELLOW, ColourRule, Light, green_rule, saturation

_BESIDE = 5  # how close to green a petal comes [px]

LEAST_SHADE = 0.25
"""What is darker than this share of lit leaves is not looked at."""
LEAST_PATCH, PETAL_PATCH, GOLDEN_PATCH = 2e-5, 1e-3, 2e-2
"""Least share of the image that a green patch has, and greatest that a petal patch has: any, and a golden one."""
GOLDEN_SATURATION, GOLDEN_GREEN, GOLDEN_GAIN = 0.65, 0.8, 0.7
"""Least saturation of golden petals, 0..1, their least green relative to red (oranges and ripening fruit have less) and
their least brightness relative to bright leaves. Chosen on half of the photographs of docs/reports/masks.md."""
COLOURFUL = 0.5
"""What is as saturated as this, 0..1, is left out when the lamp is estimated for petals."""
WHITE_SCENE = 0.05
"""Where more than this share of the image is white, small white patches are gaps in the foliage, not petals."""


def segment_images(rgb: NDArray[Any], params: Params | None = None) -> Masks:
    """Return the plant and flower pixels of colour images (V, H, W, 3) uint8 without depth or poses.

    Colour alone cannot tell plants behind from the plant in front, nor a green pot from leaves.

    Raises:
        StageFailure: `no_plant_found` when the images show too little green, or the light holds none.
    """
    params = params or Params()
    images = check_array("images", rgb, (None, None, None, 3), dtype="uint8")
    light = Light.on(images, params.green)
    labels = np.zeros(images.shape[:3], dtype=np.uint8)
    if light.holds_green:
        rule, greys = green_rule(light, params), Light.on(images, params.green, COLOURFUL)
        for view in range(len(images)):
            labels[view] = labels_of_image(images[view], rule, light, greys)
    found = int((labels > 0).sum())
    if found < LEAST_PIXELS:
        raise StageFailure(
            "no_plant_found", f"{found} plant pixels; is it green, and the light not that of red grow lamps?"
        )
    return Masks(labels, "colour")


def labels_of_image(rgb: NDArray[Any], rule: ColourRule, light: Light, greys: Light) -> NDArray[np.uint8]:
    """Return the labels (H, W) uint8 of one image (H, W, 3): 0 background, 1 plant, 2 flower.

    `rule` and `light` take all that is not green for grey; `greys` leaves out what is `COLOURFUL`. Only petals are
    looked for in the latter: under mixed grow lamps bluish leaves are green in the former alone.

    What is much darker than lit leaves has no trustworthy colour: a black cloth in a JPEG is green in places. Green
    patches smaller than `LEAST_PATCH` of the image are noise. Of the small patches that touch green, golden ones are
    petals. White ones are, if they cover more than the golden ones, since a plant has petals of one colour and leaves
    that shine; and if little else is white: before white film or sky each gap between leaves looks like a petal. Other
    yellow ones are plant, because pods and young leaves are as yellow.
    """
    image = cv2.medianBlur(rgb, 3)
    classes = rule.classes(image)
    lit = image.max(axis=2) >= LEAST_SHADE * light.leaf
    green = _patches((classes == GREEN) & lit, least=LEAST_PATCH * classes.size)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_BESIDE, _BESIDE))
    near = cv2.dilate(green.astype(np.uint8), window) > 0
    yellow, white = (
        _patches(classes == colour, most=PETAL_PATCH * classes.size, touching=near) for colour in (YELLOW, WHITE)
    )
    petals = _patches(_golden(image, greys), most=GOLDEN_PATCH * classes.size, touching=near)
    if (classes == WHITE).mean() <= WHITE_SCENE and white.sum() >= petals.sum():
        petals = white
    return np.where(petals, 2, green | yellow).astype(np.uint8)


def _golden(rgb: NDArray[Any], light: Light) -> NDArray[np.bool_]:
    """Return which pixels (H, W) are as yellow as a tomato's petals: as red as green, where leaves are greener."""
    balanced = rgb * np.array(light.gains, dtype=np.float32)
    red, green = balanced[..., 0], balanced[..., 1]
    bright = balanced.max(axis=2) >= GOLDEN_GAIN * light.leaf
    return bright & (saturation(balanced) >= GOLDEN_SATURATION) & (red >= green) & (green >= GOLDEN_GREEN * red)


def _patches(
    part: NDArray[np.bool_], *, least: float = 0, most: float = np.inf, touching: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Return the connected patches of `part` (H, W) with `least` to `most` pixels that touch something."""
    count, numbered, stats, _ = cv2.connectedComponentsWithStats(part.astype(np.uint8), connectivity=8)
    patch, area = np.asarray(numbered, dtype=np.int32), stats[:, cv2.CC_STAT_AREA]
    kept = (area >= least) & (area <= most)
    if touching is not None:
        kept &= np.bincount(patch[touching], minlength=count) > 0
    return part & kept[patch]
