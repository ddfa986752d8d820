"""Response: how the flowers moved during the shake, measured in the side camera's frames. T frames, F flowers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array, check_range, check_transform
from anther.devices import Frame
from anther.errors import InputError, bad_input
from anther.files import read_npz, write_npz
from anther.flower_tracking import (
    Image,
    back_projected,
    centre_of_petals,
    common_shift,
    follow,
    petal_depth,
    petal_weight,
)
from anther.flowers import Flowers
from anther.geometry import Array, Intrinsics, inverse, transform_points
from anther.oscillation import find_frequency, fit_swing

SCHEMA = 1


@dataclass(frozen=True, slots=True)
class Params:
    """How flowers are found and followed.

    Attributes:
        depth_gate: a flower is looked for this far before and behind where it was found at rest [m].
        flower_radius: of a flower [m].
        shift: farthest that the held plant may stand from where it was seen at rest [m].
        reach: farthest that a flower may be, in the next frame, from where its last two places point to [m].
        depth_reach: depth further than this from a track's median, or from where the flower was at rest, is not its
            own [m].
        depth_share: of the frames in which depth must be sure; else only the sideways motion is measured.
        overlap: flowers closer than this many flower radii in the image cannot be told apart.
        correlation: below this a flower counts as lost in a frame.
        seen_share: of the frames in which a flower must be followed to be measured.
        least_error, relative_error: an amplitude whose standard deviation is larger than both the former [m] and the
            latter's share of it counts as not measured.
        outlier: samples this many robust standard deviations off the fit are left out.
    """

    depth_gate: float = 0.08
    flower_radius: float = 0.007
    shift: float = 0.025
    reach: float = 0.012
    depth_reach: float = 0.02
    depth_share: float = 0.8
    overlap: float = 1.5
    correlation: float = 0.6
    seen_share: float = 0.5
    least_error: float = 0.0003
    relative_error: float = 0.1
    outlier: float = 4.0

    def __post_init__(self) -> None:
        for name in ("depth_gate", "flower_radius", "shift", "reach"):
            check_range(name, getattr(self, name), 1e-4, 1.0, "m")
        check_range("seen_share", self.seen_share, 0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Measured flower motion. What could not be measured is NaN.

    Attributes:
        times: (T,) of the frames [s].
        tracks: (T, F, 3) flower centres, world [m]; NaN where not seen.
        amplitude: (F,) semi-major axis of each flower's swing at the shake's frequency [m].
        amplitude_std: (F,) its standard deviation [m].
        frequency: (F,) of the swing [Hz].
        acceleration_peak: (F,) amplitude x (2 pi frequency)^2 [m/s2].
        visible: (F,) bool, whether it could be measured.
        notes: what the stage wants the user to know.
    """

    times: Array
    tracks: Array
    amplitude: Array
    amplitude_std: Array
    frequency: Array
    acceleration_peak: Array
    visible: NDArray[Any]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        frames, flowers = len(self.times), len(self.amplitude)
        object.__setattr__(self, "times", check_array("response times", self.times, (frames,)))
        tracks = check_array("response tracks", self.tracks, (frames, flowers, 3), finite=False)
        object.__setattr__(self, "tracks", tracks)
        for name in ("amplitude", "amplitude_std", "frequency", "acceleration_peak"):
            object.__setattr__(self, name, check_array(name, getattr(self, name), (flowers,), finite=False))
        object.__setattr__(self, "visible", check_array("visible", self.visible, (flowers,), dtype="bool"))

    def save(self, path: Path | str) -> None:
        """Write the response to an .npz."""
        names = ("times", "tracks", "amplitude", "amplitude_std", "frequency", "acceleration_peak", "visible")
        write_npz(
            path, "response", SCHEMA, notes=json.dumps(self.notes), **{name: getattr(self, name) for name in names}
        )

    @classmethod
    def load(cls, path: Path | str) -> Response:
        """Read a response written by `save`.

        Raises:
            InputError: missing, truncated or of another kind.
        """
        arrays: dict[str, Any] = read_npz(path, "response", SCHEMA)
        return cls(notes=tuple(json.loads(str(arrays.pop("notes")))), **arrays)


