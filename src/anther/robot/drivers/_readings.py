"""What an arm tells of its joints, put in order and on this machine's clock. J joints."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from anther.core.geometry import Array
from anther.robot.devices import DeviceError

STALE = 0.05
"""Joints read longer ago than this are not believed [s]."""


class Reading(NamedTuple):
    """Joints (J,) [rad] read at `time` [s] on this machine's clock, by the robot's stamp."""

    time: float
    joints: Array


def rate_of(readings: list[Reading]) -> Array | None:
    """Return the rates (J,) [rad/s] of readings in order, at the last; None where too few are close enough."""
    last = readings[-1]
    # two readings at 100 Hz and more, before the rate is another
    before = next((r for r in readings if 0.02 <= last.time - r.time <= 0.06), None)
    return None if before is None else (last.joints - before.joints) / (last.time - before.time)


def check_fresh(age: float, stale: float = STALE) -> None:
    """Refuse joints that were read longer ago than `stale` [s]."""
    if not age <= stale:
        given = f"the newest joints are {1e3 * age:.0f} ms old; allowed: {1e3 * stale:.0f} ms"
        raise DeviceError(f"{given}. Check network, robot, and both clocks; then start anew.")


def check_finite_joints(joints: Array) -> Array:
    """Return joints (J,) [rad] that are numbers."""
    if not np.isfinite(joints).all():
        raise DeviceError(f"joints: got {joints} rad. The arm does not tell where it is.")
    return joints


class RobotClock:
    """A robot's clock, set behind this machine's by the message that came quickest.

    Attributes:
        offset: this machine's time less the robot's [s]; NaN before the first message.
    """

    def __init__(self) -> None:
        self.offset = self._last_arrival = float("nan")

    def receive(self, stamp: float, arrival: float) -> None:
        """Take the stamp of a message [s], and when it arrived on this machine's clock [s]."""
        # clocks drift apart by less than 1e-4: an order more than quartz does
        lag, drifted = arrival - stamp, self.offset + 1e-4 * (arrival - self._last_arrival)
        self.offset = lag if np.isnan(drifted) else min(lag, drifted)
        self._last_arrival = arrival


class Kept:
    """The readings of the last minute, longer than any shake, in order of time; threads may share it."""

    seconds = 60.0

    def __init__(self) -> None:
        self._rows, self._lock = deque[tuple[float, ...]](), threading.Lock()

    def take(self, taken: float, *values: float) -> None:
        """Keep a reading of a time [s], unless a newer one is there or one of its numbers is none."""
        with self._lock:
            if not np.isfinite(values).all() or (self._rows and taken <= self._rows[-1][0]):
                return
            self._rows.append((taken, *values))
            while self._rows[0][0] < taken - self.seconds:
                self._rows.popleft()

    @property
    def newest(self) -> float:
        """Time of the newest reading [s]; minus infinity before the first."""
        with self._lock:
            return self._rows[-1][0] if self._rows else float("-inf")

    def has_begun(self, seconds: float) -> bool:
        """Return whether a first reading comes within a time [s]; wait for it until then."""
        until = time.monotonic() + seconds
        while not np.isfinite(self.newest) and time.monotonic() <= until:
            time.sleep(0.01)
        return bool(np.isfinite(self.newest))

    def since(self, begin: float) -> list[tuple[float, ...]]:
        """Return the readings from a time on [s], each its time and its values."""
        with self._lock:
            return [row for row in self._rows if row[0] >= begin]


class Readings:
    """The joints as they come in, put in order by their names.

    Attributes:
        recent: the newest ones, in order; empty before the first.
        trouble: why what comes in cannot be used; empty while it can.
        others: names of the joints that came in without any of the arm's.
        rate: readings a second, of the last hundred.
        clock: the robot's.
    """

    def __init__(self, names: Sequence[str], clock: Callable[[], float]) -> None:
        self.recent = list[Reading]()
        self.trouble, self.rate = "", float("nan")
        self.others: tuple[str, ...] = ()
        self._names, self._clock, self._arrivals = tuple(names), clock, list[float]()
        self.clock = RobotClock()

    def receive(self, message: Any) -> None:
        """Take a sensor_msgs/JointState; one of other joints only is passed over."""
        arrival, stamp = self._clock(), message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        places = {name: i for i, name in enumerate(message.name)}
        if not any(name in places for name in self._names):
            self.others = tuple(places)
            return
        missing = [name for name in self._names if name not in places]
        if missing or len(places) != len(message.name) or len(message.position) != len(message.name):
            given = f"{', '.join(missing)} missing" if missing else f"{len(message.position)} angles, names twice"
            self.trouble = f"joints: got {', '.join(message.name)}: {given}; allowed: {', '.join(self._names)}"
            return
        joints = np.array([message.position[places[name]] for name in self._names], dtype=float)
        if not np.isfinite(joints).all():
            self.trouble = f"joints: got {joints} rad"
            return
        self.clock.receive(stamp, arrival)
        self._arrivals = [*self._arrivals[-99:], arrival]
        if len(self._arrivals) > 1:
            self.rate = (len(self._arrivals) - 1) / max(arrival - self._arrivals[0], 1e-9)
        self.trouble = ""
        self.take(Reading(stamp + self.clock.offset, joints))

    @property
    def last(self) -> Reading | None:
        """The newest; None before the first."""
        return self.recent[-1] if self.recent else None

    def take(self, reading: Reading) -> None:
        """Take a reading, unless a newer one is there."""
        if not self.recent or reading.time > self.recent[-1].time:
            self.recent = [*self.recent[-40:], reading]  # a rate is measured between them, at up to 500 a second

    def speed(self) -> Array | None:
        """Return rates (J,) [rad/s] at the newest reading, by those before; None: there are too few."""
        return rate_of(self.recent) if self.recent else None

    def age(self) -> float:
        """Return how old the newest is [s]; infinite before the first."""
        return float("inf") if self.last is None else self._clock() - self.last.time

    def newest(self, stale: float) -> Reading:
        """Return the newest reading; refuse one that is older than `stale` [s], or cannot be used."""
        if self.trouble:
            raise DeviceError(f"{self.trouble}. Check the robot's description, and start anew.")
        check_fresh(self.age(), stale)
        assert self.last is not None
        return self.last
