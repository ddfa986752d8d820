"""What every made-up arm that moves in time has: a log of where it was."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from anther.core.geometry import Array


class LoggedArm:
    """Attributes: `log` of (time [s], joints (J,)); `sleep`, by the clock of those times; `slowest`, faster than which
    it moves [rad/s]."""

    log: list[tuple[float, Array]]
    sleep: Callable[[float], None]
    slowest = 1e-3

    def speed(self) -> tuple[Array, Array]:
        """Return times (T,) [s] and the greatest speed of any joint then (T,) [rad/s]."""
        times, joints = (np.array(column) for column in zip(*list(self.log), strict=True))
        return times[1:], np.abs(np.diff(joints, axis=0)).max(axis=1) / np.diff(times)

    def stopped_after(self, since: float) -> float:
        """Return how long after `since` [s] it moved last [s]; fail if it does not come to rest."""
        self.sleep(0.4)
        times, speed = self.speed()
        assert speed[-10:].max() < 1e-3
        return max(float(times[speed > self.slowest].max(initial=-np.inf)) - since, 0.0)
