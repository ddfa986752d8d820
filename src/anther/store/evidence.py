"""What visits taught of a plant, as sums that can be kept: they do not depend on the order in which visits arrive.

What one visit says of a quantity, apart from what was believed before it, is the quotient of the normal belief after
and the one before, both in the logarithm: precision d = 1/s_after^2 - 1/s_before^2 and mean y = (m_after/s_after^2 -
m_before/s_before^2)/d. Without this division the prior would be counted once a visit. Visits of one plant add up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from anther.plant import LEARNED, Material

LEAST = 0.05
"""A visit teaches a quantity if it adds this share of the precision there was; less is noise of the ensemble [-]."""

Sums = Mapping[str, list[float]]
"""Quantity of `plant.LEARNED` -> [sum of d, sum of d y]."""


def told(before: Material, after: Material) -> Sums:
    """Return what one visit says of each quantity; those of which it says nothing are left out."""
    sums = {}
    for value, spread in LEARNED.items():
        old, new = getattr(before, spread), getattr(after, spread)
        if new > 0 and old > 0 and 1 / new**2 >= (1 + LEAST) / old**2:
            weighted = np.log(getattr(after, value)) / new**2 - np.log(getattr(before, value)) / old**2
            sums[value] = [1 / new**2 - 1 / old**2, float(weighted)]
    return sums


def summed(parts: Iterable[Sums]) -> Sums:
    """Return several visits' sums as one."""
    total: dict[str, list[float]] = {}
    for part in parts:
        for quantity, (precision, weighted) in part.items():
            before = total.get(quantity, [0.0, 0.0])
            total[quantity] = [before[0] + precision, before[1] + weighted]
    return total
