"""Points of the plant tracked from one frame at rest, fast enough for use during a shake.

P points, T frames, K frequencies. Pixels are (column, row).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array, ComplexArray, Intrinsics, inverse, transform_points
from anther.core.opencv import cv2
from anther.core.oscillation import MUCH_ALIKE
from anther.pollination.response._depth import depth_along
from anther.pollination.response._following import placed
from anther.pollination.response._petals import Image, Patch, seek, smoothed
from anther.pollination.response.thresholds import DEPTH_GATE, OUTLIER, overtones
from anther.robot.devices import Frame

NEAR = 0.02
"""A point is visible where the measured depth agrees with its own within this [m]."""
SLOW = 4
"""Number of Legendre polynomials fitted for slow motion: wind and decaying swings."""


class Sight(NamedTuple):
    """Flowers and plant points in the view of a fixed camera.

    Attributes:
        picture: (H, W) of the plant at rest.
        pixels: (P, 2) where the points are in it.
        per_pixel: (P,) what a pixel measures there [m].
        depth: (P,) of the points [m].
        axes: (P, 3, 3) so that a motion in the world (3,) @ axes[p] is how far the point goes across and down the
            picture, at its depth, and away from the camera.
        shown: (P,) whether the point is in sight.
        flowers: the first F points, each alone as it looks at rest.
    """

    picture: NDArray[np.uint8]
    pixels: Array
    per_pixel: Array
    depth: Array
    axes: Array
    shown: NDArray[np.bool_]
    flowers: tuple[Patch, ...]


class Swings(NamedTuple):
    """Swings of points by frequency: x(t) = Im(phasor exp(2 pi i f t)), t on the cameras' clock.

    Attributes:
        phasors: (P, K, 3) along `axes` [m]; NaN where the point was not tracked, and away from the camera where its
            depth was not measured.
        std: (P, 3) standard deviation of either part of any of them [m].
        axes: (P, 3, 3) of `Sight`.
        growing: relative growth rate of all flowers' swings in the middle of the frames [1/s]; 0 if not significant or
            with several frequencies.
        overtones: (P, H, 3) phasors at 2, 3, ... times a single frequency, NaN away from the camera; H is 0 where none
            were fitted.
    """

    phasors: ComplexArray
    std: Array
    axes: Array
    growing: float = 0.0
    overtones: ComplexArray = np.zeros((0, 0, 3), np.complex128)


def sight(frame: Frame, intrinsics: Intrinsics, T_world_cam: Array, flowers: Array, points: Array) -> Sight:
    """Return where flowers (F, 3) and points (N, 3), world [m], are in a frame of the plant at rest, in this order.

    Flowers are looked for by their petals, all shifted alike first, as `measure_response` does.
    """
    places = np.concatenate([flowers.reshape(-1, 3), points.reshape(-1, 3)])
    rest, pixels, inside = pictured(places, intrinsics, T_world_cam)
    shown = inside & _own_depth(frame.depth, pixels, rest[:, 2], inside)
    count, alone, gain = len(flowers), list[Patch](), _gain(frame)
    if count and rest[:count, 2].min() > DEPTH_GATE:
        pixels[:count], alone = placed(frame, intrinsics, rest[:count])
        alone = [patch._replace(image=patch.image * gain) for patch in alone]
        shown[:count] = inside[:count] & np.array([patch.is_shown for patch in alone])
    axes = np.repeat(T_world_cam[None, :3, :3], len(rest), axis=0)
    axes[:, :, :2] -= axes[:, :, 2:] * (rest[:, :2] / np.maximum(rest[:, 2:], NEAR))[:, None]
    return Sight(_picture(frame, gain), pixels, rest[:, 2] / intrinsics.fx, rest[:, 2], axes, shown, tuple(alone))


def pictured(points: Array, intrinsics: Intrinsics, T_world_cam: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return points (N, 3), world [m], in a camera's frame (N, 3) [m], their pixels (N, 2), and (N,) which of them are
    in its picture, whatever hides them; pixels of the others mean nothing.
    """
    own = transform_points(inverse(T_world_cam), points)
    ahead = own[:, 2] > NEAR
    pixels = intrinsics.project(np.where(ahead[:, None], own, 1.0))
    return own, pixels, ahead & np.all((pixels >= 0) & (pixels < [intrinsics.width, intrinsics.height]), axis=1)


