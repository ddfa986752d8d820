"""A cart of one axis: what it reports, put on this machine's clock; the next speed; whether it goes as it was sent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from anther.robot.devices import DeviceError
from anther.robot.drivers._readings import RobotClock

Axis = Literal["x", "-x", "y", "-y"]
STOOD = 0.3
"""A cart stands that stayed in one place for so long [s]."""
WINDOWS, LAG, SLACK = (1.0, 2.0), 0.3, 0.02
"""In each of these times [s] it goes as far as was sent, but for `LAG` [s] of the greatest speed sent, and `SLACK` [m].

Guesses: a drive that takes 0.2 s to follow, odometry that is 0.1 s old, wheels that slip by a few per cent."""
BEHIND, GAIN = 0.15, 2.0
"""The place is taken as so old [s]; what is left then is gone with so much speed for each metre [1/s].

Odometry and drive may so be late by 0.2 s together."""


class Reading(NamedTuple):
    """One axis at `time` [s] on this machine's clock, by the cart's stamp: place [m], speed [m/s]."""

    time: float
    place: float
    speed: float


class Odometry:
    """One axis of a nav_msgs/Odometry.

    Attributes:
        recent: readings of the last three seconds, in order.
        trouble: why the newest message cannot be used; empty if it can.
        lost: why no place is believed any more; empty while it is.
        heard: when the last message came [s].
        clock: the cart's.
    """

    def __init__(self, axis: Axis, zero: float, fastest: float, clock: Callable[[], float]) -> None:
        """Begin.

        Args:
            axis: the coordinate that grows along the rails as the travel does.
            zero: what it reads where the travel is 0 [m].
            fastest: the cart is not sent faster [m/s]; at twice of that its place jumps.
            clock: [s].
        """
        self._name, self._sign = axis[-1], -1.0 if axis[0] == "-" else 1.0
        self._zero, self._fastest, self._now = zero, fastest, clock
        self.recent, self.clock = list[Reading](), RobotClock()
        self.trouble, self.lost, self.heard = "", "", -np.inf

    @property
    def span(self) -> float:
        """Time from the first to the last of the recent readings [s]."""
        return self.recent[-1].time - self.recent[0].time if self.recent else 0.0

    def receive(self, message: Any) -> None:
        """Take a nav_msgs/Odometry; one whose stamp is not newer than the last one's is passed over."""
        self.heard, stamp = self._now(), message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        place = self._sign * (getattr(message.pose.pose.position, self._name) - self._zero)
        speed = self._sign * getattr(message.twist.twist.linear, self._name)
        self.trouble = "" if np.isfinite([place, speed]).all() else f"its odometry reports {place} m, {speed} m/s"
        if self.trouble:
            return
        self.clock.receive(stamp, self.heard)
        new = Reading(stamp + self.clock.offset, place, speed)
        if self.recent and new.time <= self.recent[-1].time:
            return
        if self.recent:
            last = self.recent[-1]
            most, way = 0.03 + 2 * self._fastest * (new.time - last.time), abs(place - last.place)
            if way > most:
                self.lost = f"its odometry jumped by {way:.3f} m from one reading to the next; allowed: {most:.3f} m"
        self.recent = [*(r for r in self.recent if r.time > new.time - 3.0), new]

    def newest(self, stale: float) -> Reading:
        """Return the newest reading.

        Raises:
            DeviceError: it is older than `stale` [s], or cannot be believed.
        """
        if self.lost:
            raise DeviceError(f"cart: {self.lost}. Find its zero again, then start anew.")
        if self.trouble:
            raise DeviceError(f"cart: {self.trouble}; allowed: finite numbers. Look at its encoder.")
        now, allowed = self._now(), f"allowed: {1e3 * stale:.0f} ms"
        if not now - self.heard <= stale:
            given = f"no odometry for {1e3 * (now - self.heard):.0f} ms"
            raise DeviceError(f"cart: {given}; {allowed}. Is it on, and the network whole?")
        if not now - self.recent[-1].time <= stale:
            given = f"its odometry comes, but is {1e3 * (now - self.recent[-1].time):.0f} ms old by its stamps"
            raise DeviceError(f"cart: {given}; {allowed}. Check its clock and the network, then start anew.")
        return self.recent[-1]

    def stands(self, tolerance: float, since: float = -np.inf) -> bool:
        """Return whether it stayed within half of `tolerance` [m] for `STOOD`, by readings not older than `since` [s].

        Its speed counts on average: the arm on it may rock it. False, too, where there are not enough readings to tell.
        """
        rows = [r for r in self.recent if r.time >= since]
        first = next((i for i in reversed(range(len(rows))) if rows[i].time <= rows[-1].time - STOOD), None)
        if first is None:
            return False
        places, speeds = zip(*((r.place, r.speed) for r in rows[first:]), strict=True)
        return max(places) - min(places) <= tolerance / 2 and abs(float(np.mean(speeds))) <= tolerance / STOOD


