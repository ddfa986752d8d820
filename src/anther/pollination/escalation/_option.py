"""One way to shake, a frequency along a line: what is known of it, how far it was and may be raised. F flowers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from anther.core.geometry import Array
from anther.core.records import Range, Record
from anther.plant.limits import GUSTS, LOADED
from anther.pollination.decision import COSTS, Weighed, Worth, weighed, worth
from anther.pollination.escalation._knowledge import Known
from anther.pollination.shake import Params as Limits

SHORTEST = 10.0
"""What two probes, a step, a hold and coming to rest take [s]."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How a watched shake is raised.

    Attributes:
        most_seconds: of the whole shake [s], within the cell's `SafetyLimits.shake_duration`. Of simulated shakes that
            were given 12 most were ended by time (docs/reports/shaking.md).
    """

    most_seconds: Annotated[float, Range(SHORTEST, 60, "s")] = 20.0


WORDS = {
    "stem_strain": "the bending of the stem",
    "joint_strain": "the bending of pedicels",
    "base_strain": "the bending of branch bases",
    "leaf_load": "the load at leaf bases",
    "grip_force": "slip",
}
"""The kinds of load, for people."""

ACTUATOR, DEARER = "what the actuator can do", "more would cost more than it adds"
SIZES, DOWN = 60, 1e-3
"""Amplitudes that are weighed, evenly on a logarithmic scale, from this share of what the actuator manages on."""


class Allowed(NamedTuple):
    """How far a shake may be raised: amplitude [m], the flowers' median there [m/s2], its worth, and what ends it."""

    amplitude: float
    flowers: float
    net: float
    binds: str


def limits_of(limits: Limits, press: float, hertz: float) -> dict[str, float]:
    """Return by kind what nineteen organs of twenty bear at a tone [Hz], and what pads hold with `press` [N]."""
    plant = {kind: np.inf if kind == "leaf_load" and hertz > GUSTS else one.low for kind, one in LOADED.items()}
    return plant | {"grip_force": limits.held(press)}


@dataclass(slots=True, eq=False)
class Option:
    """A way to shake.

    Attributes:
        hertz: its frequency [Hz].
        held: the pull that the pads hold [N].
        price: of a flower that is lost (`anther.pollination.decision.PRICES`).
        planned: amplitude that the model finds worth most [m].
        reach: that the actuator manages [m].
        told: what is known of it.
        may: how far it may be raised.
        tried: how far it was raised [m].
    """

    hertz: float
    held: float
    price: float
    planned: float
    reach: float
    told: Known
    may: Allowed = field(init=False)
    tried: float = 0.0
    _measured: Array = field(init=False)  # (F,) last acceleration of each flower that a camera measured, NaN: none

    def __post_init__(self) -> None:
        self._measured = np.where(self.told.seen, self.told.answer.flowers[0], np.nan)
        self.may = self._allowed()

    def _allowed(self) -> Allowed:
        """Return how far it is worth to be raised by what is known of it now."""
        told = self.told
        tried = self._tried
        found = self._worth(tried)
        best = int(found.net.argmax())
        costs = {"joint_strain": found.lost} | {kind: cost * found.bent[kind] for kind, cost in COSTS.items()}
        dearest = max(costs, key=lambda kind: float(costs[kind][best]))
        binds = ACTUATOR if best == SIZES - 1 else f"{DEARER}, first by {WORDS[dearest]}"
        amplitude = float(tried[best])
        return Allowed(amplitude, amplitude * float(np.median(told.flowers)), float(found.net[best]), binds)

    @property
    def promised(self) -> float:
        """What it is worth, as is believed."""
        return self.may.net

    @property
    def borne(self) -> float:
        """How far it was raised, as far as that is still allowed after every look at it [m]."""
        return min(self.tried, self.may.amplitude)

    def worth_at(self, amplitude: float) -> float:
        """Return what it is worth at an amplitude [m], by what is known of it now."""
        return float(self._worth(np.array([amplitude])).net[0])

    @property
    def _tried(self) -> Array:
        """The amplitudes that are weighed [m]."""
        return self.reach * np.geomspace(DOWN, 1.0, SIZES)

    def _worth(self, amplitudes: Array) -> Worth:
        told = self.told
        return worth(told.answer, amplitudes, self.hertz, self.held, self.price, told.measured)

    @property
    def weighed(self) -> Weighed:
        """What it is worth by its amplitude, by what is known of it now."""
        return weighed(self.told.answer, self._tried, self.hertz, self.held, self.price, self.told.measured)

    def looked_at(self, told: Known) -> None:
        """Learn from a look at it alone.

        A flower that was measured before, but not now, may be hidden, or swing too fast to be followed: it does what it
        did, or what the members say where that is more.
        """
        self._measured = np.where(told.seen, told.answer.flowers[0], self._measured)
        flowers = np.where(told.seen, told.answer.flowers, np.fmax(told.answer.flowers, self._measured))
        self.told = told._replace(answer=told.answer._replace(flowers=flowers))
        self.may = self._allowed()
