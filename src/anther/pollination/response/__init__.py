"""Response: how the flowers moved during the shake, measured in the side camera's frames. T frames, F flowers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_range, check_transform
from anther.core.errors import InputError, bad_input
from anther.core.geometry import Array, Intrinsics, inverse, transform_points
from anther.core.oscillation import find_frequency, fit_swing
from anther.core.records import Range, Shape, Stored
from anther.perception.flowers import Flowers
from anther.pollination.execution import Step
from anther.pollination.response._following import Followed, Remarks, follow_flowers, without_outliers
from anther.pollination.response._near_grasp import StemMotion, StemNear, measure_stem, stem_near
from anther.pollination.response.thresholds import (
    FEWEST_FRAMES,
    LEAST_SPREAD,
    SEEN_SHARE,
    SPREAD,
    most_residual,
    overtones,
)
from anther.robot.devices import Frame

__all__ = ["Response", "StemMotion", "StemNear", "measure_response", "stem_near"]


@dataclass(frozen=True, slots=True, eq=False)
class Response(Stored):
    """Measured flower motion. What could not be measured is NaN.

    Attributes:
        times: (T,) of the frames [s].
        tracks: (T, F, 3) flower centres, world [m]; NaN where not seen.
        amplitude: (F,) semi-major axis of each flower's swing at the shake's frequency [m].
        amplitude_std: (F,) its standard deviation [m].
        frequency: (F,) of the swing [Hz].
        frequency_std: (F,) its standard deviation [Hz] (Rife & Boorstyn 1974, the bound that least squares reaches).
        direction: (F, 3) unit vector along which it swung most, world; without what the camera could not see of it.
        phase: (F,) [rad] of the swing along `direction`: sin(2 pi f t + phase), f the shake's frequency, t the cameras'
            clock. Where the flower moves on an ellipse, other directions have other phases.
        phase_std: (F,) its standard deviation [rad].
        acceleration_peak: (F,) the largest in a period [m/s2], with overtones where a shake is slow.
        at_most: (F,) where a flower was followed but moved less than can be told: that least amplitude [m].
        visible: (F,) bool, whether it could be measured.
        notes: what the stage wants the user to know.
        stem: how the main stem moved beside the pads.
    """

    KIND, SCHEMA, CALLED = "response", 5, "response"
    times: Annotated[Array, Shape("T"), Range(unit="s")]
    tracks: Annotated[Array, Shape("T", "F", 3, missing=True), Range(unit="m")]
    amplitude: Annotated[Array, Shape("F", missing=True), Range(unit="m")]
    amplitude_std: Annotated[Array, Shape("F", missing=True), Range(unit="m")]
    frequency: Annotated[Array, Shape("F", missing=True), Range(unit="Hz")]
    frequency_std: Annotated[Array, Shape("F", missing=True), Range(unit="Hz")]
    phase: Annotated[Array, Shape("F", missing=True), Range(unit="rad")]
    phase_std: Annotated[Array, Shape("F", missing=True), Range(unit="rad")]
    acceleration_peak: Annotated[Array, Shape("F", missing=True), Range(unit="m/s2")]
    at_most: Annotated[Array, Shape("F", missing=True), Range(unit="m")]
    direction: Annotated[Array, Shape("F", 3, missing=True)]
    visible: Annotated[NDArray[np.bool_], Shape("F")]
    notes: tuple[str, ...] = ()
    stem: StemMotion = field(default_factory=lambda: StemMotion.of([]))

    def flower_acceleration(self, steps: Sequence[Step] = ()) -> Array:
        """Return (F,) the peak acceleration of each flower [m/s2]; NaN where nothing tells.

        It is what was measured after the shake; else in the last of its steps; else 0 where the flower was followed,
        but moved less than can be told.
        """
        unmoved = np.where(np.isfinite(self.at_most), 0.0, np.nan)
        during = np.array(steps[-1].flowers, dtype=float) if steps else np.full(len(self.visible), np.nan)
        return np.where(self.visible, self.acceleration_peak, np.where(np.isfinite(during), during, unmoved))


def measure_response(
    frames: Sequence[Frame],
    intrinsics: Intrinsics,
    T_world_cam: Array,
    flowers: Flowers,
    frequency_hint: float,
    *,
    exposure: float = 0.0,
    stem: StemNear | None = None,
) -> Response:
    """Follow every flower through the frames and fit its swing.

    Each flower is looked for where its position at rest projects, all flowers shifted together first because the held
    plant stands a little differently; then followed by its own pixels, lifted to 3-D by their depth, and a sinusoid of
    the shake's frequency is fitted (`oscillation.fit_swing`). Flowers that overlap in the image may be mixed up, which
    their deviation contains. A swing below what the camera can tell is NaN, never a guess; notes say why, one for each
    reason.

    Args:
        frames: of a camera that stands still, while the plant was shaken.
        intrinsics: of the camera.
        T_world_cam: (4, 4) its pose.
        flowers: at rest, as perception found them.
        frequency_hint: the shake's frequency [Hz].
        exposure: of each frame, if it is known [s]. What swings while the shutter is open shows sinc(f exposure) of its
            amplitude (0.84 at 27 Hz and 12 ms), which is made up for.
        stem: where to look for the main stem beside the pads; None: nowhere.

    Raises:
        InputError: fewer than 8 frames, frames of another size, or an exposure of more than half a period.
    """
    _check(frames, intrinsics)
    check_range("frequency_hint", frequency_hint, 1e-3, 1e3, "Hz")
    blurred = 0.5  # of the period: a shutter open for longer shows less than 0.64 of the swing
    check_range("exposure", exposure, 0, blurred / frequency_hint, "s")
    sharp = float(np.sinc(frequency_hint * exposure))
    T = check_transform("T_world_cam", T_world_cam)
    times = np.array([f.time for f in frames])
    rest = transform_points(inverse(T), flowers.positions)
    found, mixed, remarks = follow_flowers(frames, intrinsics, rest, frequency_hint)
    tracks, motions = np.full((len(frames), len(rest), 3), np.nan), [_Motion.unseen()] * len(rest)
    for one in found:
        tracks[:, one.flower] = one.track @ T[:3, :3].T + T[:3, 3]
        measured = _motion(times, one, frequency_hint)
        if isinstance(measured, str):
            remarks.setdefault(measured, []).append(one.flower)
            continue
        larger = {name: getattr(measured, name) / sharp for name in _SIZES}
        motions[one.flower] = measured._replace(direction=T[:3, :3] @ measured.direction, **larger)
        if not one.deep and np.isfinite(measured.amplitude):
            remarks.setdefault("no sure depth: motion towards the camera is left out", []).append(one.flower)
    values = {name: np.array([getattr(motion, name) for motion in motions], dtype=float) for name in _NUMBERS}
    direction = np.array([motion.direction for motion in motions]).reshape(-1, 3)
    visible, notes = np.isfinite(values["amplitude"]), _notes(mixed, remarks, values["at_most"])
    beside = StemMotion.of([]) if stem is None else measure_stem(frames, intrinsics, T, stem, frequency_hint)
    return Response(times, tracks, **values, direction=direction, visible=visible, notes=notes, stem=beside)


def _check(frames: Sequence[Frame], intrinsics: Intrinsics) -> None:
    if len(frames) < FEWEST_FRAMES:
        allowed = f"{FEWEST_FRAMES} or more"
        raise bad_input("frames", given=len(frames), allowed=allowed, do="Record longer or faster.")
    size = (intrinsics.height, intrinsics.width)
    wrong = [f for f in frames if f.depth.shape != size or f.rgb.shape != (*size, 3)]
    if wrong:
        raise bad_input(
            "frame", given=f"{wrong[0].depth.shape}", allowed=f"{size}", do="Give this camera's intrinsics."
        )


class _Motion(NamedTuple):
    """What `Response` says of one flower."""

    direction: Array
    amplitude: float = float("nan")
    amplitude_std: float = float("nan")
    frequency: float = float("nan")
    frequency_std: float = float("nan")
    phase: float = float("nan")
    phase_std: float = float("nan")
    acceleration_peak: float = float("nan")
    at_most: float = float("nan")

    @staticmethod
    def unseen(at_most: float = float("nan")) -> _Motion:
        """Return that of a flower that was not measured: it moves by no more than `at_most` [m]."""
        return _Motion(np.full(3, np.nan), at_most=at_most)


_SIZES = ("amplitude", "amplitude_std", "acceleration_peak", "at_most")
_NUMBERS = tuple(name for name in _Motion._fields if name != "direction")


SIGNIFICANCE = 3.0
"""Nor are those smaller than this many standard deviations."""


def _motion(times: Array, one: Followed, hint: float) -> _Motion | str:
    """Return the motion of a flower, or why it is not measured."""
    lost = f"lost in more than {1 - SEEN_SHARE:.0%} of the frames. Move the side camera"
    if np.isfinite(one.track[:, 0]).mean() < SEEN_SHARE:
        return lost
    try:
        own = without_outliers(times, one.track, hint, overtones(hint))
        clean, unseen = _without_noisy_depth(times, own, hint, one.deep)
        swing = fit_swing(times, clean, hint, overtones(hint))
    except InputError as error:
        return f"could not be measured: {error}"
    if np.isfinite(clean[:, 0]).mean() < SEEN_SHARE:
        return lost
    amplitude, noise = swing.amplitude, swing.amplitude_std
    least_pixels = 0.2  # of a swing in the image
    limit = max(SIGNIFICANCE * noise, least_pixels * one.pixel)
    sideways = float(np.linalg.norm(np.nanstd(clean - swing.at(times), axis=0)[:2]))
    jumps = sideways > most_residual(one.pixel, amplitude)
    if jumps or noise > _most_noise(amplitude):
        return "did not swing with the shake: partly hidden or confused. Shake less, or move the side camera"
    if amplitude < limit:
        return _Motion.unseen(limit)
    weight = 1 / np.maximum(swing.axis_std, 0.3 * swing.axis_std.max())  # the surer an axis, the more it tells
    frequency, span = find_frequency(times, clean * weight, hint), float(np.ptp(times))
    mixed_up = 0.15  # `SPREAD` of flowers that may be mixed up
    usual = amplitude * (mixed_up if one.mixed else SPREAD)
    spread = float(np.linalg.norm([noise, LEAST_SPREAD, usual, np.hypot(amplitude, unseen) - amplitude]))
    phase_error = 0.05  # rad, beside what the residual tells: 98 % of phases in films lay within two deviations
    return _Motion(
        direction=swing.direction,
        amplitude=amplitude,
        amplitude_std=spread,
        frequency=frequency,
        frequency_std=float(np.sqrt(3) / np.pi * noise / amplitude / span),
        phase=swing.phase,
        phase_std=float(np.hypot(noise / amplitude, phase_error)),
        # in depth noise passes for overtones
        acceleration_peak=swing.acceleration(limit, axes=2) * (frequency / hint) ** 2,
    )


def _most_noise(amplitude: float) -> float:
    """Return the standard deviation [m] up to which an amplitude [m] counts as measured: 0.3 mm, or a tenth of it."""
    return max(0.0003, 0.1 * amplitude)


def _without_noisy_depth(times: Array, track: Array, hint: float, deep: bool) -> tuple[Array, float]:
    """Return the track (T, 3), without motion in depth where that is only noise, and how large it may have been [m].

    Without it the flower is where its rays pass the plane of its median depth: its motion across the line of sight.
    """
    flat = track * (np.nanmedian(track[:, 2]) / track[:, 2:])
    swing, across = fit_swing(times, track, hint), fit_swing(times, flat, hint).amplitude
    size, noise = float(np.linalg.norm(swing.coefficients[:2, 2])), float(swing.axis_std[2])
    sure = deep and noise <= _most_noise(across)
    if sure and size >= SIGNIFICANCE * noise:
        return track, 0.0
    depthless = 0.2  # spread of the whole amplitude relative to its sideways part, where depth is not sure
    unseen = SIGNIFICANCE * noise if sure else across * np.sqrt((1 + depthless) ** 2 - 1)
    return flat, float(unseen)


def _notes(mixed: list[NDArray[Any]], remarks: Remarks, at_most: Array) -> tuple[str, ...]:
    """Return one note for each reason; of the limits of the faint ones the largest is told."""
    reasons: dict[str, Sequence[int]] = {**remarks}
    faint = np.flatnonzero(np.isfinite(at_most))
    if len(faint):
        reasons[f"moved less than the camera can tell (about {1000 * at_most[faint].max():.1f} mm)"] = faint.tolist()
    notes = [f"{'Flowers' if len(who) > 1 else 'Flower'} {_named(who)}: {why}." for why, who in reasons.items() if who]
    groups = "; ".join(_named(group) for group in mixed)
    overlap = [f"Flowers {groups} overlap in the view: their motions may be mixed up."] if groups else []
    return (*overlap, *notes)


def _named(flowers: Iterable[int]) -> str:
    return ", ".join(str(k + 1) for k in sorted(flowers))