class Sent:
    """The speeds that a cart was sent, each until the next."""

    def __init__(self, now: float) -> None:
        """Begin at rest at a time [s]."""
        self._begin = now
        self._rows = [(now, 0.0, 0.0)]  # time [s], way until then [m], speed from then on [m/s]

    @property
    def last(self) -> tuple[float, float]:
        """When the last one was sent [s], and which [m/s]."""
        return self._rows[-1][0], self._rows[-1][2]

    def add(self, now: float, speed: float) -> None:
        """Note a speed [m/s] that is sent now [s]."""
        before, way, v = self._rows[-1]
        rows = [row for row in self._rows if row[0] > now - 4.0]  # readings are younger
        self._rows = [*rows, (now, way + v * (now - before), speed)]

    def check_followed(self, recent: list[Reading]) -> None:
        """Check that the cart goes as it was sent, by its recent readings.

        Raises:
            DeviceError: it does not.
        """
        for window in WINDOWS:
            self._check_window(recent, max(self._begin, recent[-1].time - window))

    def _check_window(self, recent: list[Reading], since: float) -> None:
        rows = [r for r in recent if r.time >= since] or recent[-1:]
        times, ways, speeds = np.array(self._rows).T
        end = max(times[-1], rows[-1].time) + 1e-9
        times, ways = np.r_[times, end], np.r_[ways, ways[-1] + speeds[-1] * (end - times[-1])]
        sent = float(np.diff(np.interp([rows[0].time, rows[-1].time], times, ways))[0])
        went = rows[-1].place - rows[0].place
        fastest = float(np.abs(speeds[times[1:] >= since - LAG]).max())  # that still held then
        allowed = SLACK + LAG * fastest
        if abs(sent - went) <= allowed:
            return
        if sent * went < 0 and abs(went) > 0.2 * abs(sent):
            do = "It goes the wrong way: turn the sign of its drive or of its odometry"
        elif abs(went) > abs(sent):
            do = "It goes where nobody sent it: end what else commands it"
        else:
            do = "It does not follow: look what is in its way, if its odometry lives, if it can go so fast"
        given = f"it went {went:+.3f} m where {sent:+.3f} m were sent"
        raise DeviceError(f"cart: {given}; allowed: within {allowed:.3f} m. {do}, then start anew.")


def check_between(start: float, here: float, to: float, tolerance: float) -> None:
    """Check that a cart is between where it began and where it goes [m], but for a little more than its tolerance [m].

    Raises:
        DeviceError: it is not.
    """
    way, most = np.sign(to - start), 0.01 + 2 * tolerance
    beyond, behind = (here - to) * way, (start - here) * way
    if max(beyond, behind) <= most:
        return
    where, do = "beyond its place", "It brakes later than it is told: lower acceleration"
    if behind > beyond:
        where, do = "on the wrong side of where it began", "Turn the sign of its drive or of its odometry"
    given = f"it is {1e3 * max(beyond, behind):.0f} mm {where}"
    raise DeviceError(f"cart: {given}; allowed: {1e3 * most:.0f} mm. {do}, then start anew.")


def next_speed(left: float, v: float, seconds: float, slowest: float, fastest: float, acceleration: float) -> float:
    """Return the speed [m/s] that follows another within an acceleration, where a way is left.

    Args:
        left: the way, with its sign [m].
        v: the last speed sent [m/s].
        seconds: since then [s].
        slowest, fastest: sizes of a speed [m/s].
        acceleration: [m/s^2]. It brakes with 0.7 of it: the rest makes good for a late start.
    """
    way, most = max(abs(left) - BEHIND * abs(v), 0.0), acceleration * seconds
    want = np.sign(left) * max(min(fastest, GAIN * way, np.sqrt(1.4 * acceleration * way)), slowest)
    return float(np.clip(want, v - most, v + most))
