"""How the plant is approached and held."""

from __future__ import annotations

from dataclasses import dataclass

from anther.checks import check_parameters, check_range


@dataclass(frozen=True, slots=True)
class Params:
    """How the plant is approached and held.

    Attributes:
        approach_speed: on that line [m/s].
        settle: wait between closing and shaking, in which touched leaves calm down [s].
    """

    approach_speed: float = 0.12
    settle: float = 0.6

    def __post_init__(self) -> None:
        check_parameters(self)
        check_range("approach_speed", self.approach_speed, 0.001, 0.6, "m/s")
        check_range("settle", self.settle, 0.01, 30.0, "s")
