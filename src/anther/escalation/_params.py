"""Parameters of a watched shake."""

from __future__ import annotations

from dataclasses import dataclass

from anther.checks import check_range

SHORTEST = 10.0
"""What two probes, a step, a hold and coming to rest take [s]."""


@dataclass(frozen=True, slots=True)
class Params:
    """How a watched shake is raised.

    Attributes:
        target: median acceleration of the flowers at which it is enough [m/s2]: half of their pollen is free at about
            20, between 5 and 80 (facts: pollination 6).
        most: no flower that is seen shall feel more [m/s2]; pedicels were bent by 0.5 % at 23 to 55 (the same), so by
            1 % at 46 to 110.
        raised: a step is at most so many times the one before, and adds at most half the target to any flower seen.
        hold: how long the last step goes on [s]; a flower approaches what it can free within 0.6 s.
        most_seconds: of the whole shake [s], within the cell's `SafetyLimits.shake_duration`. Of simulated shakes that
            were given 12 most were ended by time (docs/reports/shaking.md).
    """

    target: float = 30.0
    most: float = 45.0
    raised: float = 2.0
    hold: float = 1.2
    most_seconds: float = 20.0

    def __post_init__(self) -> None:
        check_range("target", self.target, 0.1, 1000, "m/s2")
        check_range("most", self.most, self.target, 10_000, "m/s2")
        check_range("raised", self.raised, 1.05, 4)
        check_range("hold", self.hold, 0.5, 10, "s")
        check_range("most_seconds", self.most_seconds, SHORTEST, 60, "s")
