"""An inertial sensor that publishes sensor_msgs/Imu under ROS 2, as a `devices.Imu`; no real one was heard."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from anther.robot.devices import DeviceError, ImuReadings
from anther.robot.drivers._readings import Kept, RobotClock
from anther.robot.drivers.ros2 import Node


class Ros2Imu:
    """What a topic tells.

    Args:
        node: a `Node`.
        topic: of sensor_msgs/Imu, acceleration and rate in one message.
        clock: the robot's [s]; the message that came quickest sets the stamps on it.

    Attributes:
        T_cam_imu: None: it is no part of the wrist camera.

    Raises:
        InputError: no name of a topic.
        DeviceError: nothing is heard.
    """

    T_cam_imu = None
    _patience = 5.0
    """Something is heard within this time [s]."""

    def __init__(self, node: Node, topic: str = "/imu", *, clock: Callable[[], float] = time.monotonic) -> None:
        self.node, self._clock, self._since = node, clock, float("inf")
        self._kept, self._robot_clock = Kept(), RobotClock()
        node.subscribe(topic, "sensor_msgs/msg/Imu", self._receive)
        if not self._kept.has_begun(self._patience):
            given = f"nothing within {self._patience:g} s on {topic}"
            raise DeviceError(f"inertial sensor: got {given}; allowed: sensor_msgs/Imu. Is its driver running?")

    def start(self) -> None:
        """Begin to record."""
        self._since = self._kept.newest

    def recorded(self, since: float) -> ImuReadings:
        """Return what was read from `since` on [s]."""
        rows = np.array(self._kept.since(max(since, self._since))).reshape(-1, 7)
        return ImuReadings(rows[:, 0], rows[:, 1:4], rows[:, 4:])

    def stop(self) -> None:
        """End the recording."""
        self._since = float("inf")

    def close(self) -> None:
        """End the node."""
        self.node.close()

    def _receive(self, message: Any) -> None:
        arrival, stamp = self._clock(), message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        force, rate = message.linear_acceleration, message.angular_velocity
        self._robot_clock.receive(stamp, arrival)
        self._kept.take(stamp + self._robot_clock.offset, force.x, force.y, force.z, rate.x, rate.y, rate.z)
