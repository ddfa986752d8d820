"""Does the plant stand? The least stiffness at which it does not buckle, and branches stiff enough for their leaves."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from anther.elastic_rod.equilibrium import stands
from anther.elastic_rod.motion import Clamp
from anther.elastic_rod.rods import Array, Rods

SOFTEST, STIFFEST = 1e4, 1e12
"""Range of Young's modulus that is searched [Pa]."""


def least_youngs(rods: Rods, clamp: Clamp, fixed: NDArray[np.bool_], stiffening: Array) -> float | None:
    """Return Young's modulus of the main stem at which the rods just stand [Pa], within 2 %; None if none helps.

    The weight's torques do not depend on the stiffness, so the tangent stiffness is E A - B and there is one such
    value; it is bisected on a logarithmic scale.

    Args:
        rods: the rods; their natural shape is found anew for every value.
        clamp: what is held.
        fixed: (N,) edges that keep their own Young's modulus.
        stiffening: (N,) Young's modulus of the others over the main stem's [-].
    """

    def stands_with(log_youngs: float) -> bool:
        youngs = np.where(fixed, rods.youngs, np.exp(log_youngs) * stiffening)
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


def branch_stiffening(
    rods: Rods, stem: NDArray[np.bool_], pedicel: NDArray[np.bool_], blade: NDArray[np.bool_], least: float
) -> Array:
    """Return (N,) factors on Young's modulus with which no leaf and no branch buckles before the main stem does.

    A scan shows a leaf's ribs too thin or not at all, yet leaves hold themselves up: what a leaf lacks is not taken for
    a stiffer plant. Leaf blades come first, then what stands on the main stem, each clamped at its base.

    Args:
        rods: tissue, leaves and flowers, of one Young's modulus but for the pedicels.
        stem, pedicel, blade: (N,) which edges are main stem, pedicel, and branch in a leaf blade.
        least: factor of every edge in a blade [-].
    """
    factor = np.where(blade, least, 1.0)
    stem_needs = least_youngs(rods, Clamp.root(rods), pedicel, np.where(stem, 1.0, _RIGID))
    if stem_needs is None:
        return factor
    youngs = np.where(pedicel, _RIGID * np.asarray(rods.youngs), stem_needs)
    for organ in (blade & ~blade[rods.parent], ~stem & ~pedicel & stem[rods.parent]):
        for base in np.flatnonzero(organ[1:]) + 1:
            beyond = _beyond(rods, int(base))
            if len(beyond) > 2:
                factor[beyond[1:]] *= _until_it_stands(_part(replace(rods, youngs=youngs * factor), beyond))
    return np.where(pedicel, 1.0, factor)


def _until_it_stands(branch: Rods) -> float:
    """Return a factor on Young's modulus, 1 or in steps of a fifth, with which the branch stands; 1 if none helps."""
    for factor in 1.2 ** np.arange(40):
        if stands(replace(branch, youngs=factor * np.asarray(branch.youngs)), Clamp.root(branch)):
            return float(factor)
    return 1.0


def _beyond(rods: Rods, base: int) -> NDArray[np.intp]:
    """Return the nodes of the branch that begins at `base`, after the node it stands on."""
    inside = np.zeros(len(rods.nodes), dtype=bool)
    inside[base] = True
    for j in range(base + 1, len(inside)):
        inside[j] = inside[rods.parent[j]]
    return np.concatenate([[rods.parent[base]], np.flatnonzero(inside)])


def _part(rods: Rods, nodes: NDArray[np.intp]) -> Rods:
    """Return the rods of some nodes; the first becomes the root."""
    parent = np.searchsorted(nodes, rods.parent[nodes])
    parent[0] = -1
    values = {f.name: getattr(rods, f.name)[nodes] for f in fields(rods) if np.ndim(getattr(rods, f.name)) == 1}
    return replace(rods, **values | {"nodes": rods.nodes[nodes], "parent": parent}, natural=None)


_RIGID = 1e3
"""Factor that takes a part out of the question whether the rest stands."""
