"""One way to shake, a frequency along a line: what is known of it, and how far it was raised. F flowers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anther.escalation._knowledge import JUMP, Allowed, Known, remembered
from anther.geometry import Array

SLOW, SLOW_KEPT = 5.0, 0.6
"""Below so many hertz a promise counts so much until that shake was watched alone: of such promises five plants of
linear equations felt 0.54 and 13 of the whole cell 0.5; of those at 5 to 9 Hz 0.9 and 0.8 (docs/reports/shaking.md)."""


@dataclass(slots=True, eq=False)
class Option:
    """A way to shake.

    Attributes:
        hertz: its frequency [Hz].
        told: what is known of it.
        may: how far it may be raised.
        tried: how far it was raised [m].
        alone: whether it was watched alone.
        shown: whether a flower was followed then.
        most: (F,) acceleration above which an earlier look would have measured a flower [m/s2 for each m]; None before.
    """

    hertz: float
    told: Known
    may: Allowed
    tried: float = 0.0
    alone: bool = False
    shown: bool = False
    most: Array | None = None

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

    def looked_at(self, told: Known, may: Allowed) -> float:
        """Learn from a look at it alone; return which share of what was promised before is kept, at most 1."""
        before, first = self.may, not self.alone
        self.told, self.alone = told, True
        self.may = may if first else remembered(before, may)
        return min(may.flowers / max(before.flowers, 1e-12), 1.0) if first and told.seen.any() else 1.0

    def lost(self, amplitude: float, limit: float) -> bool:
        """Return whether a flower may swing too far to be measured: by more than `limit` [m/s2].

        One that a look before showed to feel less than that may feel `JUMP` times as much for each metre, or what would
        be measured. Of one that no look ever did, as of a hidden one, only the model speaks.
        """
        told = self.told
        before = np.full(len(told.most), np.nan) if self.most is None else self.most
        may = amplitude * np.where(np.isfinite(before), np.fmin(told.most, JUMP * before), 0.0)
        self.most = np.where(told.seen | (amplitude * told.most <= limit), told.most, before)
        return bool(np.any(~told.seen & (may > limit)))