def measure_response(
    frames: Sequence[Frame],
    intrinsics: Intrinsics,
    T_world_cam: Array,
    flowers: Flowers,
    frequency_hint: float,
    *,
    params: Params = Params(),
) -> Response:
    """Follow every flower through the frames and fit its swing.

    Each flower is looked for where its position at rest projects, all flowers shifted together first because the held
    plant stands a little differently; then followed by template, lifted to 3-D by the petals' depth, and a sinusoid of
    the shake's frequency is fitted (`oscillation.fit_swing`).

    Args:
        frames: of a camera that stands still, while the plant was shaken.
        intrinsics: of the camera.
        T_world_cam: (4, 4) its pose.
        flowers: at rest, as perception found them.
        frequency_hint: the shake's frequency [Hz].
        params: of finding and following.

    Raises:
        InputError: fewer than 8 frames, or frames of another size.
    """
    _check(frames, intrinsics)
    check_range("frequency_hint", frequency_hint, 1e-3, 1e3, "Hz")
    T = check_transform("T_world_cam", T_world_cam)
    times = np.array([f.time for f in frames])
    tracks = np.full((len(frames), len(flowers.positions), 3), np.nan)
    notes: list[str] = []
    if len(flowers.positions):
        tracks, notes = _track(frames, intrinsics, transform_points(inverse(T), flowers.positions), params)
        tracks = tracks @ T[:3, :3].T + T[:3, 3]
    numbers = np.full((4, tracks.shape[1]), np.nan)
    for i in range(tracks.shape[1]):
        try:
            numbers[:, i] = _motion(times, tracks[:, i], frequency_hint, params)
        except InputError as error:
            notes.append(f"Flower {i + 1} could not be measured: {error}")
    amplitude, spread, frequency, acceleration = numbers
    faint = np.flatnonzero(amplitude < 3 * spread)
    notes += [f"Flower {i + 1} moves less than the camera's noise can tell." for i in faint]
    return Response(times, tracks, amplitude, spread, frequency, acceleration, np.isfinite(amplitude), tuple(notes))


def _check(frames: Sequence[Frame], intrinsics: Intrinsics) -> None:
    if len(frames) < 8:
        raise bad_input("frames", given=len(frames), allowed="8 or more", do="Record longer or faster.")
    size = (intrinsics.height, intrinsics.width)
    wrong = [f for f in frames if f.depth.shape != size or f.rgb.shape != (*size, 3)]
    if wrong:
        raise bad_input(
            "frame", given=f"{wrong[0].depth.shape}", allowed=f"{size}", do="Give this camera's intrinsics."
        )


def _track(frames: Sequence[Frame], intrinsics: Intrinsics, rest: Array, params: Params) -> tuple[Array, list[str]]:
    """Return camera-frame tracks (T, F, 3) of the flowers that are at `rest` (F, 3) when still, and notes."""
    tracks = np.full((len(frames), len(rest), 3), np.nan)
    nearest, farthest = rest[:, 2].min() - params.depth_gate, rest[:, 2].max() + params.depth_gate
    if nearest <= 0:
        return tracks, ["The side camera does not look at the flowers."]
    notes: list[str] = []
    weights = [petal_weight(frame, nearest, farthest) for frame in frames]
    pixels, per_metre = intrinsics.project(rest), intrinsics.fx / rest[:, 2]
    # start where the flowers stand most like at rest: there neighbours are told apart most surely
    fits = [common_shift(w, pixels, int(params.shift * float(per_metre.mean()))) for w in weights]
    first = int(np.argmax([fit for fit, _ in fits]))
    near = np.linalg.norm(pixels[:, None] - pixels, axis=2) + np.diag(np.full(len(pixels), np.inf))
    for i, (pixel, scale) in enumerate(zip(pixels + fits[first][1], per_metre, strict=True)):
        radius, reach = params.flower_radius * scale, int(np.ceil(params.reach * scale))
        start = centre_of_petals(weights[first], pixel, radius)
        if start is None or (near[i] < params.overlap * radius).any():
            how = "is hidden from" if start is None else "overlaps another in the view of"
            notes.append(f"Flower {i + 1} {how} the side camera.")
            continue
        onward, back = (
            follow(way, start, radius=radius, reach=reach, least=params.correlation)
            for way in (weights[first:], weights[first::-1])
        )
        path = np.concatenate([back[:0:-1], onward])
        depth = _depth(frames, weights, path, radius=max(int(radius), 2), reach=params.depth_reach)
        if np.isfinite(depth).any() and abs(np.nanmedian(depth) - rest[i, 2]) > params.depth_reach:
            notes.append(f"Flower {i + 1} is hidden from the side camera by something like a flower.")
            continue
        if np.isfinite(depth).mean() < params.depth_share * np.isfinite(path[:, 0]).mean():
            notes.append(f"Flower {i + 1} has no sure depth: its motion towards the camera is left out.")
            depth = np.full(len(frames), rest[i, 2])
        tracks[:, i] = _lifted(intrinsics, path, depth)
    return tracks, notes


