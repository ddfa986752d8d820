"""Points of the plant followed from one frame at rest: quick enough to watch a shake while it lasts.

P points, T frames, K tones. Pixels are (column, row).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.devices import Frame
from anther.flower_tracking import Image, Patch, seek, smoothed
from anther.geometry import Array, Intrinsics, inverse, transform_points
from anther.response.following import OWN_LIKENESS, placed
from anther.response.params import DEPTH_GATE, LEAST_COVER, Params
from anther.vibration.observables import ComplexArray

DEFAULTS = Params()
WINDOW = 15
"""Side of the square that is compared [px]: two flowers wide at 0.55 m from a D455."""
LEVELS = 2
"""Halvings of the picture, so that a point is found up to about 25 px from where it was looked for."""
THERE_AND_BACK = 1.0
"""A point followed there and back must come home to this [px] (Kalal et al. 2010, forward-backward error)."""
NEAR = 0.02
"""A point is in sight where the depth measured there is its own to this [m]."""
BRIGHT = 100.0
"""Median grey of the pictures that are compared: exposure and gain of a camera change from frame to frame."""
SCALES = (1.0, 1.6, 0.6)
"""Times what is expected, along which a flower is looked for."""
SEEK = 8
"""A flower is looked for so far from there [px], then within `Params.near` of the swing that fits."""
SLOW = 4
"""Legendre polynomials beside the tones: wind, and swings that die out."""
LEAST_SHARE = 0.6
"""Of the frames in which a point must be followed."""
LEAST_ERROR = 0.03
"""No place is surer than this [px]: a guess, and about what films without motion show."""


class Sight(NamedTuple):
    """What a camera that stands still has in sight.

    Attributes:
        picture: (H, W) of the plant at rest.
        pixels: (P, 2) where the points are in it.
        per_pixel: (P,) what a pixel measures there [m].
        shown: (P,) whether the point is in sight.
        flowers: the first F points, each alone as it looks at rest.
    """

    picture: NDArray[np.uint8]
    pixels: Array
    per_pixel: Array
    shown: NDArray[np.bool_]
    flowers: tuple[Patch, ...]


class Swings(NamedTuple):
    """How points swung, by tone: x(t) = Im(phasor exp(2 pi i f t)), t on the cameras' clock.

    Attributes:
        phasors: (P, K, 2) along the camera's x and y [m]; NaN where the point was not followed.
        std: (P,) standard deviation of either part of any of them [m].
    """

    phasors: ComplexArray
    std: Array


def sight(
    frame: Frame, intrinsics: Intrinsics, T_world_cam: Array, flowers: Array, points: Array, params: Params = DEFAULTS
) -> Sight:
    """Return where flowers (F, 3) and points (N, 3), world [m], are in a frame of the plant at rest, in this order.

    Flowers are looked for by their petals, all shifted alike first, as `measure_response` does.
    """
    T = inverse(T_world_cam)
    rest = transform_points(T, np.concatenate([flowers.reshape(-1, 3), points.reshape(-1, 3)]))
    pixels = intrinsics.project(np.where(rest[:, 2:] > NEAR, rest, 1.0))
    inside = np.all((pixels >= 0) & (pixels < [intrinsics.width, intrinsics.height]), axis=1)
    shown = inside & (rest[:, 2] > NEAR) & _own_depth(frame.depth, pixels, rest[:, 2], inside)
    count, alone, gain = len(flowers), list[Patch](), _gain(frame)
    if count and rest[:count, 2].min() > DEPTH_GATE:
        pixels[:count], alone = placed(frame, intrinsics, rest[:count], params)
        alone = [patch._replace(image=patch.image * gain) for patch in alone]
        shown[:count] = inside[:count] & np.array([patch.cover >= LEAST_COVER for patch in alone])
    return Sight(_picture(frame, gain), pixels, rest[:, 2] / intrinsics.fx, shown, tuple(alone))


def swings(at: Sight, frames: Sequence[Frame], tones: Array, expected: ComplexArray | None = None) -> Swings:
    """Return how the points in sight swung in frames of a shake whose tones (K,) [Hz] are known.

    Each point's surroundings in the picture at rest are looked for in every frame (Lucas-Kanade with a pyramid), there
    and back: where it is going, else at home, else where it was. A flower is small before a background that stands
    still: its own pixels alone are then looked for along what is expected and along that path, each time once more
    along the swing that fits; where it is found most often counts. Then tones and slow terms are fitted to each path by
    least squares.

    Args:
        at: what is in sight.
        frames: of the shake.
        tones: (K,) [Hz].
        expected: (F, K, 2) phasors of the flowers as `Swings` has them [m]; None: nothing is.
    """
    phasors = np.full((len(at.pixels), len(tones), 2), np.nan, np.complex128)
    std, times = np.full(len(at.pixels), np.nan), np.array([f.time for f in frames])
    if not at.shown.any() or len(frames) <= 2 * len(tones) + SLOW:
        return Swings(phasors, std)
    basis = _basis(times, tones)
    gains = [_gain(frame) for frame in frames]
    paths = np.swapaxes(_paths(at, [_picture(f, gain) for f, gain in zip(frames, gains, strict=True)]), 0, 1)
    seeing = at.shown[: len(at.flowers)].any()
    images = [smoothed(f) * gain for f, gain in zip(frames, gains, strict=True)] if seeing else []
    for point, path in zip(np.flatnonzero(at.shown), paths, strict=True):
        if point < len(at.flowers):
            guess = None if expected is None else expected[point] / at.per_pixel[point]
            found = _fitted(basis, _flower_path(at, int(point), images, path, basis, guess))
        else:
            found = _fitted(basis, path)
        if found is not None:
            sine, cosine = found[0][: len(tones)], found[0][len(tones) : 2 * len(tones)]
            phasors[point], std[point] = sine + 1j * cosine, found[1]
    return Swings(phasors * at.per_pixel[:, None, None], std * at.per_pixel)


def _own_depth(depth: Any, pixels: Array, expected: Array, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    own = np.zeros(len(pixels), dtype=bool)
    for k in np.flatnonzero(inside):
        u, v = np.rint(pixels[k]).astype(int)
        around = depth[max(v - 2, 0) : v + 3, max(u - 2, 0) : u + 3]
        read = around[around > 0]
        own[k] = len(read) > 0 and np.abs(read - expected[k]).min() < NEAR
    return own


def _gain(frame: Frame) -> float:
    """Return what brings the median grey of a frame to `BRIGHT`."""
    return BRIGHT / max(float(np.median(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY))), 1.0)


def _picture(frame: Frame, gain: float) -> NDArray[np.uint8]:
    grey = cv2.GaussianBlur(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 0.8)
    return np.clip(grey * gain, 0, 255).astype(np.uint8)


def _flower_path(
    at: Sight, k: int, images: Sequence[Image], path: Array, basis: Array, expected: ComplexArray | None
) -> Array:
    """Return (T, 2) where a flower's own pixels are [px], NaN where they are not found.

    Args:
        at: what is in sight.
        k: number of the flower.
        images: T smoothed frames.
        path: (T, 2) where its surroundings were found.
        basis: (T, 2K + SLOW) of the tones.
        expected: (K, 2) its phasors [px], or None.
    """
    own = at.flowers[k]
    shift = at.pixels[k] - own.centre
    ways = [np.where(np.isfinite(path), path, at.pixels[k])]
    if expected is not None:
        swing = basis[:, : 2 * len(expected)] @ np.concatenate([expected.real, expected.imag])
        ways = [at.pixels[k] + scale * swing for scale in SCALES] + ways
    best, worth = np.full_like(path, np.nan), 0.0
    for way in ways:
        found = seek(images, own, way - shift, SEEK, OWN_LIKENESS) + shift
        fitted = _fitted(basis, found)
        if fitted is None:
            continue
        found = seek(images, own, basis @ fitted[0] - shift, DEFAULTS.near, OWN_LIKENESS) + shift
        sure = float(np.isfinite(found[:, 0]).mean()) / (1 + fitted[1])
        if sure > worth:
            best, worth = found, sure
    return best


def _paths(at: Sight, pictures: Sequence[NDArray[np.uint8]]) -> Array:
    """Return (T, S, 2) where the S points in sight are in the pictures [px]; NaN where lost."""
    home = at.pixels[at.shown].astype(np.float32)[:, None]
    out = np.full((len(pictures), len(home), 2), np.nan)
    place, before = home.copy(), home.copy()
    options: dict[str, Any] = {
        "winSize": (WINDOW, WINDOW),
        "maxLevel": LEVELS,
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01),
    }
    for i, picture in enumerate(pictures):
        lost = np.ones(len(home), dtype=bool)
        found = place.copy()
        for guess in (2 * place - before, home, place):
            there, ok, _ = cv2.calcOpticalFlowPyrLK(at.picture, picture, home[lost], guess[lost].copy(), **options)
            back, ok_back, _ = cv2.calcOpticalFlowPyrLK(picture, at.picture, there, home[lost].copy(), **options)
            missed = np.linalg.norm(back - home[lost], axis=2)[:, 0]
            good = (np.asarray(ok) > 0)[:, 0] & (np.asarray(ok_back) > 0)[:, 0] & (missed < THERE_AND_BACK)
            here = np.flatnonzero(lost)[good]
            found[here], lost[here] = there[good], False
            if not lost.any():
                break
        out[i] = np.where(lost[:, None], np.nan, found[:, 0])
        before, place = np.where(lost[:, None, None], found, place), found
    return out


def _basis(times: Array, tones: Array) -> Array:
    """Return (T, 2K + SLOW) sines, cosines and slow terms."""
    phase = 2 * np.pi * times[:, None] * tones
    along = 2 * (times - times[0]) / max(float(np.ptp(times)), 1e-9) - 1
    slow = np.polynomial.legendre.legvander(along, SLOW - 1)
    return np.column_stack([np.sin(phase), np.cos(phase), slow]).astype(np.float64)


def _fitted(basis: Array, path: Array) -> tuple[Array, float] | None:
    """Return the coefficients (2K + SLOW, 2) of a path (T, 2) and the deviation of any, [px]; None if it was lost."""
    used, least = np.isfinite(path).all(axis=1), max(LEAST_SHARE * len(path), basis.shape[1] + 2)
    if used.sum() < least:
        return None
    miss = np.abs(path - basis @ _solved(basis[used], path[used])[0])
    usual = 1.4826 * np.median(miss[used], axis=0)
    used &= (np.nan_to_num(miss, nan=np.inf) <= DEFAULTS.outlier * np.maximum(usual, LEAST_ERROR)).all(axis=1)
    if used.sum() < least:
        return None
    coefficients, inverse_gram = _solved(basis[used], path[used])
    square = np.sum((path[used] - basis[used] @ coefficients) ** 2, axis=0) / (used.sum() - basis.shape[1])
    noise = max(float(np.sqrt(square.max())), LEAST_ERROR)
    return coefficients, noise * float(np.sqrt(inverse_gram.diagonal()[:-SLOW].max()))


def _solved(basis: Array, values: Array) -> tuple[Array, Array]:
    """Return least-squares coefficients and the normal matrix's inverse; a decomposition would wake BLAS threads."""
    inverse_gram = np.linalg.inv(basis.T @ basis + 1e-9 * np.eye(basis.shape[1])).astype(np.float64)
    return inverse_gram @ (basis.T @ values), inverse_gram
