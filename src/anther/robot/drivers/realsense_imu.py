"""The inertial sensor in a RealSense D435i or D455, as a `devices.Imu`; on metal it has not run (docs/cameras.md).

Accelerometer and gyroscope come apart, each at its own rate; the SDK turns both into the axes of the depth lens
(librealsense: doc/d435i.md).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from anther.core.geometry import Array
from anther.robot.devices import DeviceError, ImuReadings
from anther.robot.drivers._readings import Kept
from anther.robot.drivers.realsense import (
    Found,
    Stamps,
    closed_on_error,
    find_device,
    info_of,
    load_sdk,
    stamp_in_host_time,
    way_between,
)


class RealSenseImu:
    """Accelerometer and gyroscope of the RealSense that is the wrist camera, each at its fastest rate.

    They are read all the time; what `recorded` gives begins with `start`.

    Args:
        serial: which camera, as printed on it; None: the only one.
        clock: the robot's [s].
        devices: gives what is connected; None: the SDK's own search.

    Attributes:
        T_cam_imu: (4, 4) in the frame of the colour lens [m], as the camera says.

    Raises:
        MissingExtra: pyrealsense2 is not installed.
        DeviceError: no such camera, it has no such sensor, or nothing is read.
    """

    _patience = 3.0
    """Something is read within this time [s]."""

    def __init__(
        self,
        serial: str | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        devices: Found | None = None,
    ) -> None:
        self._rs, self._since = load_sdk(), float("inf")
        self._stamps = Stamps(self._rs, clock)
        self._force, self._rate, self._sensor = Kept(), Kept(), None
        with closed_on_error(self.close, "RealSense's inertial sensor"):
            device = find_device(self._rs, devices or self._rs.context().query_devices, serial)
            self._sensor, profiles = self._streams(device)
            self.T_cam_imu = self._place(device, profiles[0])
            self._sensor.open(profiles)
            self._sensor.start(self._receive)
            if not all(kept.has_begun(self._patience) for kept in (self._force, self._rate)):
                given = f"nothing within {self._patience:g} s"
                raise DeviceError(f"RealSense's inertial sensor: got {given}; allowed: both streams. Plug it in anew.")

    def start(self) -> None:
        """Begin to record."""
        self._since = self._force.newest

    def recorded(self, since: float) -> ImuReadings:
        """Return what was read from `since` on [s], the gyroscope's readings at the times of the accelerometer's."""
        force = np.array(self._force.since(max(since, self._since))).reshape(-1, 4)
        rate = np.array(self._rate.since(float("-inf"))).reshape(-1, 4)
        times = rate[:, 0]
        both = (force[:, 0] >= times.min(initial=np.inf)) & (force[:, 0] <= times.max(initial=-np.inf))
        force = force[both]
        turned = [np.interp(force[:, 0], times, axis) if len(force) else np.zeros(0) for axis in rate[:, 1:].T]
        return ImuReadings(force[:, 0], force[:, 1:], np.transpose(turned))

    def stop(self) -> None:
        """End the recording."""
        self._since = float("inf")

    def close(self) -> None:
        """Let go of the sensor; of that of an unplugged camera as well."""
        sensor, self._sensor = self._sensor, None
        if sensor is not None:
            with suppress(RuntimeError):
                sensor.stop()
            with suppress(RuntimeError):
                sensor.close()

    def _streams(self, device: Any) -> tuple[Any, list[Any]]:
        """Return the sensor, and its fastest profiles of accelerometer and gyroscope.

        Raises:
            DeviceError: the camera has none.
        """
        rs = self._rs
        for sensor in device.query_sensors():
            profiles = list(sensor.get_stream_profiles())
            found = [
                max((p for p in profiles if p.stream_type() == kind), key=lambda p: p.fps(), default=None)
                for kind in (rs.stream.accel, rs.stream.gyro)
            ]
            if all(found):
                stamp_in_host_time(rs, sensor)
                return sensor, found
        name = info_of(device, rs.camera_info.name) or "this RealSense"
        raise DeviceError(f"{name} has no inertial sensor: a D435i or D455 has one. Remove [imu] from the cell file.")

    def _place(self, device: Any, accelerometer: Any) -> Array:
        """Return T_cam_imu (4, 4), to the colour lens."""
        rs = self._rs
        colours = (
            profile
            for sensor in device.query_sensors()
            for profile in sensor.get_stream_profiles()
            if profile.stream_type() == rs.stream.color
        )
        return way_between(accelerometer, next(colours))

    def _receive(self, frame: Any) -> None:
        """Take a reading, in the SDK's own thread."""
        data = frame.as_motion_frame().get_motion_data()
        is_force = frame.get_profile().stream_type() == self._rs.stream.accel
        (self._force if is_force else self._rate).take(self._stamps.time(frame), data.x, data.y, data.z)
