"""A cart of two axes without physics, on rails of 100 m, and its faults. Every reading is 10 ms later than the last."""

from __future__ import annotations

import numpy as np

from anther.core.errors import bad_input
from anther.core.geometry import Array
from anther.robot.devices import CartState, DeviceError

ENDS = np.array([[0.0, 100.0], [0.0, 2.0]])


class FakeCart:
    """Goes in ten steps. `fault`: "", "silent", "old" (the last reading for ever), "blocked", "interrupt", "short".

    Attributes:
        moves: places that it was sent to; stops: how often it was stopped.
        steps: changes of its place by itself, one used at each reading [m].
    """

    def __init__(self) -> None:
        self.place, self.time, self.fault = np.array([10.0, 1.0]), 0.0, ""
        self.is_moving, self.stops = False, 0
        self.moves: list[Array] = []
        self.steps: list[float] = []

    def state(self) -> CartState:
        if self.fault == "silent":
            raise DeviceError("cart: it does not answer. Check its cable.")
        if self.fault != "old":
            self.time += 0.01
        if self.steps:
            self.place = self.place + np.array([self.steps.pop(0), 0.0])
        return CartState(self.time, self.place.copy(), self.is_moving)

    def move(self, place: Array) -> CartState:
        self.state()
        if not np.all((place >= ENDS[:, 0]) & (place <= ENDS[:, 1])):
            raise bad_input("cart place", given=f"{place} m", allowed=f"{ENDS.tolist()} m", do="Stay on the rails.")
        self.moves.append(place)
        begin, self.is_moving = self.place, True
        try:
            for share in np.linspace(0, 1, 11):
                self.place = begin + share * (place - begin)
                if share > 0.45 and self.fault == "interrupt":
                    self.fault = ""
                    raise KeyboardInterrupt
                if share > 0.45 and self.fault == "blocked":
                    raise DeviceError("cart: something is in its way. Look what it is.")
                if share > 0.45 and self.fault == "short":
                    break
        finally:
            self.is_moving = False
        return self.state()

    def stop(self) -> None:
        self.stops, self.is_moving = self.stops + 1, False
