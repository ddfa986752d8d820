"""The state of a served cell as its machines share it: a file of numbers, and the clock that is in it.

MuJoCo may be slower than the wall: all machines of a served cell go by the cell's own time.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from anther.robot.devices import DeviceError

TIME, WALL, RATE, RECORDED, FIRST = 0, 1, 2, 3, 4
STEP = 0.002  # s: time goes on evenly between two steps, but no further
DEAD = 20.0  # s of the wall without a step


class World:
    """What was written last into the file."""

    def __init__(self, path: Path | str, *, count: int = 0) -> None:
        """Look at a world, or begin one of `count` positions."""
        if count:
            self._numbers = np.memmap(path, float, "w+", shape=FIRST + count)
        else:
            self._numbers = np.memmap(path, float, "r+")

    def step(self, now: float, qpos: np.ndarray, rate: float) -> None:
        """Note a step; rate: how fast the cell's time goes at most, by the wall's."""
        self._numbers[FIRST:], self._numbers[RATE] = qpos, rate
        self._numbers[TIME : WALL + 1] = now, time.monotonic()

    @property
    def recorded(self) -> bool:
        """Whether a camera records: then every frame must be rendered in its time."""
        return bool(self._numbers[RECORDED])

    @recorded.setter
    def recorded(self, value: bool) -> None:
        self._numbers[RECORDED] = value

    def qpos(self) -> np.ndarray:
        return np.array(self._numbers[FIRST:])

    @property
    def rate(self) -> float:
        return float(self._numbers[RATE])

    def clock(self) -> float:
        now, wall = self._numbers[TIME : WALL + 1]
        return float(now) + min(max(time.monotonic() - float(wall), 0.0) * self.rate, STEP)

    def sleep(self, seconds: float) -> None:
        now, last = self.clock(), time.monotonic()
        until = now + seconds
        while now < until:
            time.sleep(max(0.8 * (until - now) / max(self.rate, 0.05), 3e-4))
            before, now = now, self.clock()
            if now > before + 1e-9:
                last = time.monotonic()
            elif time.monotonic() - last > DEAD:
                raise DeviceError("the served cell stands still")
