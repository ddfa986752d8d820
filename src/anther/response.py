"""Response: how the flowers moved during the shake, measured in the side camera's frames. T frames, F flowers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from anther.checks import check_array, check_range, check_transform
from anther.devices import Frame
from anther.errors import InputError, bad_input
from anther.files import read_npz, write_npz
from anther.flower_tracking import (
    Image,
    back_projected,
    centre_of_petals,
    common_shift,
    coverage,
    follow,
    petal_depths,
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
        hidden_gap: petals nearer or farther than a flower's by this belong to another, which hides it [m].
        least_cover: petals must cover this share of a flower's disc, or else it counts as hidden.
        overlap: flowers closer than this many flower radii in the image are measured together.
        member_spread: standard deviation of the members' amplitudes in such a group, relative to the group's.
        depthless: standard deviation of the whole amplitude relative to its sideways part, where depth is not sure.
        depth_error: relative standard deviation of motion in depth: sensors mix a small thing's depth with what is
            beside it.
        correlation: a patch is recognised above this; below it the centre of its petals is taken.
        seen_share: of the frames in which a flower must be followed to be measured.
        residual_pixels, relative_residual: a track whose sideways deviation from a swing is larger than both the former
            [px] and the latter's share of the amplitude jumps from petal to petal and counts as not measured.
        least_error, relative_error: an amplitude whose standard deviation is larger than both the former [m] and the
            latter's share of it counts as not measured.
        least_pixels: swings smaller than this in the image are not measured [px].
        significance: nor are those smaller than this many standard deviations.
        outlier: samples this many robust standard deviations off the fit are left out.
    """

    depth_gate: float = 0.08
    flower_radius: float = 0.007
    shift: float = 0.025
    reach: float = 0.012
    depth_reach: float = 0.02
    depth_share: float = 0.8
    hidden_gap: float = 0.04
    least_cover: float = 0.12
    overlap: float = 1.5
    member_spread: float = 0.4
    depthless: float = 0.2
    depth_error: float = 0.2
    correlation: float = 0.6
    seen_share: float = 0.7
    residual_pixels: float = 0.75
    relative_residual: float = 0.2
    least_error: float = 0.0003
    relative_error: float = 0.1
    least_pixels: float = 0.2
    significance: float = 3.0
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
    the shake's frequency is fitted (`oscillation.fit_swing`). Flowers that overlap in the image are followed as one:
    each gets the group's amplitude, with a deviation that says how much members of a group differ. A swing below what
    the camera can tell is NaN, never a guess; notes say why, one for each reason.

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
    rest = transform_points(inverse(T), flowers.positions)
    groups, remarks = _track(frames, intrinsics, rest, params) if len(rest) else ([], [])
    tracks, numbers = np.full((len(frames), len(rest), 3), np.nan), np.full((4, len(rest)), np.nan)
    together: list[NDArray[Any]] = []
    for group in groups:
        offset = rest[group.flowers] - rest[group.flowers].mean(axis=0)
        tracks[:, group.flowers] = (group.track[:, None] + offset) @ T[:3, :3].T + T[:3, 3]
        measured = _motion(times, group, frequency_hint, params)
        if isinstance(measured, str):
            remarks.append((measured, group.flowers))
        else:
            numbers[:, group.flowers] = np.array(measured)[:, None]
            together += [group.flowers] if len(group.flowers) > 1 else []
            remarks += [] if group.deep else [("no sure depth: motion towards the camera is left out", group.flowers)]
    amplitude, spread, frequency, acceleration = numbers
    visible = np.isfinite(amplitude)
    notes = (*_overlaps(together), *_merged(remarks))
    return Response(times, tracks, amplitude, spread, frequency, acceleration, visible, notes)