def swings(at: Sight, frames: Sequence[Frame], tones: Array, expected: ComplexArray | None = None) -> Swings:
    """Measure the swings of visible points in frames of a shake of known frequencies (K,) [Hz].

    The patch around each point in the picture at rest is tracked in every frame by pyramidal Lucas-Kanade, forward and
    backward, from the extrapolated, the rest and the last position. A flower is small before a still background, so its
    own pixels are matched again along the predicted and the tracked path, and once more along the fitted swing; the
    path with the most matches counts. Its depth is read from those pixels. Sinusoids and slow terms are fitted by least
    squares; at a single frequency also its `overtones` across the line of sight, if the frames separate them. Depth is
    too noisy for overtones.

    Args:
        at: view of the plant.
        frames: of the shake.
        tones: (K,) frequencies [Hz].
        expected: (F, K, 3) predicted phasors of the flowers, as `Swings` has them [m]; None: no prediction.
    """
    times = np.array([f.time for f in frames])
    every = _with_overtones(times, tones) if len(tones) == 1 else tones
    phasors = np.full((len(at.pixels), len(every), 3), np.nan, np.complex128)
    std = np.full((len(at.pixels), 3), np.nan)
    if not frames or not at.shown.any():
        return Swings(phasors[:, : len(tones)], std, at.axes)
    if expected is not None:
        expected = np.pad(expected, [(0, 0), (0, len(every) - len(tones)), (0, 0)])
    basis, plain, swinging = _basis(times, every), _basis(times, tones), list[Array]()
    with ThreadPoolExecutor() as pool:  # OpenCV lets go of Python's lock
        gains = list(pool.map(_gain, frames))
        pictures = pool.map(_picture, frames, gains)
        seeing = at.shown[: len(at.flowers)].any()
        images = list(pool.map(lambda frame, gain: smoothed(frame) * gain, frames, gains)) if seeing else []
        paths = np.swapaxes(_paths(at, list(pictures)), 0, 1)
    for point, around, middle in zip(np.flatnonzero(at.shown), paths, _middles(at, paths), strict=True):
        flower, scale, path = point < len(at.flowers), at.per_pixel[point], around
        guess = None if expected is None or not flower else expected[point]
        if flower:
            path = _flower_path(at, int(point), images, around, middle, basis, guess)
        across = _fitted(basis, path)
        if flower and across is not None and _rough(path - basis @ across.coefficients):
            across = None
        known = None if guess is None else guess[: len(tones)]
        away = _away(at, int(point), frames, path, plain, known) if flower and across is not None else None
        if across is not None:
            phasors[point, :, :2], std[point, :2] = scale * _phasors(across, len(every)), scale * across.std
            if flower and len(tones) == 1:
                swinging.append(scale * path)
        if away is not None:
            phasors[point, : len(tones), 2:], std[point, 2] = _phasors(away, len(tones)), away.std
    own, over = phasors[:, : len(tones)], phasors[:, len(tones) :]
    return Swings(own, std, at.axes, _growing(times, basis, swinging), over)


