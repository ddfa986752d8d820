"""Tracking flowers through the side camera's frames, and lifting them to 3-D. T frames, F flowers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from anther.core.errors import InputError
from anther.core.geometry import Array, Intrinsics
from anther.core.oscillation import fit_swing, swing_basis
from anther.pollination.response._depth import depth_along
from anther.pollination.response._petals import (
    Image,
    Patch,
    centre_of_petals,
    common_shift,
    cut_patch,
    flower_weight,
    follow,
    petal_weight,
    seek,
    smoothed,
)
from anther.pollination.response.thresholds import (
    DEPTH_GATE,
    DEPTH_REACH,
    LIKENESS,
    OUTLIER,
    REACH,
    SHIFT,
    overtones,
)
from anther.robot.devices import Frame

FLOWER_RADIUS = 0.007
"""Of a flower [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """One flower through the frames.

    Attributes:
        flower: which.
        track: (T, 3) its middle, camera frame [m]; NaN where not seen.
        pixel: what a pixel measures there [m].
        deep: whether the track's depth was measured.
        mixed: whether another flower overlaps it in the image.
    """

    flower: int
    track: Array
    pixel: float
    deep: bool
    mixed: bool


Remarks = dict[str, list[int]]
"""What there is to say, and about which flowers."""


def follow_flowers(
    frames: Sequence[Frame], intrinsics: Intrinsics, rest: Array, hint: float
) -> tuple[list[Followed], list[NDArray[Any]], Remarks]:
    """Follow the flowers that are at `rest` (F, 3), camera frame, when still; also return those that overlap.

    Args:
        frames: T of them.
        intrinsics: of the camera.
        rest: (F, 3) [m].
        hint: the shake's frequency [Hz].
    """
    if not len(rest) or rest[:, 2].min() <= DEPTH_GATE:
        return [], [], {"not in front of the side camera": [*range(len(rest))]}
    begin = _begin(frames, intrinsics, rest)
    inside = np.all((begin.pixels >= 0) & (begin.pixels < [intrinsics.width, intrinsics.height]), axis=1)
    shown = np.array([patch.is_shown for patch in begin.own])
    seen = np.flatnonzero(inside & shown)
    mixed = _overlapping(begin.pixels, 1.5 * begin.radius, seen)  # nearer in the image they may be confused
    found = []
    for k in seen:
        path = _path(frames, begin, int(k), hint)
        deep, depth = _depth(frames, begin.own[k], path, hint, float(rest[k, 2]))
        lifted = _lifted(intrinsics, path + begin.pixels[k] - begin.own[k].centre, depth)
        found.append(Followed(int(k), lifted, rest[k, 2] / intrinsics.fx, deep, any(k in group for group in mixed)))
    remarks = {
        "outside the side camera's picture": np.flatnonzero(~inside).tolist(),
        "hidden from the side camera": np.flatnonzero(inside & ~shown).tolist(),
    }
    return found, mixed, remarks


class _Begin(NamedTuple):
    """Where the following begins.

    Attributes:
        frame: number of the frame.
        pixels: (F, 2) where the flowers are in it.
        radius: (F,) of a flower [px].
        own, wide: each flower alone, and with its surroundings.
        images: T smoothed frames.
    """

    frame: int
    pixels: Array
    radius: Array
    own: list[Patch]
    wide: list[Patch]
    images: list[Image]


def _begin(frames: Sequence[Frame], intrinsics: Intrinsics, rest: Array) -> _Begin:
    """Begin where the flowers stand most like at rest: there neighbours are told apart most surely."""
    pixels, per_metre = intrinsics.project(rest), intrinsics.fx / rest[:, 2]
    gate = rest[:, 2].min() - DEPTH_GATE, rest[:, 2].max() + DEPTH_GATE
    petals = [petal_weight(frame, *gate) for frame in frames]
    alike = [flower_weight(frame, w, *gate) for frame, w in zip(frames, petals, strict=True)]
    fits = [common_shift(w, pixels, int(SHIFT * float(per_metre.mean()))) for w in alike]
    first = int(np.argmax([fit for fit, _ in fits]))
    radius = FLOWER_RADIUS * per_metre
    pixels = pixels + fits[first][1]
    crowded = 2.0  # radii between flowers that are placed by projection, not by the centre of the petals
    crowd = np.concatenate([np.zeros(0, int), *_overlapping(pixels, crowded * radius, np.arange(len(pixels)))])
    for k in np.setdiff1d(np.arange(len(pixels)), crowd):  # in a crowd the petals' centre is that of the crowd
        pixels[k] = centre_of_petals(petals[first], pixels[k], float(radius[k]))
    images = [smoothed(frame) for frame in frames]

    def patches(size: float) -> list[Patch]:
        return [
            cut_patch(frames[first], images[first], petals[first], pixel, size * r, z, size * DEPTH_REACH)
            for pixel, r, z in zip(pixels, radius, rest[:, 2], strict=True)
        ]

    wide = 2.0  # flower radii, of the patch with surroundings that is tracked first
    return _Begin(first, pixels, radius, patches(1.0), patches(wide), images)


def placed(frame: Frame, intrinsics: Intrinsics, rest: Array) -> tuple[Array, list[Patch]]:
    """Return where flowers at `rest` (F, 3), camera frame, are in a frame (F, 2) [px], and each alone."""
    begin = _begin([frame], intrinsics, rest)
    return begin.pixels, begin.own


def _path(frames: Sequence[Frame], begin: _Begin, k: int, hint: float) -> Array:
    """Return where flower k's own patch is in all frames (T, 2) [px].

    The flower with its surroundings is followed from frame to frame, on and back, as that is not mistaken for a
    neighbour; then the flower alone is looked for near the swing that fits best.
    """
    reach = int(np.ceil(REACH / FLOWER_RADIUS * begin.radius[k]))
    ways = begin.images[begin.frame :], begin.images[begin.frame :: -1]
    onward, back = (follow(way, begin.wide[k], reach=reach, worst=LIKENESS) for way in ways)
    path, times = np.concatenate([back[:0:-1], onward]), np.array([frame.time for frame in frames])
    for _ in range(2):
        try:
            swing = fit_swing(times, without_outliers(times, path, hint, overtones(hint)), hint, overtones(hint))
        except InputError:
            return path
        path = seek(begin.images, begin.own[k], swing.at(times))
    return path


def _depth(frames: Sequence[Frame], patch: Patch, path: Array, hint: float, rest: float) -> tuple[bool, Array]:
    """Return whether a flower's depth is sure along its path (T, 2), and that depth (T,) [m], or `rest` where not."""
    swing = swing_basis(np.array([f.time for f in frames]), hint, overtones(hint))
    depth = depth_along(frames, patch, path, swing, np.array(rest))
    sure = bool(np.isfinite(depth).mean() >= 0.8 * np.isfinite(path[:, 0]).mean() > 0)
    return sure, depth if sure else np.full(len(frames), rest)


def _overlapping(pixels: Array, apart: Array, seen: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the groups of two or more of the `seen` flowers linked by gaps of less than `apart` (F,) [px]."""
    if not len(seen):
        return []
    gaps = np.linalg.norm(pixels[seen, None] - pixels[seen], axis=2)
    count, label = connected_components(gaps < apart[seen, None])
    groups = [seen[label == k] for k in range(count)]
    return [group for group in groups if len(group) > 1]


def _lifted(intrinsics: Intrinsics, path: Array, depth: Array) -> Array:
    """Return camera-frame points (T, 3) of a pixel path (T, 2) at depths (T,); NaN where either is missing."""
    rays = (path - [intrinsics.cx, intrinsics.cy]) / [intrinsics.fx, intrinsics.fy]
    points = np.column_stack([rays, np.ones(len(path))]) * depth[:, None]
    return np.where(np.isfinite(points).all(axis=1, keepdims=True), points, np.nan)


def without_outliers(times: Array, track: Array, frequency: float, overtones: int = 0) -> Array:
    """Return the track (T, D) with NaN where it lies more than `OUTLIER` robust deviations off its swing on an axis."""
    miss = np.abs(track - fit_swing(times, track, frequency, overtones).at(times))
    spread = 1.4826 * np.nanmedian(miss, axis=0)
    return np.where((miss <= OUTLIER * np.maximum(spread, 1e-5)).all(axis=1, keepdims=True), track, np.nan)
