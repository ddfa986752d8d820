"""One way to shake, a frequency along a line: what is known of it, how far it was and may be raised. F flowers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from anther.core.checks import check_range
from anther.core.geometry import Array
from anther.core.records import Range, Record
from anther.pollination.escalation._knowledge import JUMP, Known
from anther.pollination.shake import Params as Limits

SHORTEST = 10.0
"""What two probes, a step, a hold and coming to rest take [s]."""


@dataclass(frozen=True, slots=True)
class Params(Record):
    """How a watched shake is raised.

    Attributes:
        target: median acceleration of the flowers at which it is enough [m/s2]: half of their pollen is free at about
            20, between 5 and 80 (facts: pollination 6).
        most: no flower that is seen shall feel more [m/s2]; pedicels were bent by 0.5 % at 23 to 55 (the same), so by
            1 % at 46 to 110.
        most_seconds: of the whole shake [s], within the cell's `SafetyLimits.shake_duration`. Of simulated shakes that
            were given 12 most were ended by time (docs/reports/shaking.md).
    """

    target: Annotated[float, Range(0.1, 1000, "m/s2")] = 30.0
    most: Annotated[float, Range(0.1, 10_000, "m/s2")] = 45.0
    most_seconds: Annotated[float, Range(SHORTEST, 60, "s")] = 20.0

    def _check(self) -> None:
        check_range("most", self.most, self.target, 10_000, "m/s2")


WATCHED = 3.0
"""So many times the plan's risk is allowed once the camera has seen the shake: a load that passes what is said of it
seldom passes what the plant bears. By the arm, 53 plants (MuJoCo's linear equations, with `FEW`): with 2, 3 and 4 the
median flower felt 6.4, 7.2 and 7.9 m/s2 (geometric mean) and 0.6, 0.9 and 1.4 % were harmed. By the motor, 40 plants of
the whole cell: with 8 times 4 were harmed."""

WORDS = {
    "stem_strain": "the bending of the stem",
    "joint_strain": "the bending of pedicels",
    "base_strain": "the bending of branch bases",
    "leaf_load": "the load at leaf bases",
    "grip_force": "slip",
}
"""The kinds of load, for people."""

SLOW, SLOW_KEPT = 5.0, 0.6
"""Below so many hertz a promise counts so much until that shake was watched alone: of such promises five plants of
linear equations felt 0.54 and 13 of the whole cell 0.5; of those at 5 to 9 Hz 0.9 and 0.8 (docs/reports/shaking.md)."""


class Allowed(NamedTuple):
    """How far a shake may be raised: amplitude [m], the flowers' median there [m/s2], and what ends it."""

    amplitude: float
    flowers: float
    binds: str


def risk(planned: float) -> float:
    """Return the share of watched shakes in which a load may be larger than is said; of a plan's."""
    return min(WATCHED * planned, 0.5)


def limits_of(limits: Limits, press: float, hertz: float) -> dict[str, float]:
    """Return by kind what the plant may bear at a tone [Hz], and what pads hold that press with `press` [N]."""
    plant = {kind: float(limit) for kind, limit in limits.plant.at(hertz).items()}
    return plant | {"grip_force": limits.held(press)}


def remembered(before: Allowed, now: Allowed) -> Allowed:
    """Return how far a shake may be raised after two looks at it: if the first allowed less, half of that counts [ln].

    What swung far once may do so again, and what is seen of a swing errs by a quarter.
    """
    share = min(1.0, (before.amplitude / now.amplitude) ** 0.5)
    binds = now.binds if share == 1 else before.binds
    return Allowed(share * now.amplitude, share * now.flowers, binds)


@dataclass(slots=True, eq=False)
class Option:
    """A way to shake.

    Attributes:
        hertz: its frequency [Hz].
        limits: see `limits_of`.
        planned: amplitude that the model allows [m].
        reach: that the actuator manages [m].
        params: what is enough.
        told: what is known of it.
        may: how far it may be raised.
        tried: how far it was raised [m].
        alone: whether it was watched alone.
        shown: whether a flower was followed then.
        most: (F,) acceleration above which an earlier look would have measured a flower [m/s2 for each m]; NaN before.
    """

    hertz: float
    limits: Mapping[str, float]
    planned: float
    reach: float
    params: Params
    told: Known
    may: Allowed = field(init=False)
    tried: float = 0.0
    alone: bool = False
    shown: bool = False
    most: Array | float = np.nan

    def __post_init__(self) -> None:
        self.may = self._allowed()

    def _allowed(self) -> Allowed:
        """Return how far it may be raised by what is known of it now."""
        told = self.told
        median, largest = float(np.median(told.flowers)), float(told.flowers[told.seen].max(initial=0.0))
        caps = {WORDS[kind]: limit / max(told.loads[kind], 1e-12) for kind, limit in self.limits.items()}
        caps["what the actuator can do"] = self.reach
        caps["the target"] = self.params.target / max(median, 1e-12)
        caps["the most a flower may feel"] = self.params.most / max(largest, 1e-12)
        binds = min(caps, key=lambda name: caps[name])
        return Allowed(caps[binds], median * caps[binds], binds)

    @property
    def promised(self) -> float:
        """What the flowers may feel, as far as such promises are kept [m/s2]."""
        return (SLOW_KEPT if self.hertz < SLOW and not self.alone else 1.0) * self.may.flowers

    @property
    def borne(self) -> float:
        """How far it was raised, as far as that is still allowed after every look at it [m]."""
        return min(self.tried, self.may.amplitude)

    @property
    def moved(self) -> float:
        """The flowers' median at `borne` [m/s2]."""
        return self.borne * float(np.median(self.told.flowers))

    def looked_at(self, told: Known) -> float:
        """Learn from a look at it alone; return which share of what was promised before is kept, at most 1."""
        before, first = self.may, not self.alone
        self.told, self.alone = told, True
        self.may = now = self._allowed()
        if not first:
            self.may = remembered(before, now)
        return min(now.flowers / max(before.flowers, 1e-12), 1.0) if first and told.seen.any() else 1.0

    def keep_to_plan(self, why: str) -> None:
        """Forget what looks at it allowed: it may be raised to what the model allows."""
        self.may = self._allowed()
        share = self.planned / self.may.amplitude
        if share < 1:
            self.may = Allowed(self.planned, share * self.may.flowers, why)

    def lost(self, amplitude: float, limit: float) -> bool:
        """Return whether a flower may swing too far to be measured: by more than `limit` [m/s2].

        One that a look before showed to feel less than that may feel `JUMP` times as much for each metre, or what would
        be measured. Of one that no look ever did, as of a hidden one, only the model speaks.
        """
        told, before = self.told, self.most
        may = amplitude * np.where(np.isfinite(before), np.fmin(told.most, JUMP * before), 0.0)
        self.most = np.where(told.seen | (amplitude * told.most <= limit), told.most, before)
        return bool(np.any(~told.seen & (may > limit)))
