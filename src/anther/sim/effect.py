"""What a shake did to a plant: whether it harmed it and how probably, and how much pollen it freed. By truth alone.

F flowers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from anther.geometry import Array
from anther.sim.truth import DOSE_EXPONENT, HALF_DOSE, TOLERANCE

MOVED = 5.0
"""Median peak acceleration from which on flowers count as moved [m/s2]: an ordinary breeze of 2-4 m/s, which lets open
fields set fruit, gives them 4-24 (facts: pollination 6)."""
MUCH = 10.0
"""Another threshold to count flowers by [m/s2]: the middle of what that breeze gives."""
BEARERS = {
    "stem": "stem or branches",
    "pedicel": "pedicels",
    "base": "bases of petioles, peduncles and midribs",
    "leaf": "leaf bases under the leaves' load",
}
"""The kinds of `truth.TOLERANCE` in words."""


@dataclass(frozen=True, slots=True, eq=False)
class Harm:
    """What a plant bore, and what it bears.

    Attributes:
        loads: kind of `truth.TOLERANCE` -> the peak of it: bending strain [-] of "stem", "pedicel" and "base",
            acceleration [m/s2] of "leaf".
        limits: what this plant bears of each, in the same units.
    """

    loads: Mapping[str, float]
    limits: Mapping[str, float]

    @property
    def passed(self) -> tuple[str, ...]:
        """The kinds of which this plant bore more than it bears."""
        return tuple(kind for kind, load in self.loads.items() if not load <= self.limits[kind])

    @property
    def probability(self) -> float:
        """That a plant of which nothing is known but its loads is harmed: one of its limits is below its load."""
        return 1 - float(np.prod([1 - TOLERANCE[kind].share_below(load) for kind, load in self.loads.items()]))

    @property
    def words(self) -> str:
        """What was passed and by how much, "" if nothing."""
        return ", ".join(
            f"{BEARERS[kind]}: {_size(kind, self.loads[kind])}, this plant bears {_size(kind, self.limits[kind])}"
            for kind in self.passed
        )


def _size(kind: str, load: float) -> str:
    return f"{load / 9.81:.2f} g" if kind == "leaf" else f"{load:.2%}"


def pollen_freed(acceleration: Array) -> tuple[float, float, float]:
    """Return the mean share of pollen that leaves the flowers: its 5 %, 50 % and 95 % quantile over what is not known.

    A flower frees a^n / (a^n + h^n) of its pollen; h and n are drawn from `truth.HALF_DOSE` and `truth.DOSE_EXPONENT`,
    one pair for all flowers of a plant. How long it is shaken does not count: this is the most one acceleration frees.

    Args:
        acceleration: (F,) peak acceleration of each flower [m/s2]; NaN where unknown, which is left out.

    Returns:
        NaN, all three, if no flower is known.
    """
    known = acceleration[np.isfinite(acceleration)]
    if len(known) == 0:
        return np.nan, np.nan, np.nan
    middles = (np.arange(200) + 0.5) / 200
    half = HALF_DOSE.median * np.exp(HALF_DOSE.sigma * norm.ppf(middles))
    ratio = (known / half[:, None])[..., None] ** np.linspace(DOSE_EXPONENT.low, DOSE_EXPONENT.high, 21)  # (200, F, 21)
    low, middle, high = np.quantile((ratio / (1 + ratio)).mean(axis=1), [0.05, 0.5, 0.95])
    return float(low), float(middle), float(high)
