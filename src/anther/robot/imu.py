"""What a gripper does while an arm shakes it, by an inertial sensor that rides with it.

An arm reads its motors, not its links: above some 5 Hz the springs of its joints leave open how the gripper moves.
K frequencies.
"""

from __future__ import annotations

import numpy as np

from anther.core.geometry import Array, ComplexArray
from anther.plant.limits import GRAVITY
from anther.robot.devices import DeviceError, ImuReadings

ERROR = 0.05
"""Standard deviation of a measured motion relative to it, without noise: 1 % of scale and two degrees of mounting; a
guess."""
CHECK = "Check how it is mounted and calibrated."


def measure_motion(
    readings: ImuReadings, span: tuple[float, float], T_world_imu: Array, point: Array, frequencies: Array
) -> tuple[ComplexArray, Array]:
    """Return (K, 3) phasors of what a point of the hand does in a shake of known frequencies, world [m], and (K,) the
    standard deviation of real and imaginary parts [m].

    x(t) = Im(phasor exp(2 pi i f t)), t on the clock of the readings. The hand turns little: with its rotation theta,
    from the gyroscope, the accelerometer reads a - g + theta x g to first order, and the point moves by theta x r
    besides.

    Args:
        readings: of the shake.
        span: begin and end of its steady part [s].
        T_world_imu: (4, 4) the sensor's pose about which it swings.
        point: (3,) of the hand, world [m].
        frequencies: (K,) of the shake [Hz].

    Raises:
        DeviceError: the readings do not cover the span, are such as no sensor at this pose can have, or their noise
            hides the motion.
    """
    tones, (begin, end) = np.asarray(frequencies, dtype=np.float64), span
    used = (readings.times >= begin) & (readings.times <= end)
    times, omega = readings.times[used], 2 * np.pi * tones
    _check_times(times, span, float(tones.max()))
    angle = times[:, None] * omega
    basis = np.column_stack([np.sin(angle), np.cos(angle), times - times.mean(), np.ones_like(times)])
    both = np.column_stack([readings.acceleration[used], readings.rate[used]])
    if not np.ptp(both, axis=0).any():
        raise DeviceError(f"inertial sensor: got the same reading {len(times)} times; allowed: once. Restart it.")
    parts, R = np.linalg.lstsq(basis, both, rcond=None)[0], T_world_imu[:3, :3]
    _check_gravity(R @ parts[-1, :3])
    spare = max(len(times) - basis.shape[1], 1)
    noise = np.sqrt(np.sum((both - basis @ parts)[:, :3] ** 2) / (3 * spare))
    std = noise * np.sqrt(np.linalg.inv(basis.T @ basis).diagonal()[: len(omega)])
    phasors = parts[: len(omega)] + 1j * parts[len(omega) : 2 * len(omega)]
    turned = phasors[:, 3:] @ R.T / (1j * omega[:, None])
    accelerated = phasors[:, :3] @ R.T - np.cross(turned, [0.0, 0.0, -GRAVITY])
    moved = -accelerated / omega[:, None] ** 2 + np.cross(turned, point - T_world_imu[:3, 3])
    size, hidden = np.linalg.norm(moved, axis=1), 0.3  # of a motion that is its own error; a judgement
    std = np.hypot(std / omega**2, ERROR * size / np.sqrt(6))
    if np.any(std > hidden * size):
        given = f"a motion of {1e3 * size.min():.2g} mm with an error of {1e3 * std[size.argmin()]:.2g} mm"
        raise DeviceError(f"inertial sensor: got {given}; allowed: {hidden:.0%} of it. Shake more, or for longer.")
    return np.asarray(moved, dtype=np.complex128), std


def _check_times(times: Array, span: tuple[float, float], fastest: float) -> None:
    """Check that readings at `times` [s] tell tones up to `fastest` [Hz] throughout a span.

    Raises:
        DeviceError: they do not.
    """
    half, late = 0.5 / fastest, 0.1  # s: half a period; what the last reading may take to arrive, a guess
    gaps = np.diff(times)
    if len(times) < 2 or times[0] - span[0] > late or span[1] - times[-1] > late or gaps.max() > half:
        given = f"{len(times)} readings in {span[1] - span[0]:.2f} s"
        allowed = f"one in every {1e3 * half:.0f} ms of them"
        raise DeviceError(f"inertial sensor: got {given}; allowed: {allowed}. Check its cable and its rate.")


def _check_gravity(mean: Array) -> None:
    """Check that what an accelerometer reads in the mean (3,), world [m/s2], is gravity's.

    Raises:
        DeviceError: it is not.
    """
    size, tilt = float(np.linalg.norm(mean)), float(np.degrees(np.arctan2(np.hypot(*mean[:2]), mean[2])))
    error, widest = 0.1, 10.0  # uncalibrated sensors are off by a few per cent; deg; guesses
    if not abs(size / GRAVITY - 1) <= error:
        raise DeviceError(f"inertial sensor: got {size:.3g} m/s2 of gravity; allowed: {GRAVITY:g} +- 10 %. {CHECK}")
    if tilt > widest:
        given = f"gravity {tilt:.0f} degrees from where the arm's joints have it"
        raise DeviceError(f"inertial sensor: got {given}; allowed: {widest:g}. {CHECK}")