def _growing(times: Array, basis: Array, paths: Sequence[Array]) -> float:
    """Return by which share of itself the first tone of the basis grows in a second [1/s], the same for paths (T, 2).

    Those that swing furthest tell it.
    """
    tone = np.array([0, (basis.shape[1] - SLOW) // 2])
    both = np.column_stack([basis[:, tone] * (times - times.mean())[:, None], basis])
    top = bottom = variance = 0.0
    for path in paths:
        used = np.isfinite(path).all(axis=1)
        spare = used.sum() - both.shape[1]
        if spare < 4:  # too few degrees of freedom
            continue
        parts, inverse_gram = _solved(both[used], path[used])
        grown, swung = parts[:2], parts[2 + tone]
        noise = np.sum((path[used] - both[used] @ parts) ** 2) / (2 * spare)
        top += float(np.sum(grown * swung))
        bottom += float(np.sum(swung**2))
        variance += float(noise * np.sum((swung**2).T @ inverse_gram.diagonal()[:2]))
    return top / bottom if abs(top) > 2.0 * np.sqrt(variance) else 0.0


def likeness(rate: float, seconds: float, tones: Array) -> float:
    """Return how much alike tones (K,) [Hz] look in frames at a rate [1/s] over so many seconds; 1: not at all.

    It is the variance of the tone that is told worst over what it would be beside no other and no slow motion. Tones
    above half the rate seem slower than they are; known ones may (stroboscope), as long as no two seem alike. Infinite
    where there are not five more frames than numbers that are fitted.
    """
    return _alike(np.arange(int(seconds * rate)) / rate, tones)


def _alike(times: Array, tones: Array) -> float:
    spare = 5  # least number of degrees of freedom of a fit
    if len(times) < 2 * len(tones) + SLOW + spare:
        return float("inf")
    _, inverse_gram = _solved(_basis(times, tones), times[:, None])
    return float(inverse_gram.diagonal()[:-SLOW].max()) * len(times) / 2


def _with_overtones(times: Array, tone: Array) -> Array:
    """Return (1 + H,) a tone and as many of its `overtones` as frames tell from it."""
    every = [tone * np.arange(1, 2 + count) for count in range(overtones(float(tone[0])), 0, -1)]
    return next((some for some in every if _alike(times, some) <= MUCH_ALIKE), tone)


def _own_depth(depth: Any, pixels: Array, expected: Array, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    own = np.zeros(len(pixels), dtype=bool)
    for k in np.flatnonzero(inside):
        u, v = np.rint(pixels[k]).astype(int)
        around = depth[max(v - 2, 0) : v + 3, max(u - 2, 0) : u + 3]
        read = around[around > 0]
        own[k] = len(read) > 0 and np.abs(read - expected[k]).min() < NEAR
    return own


def _gain(frame: Frame) -> float:
    """Return what brings the median grey of a frame, of every 16th pixel, to 100."""
    some = np.ascontiguousarray(frame.rgb[::4, ::4])
    bright = 100.0  # median grey: a camera's exposure and gain change from frame to frame
    return bright / max(float(np.median(cv2.cvtColor(some, cv2.COLOR_RGB2GRAY))), 1.0)


def _picture(frame: Frame, gain: float) -> NDArray[np.uint8]:
    grey = cv2.GaussianBlur(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 0.8)
    return np.clip(grey * gain, 0, 255).astype(np.uint8)


def _flower_path(
    at: Sight, k: int, images: Sequence[Image], path: Array, middle: Array, basis: Array, expected: ComplexArray | None
) -> Array:
    """Return (T, 2) where a flower's own pixels are [px], NaN where they are not found.

    Args:
        at: what is in sight.
        k: number of the flower.
        images: T smoothed frames.
        path: (T, 2) where its surroundings were found.
        middle: (2,) of it, see `_middles`.
        basis: (T, 2K + SLOW) of the tones.
        expected: (K, 3) its phasors [m], or None.
    """
    own = at.flowers[k]
    shift = at.pixels[k] - own.centre
    ways = [np.where(np.isfinite(path), path, middle)]
    if expected is not None:
        swing = _swung(basis, expected)[:, :2] / at.per_pixel[k]
        ways = [middle + scale * swing for scale in (1.0, 1.6, 0.6)]  # a guess at the error of a prediction + ways
    best, worth = np.full_like(path, np.nan), 0.0
    for way in ways:
        found = seek(images, own, way - shift, reach=8) + shift
        fitted = _fitted(basis, found)
        if fitted is None:
            continue
        found = seek(images, own, basis @ fitted.coefficients - shift) + shift
        sure = float(np.isfinite(found[:, 0]).mean()) / (1 + fitted.std)
        if sure > worth:
            best, worth = found, sure
        if worth > 0.9:  # good enough to try no other path; a guess
            break
    return best


def _rough(off: Array) -> bool:
    """Return whether a path that is off (T, 2) [px] from the swing that fits it is found now here, now there.

    What is looked for near a swing, and found anywhere there, looks like that swing, however large. A motion that is no
    tone, such as the swing into which the plant was let go, goes on from frame to frame.
    """
    steps = np.diff(off, axis=0)
    steps = steps[np.isfinite(steps).all(axis=1)]
    return (
        len(steps) == 0 or float(np.sqrt(np.mean(np.sum(steps**2, axis=1)) / 2)) > 0.6
    )  # px; 97 % of right paths are smoother


def _paths(at: Sight, pictures: Sequence[NDArray[np.uint8]]) -> Array:
    """Return (T, S, 2) where the S points in sight are in the pictures [px]; NaN where lost."""
    home = at.pixels[at.shown].astype(np.float32)[:, None]
    out = np.full((len(pictures), len(home), 2), np.nan)
    place, before = home.copy(), home.copy()
    side = 15  # px: two flowers wide at 0.55 m from a D455
    options: dict[str, Any] = {
        "winSize": (side, side),
        "maxLevel": 2,  # image pyramid: a search range of about 25 px
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
            good = (
                (np.asarray(ok) > 0)[:, 0] & (np.asarray(ok_back) > 0)[:, 0] & (missed < 1.0)
            )  # px, forward-backward error (Kalal et al. 2010)
            here = np.flatnonzero(lost)[good]
            found[here], lost[here] = there[good], False
            if not lost.any():
                break
        out[i] = np.where(lost[:, None], np.nan, found[:, 0])
        before, place = np.where(lost[:, None, None], found, place), found
    return out


def _middles(at: Sight, paths: Array) -> Array:
    """Return (S, 2) about which the paths (S, T, 2) of the points in sight go [px]: a plant drifts while it is shaken.

    One that was lost in half of the frames is looked for as far from its home as the others are from theirs.
    """
    home, share = at.pixels[at.shown], np.isfinite(paths[:, :, 0]).mean(axis=1)
    found = np.nanmedian(paths[share > 0], axis=1)
    if not len(found):
        return home
    middles = home + np.median(found - home[share > 0], axis=0)
    middles[share > 0.5] = found[share[share > 0] > 0.5]
    return middles


def _basis(times: Array, tones: Array) -> Array:
    """Return (T, 2K + SLOW) sines, cosines and slow terms."""
    phase = 2 * np.pi * times[:, None] * tones
    along = 2 * (times - times[0]) / max(float(np.ptp(times)), 1e-9) - 1
    slow = np.polynomial.legendre.legvander(along, SLOW - 1)
    return np.column_stack([np.sin(phase), np.cos(phase), slow]).astype(np.float64)


class _Fit(NamedTuple):
    """Coefficients (2K + SLOW, D) of a path and the deviation of any."""

    coefficients: Array
    std: float


def _phasors(fit: _Fit, tones: int) -> ComplexArray:
    sine, cosine = fit.coefficients[:tones], fit.coefficients[tones : 2 * tones]
    return np.asarray(sine + 1j * cosine, dtype=np.complex128)


def _swung(basis: Array, phasors: ComplexArray) -> Array:
    """Return the motion (T, 3) of phasors (K, 3)."""
    return basis[:, : 2 * len(phasors)] @ np.concatenate([phasors.real, phasors.imag])


def _away(
    at: Sight, k: int, frames: Sequence[Frame], path: Array, basis: Array, expected: ComplexArray | None
) -> _Fit | None:
    """Return the fit of how far away [m] a flower is along its path (T, 2) [px]; None where that is not read."""
    own, rest = at.flowers[k], at.depth[k]
    middle = path - (at.pixels[k] - own.centre)
    for about in ([] if expected is None else [rest + _swung(basis, expected)[:, 2]]) + [np.array(rest)]:
        depth = depth_along(frames, own, middle, basis, about)
        found = _fitted(basis, depth[:, None], 0.0005)  # m, least error of a depth reading: a guess
        if found is not None:
            return found
    return None


def _fitted(basis: Array, path: Array, least_error: float = 0.03) -> _Fit | None:
    """Return what a path (T, D) is a sum of, no place surer than `least_error`; None if it was lost.

    The error of a position by default [px]: a guess, about the noise in films without motion.
    """
    used, least = (
        np.isfinite(path).all(axis=1),
        max(0.6 * len(path), basis.shape[1] + 2),
    )  # a share of the frames, a guess
    if used.sum() < least:
        return None
    miss = np.abs(path - basis @ _solved(basis[used], path[used])[0])
    usual = 1.4826 * np.median(miss[used], axis=0)
    used &= (np.nan_to_num(miss, nan=np.inf) <= OUTLIER * np.maximum(usual, least_error)).all(axis=1)
    if used.sum() < least:
        return None
    coefficients, inverse_gram = _solved(basis[used], path[used])
    square = np.sum((path[used] - basis[used] @ coefficients) ** 2, axis=0) / (used.sum() - basis.shape[1])
    noise = max(float(np.sqrt(square.max())), least_error)
    return _Fit(coefficients, noise * float(np.sqrt(inverse_gram.diagonal()[:-SLOW].max())))


def _solved(basis: Array, values: Array) -> tuple[Array, Array]:
    """Return least-squares coefficients and the normal matrix's inverse; a decomposition would wake BLAS threads."""
    inverse_gram = np.linalg.inv(basis.T @ basis + 1e-9 * np.eye(basis.shape[1])).astype(np.float64)
    return inverse_gram @ (basis.T @ values), inverse_gram
