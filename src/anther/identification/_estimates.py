"""Estimates with the errors they have in common: linearised propagation, comparison and combination.

Every source of error (radius, length, frequency, ...) has a standard error. An estimate keeps by how much its logarithm
changes for one standard error of each source, so that errors shared by two estimates cancel in their difference and do
not average out in their mean.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

DISAGREEMENT = 2.0
"""Estimates farther apart than so many standard errors of their difference are called in disagreement [-]."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A positive quantity with its error.

    Attributes:
        name: what it rests on.
        value: in SI units.
        shares: change of ln value per standard error of each source of error [-], signed; sources are independent.
    """

    name: str
    value: float
    shares: Mapping[str, float]

    @property
    def relative_error(self) -> float:
        """Standard error of ln value [-]."""
        return float(np.sqrt(sum(share**2 for share in self.shares.values())))

    @property
    def standard_error(self) -> float:
        """Standard error, in the value's units."""
        return self.value * self.relative_error


def propagate(
    name: str, function: Callable[[Mapping[str, float]], float], errors: Mapping[str, float], **own: float
) -> Quantity:
    """Return the estimate function({}) with the errors of its inputs.

    Linearised in the logarithm by central differences one standard error wide (GUM, JCGM 100:2008, 5.1.3 and its note
    on numerical sensitivities), so that moderate curvature is averaged rather than missed.

    Args:
        name: of the estimate.
        function: value for given shifts of the sources; a source not named is not shifted.
        errors: standard error of each source, in the units in which `function` shifts it.
        own: relative standard errors that belong to this estimate alone.
    """
    shares = {}
    for source, error in errors.items():
        if error > 0:
            shares[source] = 0.5 * float(np.log(function({source: error}) / function({source: -error})))
    return Quantity(name, function({}), shares | {k.replace("_", " "): v for k, v in own.items() if v > 0})


def disagreement(a: Quantity, b: Quantity) -> float:
    """Return |ln a - ln b| in standard errors of that difference."""
    sources = a.shares.keys() | b.shares.keys()
    error = np.sqrt(sum((a.shares.get(s, 0.0) - b.shares.get(s, 0.0)) ** 2 for s in sources))
    return float(abs(np.log(a.value / b.value)) / max(error, 1e-12))


def combine(a: Quantity, b: Quantity) -> Quantity:
    """Return the geometric mean of two estimates that has the least variance.

    The weights allow for shared errors and stay within 0 and 1. Where the two disagree, one of them has an error that
    nobody stated: the weights are then equal, and half the distance is added as an error of its own.
    """
    sources = a.shares.keys() | b.shares.keys()
    shared = sum(a.shares.get(s, 0.0) * b.shares.get(s, 0.0) for s in sources)
    spread = a.relative_error**2 + b.relative_error**2 - 2 * shared
    apart = disagreement(a, b) > DISAGREEMENT
    weight = 0.5 if apart or spread < 1e-24 else float(np.clip((b.relative_error**2 - shared) / spread, 0, 1))
    shares = {s: weight * a.shares.get(s, 0.0) + (1 - weight) * b.shares.get(s, 0.0) for s in sorted(sources)}
    if apart:
        shares["disagreement"] = 0.5 * float(abs(np.log(a.value / b.value)))
    value = float(np.exp(weight * np.log(a.value) + (1 - weight) * np.log(b.value)))
    return Quantity(f"{a.name} and {b.name}", value, shares)
