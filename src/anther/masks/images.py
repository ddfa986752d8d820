"""Masks of colour images without depth: the same colour rule, then only what hangs together. H x W pixels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.masks.light import GREEN, WHITE, YELLOW, ColourRule

_BESIDE = 5  # how close to green a petal comes [px]

LEAST_SHADE = 0.25
"""What is darker than this share of lit leaves is not looked at."""

LEAST_PATCH, PETAL_PATCH = 2e-5, 1e-3
"""Least share of the image that a green patch has, and greatest that a petal patch has."""


def labels_of_image(rgb: NDArray[Any], rule: ColourRule, leaf: float) -> NDArray[np.uint8]:
    """Return the labels (H, W) uint8 of one image (H, W, 3): 0 background, 1 plant, 2 flower.

    What is much darker than lit leaves (brightness `leaf`) has no trustworthy colour: a black cloth in a JPEG is green
    in places. Green patches smaller than `LEAST_PATCH` of the image are noise. Small patches that touch green
    are petals if they are white; yellow ones are plant, because pods and young leaves are as yellow.
    """
    image = cv2.medianBlur(rgb, 3)
    classes = rule.classes(image)
    lit = image.max(axis=2) >= LEAST_SHADE * leaf
    green = _patches((classes == GREEN) & lit, least=LEAST_PATCH * classes.size)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_BESIDE, _BESIDE))
    near = cv2.dilate(green.astype(np.uint8), window) > 0
    yellow, white = (
        _patches(classes == colour, most=PETAL_PATCH * classes.size, touching=near) for colour in (YELLOW, WHITE)
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
