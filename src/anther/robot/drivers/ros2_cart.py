"""A cart on rails under ROS 2, as a `devices.Cart`: speeds on cmd_vel, places from odometry. No real one was driven.

A speed has no end: the cart keeps it until its own controller's time-out. So at every command its place is held against
what was sent, and whatever does not fit ends the motion: zero is sent until the odometry says that the cart stands.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from anther.core.checks import check_array, check_range
from anther.core.errors import bad_input
from anther.core.geometry import Array
from anther.robot.devices import CartLimits, CartState, DeviceError
from anther.robot.drivers._rails import STOOD, Axis, Odometry, Sent, check_between, next_speed
from anther.robot.drivers._streamed import prioritize_thread, shorten_thread_turns
from anther.robot.drivers.ros2 import Node

LATE = 0.15
"""Commands further apart than this end the motion [s]: three at 20 Hz, well before a controller's usual 0.5 s."""
CREEP = 0.03
"""No drive is asked to go slower than this, or than 5 tolerances a second, before it is near [m/s]; half of that where
it missed. A guess."""
TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


class VelocityCart:
    """A cart of one axis that takes geometry_msgs/TwistStamped or Twist and reports nav_msgs/Odometry.

    Attributes: `node` through which it is spoken to; `odometry`, what it reports.
    """

    _patience = 5.0
    """Something of a cart that is on is heard within this [s]."""

    def __init__(
        self,
        node: Node,
        limits: CartLimits,
        *,
        speed: float = 0.3,
        acceleration: float = 0.2,
        commands: str = "/cmd_vel",
        odometry: str = "/odom",
        stamped: bool = True,
        axis: Axis = "x",
        zero: float = 0.0,
        rate: float = 20.0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Connect. Nothing moves.

        Args:
            node: a `Node`.
            limits: where its one axis ends, and from when on a reading is old.
            speed: the fastest that it is sent [m/s].
            acceleration: of what is sent, no more than the drive's own [m/s^2]. A stop is zero at once.
            commands, odometry: topics.
            stamped: whether commands are TwistStamped, else Twist.
            axis: of odometry and command, along the rails as the travel grows.
            zero: what the odometry reads where the travel is 0 [m].
            rate: of the commands [1/s].
            clock, sleep: [s]; the clock of readings.

        Raises:
            InputError: a number or topic is not possible, or the limits have a lift.
            DeviceError: no odometry is heard, or nobody listens.
        """
        check_range("speed", speed, 0.02, 1.0, "m/s")
        check_range("acceleration", acceleration, 0.02, 1.0, "m/s^2")
        check_range("rate", rate, 20, 100, "commands a second")
        if len(limits.lower) != 1:
            given = f"{len(limits.lower)} axes"
            raise bad_input("cart", given=given, allowed="travel alone: cmd_vel lifts nothing", do="Remove lift.")
        self.node, self._limits, self._speed, self._acceleration = node, limits, speed, acceleration
        self._topic, self._kind, self._period = commands, STAMPED if stamped else TWIST, 1 / rate
        self._name, self._sign, self._clock, self._sleep = axis[-1], -1.0 if axis[0] == "-" else 1.0, clock, sleep
        self._one, self._lock, self._stops, self._stopped = threading.Lock(), threading.Lock(), 0, False
        self._wrong = ""  # how it went otherwise than it was sent: it is not sent again
        self.odometry = Odometry(axis, zero, speed, clock)
        node.subscribe(odometry, "nav_msgs/msg/Odometry", self.odometry.receive)
        self._commands = node.publisher(commands, self._kind)
        self._wait(lambda: bool(self.odometry.recent), f"reports no odometry on {odometry}")
        self._wait(lambda: self.odometry.span > STOOD, f"reports odometry on {odometry} whose stamps stand still")
        self._wait(self._listens, f"has nobody who listens to {commands}")
        self._message(0.0)  # slow at first

    def state(self) -> CartState:
        """Return the newest reading; see `anther.robot.devices.Cart`. It is moving until it is known to stand."""
        now = self.odometry.newest(self._limits.stale_after)
        return CartState(now.time, np.array([now.place]), not self.odometry.stands(self._limits.tolerance))

    def move(self, place: Array) -> CartState:
        """Go to a place (1,) [m] and stand there; see `anther.robot.devices.Cart`.

        Raises:
            InputError: it is beyond the cart's ends. Nothing was commanded.
            DeviceError: the cart may not move, or did not go as it was sent; it was told to stop.
        """
        (to,), (lower,), (upper,) = check_array("cart place", place, (1,)), self._limits.lower, self._limits.upper
        if not lower <= to <= upper:
            allowed = f"{lower:g} .. {upper:g} m"
            raise bad_input("cart place", given=f"{to:g} m", allowed=allowed, do="Stay between its ends.")
        if not self._one.acquire(blocking=False):
            raise DeviceError("cart: it is moved already; allowed: one motion at a time. Wait until it stands.")
        try:
            self._begin()
            with shorten_thread_turns(), prioritize_thread():
                try:
                    return self._go(float(to))
                except BaseException as error:
                    moves = self._halt()
                    if moves:  # worse than whatever was before, Ctrl-C too
                        raise DeviceError(f"{str(error) or 'cart: interrupted.'} {moves}") from error
                    raise
        finally:
            self._one.release()

    def stop(self) -> None:
        """Send zero until the cart stands; a motion that another thread has begun ends.

        Raises:
            DeviceError: its odometry does not say that it stands, a second after it should.
        """
        with self._lock:
            self._stops, self._stopped = self._stops + 1, True
        try:
            moves = self._halt()
        finally:
            with self._lock:
                self._stops -= 1
        if moves:
            raise DeviceError(f"cart: {moves}")

    def describe(self) -> list[str]:
        """Return in words what is heard of the cart."""
        told, others = self.odometry, self.node.publishers(self._topic) - 1
        ahead = -1e3 * (told.clock.offset - self._clock() + time.time())
        rate = (len(told.recent) - 1) / max(told.span, 1e-9)
        kind = self._kind.rpartition("/")[2]
        return [
            f"{rate:.0f} odometry messages a second; its clock is {ahead:+.0f} ms ahead of this machine's",
            f"commands: {1 / self._period:g} a second to {self._topic} as {kind}, at most {self._speed:g} m/s",
            *([f"{others} others can command it too: end them"] if others > 0 else []),
        ]

    def close(self) -> None:
        """End the node."""
        self.node.close()

    def _begin(self) -> None:
        """Check that a motion may begin."""
        if self._wrong:
            raise DeviceError(self._wrong)
        with self._lock:
            if self._stops:
                raise DeviceError("cart: it is being stopped; allowed: a motion after that. Wait until it stands.")
            self._stopped = False
        here, tolerance = self.odometry.newest(self._limits.stale_after), self._limits.tolerance
        if not self._listens():
            raise DeviceError(f"cart: nobody listens to {self._topic}; allowed: its controller. Is it still active?")
        if not self.odometry.stands(tolerance):
            raise DeviceError(f"cart: it moves ({here.speed:+.3f} m/s) although nobody sent it. Stop it by hand.")
        (lower,), (upper,) = self._limits.lower, self._limits.upper
        if not lower - tolerance <= here.place <= upper + tolerance:
            given = f"it stands at {here.place:.3f} m; allowed: {lower:g} .. {upper:g} m"
            raise DeviceError(f"cart: {given}. Push it back, or find its zero.")

    def _go(self, to: float) -> CartState:
        """Send speeds until the cart stands at a place [m]."""
        tolerance, stale, due = self._limits.tolerance, self._limits.stale_after, self._clock()
        start, sent, begin, rests = self.odometry.newest(stale).place, Sent(due), due, np.inf
        creep = min(CREEP, 5 * tolerance, self._speed)
        until = begin + 10.0 + 1.5 * abs(to - start) / self._speed + 2 * self._speed / self._acceleration  # a guess
        while True:
            now, (last, v) = self._clock(), sent.last
            if now - last > LATE:
                given = f"a command came {1e3 * (now - last):.0f} ms after the one before"
                raise DeviceError(f"cart: {given}; allowed: {1e3 * LATE:.0f} ms. Let nothing else run on this machine.")
            here = self.odometry.newest(stale).place
            try:
                check_between(start, here, to, tolerance)
                sent.check_followed(self.odometry.recent)
            except DeviceError as error:
                self._wrong = str(error)
                raise
            if rests == np.inf and abs(to - here) <= tolerance / 2:
                rests = now
            elif self.odometry.stands(tolerance, rests):
                if abs(to - here) <= tolerance:
                    return self.state()
                rests, creep = np.inf, creep / 2
            if abs(to - here) < 0.05:  # from there it creeps, too slowly for frozen odometry to be noticed otherwise
                until = min(until, now + 8.0)
            if now > until:
                given = f"it is {1e3 * abs(to - here):.1f} mm from its place after {now - begin:.0f} s"
                raise DeviceError(f"cart: {given}; allowed: {until - begin:.0f} s. Look why, or widen tolerance.")
            v = next_speed(to - here, v, now - last, creep, self._speed, self._acceleration) if rests == np.inf else 0.0
            self._command(v)
            sent.add(now, v)
            due = max(due + self._period, now)
            self._sleep(max(due - self._clock(), 0.0))

    def _halt(self) -> str:
        """Send zero until the cart has stood since then; return why it is not seen to, or nothing."""
        begin, seconds = self._clock(), 1.0 + self._speed / self._acceleration
        while not self.odometry.stands(self._limits.tolerance, begin):
            if self._clock() - begin > seconds:
                try:
                    moves = f"moves at {self.odometry.newest(self._limits.stale_after).speed:+.3f} m/s"
                except DeviceError:
                    moves = "is not known to stand: its odometry cannot be believed"
                return f"It {moves} after {seconds:.1f} s of zero sent. Press its stop."
            with suppress(DeviceError):
                self._command(0.0)
            self._sleep(self._period)
        return ""

    def _command(self, v: float) -> None:
        message = self._message(v)
        with self._lock:
            if v and self._stopped:
                raise DeviceError("cart: it was stopped on its way, as asked. Send it again.")
            try:
                self._commands.publish(message)
            except Exception as error:  # of the middleware's own kinds
                raise DeviceError(f"cart: ROS 2 sends nothing ({error}); allowed: speeds. Start anew.") from error

    def _message(self, v: float) -> Any:
        linear = self.node.make("geometry_msgs/msg/Vector3", **{self._name: self._sign * v})
        twist = self.node.make(TWIST, linear=linear)
        if self._kind == TWIST:
            return twist
        return self.node.make(STAMPED, header=self.node.make("std_msgs/msg/Header", stamp=self.node.now()), twist=twist)

    def _listens(self) -> bool:
        return self._commands.get_subscription_count() > 0

    def _wait(self, done: Callable[[], bool], what: str) -> None:
        until = self._clock() + self._patience
        while not done():
            if self._clock() > until:
                raise DeviceError(f"the cart {what} in {self._patience:g} s. {self.odometry.trouble or 'Is it on?'}")
            self._sleep(0.05)
