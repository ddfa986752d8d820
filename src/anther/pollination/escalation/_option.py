"""One candidate shake: its prediction, its executed and its allowed amplitude. F flowers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from anther.core.geometry import Array
from anther.core.records import Range, Record
from anther.plant.limits import GUSTS, LOADED
from anther.pollination.decision import COSTS, Answer, Worth, WorthCurve, weighed, worth
from anther.pollination.escalation._knowledge import Prediction
from anther.pollination.shake import Params as Limits

SHORTEST = 10.0
"""Time for two probes, a step, the last step and the ramp to rest [s]."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How a watched shake is raised.

    Attributes:
        most_seconds: of the whole shake [s], within the cell's `SafetyLimits.shake_duration`; with 12 s most simulated
            shakes end by time (docs/reports/shaking.md).
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


class Allowed(NamedTuple):
    """Best amplitude of a shake [m], the flowers' median acceleration there [m/s2], its worth, and what limits it."""

    amplitude: float
    flowers: float
    net: float
    binds: str


def limits_of(limits: Limits, press: float, hertz: float) -> dict[str, float]:
    """Return by kind the load that 95 % of organs bear at a frequency [Hz], and the friction of pads at `press` [N]."""
    plant = {kind: np.inf if kind == "leaf_load" and hertz > GUSTS else one.low for kind, one in LOADED.items()}
    return plant | {"grip_force": limits.held(press)}


@dataclass(slots=True, eq=False)
class Option:
    """A way to shake.

    Attributes:
        hertz: its frequency [Hz].
        held: pull that the pads hold without slip [N].
        price: of a lost flower (`anther.pollination.decision.PRICES`).
        planned: best amplitude by the prior [m].
        reach: largest amplitude of the actuator [m].
        prediction: of the shake.
        allowed: amplitude of largest worth.
        raised_to: largest amplitude executed [m].
    """

    hertz: float
    held: float
    price: float
    planned: float
    reach: float
    prediction: Prediction
    allowed: Allowed = field(init=False)
    raised_to: float = 0.0
    _measured: Array = field(init=False)  # (F,) last acceleration of each flower that a camera measured, NaN: none

    def __post_init__(self) -> None:
        self._measured = np.where(self.prediction.seen, self.prediction.answer.flowers[0], np.nan)
        self.allowed = self._find_allowed()

    def _find_allowed(self) -> Allowed:
        """Return the amplitude of largest worth by the present prediction."""
        prediction = self.prediction
        tried = self._amplitudes
        found = self._worth(tried)
        best = int(found.net.argmax())
        costs = {"joint_strain": found.lost} | {kind: cost * found.bent[kind] for kind, cost in COSTS.items()}
        dearest = max(costs, key=lambda kind: float(costs[kind][best]))
        binds = ACTUATOR if best == len(tried) - 1 else f"{DEARER}, first by {WORDS[dearest]}"
        amplitude = float(tried[best])
        return Allowed(amplitude, amplitude * float(np.median(prediction.flowers)), float(found.net[best]), binds)

    @property
    def predicted_worth(self) -> float:
        """Worth of the best amplitude by the present prediction."""
        return self.allowed.net

    @property
    def tolerated(self) -> float:
        """Largest executed amplitude that the present prediction still allows [m]."""
        return min(self.raised_to, self.allowed.amplitude)

    def worth_at(self, amplitude: float) -> float:
        """Return the worth at an amplitude [m] by the present prediction."""
        return float(self._worth(np.array([amplitude])).net[0])

    @property
    def _amplitudes(self) -> Array:
        """The amplitudes compared [m], on a logarithmic scale."""
        least, count = 1e-3, 60  # of the actuator's reach
        return self.reach * np.geomspace(least, 1.0, count)

    def _worth(self, amplitudes: Array) -> Worth:
        prediction = self.prediction
        return worth(prediction.answer, amplitudes, self.hertz, self.held, self.price, prediction.measured)

    @property
    def weighed(self) -> WorthCurve:
        """Worth by amplitude, by the present prediction."""
        return weighed(
            self.prediction.answer, self._amplitudes, self.hertz, self.held, self.price, self.prediction.measured
        )

    def update(self, prediction: Prediction) -> None:
        """Take a new prediction after an observation of this shake alone.

        A flower measured before, but not now, may be hidden or swing too fast to track: it keeps its last measured
        acceleration, or the members' prediction where that is larger.
        """
        self._measured = np.where(prediction.seen, prediction.answer.flowers[0], self._measured)
        flowers = np.where(
            prediction.seen, prediction.answer.flowers, np.fmax(prediction.answer.flowers, self._measured)
        )
        self.prediction = prediction._replace(answer=prediction.answer._replace(flowers=flowers))
        self.allowed = self._find_allowed()

    def heed(self, prediction: Prediction) -> None:
        """Take only what is larger in a prediction after an observation that proves nothing.

        Flowers that seem to stand still may be hidden or mistaken, which says nothing of this shake; what seems to be
        loaded more may be.
        """
        larger = Answer(*map(np.fmax, self.prediction.answer, prediction.answer))
        self.prediction = self.prediction._replace(answer=larger)
        self.allowed = self._find_allowed()
