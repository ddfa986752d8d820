"""A sensor on the hand tells what a point of the hand does; readings that cannot be of one there are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from anther.core.geometry import Array, ComplexArray, transform
from anther.plant.limits import GRAVITY
from anther.robot.devices import DeviceError, ImuReadings
from anther.robot.imu import ERROR, measure_motion

TONES = np.array([3.0, 8.0, 21.0])
RNG = np.random.default_rng(3)
SHIFTS = 0.4e-3 * (RNG.normal(size=(3, 3)) + 1j * RNG.normal(size=(3, 3)))
"""What the sensor does at each tone [m], and how the hand turns [rad]."""
TURNS = 4e-3 * (RNG.normal(size=(3, 3)) + 1j * RNG.normal(size=(3, 3)))
T_WORLD_IMU = transform(Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix(), [0.6, 0.1, 0.3])
POINT = np.array([0.75, 0.02, 0.38])
SPAN = (100.2, 100.9)


def swung(phasors: ComplexArray, times: Array) -> Array:
    """Return (N, 3) the motion of phasors by tone."""
    return np.imag(np.exp(2j * np.pi * times[:, None] * TONES) @ phasors)


def readings(rate: float = 250.0, span: tuple[float, float] = (100.0, 101.0)) -> ImuReadings:
    """Return what a perfect sensor reads on a hand that shifts and turns."""
    step = 1e-4
    times = np.arange(span[0], span[1], 1 / rate)
    places = [swung(SHIFTS, times + k * step) for k in (-1, 0, 1)]
    poses = [Rotation.from_rotvec(swung(TURNS, times + k * step)) for k in (-1, 0, 1)]
    nominal = Rotation.from_matrix(T_WORLD_IMU[:3, :3])
    force = (places[0] - 2 * places[1] + places[2]) / step**2 + [0, 0, GRAVITY]
    turned = (poses[0].inv() * poses[2]).as_rotvec() / (2 * step)
    # in its own frame: a turn of the hand, then the way it is mounted
    own = (poses[1] * nominal).inv().apply(force)
    return ImuReadings(times, own, nominal.inv().apply(turned))


TOLD = readings()


def test_what_a_point_of_the_hand_does_is_told_to_a_few_per_cent() -> None:
    """It swings about the sensor by 20 cm times the turn: without that, or without gravity's turn, it is far off."""
    truth = SHIFTS + np.cross(TURNS, POINT - T_WORLD_IMU[:3, 3])
    found, std = measure_motion(TOLD, SPAN, T_WORLD_IMU, POINT, TONES)
    assert np.linalg.norm(found - truth) < 0.02 * np.linalg.norm(truth)
    for tone in range(3):
        assert np.linalg.norm(found[tone] - truth[tone]) < 0.04 * np.linalg.norm(truth[tone])
        assert std[tone] == pytest.approx(ERROR * np.linalg.norm(found[tone]) / np.sqrt(6), rel=0.3)


def test_noise_is_in_the_error_that_is_told() -> None:
    truth, _ = measure_motion(TOLD, SPAN, T_WORLD_IMU, POINT, TONES)
    rng, off, told = np.random.default_rng(0), list[ComplexArray](), list[Array]()
    for _ in range(20):
        noisy = replace(TOLD, acceleration=TOLD.acceleration + 0.3 * rng.normal(size=TOLD.acceleration.shape))
        found, std = measure_motion(noisy, SPAN, T_WORLD_IMU, POINT, TONES[1:])
        off.append(found - truth[1:])
        told.append(std)
    noise = np.sqrt(np.mean(told, axis=0) ** 2 - ERROR**2 * np.linalg.norm(truth[1:], axis=1) ** 2 / 6)
    assert np.sqrt(np.mean(np.abs(off) ** 2, axis=(0, 2)) / 2) == pytest.approx(noise, rel=0.5)


def test_readings_before_and_after_the_span_do_not_count() -> None:
    found, _ = measure_motion(TOLD, SPAN, T_WORLD_IMU, POINT, TONES)
    late = TOLD.times > SPAN[1]
    disturbed = replace(TOLD, acceleration=np.where(late[:, None], 50.0, TOLD.acceleration))
    assert np.array_equal(measure_motion(disturbed, SPAN, T_WORLD_IMU, POINT, TONES)[0], found)


def without(used: Callable[[Array], Array]) -> ImuReadings:
    rows = used(TOLD.times)
    return ImuReadings(TOLD.times[rows], TOLD.acceleration[rows], TOLD.rate[rows])


WRONG: dict[str, tuple[ImuReadings, str]] = {
    "nothing": (without(lambda t: t < 0), "0 readings in 0.70 s"),
    "silent since": (without(lambda t: t < 100.6), "allowed: one in every"),
    "a gap": (without(lambda t: (t < 100.4) | (t > 100.45)), "allowed: one in every 24 ms"),
    "slow": (readings(rate=30.0), "its rate"),
    "frozen": (
        replace(TOLD, acceleration=np.tile(TOLD.acceleration[:1], (250, 1)), rate=np.tile(TOLD.rate[:1], (250, 1))),
        "the same reading",
    ),
    "noise": (
        replace(TOLD, acceleration=TOLD.acceleration + 8.0 * RNG.normal(size=(250, 3))),
        "Shake more, or for longer",
    ),
    "in g": (replace(TOLD, acceleration=TOLD.acceleration / GRAVITY), "1 m/s2 of gravity"),
    "axes exchanged": (replace(TOLD, acceleration=TOLD.acceleration[:, [1, 2, 0]]), "degrees from where the arm"),
    "gravity taken out": (replace(TOLD, acceleration=TOLD.acceleration - TOLD.acceleration.mean(axis=0)), "gravity"),
}


@pytest.mark.parametrize("what", WRONG)
def test_readings_that_cannot_be_are_refused_with_what_is_wrong(what: str) -> None:
    told, words = WRONG[what]
    with pytest.raises(DeviceError, match=words):
        measure_motion(told, SPAN, T_WORLD_IMU, POINT, TONES)
