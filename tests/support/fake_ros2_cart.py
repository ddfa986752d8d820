"""A cart on rails under ROS 2 without ROS 2, and the cart's end of the real one.

It does what ros2_controllers' diff_drive_controller does with a speed: it goes on with the last one for half a second,
then stops; a stamped one that is older than that is passed over. A drive follows with its own acceleration. Time is the
fake's own, and goes on while the driver sleeps: a test takes milliseconds, and is the same each time.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from fake_ros2 import FakeNode, RosEnd

from anther.robot.drivers._streamed import prioritize_thread

STEP = 0.01  # s
TIMEOUT = 0.5  # s, of the controller
BRAKE = 0.8  # m/s^2, of the drive
AHEAD = 3.7  # s by which the cart's clock is ahead


class FakeRails:
    """A cart that stands at 2 m.

    Attributes:
        place, v: where it is [m] and how fast [m/s]; `log` of (time, place, speed); `heard` of (time, speed).
        now: [s]; `clock` returns it, `sleep` makes it go on.
        mute, frozen, old, stuck, deaf: it tells nothing; tells the same place, or the same stamp, again and again; does
            not move; goes on with the last speed whatever it hears, and without a time-out.
        sign, scale: of its drive; drift: speed that nobody sent [m/s]; offset: of its odometry [m].
        delay: until what it reports is heard [s]; lag: until it follows [s]; every: between two reports [s].
        at: called at a time [s], once: (time, what to do).
    """

    def __init__(self, tell: Callable[[float, float, float], None], place: float = 2.0) -> None:
        self._tell, self.place, self.v, self.now = tell, place, 0.0, 100.0
        self.mute = self.frozen = self.old = self.stuck = self.deaf = False
        self.sign, self.scale, self.drift, self.offset, self.ahead = 1.0, 1.0, 0.0, 0.0, AHEAD
        self.delay, self.lag, self.every = 0.03, 0.05, 0.02
        self.heard: list[tuple[float, float]] = []
        self.log: list[tuple[float, float, float]] = []
        self.at: list[tuple[float, Callable[[], Any]]] = []
        self._told: list[tuple[float, float, float, float]] = []  # when it is heard, stamp, place, speed
        self._next_tell, self._last = self.now, (0.0, 0.0, 0.0)

    def clock(self) -> float:
        return self.now

    def hear(self, message: Any) -> None:
        linear = message.twist.linear if hasattr(message, "twist") else message.linear
        self.heard.append((self.now, linear.x if hasattr(linear, "x") else linear.y))

    def sleep(self, seconds: float) -> None:
        for _ in range(max(round(seconds / STEP), 1)):
            self.advance()

    def advance(self) -> None:
        self.now += STEP
        for due in [due for due in self.at if due[0] <= self.now]:
            self.at.remove(due)
            due[1]()
        heard = [row for row in self.heard if row[0] <= self.now - self.lag]
        wanted = heard[-1][1] if heard and (self.deaf or self.now - heard[-1][0] <= TIMEOUT) else 0.0
        if self.deaf:
            wanted = next((v for _, v in reversed(heard) if v), 0.0)
        wanted = self.sign * self.scale * wanted + self.drift
        self.v = 0.0 if self.stuck else self.v + float(np.clip(wanted - self.v, -BRAKE * STEP, BRAKE * STEP))
        self.place += self.v * STEP
        self.log.append((self.now, self.place, self.v))
        if self.now >= self._next_tell:
            self._next_tell += self.every
            if not self.frozen:
                self._last = (self._last[0], self.place + self.offset, self.v)
            if not self.old:
                self._last = (self.now, *self._last[1:])
            if not self.mute:
                self._told.append((self.now + self.delay, *self._last))
        while self._told and self._told[0][0] <= self.now:
            _, stamp, place, speed = self._told.pop(0)
            self._tell(stamp + self.ahead, place, speed)

    def after(self, seconds: float, do: Callable[[], Any]) -> None:
        self.at.append((self.now + seconds, do))

    def fail(self, seconds: float, **faults: Any) -> None:
        """Set attributes so long from now."""
        self.after(seconds, lambda: [setattr(self, name, value) for name, value in faults.items()])

    def run(self) -> Callable[[], None]:
        """Let time go on with the wall's, from a thread; return what ends that."""
        over = threading.Event()

        def go() -> None:
            with prioritize_thread():
                self.now = time.monotonic()
                self._next_tell = self.now
                while not over.wait(STEP):
                    while self.now < time.monotonic() - STEP:
                        self.advance()

        thread = threading.Thread(target=go, daemon=True)
        thread.start()

        def end() -> None:
            over.set()
            thread.join()

        return end


class FakeCartNode(FakeNode):
    """The node of a driver, in this process. `interrupt`: so many speeds from now Ctrl-C is pressed."""

    interrupt = -1

    def make(self, kind: str, **fields: Any) -> Any:
        return SimpleNamespace(**fields)

    def now(self) -> Any:
        return SimpleNamespace(sec=1, nanosec=0)

    def tell(self, stamp: float, place: float, speed: float) -> None:
        if "/odom" in self.hears:
            time_ = SimpleNamespace(sec=int(stamp), nanosec=int(stamp % 1 * 1e9))
            where = SimpleNamespace(pose=SimpleNamespace(position=SimpleNamespace(x=place, y=place)))
            how = SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace(x=speed, y=speed)))
            self.hears["/odom"](SimpleNamespace(header=SimpleNamespace(stamp=time_), pose=where, twist=how))

    def publisher(self, topic: str, kind: str) -> Any:
        there = super().publisher(topic, kind)

        def publish(message: Any) -> None:
            self.interrupt -= 1
            there.publish(message)
            if self.interrupt == 0:
                raise KeyboardInterrupt

        return SimpleNamespace(publish=publish, get_subscription_count=there.get_subscription_count)


class RosCartNode(RosEnd):
    """The cart's end."""

    def __init__(self) -> None:
        from geometry_msgs.msg import TwistStamped  # noqa: PLC0415
        from nav_msgs.msg import Odometry  # noqa: PLC0415

        super().__init__("fake_cart", (Odometry, "/odom"), (TwistStamped, "/cmd_vel"))

    def _take(self, message: Any) -> None:
        if time.time() - message.header.stamp.sec - 1e-9 * message.header.stamp.nanosec <= TIMEOUT:
            super()._take(message)

    def tell(self, stamp: float, place: float, speed: float) -> None:
        message = self._kind()
        message.pose.pose.position.x, message.twist.twist.linear.x = place, speed
        self.publish(message, stamp)
