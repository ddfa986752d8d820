"""The cart of a cell file: how far its axes go, how wide the path is, where the arm is stowed while it moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from anther.core.errors import bad_input
from anther.core.geometry import Array, Box
from anther.core.records import Range, Record
from anther.robot.arm.model import ArmModel
from anther.robot.devices import CartLimits

Ends = tuple[float, float]


@dataclass(frozen=True, slots=True)
class CartSection(Record):
    """What the file says of the cart besides its driver.

    Attributes:
        travel: ends of the way along the rails [m].
        lift: ends of the lift [m]; None: there is none.
        corridor: width of the path between the leaves; the arm's base is in its middle [m].
        stowed: joints in which the arm travels [rad]; None: where it is ready.
        tolerance: by which the cart may be off where it stands [m].
    """

    travel: Ends
    corridor: Annotated[float, Range(0.3, 2.0, "m")]
    lift: Ends | None = None
    stowed: list[float] | None = None
    tolerance: float = 0.003

    def _check(self) -> None:
        for name, ends in (("travel", self.travel), ("lift", self.lift)):
            if ends is not None and not ends[0] < ends[1]:
                raise bad_input(name, given=f"{list(ends)}", allowed="[lower, upper] m, lower < upper", do="Swap them.")

    def limits(self, arm: ArmModel) -> CartLimits:
        """Return what no command to the cart may exceed.

        Raises:
            InputError: the arm cannot be stowed there.
        """
        stowed = arm.ready if self.stowed is None else np.array(self.stowed)
        if stowed.shape != arm.lower.shape or np.any((stowed < arm.lower) | (stowed > arm.upper)):
            allowed = f"{arm.count} joints within the range of {arm.name} [rad]"
            raise bad_input("stowed", given=f"{stowed.tolist()}", allowed=allowed, do="Read them from the arm.")
        lower, upper = np.array([self.travel, *([self.lift] if self.lift else [])]).T
        return CartLimits(lower, upper, stowed, tolerance=self.tolerance)

    def other_side(self, workspace: Box) -> Box:
        """Return the row on the other side of the path, where no part of the arm may be: one side at a time."""
        middle: Array = (workspace.lower + workspace.upper) / 2
        across = int(np.argmax(np.abs(middle[:2])))
        lower, upper = np.full(3, -4.0), np.full(3, 4.0)
        if middle[across] > 0:
            upper[across] = -self.corridor / 2
        else:
            lower[across] = self.corridor / 2
        return Box(lower, upper)
