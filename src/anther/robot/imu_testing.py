"""Checks for whoever writes a driver of an inertial sensor, as `anther.robot.testing` has for arms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from anther.plant.limits import GRAVITY
from anther.robot.devices import Imu, ImuReadings
from anther.robot.testing import _connect, _require

__all__ = ["IMU_CHECKS", "ImuRig"]


@dataclass(frozen=True, slots=True, eq=False)
class ImuRig:
    """A driver of an inertial sensor that lies still, and the clock of its robot.

    Attributes:
        connect: returns the connected driver.
        clock: the robot's [s].
        sleep: [s].
        rate: how often it reads at least [1/s].
    """

    connect: Callable[[], Imu]
    clock: Callable[[], float]
    sleep: Callable[[float], Any]
    rate: float = 100.0


def _recorded(rig: ImuRig, imu: Imu, seconds: float) -> ImuReadings:
    imu.start()
    begin = rig.clock()
    rig.sleep(seconds)
    return imu.recorded(begin)


def check_imu_readings(rig: ImuRig) -> None:
    """Readings come as often as is said, have times that go forward on the robot's clock, and hold gravity."""
    with _connect(rig.connect) as imu:
        begin, seconds = rig.clock(), 0.5
        told, now = _recorded(rig, imu, seconds), rig.clock()
    _require(len(told.times) >= 0.8 * rig.rate * seconds, f"{len(told.times)} readings in {seconds:g} s")
    _require(bool(np.all(np.diff(told.times) > 0)), "the times of readings do not increase")
    _require(begin - 0.1 <= told.times[0] and told.times[-1] <= now + 1e-3, "times are not of the robot's clock")
    size, error = float(np.linalg.norm(told.acceleration.mean(axis=0))), 0.1
    _require(abs(size / GRAVITY - 1) <= error, f"at rest it reads {size:.3g} m/s2, not {GRAVITY:g}")
    turns = float(np.linalg.norm(told.rate.mean(axis=0)))
    _require(turns <= error, f"at rest it turns with {turns:.2g} rad/s: are these degrees?")


def check_imu_recording(rig: ImuRig) -> None:
    """What was read before `start`, before `since` or after `stop` is not told; a second recording begins anew."""
    with _connect(rig.connect) as imu:
        first = _recorded(rig, imu, 0.3)
        half = float(first.times[len(first.times) // 2])
        _require(bool(np.all(imu.recorded(half).times >= half)), "readings from before the time that was asked for")
        _require(not len(imu.recorded(rig.clock() + 10).times), "readings from after now")
        imu.stop()
        rig.sleep(0.1)
        imu.start()
        rig.sleep(0.2)
        again = imu.recorded(float("-inf")).times
        _require(len(again) > 0 and bool(again[0] > first.times[-1]), "a recording holds readings of the one before")
        imu.stop()


IMU_CHECKS = (check_imu_readings, check_imu_recording)
"""What every inertial sensor keeps."""
