"""Find where the stem leaves the soil: not always the lowest point, since leaves droop and soil is left over."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array
from anther.skeleton.raw_tree import ALPHA, RawTree, edge_lengths, path_gain, rerooted
from anther.skeleton.support import probability

_LOW = 0.5
_SAME = 0.1
"""Tips so near to each other through the tree are the same base, per plant's extent."""
_THICK = 1.5
"""Wood counts as no thicker than this times the 95th percentile: a pot left over is no stem."""

FITTED = (-19.95, 12.54, 14.04)
SEEN = (2.79, 0.36)
"""Weights of `base_evidence` in the utility of a base; constant and weight of the best utility in the log-odds that the
base is in the cloud at all: `python experiments/fit_confidence.py`."""


def stem_gain(tree: RawTree) -> Array:
    """Return (J,) the path gain (P10) by inscribed radius and roundness: a blade is thin however wide it is."""
    gain = path_gain(tree.nodes, tree.parent, tree.thickness)
    return gain * _roundness(tree)


class PlantBase(NamedTuple):
    """Where a plant stands: the node, how likely that is, and where else it might be (itself, if nowhere)."""

    node: int
    probability: float
    rival: int


def find_root(tree: RawTree, candidates: int = 60) -> PlantBase:
    """Return the tip in the lower half of the plant at which it most likely stands.

    The tips are the choices of a conditional logit, nested in whether the base is in the cloud (McFadden 1978).

    Args:
        tree: any rooting of the tree.
        candidates: only so many of the lowest tips are tried.
    """
    tips, evidence = base_evidence(tree, candidates)
    utility = evidence @ np.asarray(FITTED)
    best = int(np.argmax(utility))
    odds, same = np.exp(utility - utility[best]), same_place(tree, tips, best)
    seen = float(probability(SEEN, utility[best : best + 1] + np.log(odds.sum())))
    rival = best if same.all() else int(np.argmax(np.where(same, -1, odds)))
    return PlantBase(int(tips[best]), seen * float(odds[same].sum() / odds.sum()), int(tips[rival]))


def same_place(tree: RawTree, tips: NDArray[np.int64], best: int) -> NDArray[np.bool_]:
    """Return which of the tips (C,) are the same base as the best of them: stubs beside it."""
    parent, order = rerooted(tree.parent, int(tips[best]))
    way = np.empty(len(order))
    way[order] = _summed_down(parent, edge_lengths(tree.nodes[order], parent))
    return way[tips] <= _SAME * _extent(tree)


def base_evidence(tree: RawTree, candidates: int) -> tuple[NDArray[np.int64], Array]:
    """Return the tips (C,) where the plant may stand and what speaks for each, (C, 3), relative to the plant's extent.

    Columns: the mean way through the tree to all that it would carry (a base is near to all); how much the plant's
    wood would rise, each edge by its squared inscribed radius and roundness (a stem is thick and grows up, a drooping
    leaf grows down); how far it lies below the top.
    """
    middle = int(np.argmin(_mean_way(tree)))
    parent, order = rerooted(tree.parent, middle)
    tree, extent = tree.taking(parent, order), _extent(tree)
    z = tree.nodes[:, 2]
    tips = np.flatnonzero(np.bincount(parent[1:], minlength=len(parent)) + (parent >= 0) == 1)
    tips = tips[np.argsort(z[tips])]
    low = np.count_nonzero(z[tips] <= z.min() + _LOW * np.ptp(z))
    tips = tips[: min(max(low, 1), candidates)]  # what hangs in an arc has no low tip
    wood = tree.thickness * _roundness(tree)
    wood = np.minimum(wood / max(float(np.quantile(wood, 0.95)), 1e-12), _THICK) ** ALPHA
    rising = (z - z[np.maximum(parent, 0)]) * wood  # from another root the way there is walked the other way round
    rise = rising.sum() - 2 * _summed_down(parent, rising)
    return order[tips], np.stack([_mean_way(tree)[tips], rise[tips], z.max() - z[tips]], axis=1) / extent


def _mean_way(tree: RawTree) -> Array:
    """Return (J,) the mean way through the tree from each node to all of its length [m]."""
    length = edge_lengths(tree.nodes, tree.parent)
    beyond = length.copy()
    for j in range(len(length) - 1, 0, -1):
        beyond[tree.parent[j]] += beyond[j]
    total = max(float(length.sum()), 1e-12)
    nearer = length * (1 - 2 * beyond / total)  # a step to a node nears what lies beyond it and leaves the rest
    nearer[0] = np.average(_summed_down(tree.parent, length), weights=length) if length.any() else 0
    return _summed_down(tree.parent, nearer)


def _summed_down(parent: NDArray[Any], amount: Array) -> Array:
    """Return (J,) the sum of `amount` over each node and all between it and the root."""
    total = amount.copy()
    for j in range(1, len(parent)):
        total[j] += total[parent[j]]
    return total


def _roundness(tree: RawTree) -> Array:
    """Return (J,) about 1 on a stem, near 0 on a blade."""
    return np.minimum(tree.thickness / tree.width, 1) * (1.1 - tree.flatness)


def _extent(tree: RawTree) -> float:
    """Return the diagonal of the tree's bounding box [m]."""
    return max(float(np.linalg.norm(np.ptp(tree.nodes, axis=0))), 1e-12)


_SOIL_REACH = 0.05
"""The stem goes on straight, unseen, for at most this long down to the soil, and soil so far aside counts [m]."""
_FEWEST_CELLS = 5
_STEEPEST = 0.7
"""Cosine of the greatest angle from the vertical at which a stem is taken to go on straight."""


def distance_to_soil(base: Array, upward: Array, obstacles: Array) -> float:
    """Return how far straight below its lowest seen point the stem meets the soil [m]; 0 if it cannot be told.

    Args:
        base: (3,) the stem's lowest point seen [m].
        upward: (3,) unit vector of the stem there.
        obstacles: (M, 3) points of pot and soil [m].
    """
    aside = np.linalg.norm(obstacles[:, :2] - base[:2], axis=1)
    below = base[2] - obstacles[:, 2]
    soil = below[(aside <= _SOIL_REACH) & (np.abs(below) <= _SOIL_REACH)]
    if len(soil) < _FEWEST_CELLS or upward[2] < _STEEPEST:
        return 0.0
    return max(float(np.median(soil)) / float(upward[2]), 0.0)