def _depth(frames: Sequence[Frame], weights: Sequence[Image], path: Array, *, radius: int, reach: float) -> Array:
    """Return the petals' depth (T,) [m] along a pixel path (T, 2); NaN where none is within `reach` of the median."""
    depth = np.array([petal_depth(f, w, p, radius) for f, w, p in zip(frames, weights, path, strict=True)])
    seen = np.isfinite(depth)
    return np.where(seen & (np.abs(depth - np.median(depth[seen])) < reach), depth, np.nan) if seen.any() else depth


def _lifted(intrinsics: Intrinsics, path: Array, depth: Array) -> Array:
    """Return camera-frame points (T, 3) of a pixel path (T, 2) at depths (T,); NaN where either is missing.

    Sideways motion is measured at the median depth: depth noise would otherwise leak into it.
    """
    points = back_projected(intrinsics, path, np.full(len(path), np.nanmedian(depth)))
    points[:, 2] = depth
    return np.where(np.isfinite(points).all(axis=1, keepdims=True), points, np.nan)


def _motion(times: Array, track: Array, hint: float, params: Params) -> tuple[float, float, float, float]:
    """Return amplitude, its deviation, frequency and peak acceleration of a track (T, 3); NaN if never seen.

    Raises:
        InputError: seen in too few frames, at times that cannot tell the phase, or not as a swing.
    """
    seen = int(np.isfinite(track).all(axis=1).sum())
    if seen == 0:
        return np.nan, np.nan, np.nan, np.nan
    if seen < max(params.seen_share * len(times), 8):
        raise bad_input(
            "frames with the flower", given=seen, allowed=f">= half of {len(times)}", do="Move the side camera."
        )
    clean = _without_outliers(times, track, hint, params.outlier)
    swing, frequency = fit_swing(times, clean, hint), find_frequency(times, clean, hint)
    if swing.amplitude_std > max(params.least_error, params.relative_error * swing.amplitude):
        raise bad_input(
            "its track's deviation from the shake's swing",
            given=f"{1000 * swing.residual:.1f} mm rms around {1000 * swing.amplitude:.1f} mm",
            allowed=f"a deviation of the amplitude of {1000 * params.least_error:g} mm or {params.relative_error:.0%}",
            do="Neighbouring flowers were probably confused: shake less, or move the side camera closer.",
        )
    return swing.amplitude, swing.amplitude_std, frequency, swing.amplitude * (2 * np.pi * frequency) ** 2


def _without_outliers(times: Array, track: Array, frequency: float, most: float) -> Array:
    """Return the track (T, 3) with NaN where it lies more than `most` robust deviations off its swing."""
    swing = fit_swing(times, track, frequency)
    distance = np.linalg.norm(track - swing.at(times), axis=1)
    spread = 1.4826 * float(np.nanmedian(distance))
    return np.where((distance <= most * max(spread, 1e-5))[:, None], track, np.nan)
