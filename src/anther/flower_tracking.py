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
    channel than what is seen behind the plant around there, or 98 % of the picture where there is nothing behind.
    Pixels without a depth reading count, since sensors drop thin things; of yellow ones so do those two pixels from an
    allowed one, since stereo mixes depths at edges.

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
    allowed = (frame.depth == 0) | ((frame.depth >= nearest) & (frame.depth <= farthest))
    beside = cv2.dilate(allowed.astype(np.uint8), np.ones((5, 5), np.uint8))
    darkest = np.minimum(np.minimum(red, green), blue)
    raised = darkest - _behind(darkest, frame.depth > farthest)
    white = np.clip((raised - 12) / 16, 0, 1) * np.clip((darkest - 70) / 40, 0, 1)
    return np.asarray(np.maximum(yellow * beside, white * allowed), dtype=np.float32)


def _behind(darkest: Image, far: NDArray[Any]) -> Image:
    """Return (H, W) how bright the background is near each pixel: the mean of its pixels in a box of 81."""
    inner = cv2.erode(far.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.float32)
    share = cv2.blur(inner, (81, 81))
    level = cv2.blur(darkest * inner, (81, 81)) / np.maximum(share, 1e-6)
    return np.where(share > 0.02, level, np.percentile(darkest, 98)).astype(np.float32)


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
    """Return where the petals around a pixel (2,) have their centre, by mean shift.

    None if there are too few petals. Where it slides away by more than 1.5 flower radii, because a neighbour's petals
    touch these, the first step of the shift is taken instead.
    """
    v, u = np.nonzero(weight > 0.2)
    w = weight[v, u].astype(np.float64)
    centre = first = np.array(pixel, dtype=float)
    for i in range(10):
        share = w * np.exp(-0.5 * ((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / (0.7 * radius) ** 2)
        if share.sum() < 4:
            return None
        centre = np.array([share @ u, share @ v]) / share.sum()
        first = first if i else centre
    near = 1.5 * radius
    if np.linalg.norm(centre - pixel) < near:
        return centre
    return first if np.linalg.norm(first - pixel) < 0.7 * radius else None


def coverage(weight: Image, pixel: Array, radius: float) -> float:
    """Return which share of the disc around a pixel (2,) petals cover."""
    v, u = np.nonzero(weight > 0.3)
    return float(np.count_nonzero((u - pixel[0]) ** 2 + (v - pixel[1]) ** 2 <= radius**2) / (np.pi * radius**2))


def follow(weights: Sequence[Image], start: Array, half: NDArray[Any], *, reach: int, least: float) -> Array:
    """Return the pixels (T, 2) of the petals that are at `start` (2,) in the first image; NaN where not found again.

    They are looked for where their last two places point to: first their patch of the first image, to a fraction of a
    pixel; where that has changed too much to be recognised, the centre of the petals there. A place with less than half
    or more than twice the petals of the first image is another flower's, or the flower is being hidden.

    Args:
        weights: T petal images.
        start: middle of the patch [px].
        half: (2,) whole pixels from there to the patch's sides and to its top and bottom.
        reach: how far from there the patch is looked for [px].
        least: correlation below which it is not recognised.
    """
    pad = int(half.max()) + reach + 2
    padded = [np.pad(w, pad) for w in weights]
    corner = np.rint(start).astype(int) + pad
    patch = _cut(padded[0], corner, half)
    petals = max(float(patch.sum()), 1.0)
    centre = centre_of_petals(padded[0], start + pad, float(half.max()))
    lag = np.zeros(2) if centre is None else start + pad - centre
    found = np.full((len(weights), 2), np.nan)
    place, step = start + pad, np.zeros(2)
    for i, image in enumerate(padded):
        expected = np.clip(np.rint(place + step).astype(int), pad, np.array(image.shape[::-1]) - pad - 1)
        score = cv2.matchTemplate(_cut(image, expected, half + reach), patch, cv2.TM_CCOEFF_NORMED)
        row, column = (int(x) for x in np.unravel_index(int(np.argmax(score)), score.shape))
        if score[row, column] >= least:
            peak = np.array([column + _vertex(score[row], column), row + _vertex(score[:, column], row)])
            now = expected + peak - reach + (start + pad - corner)
        else:
            centre = centre_of_petals(image, place + step - lag, float(half.max()))
            now = None if centre is None else centre + lag
        if now is None or not 0.5 < _petals(image, now, half) / petals < 2:
            step = np.zeros(2)
            continue
        step = now - place if i else step
        place = now
        found[i] = place - pad
    return found


def petal_depths(frame: Frame, weight: Image, pixel: Array, half: NDArray[Any]) -> Array:
    """Return the depths (N,) [m] of the petals in a box around a pixel (2,) that have a reading."""
    if not np.isfinite(pixel).all():
        return np.zeros(0)
    u, v = np.rint(pixel).astype(int)
    box = np.s_[max(v - half[1], 0) : max(v + half[1] + 1, 0), max(u - half[0], 0) : max(u + half[0] + 1, 0)]
    return frame.depth[box][(weight[box] > 0.3) & (frame.depth[box] > 0)].astype(np.float64)


def back_projected(intrinsics: Intrinsics, pixels: Array, depth: Array) -> Array:
    """Return the camera-frame points (T, 3) of pixels (T, 2) at depths (T,)."""
    x = (pixels[:, 0] - intrinsics.cx) / intrinsics.fx * depth
    y = (pixels[:, 1] - intrinsics.cy) / intrinsics.fy * depth
    return np.stack([x, y, depth], axis=1)


def _cut(image: Image, centre: NDArray[Any], half: NDArray[Any]) -> Image:
    (left, top), (right, bottom) = centre - half, centre + half + 1
    return image[top:bottom, left:right]


def _petals(image: Image, pixel: Array, half: NDArray[Any]) -> float:
    """Return how much petal there is in a box around a pixel (2,); 0 outside the image."""
    corner = np.rint(pixel).astype(int)
    inside = np.all(corner >= half) and np.all(corner + half < image.shape[::-1])
    return float(_cut(image, corner, half).sum()) if inside else 0.0


def _vertex(values: NDArray[Any], i: int) -> float:
    """Offset of a parabola's vertex through the values at i - 1, i, i + 1; 0 at the border."""
    if not 0 < i < len(values) - 1:
        return 0.0
    a, b, c = (float(x) for x in values[i - 1 : i + 2])
    bend = a - 2 * b + c
    return 0.5 * (a - c) / bend if bend < 0 else 0.0
