"""Find where the stem leaves the soil: not always the lowest point, since leaves droop and soil is left over."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from anther.geometry import Array
from anther.skeleton.raw_tree import RawTree, chains, path_gain, rerooted

_ALPHA, _V_BIAS = 2.0, 1.0
_LOW = 0.5
_BEGINNING = 0.15
_AWAY, _ABOVE = 1.5, 2.5
"""Per plant's extent, in an exponent. Of 121 trees of 43 plants (tomatoes, peppers, a broad-leaved plant, leafy maize;
upright, leaning by 20 and 40 degrees) these choose the base in 43 of 43, 37 of 39 and 37 of 39."""
_SHARP, _ELSEWHERE = 3.0, 0.05
"""A candidate is the base with odds that go as this power of its score; a stub on the best one's stem, not longer than
this share of the plant's extent, is no rival. Read off the same trees: of ten said to stand there with less than 0.75
four are wrong, of the others none."""


def stem_gain(tree: RawTree) -> Array:
    """Return (J,) the path gain (P10) by inscribed radius and roundness: a blade is thin however wide it is."""
    roundness = np.minimum(tree.thickness / tree.width, 1)
    gain = path_gain(tree.nodes, tree.parent, tree.thickness, alpha=_ALPHA, v_bias=_V_BIAS)
    return gain * roundness * (1.1 - tree.flatness)


class Base(NamedTuple):
    """Where a plant stands: the node, how likely that is, and where else it might be (itself, if nowhere)."""

    node: int
    probability: float
    rival: int


def find_root(tree: RawTree, candidates: int = 60) -> Base:
    """Return the tip in the lower half of the plant from which the best stem starts.

    From each low tip the best rising path of the tree rooted there is scored, times how thick and upright it
    begins: a drooping leaf's tip begins thin, rises less straight, and misses the thick lower stem. Height above
    the lowest tip and a long way through the tree to what it would carry count against a candidate.

    Args:
        tree: any rooting of the tree.
        candidates: only so many of the lowest tips are tried.
    """
    degree = np.bincount(tree.parent[1:], minlength=len(tree.nodes))
    degree[1:] += 1
    degree[0] = 1  # where the tree was rooted so far may be the root, whatever leaves there
    z = tree.nodes[:, 2]
    extent = max(float(np.linalg.norm(np.ptp(tree.nodes, axis=0))), 1e-12)
    tips = np.flatnonzero(degree == 1)
    tips = tips[np.argsort(z[tips])]
    low = int(np.count_nonzero(z[tips] <= z.min() + _LOW * np.ptp(z)))
    tips = tips[: min(max(low, 1), candidates)]  # what hangs in an arc has no low tip
    child = np.arange(1, len(tree.nodes))
    lengths = np.maximum(np.linalg.norm(tree.nodes[1:] - tree.nodes[tree.parent[1:]], axis=1), 1e-12)
    graph = csr_array((lengths, (child, tree.parent[1:])), (len(tree.nodes),) * 2)
    way = dijkstra(graph, directed=False, indices=tips)
    mean_way = np.average(way[:, 1:], axis=1, weights=lengths)
    place = np.exp(-(_ABOVE * (z[tips] - z.min()) + _AWAY * mean_way) / extent)
    stems = [_stem_from(tree, tip) for tip in tips]
    score = np.maximum(place * [stem.score for stem in stems], 1e-300)
    best = int(np.argmax(score))
    off_stem = way[:, stems[best].path].min(axis=1)
    odds = (score / score[best]) ** _SHARP * (off_stem > _ELSEWHERE * extent)
    rival = int(odds.argmax()) if odds.any() else best
    return Base(int(tips[best]), float(1 / (1 + odds.sum())), int(tips[rival]))


class _StemFrom(NamedTuple):
    """The best stem that starts at a node: how well it would be one, and its nodes."""

    score: float
    path: NDArray[np.int64]


def _stem_from(tree: RawTree, root: int) -> _StemFrom:
    parent, order = rerooted(tree.parent, root)
    other = tree.taking(parent, order)
    above = np.maximum(other.parent, 0)
    step = other.nodes - other.nodes[above]
    rising = np.maximum(step[:, 2], 0) / np.maximum(np.linalg.norm(step, axis=1), 1e-12)
    gain = stem_gain(other) * rising
    path = chains(other.parent, gain)[0]
    length = np.linalg.norm(step[path[1:]], axis=1)
    first = path[1:][np.cumsum(length) <= max(_BEGINNING * float(length.sum()), length[0])]
    mean_gain = gain[path].sum() / max(float(length.sum()), 1e-12)  # the way over a leaf to the stem is longer
    return _StemFrom(float(mean_gain * np.mean(rising[first] * other.thickness[first])), order[path])


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
