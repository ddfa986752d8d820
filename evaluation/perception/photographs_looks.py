"""What masks say of one photograph: where plant and flowers are, and which of the plant are stems and stalks.

By colour the masks have no class for stems: what is slender in them is taken for one. By words the networks are asked
for "stem.". Dimensions: H x W pixels, K masks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.core import StageFailure
from anther.perception import masks
from anther.perception.masks import FLOWER, PLANT
from anther.perception.masks.by_words import Method, Networks, Params, find_models, load_networks, paint
from evaluation.perception.colour_images import segment_images

Look = Callable[[NDArray[Any]], tuple[NDArray[np.uint8], NDArray[np.bool_]]]
"""From an image (H, W, 3) uint8 to its labels (H, W) and its stems (H, W)."""

TOMATO = masks.Params(white_petals=False)
"""All of the photographs are of tomatoes."""

WIDTH = 0.03
"""A stem is narrower than this share of the image's longer side, and a line of three times this fits into it. Chosen
by looking at the images that are not held out."""

DIRECTIONS = 18
"""Directions in which a line may lie."""

STEM = "stem."
"""The words for stems, among those of `by_words.Params.plant`."""


def by_colour(rgb: NDArray[Any]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Look at one image by colour; nothing is found where the masks refuse it."""
    try:
        labels = segment_images(rgb[None], TOMATO).labels[0]
    except StageFailure:
        labels = np.zeros(rgb.shape[:2], dtype=np.uint8)
    return labels, slender(labels > 0)


def by_words(models: Path, method: Method) -> Look:
    """Return what looks by the networks in a folder."""
    params = Params()
    networks = load_networks(method, find_models(models, method), params)
    return lambda rgb: named(networks, params, rgb)


def named(networks: Networks, params: Params, rgb: NDArray[Any]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Look at one image by words: labels as `by_words.label_views` makes them, and what "stem." found."""
    words: Sequence[str] = (*params.plant, *params.flower)
    found, word = networks.find(rgb[None], words)[0]
    labels = np.zeros(rgb.shape[:2], dtype=np.uint8)
    paint(labels, found, np.array([PLANT] * len(params.plant) + [FLOWER] * len(params.flower), dtype=np.uint8)[word])
    return labels, np.asarray(found[word == words.index(STEM)].any(axis=0), dtype=bool)


def slender(plant: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the slender parts (H, W) of a mask: no disc as wide as `WIDTH` fits in, but a line three times as long.

    Morphological openings (Serra 1982), that by lines in all directions. Holes of a pixel or two are filled before.
    """
    width = round(WIDTH * max(plant.shape)) | 1
    filled = cv2.morphologyEx(plant.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    narrow = cv2.subtract(filled, cv2.morphologyEx(filled, cv2.MORPH_OPEN, disc))
    lines = np.zeros_like(narrow)
    for angle in np.linspace(0, np.pi, DIRECTIONS, endpoint=False):
        window = _line(3 * width, angle)
        found = cv2.morphologyEx(narrow, cv2.MORPH_OPEN, window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        lines = cv2.bitwise_or(lines, found)
    return np.asarray(lines, dtype=bool)


def _line(length: int, angle: float) -> NDArray[np.uint8]:
    middle = (length - 1) / 2
    end = middle * np.array([np.cos(angle), np.sin(angle)])
    window = np.zeros((length, length), dtype=np.uint8)
    cv2.line(window, np.rint(middle - end).astype(int).tolist(), np.rint(middle + end).astype(int).tolist(), 1, 1)
    return window
