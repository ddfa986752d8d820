"""Masks of colour images without depth: the same colour rule, then only what hangs together. H x W pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.masks.light import GREEN, WHITE, YELLOW, ColourRule

if TYPE_CHECKING:
    from anther.masks import Params

_BESIDE = 5  # how close to green a petal comes [px]


def labels_of_image(rgb: NDArray[Any], rule: ColourRule, leaf: float, params: Params) -> NDArray[np.uint8]:
    """Return the labels (H, W) uint8 of one image (H, W, 3): 0 background, 1 plant, 2 flower.

    What is much darker than lit leaves (brightness `leaf`) has no trustworthy colour: a black cloth in a JPEG is green
    in places. Green patches smaller than `params.least_patch` of the image are noise. Small patches that touch green
    are petals if they are white; yellow ones are plant, because pods and young leaves are as yellow.
    """
    image = cv2.medianBlur(rgb, 3)
    classes = rule.classes(image)
    lit = image.max(axis=2) >= params.least_shade * leaf
    green = _patches((classes == GREEN) & lit, least=params.least_patch * classes.size)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_BESIDE, _BESIDE))
    near = cv2.dilate(green.astype(np.uint8), window) > 0
    yellow, white = (
        _patches(classes == colour, most=params.petal_patch * classes.size, touching=near) for colour in (YELLOW, WHITE)
    )
    return np.where(white, 2, green | yellow).astype(np.uint8)


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
