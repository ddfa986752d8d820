"""Does the plant stand? The least stiffness at which it does not buckle, and branches stout enough for their leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anther.elastic_rod.motion import Clamp
from anther.elastic_rod.rods import GRAVITY, Array, Rods
from anther.elastic_rod.stability import stands

SOFTEST, STIFFEST = 1e4, 1e12
"""Range of Young's modulus that is searched [Pa]."""


def least_youngs(rods: Rods, clamp: Clamp, fixed: NDArray[np.bool_]) -> float | None:
    """Return Young's modulus at which the rods just stand [Pa], within 2 %; None if no stiffness helps.

    The weight's torques do not depend on the stiffness, so the tangent stiffness is E A - B and there is one such
    value; it is bisected on a logarithmic scale.

    Args:
        rods: the rods; their natural shape is found anew for every value.
        clamp: what is held.
        fixed: (N,) edges that keep their own Young's modulus.
    """

    def stands_with(log_youngs: float) -> bool:
        youngs = np.where(fixed, rods.youngs, np.exp(log_youngs))
        return stands(replace(rods, youngs=youngs, natural=None), clamp)

    low, high = np.log(SOFTEST), np.log(STIFFEST)
    if not stands_with(high):
        return None
    if stands_with(low):
        return SOFTEST
    while high - low > 0.02:
        middle = (low + high) / 2
        low, high = (low, middle) if stands_with(middle) else (middle, high)
    return float(np.exp(high))


def stout_radii(rods: Rods, *, margin: float) -> Array:
    """Return edge radii (N,) [m], raised where an edge could not hold up what it carries.

    Whatever hangs beyond edge j (mass m, centre of mass at a distance d from the edge's base) needs, as a mass on a
    clamped column, EI > 4 m g d^2 / pi^2 (Euler). A scan shows a leaf's midrib too thin or not at all, yet it holds.

    Args:
        rods: tissue, leaves and flowers.
        margin: ratio of stiffness to that limit [-].
    """
    parent, weight = rods.parent, rods.node_mass.copy()
    moment = weight[:, None] * rods.nodes
    for j in range(len(weight) - 1, 0, -1):
        weight[parent[j]] += weight[j]
        moment[parent[j]] += moment[j]
    centre = moment / np.maximum(weight, 1e-12)[:, None]
    lever = np.linalg.norm(centre - rods.nodes[parent], axis=1)
    needed = margin * 4 / np.pi**2 * weight * -GRAVITY[2] * lever**2
    return np.maximum(rods.edge_radius, (4 * needed / (np.pi * np.asarray(rods.youngs))) ** 0.25)
