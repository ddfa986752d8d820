"""Following petals through the side camera's frames: petal weight, templates, depth. H x W pixels, F flowers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.devices import Frame
from anther.geometry import Array, Intrinsics

Image = NDArray[np.float32]


def petal_weight(frame: Frame, nearest: float, farthest: float) -> Image:
    """Return (H, W) in 0..1 how much a pixel looks like a petal: yellow or white, not green, and at the right distance.

    Yellow is saturated and, unlike leaves and stems, reflects no more green than red. White is brighter in its darkest
    channel than all but 2 % of the picture. Pixels without a depth reading count, since sensors drop thin things.

    Args:
        frame: RGB-D.
        nearest, farthest: z-depth petals may have [m].
    """
    red, green, blue = np.moveaxis(frame.rgb.astype(np.float32), 2, 0)
    top = np.maximum(np.maximum(red, green), 1.0)
    saturation = (np.minimum(red, green) - blue) / top
    redness = (red - green) / (red + green + blue + 1.0)
    yellow = np.clip((saturation - 0.35) / 0.2, 0, 1) * np.clip((redness + 0.06) / 0.05, 0, 1)
    yellow *= np.clip((top - 70) / 40, 0, 1)
    darkest = np.minimum(np.minimum(red, green), blue)
    white = np.clip((darkest - np.percentile(darkest, 98) - 5) / 25, 0, 1)
    allowed = (frame.depth == 0) | ((frame.depth >= nearest) & (frame.depth <= farthest))
    return np.asarray(np.maximum(yellow, white) * allowed, dtype=np.float32)


def common_shift(weight: Image, pixels: Array, reach: int) -> tuple[float, Array]:
    """Return how well expected flower pixels (F, 2) fit the petals, and the shift (2,) [px] that makes them fit best.

    The fit falls by 30 % towards a shift of `reach`: of two equal ones the nearer counts more.
    """
    smooth = cv2.GaussianBlur(weight, (0, 0), 3.0)
    grid = np.arange(-reach, reach + 1)
    u = np.clip(np.rint(pixels[:, 0]).astype(int)[:, None, None] + grid[None, None, :], 0, weight.shape[1] - 1)
    v = np.clip(np.rint(pixels[:, 1]).astype(int)[:, None, None] + grid[None, :, None], 0, weight.shape[0] - 1)
    fit = smooth[v, u].mean(axis=0) * (1 - 0.3 * np.hypot(grid[None, :], grid[:, None]) / reach)
    row, column = np.unravel_index(int(np.argmax(fit)), fit.shape)
    return float(fit[row, column]), np.array([grid[column], grid[row]], dtype=float)


def centre_of_petals(weight: Image, pixel: Array, radius: float) -> Array | None:
    """Return where the petals around a pixel (2,) have their centre, by mean shift within 1.5 flower radii.

    None if there are too few petals, or if it slides away to a neighbour.
    """
    v, u = np.nonzero(weight > 0.2)
    w = weight[v, u].astype(np.float64)
    centre = np.array(pixel, dtype=float)
    for _ in range(10):
        share = w * np.exp(-0.5 * ((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / (0.7 * radius) ** 2)
        if share.sum() < 4:
            return None
        centre = np.array([share @ u, share @ v]) / share.sum()
    return centre if np.linalg.norm(centre - pixel) < 1.5 * radius else None


def follow(weights: Sequence[Image], start: Array, *, radius: float, reach: int, least: float) -> Array:
    """Return the pixels (T, 2) of the flower at `start` (2,) in the first image; NaN where it is not found again.

    It is looked for where its last two places point to: first its patch of the first image, to a fraction of a pixel;
    where that has turned too much to be recognised, the centre of the petals there.

    Args:
        weights: T petal images.
        start: centre of its petals [px].
        radius: of a flower [px].
        reach: how far from there the patch is looked for [px].
        least: correlation below which it is not recognised.
    """
    half = int(np.ceil(1.4 * radius))
    pad = half + reach + 2
    padded = [np.pad(w, pad) for w in weights]
    corner = np.rint(start).astype(int) + pad
    patch = _cut(padded[0], corner, half)
    found = np.full((len(weights), 2), np.nan)
    place, step = start + pad, np.zeros(2)
    for i, image in enumerate(padded):
        expected = np.clip(np.rint(place + step).astype(int), pad, np.array(image.shape[::-1]) - pad - 1)
        score = cv2.matchTemplate(_cut(image, expected, half + reach), patch, cv2.TM_CCOEFF_NORMED)
        row, column = (int(x) for x in np.unravel_index(int(np.argmax(score)), score.shape))
        now = centre_of_petals(image, place + step, radius) if score[row, column] < least else None
        if score[row, column] >= least:
            peak = np.array([column + _vertex(score[row], column), row + _vertex(score[:, column], row)])
            now = expected + peak - reach + (start + pad - corner)
        if now is None:
            step = np.zeros(2)
            continue
        step = now - place if i else step
        place = now
        found[i] = place - pad
    return found


def petal_depth(frame: Frame, weight: Image, pixel: Array, radius: int) -> float:
    """Return the median depth [m] of the petals around a pixel (2,); NaN if none has a reading."""
    if not np.isfinite(pixel).all():
        return np.nan
    u, v = np.rint(pixel).astype(int)
    box = np.s_[max(v - radius, 0) : v + radius + 1, max(u - radius, 0) : u + radius + 1]
    depth = frame.depth[box][(weight[box] > 0.3) & (frame.depth[box] > 0)]
    return float(np.median(depth)) if len(depth) >= 3 else np.nan


def back_projected(intrinsics: Intrinsics, pixels: Array, depth: Array) -> Array:
    """Return the camera-frame points (T, 3) of pixels (T, 2) at depths (T,)."""
    x = (pixels[:, 0] - intrinsics.cx) / intrinsics.fx * depth
    y = (pixels[:, 1] - intrinsics.cy) / intrinsics.fy * depth
    return np.stack([x, y, depth], axis=1)


def _cut(image: Image, centre: NDArray[Any], half: int) -> Image:
    return image[centre[1] - half : centre[1] + half + 1, centre[0] - half : centre[0] + half + 1]


def _vertex(values: NDArray[Any], i: int) -> float:
    """Offset of a parabola's vertex through the values at i - 1, i, i + 1; 0 at the border."""
    if not 0 < i < len(values) - 1:
        return 0.0
    a, b, c = (float(x) for x in values[i - 1 : i + 2])
    bend = a - 2 * b + c
    return 0.5 * (a - c) / bend if bend < 0 else 0.0
