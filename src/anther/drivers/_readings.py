"""The joints that a robot tells (sensor_msgs/JointState of ROS 1 and 2): put in order, on this machine's clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from anther.devices import DeviceError
from anther.geometry import Array

STALE = 0.05
"""Joints read longer ago than this are not believed [s]."""
DRIFT = 1e-4
"""Clocks drift apart by less than this [s/s]: an order more than quartz does."""


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Joints (J,) [rad] read at `time` [s] on this machine's clock, by the robot's stamp."""

    time: float
    joints: Array


class RobotClock:
    """A robot's clock, set behind this machine's by the message that came quickest.

    Attributes:
        offset: this machine's time less the robot's [s]; NaN before the first message.
    """

    def __init__(self) -> None:
        self.offset = self._heard = float("nan")

    def hear(self, stamp: float, arrival: float) -> None:
        """Take the stamp of a message [s], and when it arrived on this machine's clock [s]."""
        lag, drifted = arrival - stamp, self.offset + DRIFT * (arrival - self._heard)
        self.offset = lag if np.isnan(drifted) else min(lag, drifted)
        self._heard = arrival


class Readings:
    """The joints as they come in, put in order by their names.

    Attributes:
        last: the newest; None before the first.
        trouble: why what comes in cannot be used; empty while it can.
        others: names of the joints that came in without any of the arm's.
        rate: readings a second, of the last hundred.
    """

    def __init__(self, names: Sequence[str], clock: Callable[[], float]) -> None:
        self.last: Reading | None = None
        self.trouble, self.rate = "", float("nan")
        self.others: tuple[str, ...] = ()
        self._names, self._clock, self._arrivals = tuple(names), clock, list[float]()
        self._robot = RobotClock()

    @property
    def offset(self) -> float:
        """See `RobotClock`."""
        return self._robot.offset

    def hear(self, message: Any) -> None:
        """Take a sensor_msgs/JointState; one of other joints only is passed over."""
        arrival, stamp = self._clock(), message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        places = {name: i for i, name in enumerate(message.name)}
        if not any(name in places for name in self._names):
            self.others = tuple(places)
            return
        missing = [name for name in self._names if name not in places]
        if missing or len(places) != len(message.name) or len(message.position) != len(message.name):
            told = f"{', '.join(missing)} missing" if missing else f"{len(message.position)} angles, names twice"
            self.trouble = f"joints: got {', '.join(message.name)}: {told}; allowed: {', '.join(self._names)}"
            return
        joints = np.array([message.position[places[name]] for name in self._names], dtype=float)
        if not np.isfinite(joints).all():
            self.trouble = f"joints: got {joints} rad"
            return
        self._robot.hear(stamp, arrival)
        self._arrivals = [*self._arrivals[-99:], arrival]
        if len(self._arrivals) > 1:
            self.rate = (len(self._arrivals) - 1) / max(arrival - self._arrivals[0], 1e-9)
        self.trouble = ""
        if self.last is None or stamp + self.offset > self.last.time:
            self.last = Reading(stamp + self.offset, joints)

    def age(self) -> float:
        """Return how old the newest is [s]; infinite before the first."""
        return float("inf") if self.last is None else self._clock() - self.last.time

    def newest(self, stale: float) -> Reading:
        """Return the newest reading.

        Raises:
            DeviceError: it is older than `stale` [s], or what comes in cannot be used.
        """
        reading, age = self.last, self.age()
        if self.trouble:
            raise DeviceError(f"{self.trouble}. Check the robot's description, and start anew.")
        if reading is None or age > stale:
            given = f"the newest joints are {1e3 * age:.0f} ms old; allowed: {1e3 * stale:.0f} ms"
            raise DeviceError(f"{given}. Check network, robot, and both clocks; then start anew.")
        return reading
