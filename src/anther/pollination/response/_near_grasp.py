"""How the main stem moves just above and below the pads: across itself in the picture, where alone it has edges.

T frames, S points of the stem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import InputError
from anther.core.geometry import Array, Intrinsics, inverse, transform_points
from anther.core.opencv import cv2
from anther.core.oscillation import fit_swing
from anther.core.records import Range, Record, Shape
from anther.pollination.response._following import without_outliers
from anther.pollination.response._petals import smoothed, vertex
from anther.pollination.response.thresholds import (
    DEPTH_GATE,
    DEPTH_REACH,
    LEAST_SPREAD,
    LIKENESS,
    REACH,
    SEEN_SHARE,
    SHIFT,
    SPREAD,
    most_residual,
)
from anther.robot.devices import Frame

MARGIN = 2
"""Pixels beside the stem that are looked at with it: without them it has no edges."""


@dataclass(frozen=True, slots=True, eq=False)
class StemMotion(Record):
    """Measured motion of points of the main stem, along what a camera can tell of it.

    Attributes:
        points: (S, 3) at rest, world [m].
        axis: (S, 3) unit vectors along which the motion is measured, world.
        motion: (S,) phasors z of it [m]: Im(z exp(2 pi i f t)), f the shake's frequency, t the cameras' clock.
        std: (S,) standard deviation of real and imaginary part [m].
    """

    CALLED = "stem"
    points: Annotated[Array, Shape("S", 3), Range(unit="m")]
    axis: Annotated[Array, Shape("S", 3)]
    motion: Annotated[NDArray[np.complex128], Shape("S"), Range(unit="m")]
    std: Annotated[Array, Shape("S"), Range(unit="m")]

    @classmethod
    def of(cls, rows: Sequence[tuple[Array, Array, complex, float]]) -> StemMotion:
        """Return rows of point, axis, motion and its deviation as one; without rows, that nothing was measured."""
        points, axes = (np.array([row[k] for row in rows], dtype=np.float64).reshape(-1, 3) for k in (0, 1))
        return cls(points, axes, np.array([r[2] for r in rows], complex), np.array([r[3] for r in rows], float))


class StemNear(NamedTuple):
    """Where to look: points of the main stem near a grasp (S, 3), unit tangents (S, 3), and radii (S,), world [m]."""

    points: Array
    tangents: Array
    radii: Array


def stem_near(nodes: Array, arc_length: Array, radii: Array, grasp: float) -> StemNear:
    """Return the nodes of a stem (N, 3) that lie beside pads at an arc length `grasp` [m]."""
    apart = np.abs(arc_length - grasp)
    nearest = 0.015  # m from the grasp: beyond the pads
    farthest = 0.06  # m from the grasp, where the grip still rules
    chosen = np.flatnonzero((apart >= nearest) & (apart <= farthest))
    along = np.gradient(nodes, axis=0)
    tangents = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return StemNear(nodes[chosen], tangents[chosen], np.asarray(radii)[chosen])


def measure_stem(
    frames: Sequence[Frame], intrinsics: Intrinsics, T_world_cam: Array, near: StemNear, hint: float
) -> StemMotion:
    """Follow the stem's points through the frames; those that are hidden, lost, or do not swing are left out.

    Args:
        frames: T of them.
        intrinsics: of the camera.
        T_world_cam: (4, 4) its pose.
        near: where to look.
        hint: the shake's frequency [Hz].
    """
    cam = inverse(T_world_cam)
    places, ways = transform_points(cam, near.points), near.tangents @ cam[:3, :3].T
    images, times = [smoothed(frame) for frame in frames], np.array([frame.time for frame in frames])
    rows = list[tuple[Array, Array, complex, float]]()
    for point, place, way, radius in zip(near.points, places, ways, near.radii, strict=True):
        if place[2] <= DEPTH_GATE:
            continue
        strip = _strip(intrinsics, place, way, float(radius))
        if strip is None:
            continue
        moved = _followed(frames, images, strip)
        swing = None if moved is None else _swing(times, moved * strip.metres, hint, strip.metres)
        if swing is not None:
            size = float(np.linalg.norm(strip.axis))
            rows.append((point, T_world_cam[:3, :3] @ strip.axis / size, swing[0] / size, swing[1] / size))
    return StemMotion.of(rows)


class _Strip(NamedTuple):
    """A piece of the picture across the stem: its own u runs across, its v along the stem.

    Attributes:
        centre: (2,) where the stem is at rest [px].
        across: (2,) unit vector of u [px/px].
        half: (2,) how far it reaches across and along [px].
        metres: a pixel there [m].
        depth: of the stem [m].
        radius: of the stem [px].
        axis: (3,) of a motion in the camera frame, what shows along u; not of unit length off the middle.
    """

    centre: Array
    across: Array
    half: tuple[int, int]
    metres: float
    depth: float
    radius: float
    axis: Array

    def cut(self, image: NDArray[Any], at: float, *, blended: bool = True) -> NDArray[Any]:
        """Return the strip (rows along, columns across) about `at` pixels across from the centre."""
        (x, y), (n, m) = self.centre + at * self.across, self.half
        u, v = self.across, np.array([-self.across[1], self.across[0]])
        back = np.array([[u[0], v[0], x - n * u[0] - m * v[0]], [u[1], v[1], y - n * u[1] - m * v[1]]])
        size, how = (2 * n + 1, 2 * m + 1), cv2.INTER_LINEAR if blended else cv2.INTER_NEAREST
        return np.asarray(
            cv2.warpAffine(image, back, size, flags=how | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)
        )


def _strip(intrinsics: Intrinsics, place: Array, way: Array, radius: float) -> _Strip | None:
    """Return where a point of the stem is in the picture; None if outside, or seen from its end."""
    pixel, ahead = intrinsics.project(np.array([place, place + 1e-3 * way]))
    along, metres = ahead - pixel, float(place[2] / intrinsics.fx)
    inside = np.all((pixel >= 0) & (pixel < [intrinsics.width, intrinsics.height]))
    if not inside or np.linalg.norm(along) * metres < 0.5e-3:
        return None
    across = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    across = across if across[0] >= 0 else -across
    offset = (pixel - [intrinsics.cx, intrinsics.cy]) / intrinsics.fx
    axis = np.array([*across, -float(across @ offset)])
    half = (int(np.ceil((SHIFT + radius) / metres)), max(int(0.005 / metres), 2))  # 5 mm along the stem either way
    return _Strip(pixel, across, half, metres, float(place[2]), radius / metres, axis)


def _followed(frames: Sequence[Frame], images: Sequence[NDArray[Any]], strip: _Strip) -> Array | None:
    """Return how far across the stem stands in each frame (T,) [px], NaN where lost; None where it is not seen."""
    gap = np.abs(strip.cut(frames[0].depth, 0.0, blended=False) - strip.depth)
    start = _stem_in((gap < DEPTH_REACH).mean(axis=0) > 0.5, strip)
    if start is None:
        return None
    half, reach = int(np.ceil(strip.radius)) + MARGIN, int(np.ceil(REACH / strip.metres))
    found, place, step = np.full(len(frames), np.nan), start, 0.0
    first = _middle(strip.cut(images[0], start), half)
    inner = _middle(first, max(half - 2 * MARGIN, 1)).reshape(-1, first.shape[2])
    colour = np.median(inner, axis=0)
    far = max(20.0, 2 * float(np.median(np.linalg.norm(inner - colour, axis=1))))
    model = _alike(first, colour, far)
    for i, image in enumerate(images):
        wide = strip._replace(half=(half + reach, strip.half[1]))
        asked = float(np.rint(place + step))
        miss = cv2.matchTemplate(_alike(wide.cut(image, asked), colour, far), model, cv2.TM_SQDIFF)[0]
        k = int(np.argmin(miss))
        if miss[k] >= LIKENESS * np.median(miss) or not 0 < k < len(miss) - 1:
            step = 0.0
            continue
        now = asked + k - reach + vertex(-miss, k)
        step, place = (now - place if i and np.isfinite(found[i - 1]) else 0.0), now
        found[i] = now
    return found


def _stem_in(own: NDArray[np.bool_], strip: _Strip) -> float | None:
    """Return where in the columns that are as far as the stem it stands [px from the middle]: the nearest run as wide.

    What is much wider is a leaf, or the gripper.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], own.astype(int), [0]])))
    begins, ends = edges[::2], edges[1::2]
    wide = ends - begins
    fits = (wide >= max(strip.radius, 2)) & (wide <= 3.5 * strip.radius + 2 * MARGIN)
    middles = ((begins + ends - 1) / 2 - strip.half[0])[fits]
    return float(middles[np.abs(middles).argmin()]) if len(middles) else None