def _check(frames: Sequence[Frame], intrinsics: Intrinsics) -> None:
    if len(frames) < 8:
        raise bad_input("frames", given=len(frames), allowed="8 or more", do="Record longer or faster.")
    size = (intrinsics.height, intrinsics.width)
    wrong = [f for f in frames if f.depth.shape != size or f.rgb.shape != (*size, 3)]
    if wrong:
        raise bad_input(
            "frame", given=f"{wrong[0].depth.shape}", allowed=f"{size}", do="Give this camera's intrinsics."
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Flowers that are followed together, mostly one.

    Attributes:
        flowers: (N,) which.
        track: (T, 3) of their middle, camera frame [m]; NaN where not seen.
        pixel: what a pixel measures there [m].
        deep: whether the track's depth was measured.
    """

    flowers: NDArray[Any]
    track: Array
    pixel: float
    deep: bool


_FAINT = "moved less than the camera can tell"

_Remarks = list[tuple[str, NDArray[Any]]]
"""What there is to say, and about which flowers."""


def _track(
    frames: Sequence[Frame], intrinsics: Intrinsics, rest: Array, params: Params
) -> tuple[list[_Group], _Remarks]:
    """Follow the flowers that are at `rest` (F, 3), camera frame, when still."""
    everyone = np.arange(len(rest))
    nearest, farthest = rest[:, 2].min() - params.depth_gate, rest[:, 2].max() + params.depth_gate
    if nearest <= 0:
        return [], [("not in front of the side camera", everyone)]
    pixels, per_metre = intrinsics.project(rest), intrinsics.fx / rest[:, 2]
    weights = [petal_weight(frame, nearest, farthest) for frame in frames]
    # start where the flowers stand most like at rest: there neighbours are told apart most surely
    fits = [common_shift(w, pixels, int(params.shift * float(per_metre.mean()))) for w in weights]
    first = int(np.argmax([fit for fit, _ in fits]))
    pixels, radius = pixels + fits[first][1], params.flower_radius * per_metre
    inside = np.all((pixels >= 0) & (pixels < [intrinsics.width, intrinsics.height]), axis=1)
    centres = _centres(frames[first], weights[first], pixels, radius, depth=rest[:, 2], params=params)
    shown = np.isfinite(centres[:, 0])
    seen = np.flatnonzero(shown & inside)
    remarks: _Remarks = [
        ("outside the side camera's picture", np.flatnonzero(~inside)),
        ("hidden from the side camera", np.flatnonzero(inside & ~shown)),
    ]
    groups: list[_Group] = []
    for flowers in _overlapping(pixels, centres, params.overlap * radius, seen):
        low, high = centres[flowers].min(axis=0), centres[flowers].max(axis=0)
        half = np.ceil((high - low) / 2 + 1.4 * radius[flowers].max()).astype(int)
        reach = int(np.ceil(params.reach * per_metre[flowers].mean()))
        onward, back = (
            follow(way, (low + high) / 2, half, reach=reach, least=params.correlation)
            for way in (weights[first:], weights[first::-1])
        )
        path = np.concatenate([back[:0:-1], onward])
        depth = _depth(frames, weights, path, half, reach=params.depth_reach)
        deep = bool(np.isfinite(depth).mean() >= params.depth_share * np.isfinite(path[:, 0]).mean())
        deep = deep and abs(np.nanmedian(depth) - rest[flowers, 2].mean()) < params.hidden_gap
        if not deep:
            depth = np.full(len(frames), rest[flowers, 2].mean())
        pixel = float(np.median(depth[np.isfinite(depth)])) / intrinsics.fx
        groups.append(_Group(flowers, _lifted(intrinsics, path, depth), pixel, deep))
    return groups, remarks


def _centres(frame: Frame, weight: Image, pixels: Array, radius: Array, *, depth: Array, params: Params) -> Array:
    """Return the centre (F, 2) of the petals at each expected pixel (F, 2); NaN where there are none at its depth."""
    centres = np.full(pixels.shape, np.nan)
    for i, (pixel, r) in enumerate(zip(pixels, radius, strict=True)):
        centre = centre_of_petals(weight, pixel, r)
        if centre is None or coverage(weight, centre, r) < params.least_cover:
            continue
        there = petal_depths(frame, weight, centre, np.full(2, max(int(r), 2)))
        if len(there) < r**2 or np.abs(there - depth[i]).min() < params.hidden_gap:
            centres[i] = centre
    return centres


def _overlapping(pixels: Array, centres: Array, apart: Array, seen: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the groups of `seen` flowers linked by gaps of less than `apart` (F,), as expected or as found [px]."""
    if not len(seen):
        return []
    gaps = [np.linalg.norm(x[seen, None] - x[seen], axis=2) for x in (pixels, centres)]
    _, label = connected_components(np.minimum(*gaps) < apart[seen, None])
    return [seen[label == k] for k in range(int(label.max()) + 1)]


def _depth(
    frames: Sequence[Frame], weights: Sequence[Image], path: Array, half: NDArray[Any], *, reach: float
) -> Array:
    """Return the petals' depth (T,) [m] along a pixel path (T, 2); NaN where none is within `reach` of the median."""
    readings = [petal_depths(f, w, p, half) for f, w, p in zip(frames, weights, path, strict=True)]
    if not sum(map(len, readings)):
        return np.full(len(frames), np.nan)
    middle = np.median(np.concatenate(readings))
    own = [r[np.abs(r - middle) < reach] for r in readings]
    return np.array([np.median(r) if len(r) >= 3 else np.nan for r in own])


def _lifted(intrinsics: Intrinsics, path: Array, depth: Array) -> Array:
    """Return camera-frame points (T, 3) of a pixel path (T, 2) at depths (T,); NaN where either is missing.

    Sideways motion is measured at the median depth: depth noise would otherwise leak into it.
    """
    points = back_projected(intrinsics, path, np.full(len(path), np.nanmedian(depth)))
    points[:, 2] = depth
    return np.where(np.isfinite(points).all(axis=1, keepdims=True), points, np.nan)


def _motion(times: Array, group: _Group, hint: float, params: Params) -> tuple[float, float, float, float] | str:
    """Return amplitude, its deviation, frequency and peak acceleration of a group; or why it is not measured."""
    lost = f"lost in more than {1 - params.seen_share:.0%} of the frames. Move the side camera"
    least = max(params.seen_share * len(times), 8)
    if np.isfinite(group.track[:, 0]).sum() < least:
        return lost
    try:
        own = _without_outliers(times, group.track, hint, params.outlier)
        clean, unseen = _without_noisy_depth(times, own, hint, group.deep, params)
        swing = fit_swing(times, clean, hint)
    except InputError as error:
        return f"could not be measured: {error}"
    if np.isfinite(clean[:, 0]).sum() < least:
        return lost
    amplitude, spread = swing.amplitude, swing.amplitude_std
    limit = max(params.significance * spread, params.least_pixels * group.pixel)
    sideways = float(np.linalg.norm(np.nanstd(clean - swing.at(times), axis=0)[:2]))
    jumps = sideways > max(params.residual_pixels * group.pixel, params.relative_residual * amplitude)
    if jumps or spread > max(params.least_error, params.relative_error * amplitude):
        return "did not swing with the shake: partly hidden or confused. Shake less, or move the side camera"
    if amplitude < limit:
        return f"{_FAINT} (about {1000 * limit:.1f} mm)"
    frequency = find_frequency(times, clean, hint)
    members = params.member_spread * amplitude if len(group.flowers) > 1 else 0.0
    towards = params.depth_error * abs(swing.direction[2]) * amplitude
    spread = float(np.linalg.norm([spread, members, towards, np.hypot(amplitude, unseen) - amplitude]))
    return amplitude, spread, frequency, amplitude * (2 * np.pi * frequency) ** 2


def _without_noisy_depth(times: Array, track: Array, hint: float, deep: bool, params: Params) -> tuple[Array, float]:
    """Return the track (T, 3), without motion in depth where that is only noise, and how large it may have been [m]."""
    swing = fit_swing(times, track, hint)
    sizes, noise = np.linalg.norm(swing.coefficients[:2], axis=0), float(swing.axis_std[2])
    sideways = float(np.hypot(sizes[0], sizes[1]))
    sure = deep and noise <= max(params.least_error, params.relative_error * sideways)
    if sure and sizes[2] >= params.significance * noise:
        return track, 0.0
    unseen = params.significance * noise if sure else sideways * np.sqrt((1 + params.depthless) ** 2 - 1)
    return np.where(np.isfinite(track), track * [1, 1, 0], np.nan), float(unseen)


def _without_outliers(times: Array, track: Array, frequency: float, most: float) -> Array:
    """Return the track (T, 3) with NaN where it lies more than `most` robust deviations off its swing on any axis."""
    miss = np.abs(track - fit_swing(times, track, frequency).at(times))
    spread = 1.4826 * np.nanmedian(miss, axis=0)
    return np.where((miss <= most * np.maximum(spread, 1e-5)).all(axis=1, keepdims=True), track, np.nan)


def _named(flowers: NDArray[Any]) -> str:
    return f"Flower{'s' if len(flowers) > 1 else ''} {', '.join(str(i + 1) for i in flowers)}"


def _overlaps(groups: list[NDArray[Any]]) -> list[str]:
    """Return the one note about flowers measured together, if any."""
    who = "; ".join(", ".join(str(i + 1) for i in group) for group in groups)
    how = "together" if len(groups) == 1 else "together, each of these groups as one"
    return [f"Flowers {who} overlap in the view and are measured {how}."] if groups else []


def _merged(remarks: _Remarks) -> list[str]:
    """Return one note for each kind of remark; of the limits in the faint ones the largest is told."""
    faint = max((text for text, _ in remarks if text.startswith(_FAINT)), default="")
    kind_of = {text: faint if text.startswith(_FAINT) else text for text, flowers in remarks if len(flowers)}
    notes: list[str] = []
    for kind in dict.fromkeys(kind_of.values()):
        who = np.concatenate([flowers for text, flowers in remarks if kind_of.get(text) == kind])
        notes.append(f"{_named(np.sort(who))}: {kind}.")
    return notes
