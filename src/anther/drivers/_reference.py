"""What a streamed arm is to do next: a motion, and those that join it without a stop. J joints."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from anther.devices import LEAD, DeviceError, JointTrajectory, More
from anther.geometry import Array


class Reference:
    """Joints, rates and accelerations over time [s] from 0 on.

    What comes next is asked for in another thread, `LEAD` before it is needed, so that nothing waits for the answer.
    """

    def __init__(self, first: JointTrajectory, more: More | None = None) -> None:
        self._more, self._coming = more, None
        self._pool = None if more is None else ThreadPoolExecutor(1)
        if self._pool is not None:
            self._pool.submit(lambda: None)  # its thread begins here, to be served as the process is: see `_priority`
        self._coming: Future[JointTrajectory | None] | None = None
        self._pieces: list[tuple[float, Any]] = []
        self.ends = 0.0
        self.join(first)

    @property
    def whole(self) -> bool:
        """Whether nothing more can come."""
        return self._more is None

    def look_ahead(self, t: float) -> None:
        """Ask for what comes after the present end, and take it once it is there.

        Raises:
            DeviceError: it comes too late; and what the asking raised.
        """
        if self._more is None or self._pool is None:
            return
        if self._coming is None and t >= self.ends - LEAD:
            self._coming = self._pool.submit(self._more)
        if self._coming is not None and self._coming.done():
            following, self._coming = self._coming.result(), None
            if following is None:
                self._more = None
            else:
                self.join(following)
        elif t >= self.ends:
            raise DeviceError(f"the next motion comes too late: not within {LEAD:g} s. Look at what else runs here.")

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """Return joints, rates, accelerations, each (J,), at time t [s]; at rest before the begin and after the end."""
        begin, curve = next((piece for piece in reversed(self._pieces) if piece[0] <= t), self._pieces[0])
        inside = float(np.clip(t - begin, 0.0, curve.x[-1]))
        if not 0 <= t < self.ends:
            still = np.zeros(curve.c.shape[-1])
            return curve(inside), still, still
        return curve(inside), curve(inside, 1), curve(inside, 2)

    def close(self) -> None:
        """Wait for no answer any more."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)

    def join(self, motion: JointTrajectory) -> None:
        """Take a motion that begins where the last one ends."""
        curve = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
        self._pieces = [*self._pieces[-1:], (self.ends, curve)]  # readings are a little older than commands
        self.ends += motion.duration


def braking(q: Array, rate: Array, acceleration: Array) -> JointTrajectory:
    """Return the straight way to rest (J,), from joints q at `rate`, with no more than `acceleration` of any joint."""
    seconds = max(float((np.abs(rate) / acceleration).max()), 1e-3)
    t = np.linspace(0, seconds, 20)[:, None]
    return JointTrajectory(t[:, 0], q + rate * t * (1 - t / (2 * seconds)), rate * (1 - t / seconds))
