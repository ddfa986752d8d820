"""How the plant is approached and held."""

from __future__ import annotations

from dataclasses import dataclass

from anther.checks import check_parameters, check_range


@dataclass(frozen=True, slots=True)
class Params:
    """How the plant is approached and held.

    Attributes:
        approach_speed: on that line [m/s].
        settle: wait between closing and shaking, in which touched leaves calm down [s],
        calm: and where the closing pads meet a petiole beside the stem, which swings for longer [s].
        opening: before closing [m], or that of the grasp if it is less; the stroke is 41.667 mm.
        rates: frame rates the side camera has [Hz] (D455).
    """

    approach_speed: float = 0.12
    settle: float = 0.6
    calm: float = 2.0
    opening: float = 0.0416
    rates: tuple[float, ...] = (15.0, 30.0, 60.0, 90.0)

    def __post_init__(self) -> None:
        check_parameters(self)
        check_range("approach_speed", self.approach_speed, 0.001, 0.6, "m/s")
        check_range("settle", self.settle, 0.01, 30.0, "s")
        check_range("calm", self.calm, 0.01, 30.0, "s")
        check_range("opening", self.opening, 0.002, 0.041667, "m")
        check_range("number of rates", len(self.rates), 1, 100)
        for rate in self.rates:
            check_range("rates", rate, 1, 1000, "Hz")