def _alike(strip: NDArray[Any], colour: Array, far: float) -> NDArray[np.float32]:
    """Return (rows, columns) in 0..1 how like the stem pixels look: what stands still behind it hardly counts."""
    apart = np.sum((strip - colour) ** 2, axis=2) / far**2
    return np.exp(-0.5 * apart).astype(np.float32)


def _middle(strip: NDArray[Any], half: int) -> NDArray[Any]:
    middle = strip.shape[1] // 2
    return np.ascontiguousarray(strip[:, middle - half : middle + half + 1])


def _swing(times: Array, moved: Array, hint: float, pixel: float) -> tuple[complex, float] | None:
    """Return the phasor of a motion (T,) [m] and its deviation; None where it is not a swing that can be told."""
    if np.isfinite(moved).mean() < SEEN_SHARE:
        return None
    try:
        path = without_outliers(times, moved[:, None], hint)
        swing = fit_swing(times, path, hint)
    except InputError:
        return None
    spread = float(np.nanstd(path - swing.at(times)))
    if spread > most_residual(pixel, swing.amplitude):
        return None
    cosine, sine = swing.coefficients[:2, 0]
    phasor = complex(sine, cosine) * np.exp(-2j * np.pi * hint * swing.span[0])
    return complex(phasor), float(np.linalg.norm([swing.amplitude_std, LEAST_SPREAD, SPREAD * abs(phasor)]))
