"""Parameters of the shake planner: what to look for, and how sure a modelled load is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from anther.core.checks import check_range
from anther.core.choices import Preset
from anther.core.records import Range, Record
from anther.pollination.decision import PRICES
from anther.pollination.shake.pads import PADS, Pads

MOST_DURATION = 5.0
"""Of a visit [s]."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """What to look for and what must not be passed.

    Attributes:
        lowest, highest: frequencies searched [Hz]; None: the actuator's band.
        frequencies: how many, evenly on a logarithmic scale.
        price: so many fruit one would forgo rather than lose one flower [-], see `anther.pollination.decision.PRICES`.
        least_amplitude: of the grip [m]; None: what the actuator can be trusted with.
        most_amplitude: of the grip [m].
        keeps_limits: whether a shake is weighed by what it costs; if not, only the machine bounds it, and the table of
            limits tells how far they are passed.
        pads: what is believed of how far they give.
        pad_friction: of a soft pad on a stem [-]; no source found, an estimate on the safe side.
        duration: of the shake [s]; longer at low frequency, to have five cycles, up to `MOST_DURATION`.
    """

    lowest: Annotated[float, Range(0.05, 500, "Hz")] | None = None
    highest: Annotated[float, Range(0.05, 500, "Hz")] | None = None
    frequencies: Annotated[int, Range(1, 2000)] = 40
    price: Annotated[float, Range(0.01, 1e4)] = PRICES["default"]
    least_amplitude: Annotated[float, Range(1e-7, 1, "m")] | None = None
    most_amplitude: Annotated[float, Range(1e-7, 1, "m")] = 0.03
    keeps_limits: bool = True
    pad_friction: Annotated[float, Range(1e-9, 1e6)] = 0.5
    pads: Pads = PADS
    duration: Annotated[float, Range(0.1, MOST_DURATION, "s")] = 3.0

    def _check(self) -> None:
        if self.lowest is not None and self.highest is not None:
            check_range("highest frequency", self.highest, self.lowest, 500, "Hz")
        if self.least_amplitude is not None:
            check_range("least_amplitude", self.least_amplitude, 1e-7, self.most_amplitude, "m")

    def held(self, press: float) -> float:
        """Return the pull that two pads hold against slip when each presses with `press` [N]."""
        return 2 * self.pad_friction * press

    def lasts(self, frequency: float) -> float:
        """Return how long a shake goes on [s]."""
        return float(np.clip(5 / frequency, self.duration, MOST_DURATION))


def with_preset(name: Preset, params: Params = Params()) -> Params:
    """Return the parameters of a preset: `PRICES` says what a lost flower costs, "paper" keeps no limit."""
    # 12 mm at 1.9 Hz: the end of its 4-12 mm and 0.7-1.9 Hz. It keeps no limit of the plant.
    paper = {"lowest": 1.9, "highest": 1.9, "most_amplitude": 0.012, "keeps_limits": False}
    return replace(params, **paper) if name == "paper" else replace(params, price=PRICES[name])
