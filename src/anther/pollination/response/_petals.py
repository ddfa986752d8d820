"""Following petals through the side camera's frames: petal weight, templates, depth. H x W pixels, F flowers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.core.opencv import cv2
from anther.robot.devices import Frame

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


def centre_of_petals(weight: Image, pixel: Array, radius: float) -> Array:
    """Return where the petals around a pixel (2,) have their centre, by mean shift; the pixel if they are too few.

    Where it slides away by more than 1.5 flower radii, because a neighbour's petals touch these, the first step of the
    shift is taken instead, if it is no leap either.
    """
    v, u = np.nonzero(weight > 0.2)
    w = weight[v, u].astype(np.float64)
    centre = first = np.array(pixel, dtype=float)
    for i in range(10):
        share = w * np.exp(-0.5 * ((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / (0.7 * radius) ** 2)
        if share.sum() < 4:
            return pixel
        centre = np.array([share @ u, share @ v]) / share.sum()
        first = first if i else centre
    if np.linalg.norm(centre - pixel) < 1.5 * radius:
        return centre
    return first if np.linalg.norm(first - pixel) < 0.7 * radius else pixel


class Patch(NamedTuple):
    """A flower as it looks in one frame: the pixels that are its own, in a square around a whole pixel.

    Attributes:
        image: (S, S, 3) colours, S odd.
        weight: (S, S) how much each pixel counts; 0 where it is not the flower's.
        centre: (2,) the middle pixel.
        radius: of the flower [px].
    """

    image: Image
    weight: Image
    centre: NDArray[Any]
    radius: float

    @property
    def cover(self) -> float:
        """Share of the flower's disc that its own pixels cover."""
        return float(np.count_nonzero(self.weight) / (np.pi * self.radius**2))

    @property
    def is_shown(self) -> bool:
        """Whether enough of the disc is covered; if not, something hides the flower."""
        return self.cover >= 0.12


def smoothed(frame: Frame) -> Image:
    """Return the colours (H, W, 3), smoothed as far as sub-pixel matching needs."""
    return np.asarray(cv2.GaussianBlur(frame.rgb.astype(np.float32), (0, 0), 0.8), dtype=np.float32)


def cut_patch(
    frame: Frame, image: Image, petals: Image, pixel: Array, radius: float, depth: float, gap: float
) -> Patch:
    """Return the flower at a pixel (2,) of a frame.

    Its own pixels are petals, and whatever else is not green and stands within `gap` of its depth: in shade or against
    a bright house white petals cannot be told by their colour. The farther from the middle, the less they count
    (Gaussian of 0.7 radii): a flower turns as it swings, and what is nearer to its stalk moves less.

    Args:
        frame: whose colours are `image` (see `smoothed`) and `petals` (see `petal_weight`).
        image, petals: (H, W, 3) and (H, W).
        pixel: (2,) where the flower is.
        radius: of the flower [px].
        depth: of the flower [m].
        gap: [m].
    """
    half, centre = int(np.ceil(1.5 * radius)), np.rint(pixel).astype(int)
    box = (slice(centre[1] - half, centre[1] + half + 1), slice(centre[0] - half, centre[0] + half + 1))
    if np.any(centre < half) or np.any(centre + half >= petals.shape[::-1]):
        nothing = np.zeros((2 * half + 1, 2 * half + 1, 4), np.float32)
        return Patch(nothing[..., :3], nothing[..., 3], centre, radius)
    away = np.hypot(*np.meshgrid(*(np.arange(-half, half + 1) + centre[a] - pixel[a] for a in (0, 1))))
    near = np.abs(frame.depth[box] - depth) < gap
    own = (near & ~_leafy(frame.rgb[box])) | ((petals[box] > 0.3) & (near | (frame.depth[box] == 0)))
    own &= away < 1.4 * radius
    return Patch(image[box], (own * np.exp(-0.5 * (away / (0.7 * radius)) ** 2)).astype(np.float32), centre, radius)


def _leafy(rgb: NDArray[Any]) -> NDArray[np.bool_]:
    red, green, blue = np.moveaxis(rgb.astype(np.float32), 2, 0)
    leafy = 0.06  # (2 green - red - blue) / (red + green + blue) of leaves and stems
    return (2 * green - red - blue) / (red + green + blue + 1) > leafy


def flower_weight(frame: Frame, petals: Image, nearest: float, farthest: float) -> Image:
    """Return (H, W) in 0..1 how much a pixel looks like a flower: as a petal or, half as much, not green at a depth."""
    pale = (frame.depth >= nearest) & (frame.depth <= farthest) & ~_leafy(frame.rgb)
    return np.maximum(petals, 0.5 * pale).astype(np.float32)


def seek(images: Sequence[Image], patch: Patch, places: Array, reach: int = 3, worst: float = 0.4) -> Array:
    """Return the pixels (T, 2) of the patch in T images, within `reach` pixels of `places` (T, 2); NaN where not found.

    The place is where the sum of the weighted squared differences of the colours is least, to a fraction of a pixel.

    Args:
        images: see `smoothed`.
        patch: what is looked for.
        places: (T, 2) [px].
        reach: [px]; by default that about a swing that was fitted.
        worst: the least sum must be below this share of the window's median, or else nothing there is like the patch.
            By default that for a flower without its surroundings: what differs more is partly hidden.
    """
    half, found = patch.weight.shape[0] // 2 + reach, np.full((len(images), 2), np.nan)
    mask = np.repeat(patch.weight[..., None], 3, axis=2)
    for i, image in enumerate(images):
        if not np.isfinite(places[i]).all():
            continue
        middle = np.rint(places[i]).astype(int)
        # beyond the picture its last pixels are repeated: the patch is found where it is whole
        window = cv2.getRectSubPix(image, (2 * half + 1, 2 * half + 1), (float(middle[0]), float(middle[1])))
        miss = cv2.matchTemplate(window, patch.image, cv2.TM_SQDIFF, mask=mask)
        row, column = (int(x) for x in np.unravel_index(int(np.argmin(miss)), miss.shape))
        if miss[row, column] < worst * np.median(miss):
            shift = np.array([column + vertex(-miss[row], column), row + vertex(-miss[:, column], row)]) - reach
            found[i] = middle + shift
    return found


def follow(images: Sequence[Image], patch: Patch, *, reach: int, worst: float) -> Array:
    """Return the pixels (T, 2) of a patch of the first image in all: each looked for where the last two point to."""
    found = np.full((len(images), 2), np.nan)
    place, step = patch.centre.astype(float), np.zeros(2)
    for i in range(len(images)):
        now = seek(images[i : i + 1], patch, (place + step)[None], reach, worst)[0]
        if np.isnan(now[0]):
            step = np.zeros(2)
            continue
        step, place = (np.clip(now - place, -reach, reach) if i else np.zeros(2)), now
        found[i] = now
    return found


def vertex(values: NDArray[Any], i: int) -> float:
    """Offset of the top of a parabola through the values at i - 1, i, i + 1; 0 at the border."""
    if not 0 < i < len(values) - 1:
        return 0.0
    a, b, c = (float(x) for x in values[i - 1 : i + 2])
    bend = a - 2 * b + c
    return 0.5 * (a - c) / bend if bend < 0 else 0.0
