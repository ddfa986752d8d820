"""Confidence of the skeleton: of each node, from the cloud around it, and of the stem's base. J nodes, N points.

A node has a high confidence when a surface lies around it at one radius and its surroundings are not a plane: bridges
have no surface, blades are planes, and where views disagree the surface is smeared. The base is a low tip, not always
the lowest, since leaves droop and soil is left over.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.geometry import Array
from anther.perception.skeleton.raw_tree import (
    RawTree,
    along_tree,
    edge_lengths,
    path_gain,
    reroot,
    sum_above,
    sum_below,
)
from anther.perception.skeleton.voxel_solid import nearest


def node_confidence(nodes: Array, parent: NDArray[Any], radius: Array, flatness: Array, points: Array) -> Array:
    """Return (J,) the probability that an organ's axis lies within 5 mm of each node.

    An axis is that of a stem, branch, petiole, rachis or truss: on the blade of a leaf the confidence is low.
    See `node_support` for the arguments.
    """
    # constant and weights of the support in the log-odds: `python -m evaluation.perception.confidence --fit`
    fitted = (-4.12, 4.63, 6.58)
    return probability(fitted, node_support(nodes, parent, radius, flatness, points))


def probability(fitted: Sequence[float], evidence: Array) -> Array:
    """Return the logistic model's probabilities (...,) of evidence (..., K), `fitted` being constant and weights."""
    return 1 / (1 + np.exp(-(fitted[0] + evidence @ np.asarray(fitted[1:]))))


def logit(share: ArrayLike) -> Array:
    """Return the log-odds of probabilities, which are kept within 0.02 .. 0.98."""
    p = np.clip(share, 0.02, 0.98)
    return np.log(p / (1 - p))


def node_support(nodes: Array, parent: NDArray[Any], radius: Array, flatness: Array, points: Array) -> Array:
    """Return the cloud's (N, 3) evidence for every node, (J, 2), each 0 .. 1, larger is better, 0 without points.

    Columns: how sharply the surface lies at one radius, exp(-2 scatter / radius); how little the surroundings are a
    plane, 1 - flatness.
    """
    points = points[:: max(len(points) // 40_000, 1)]  # more make the statistics no better
    _, owner = nearest(points, nodes)
    offset, tangent = points - nodes[owner], _tangents(nodes, parent)[owner]
    along = np.sum(offset * tangent, axis=1)
    away = np.sqrt(np.maximum(np.sum(offset**2, axis=1) - along**2, 0))
    near = away <= np.maximum(2.5 * radius, 2 * np.median(radius))[owner]
    owner, scatter = owner[near], np.abs(away - radius[owner])[near]
    count = np.bincount(owner, minlength=len(nodes))
    scatter = np.bincount(owner, scatter, minlength=len(nodes)) / np.maximum(count, 1)
    columns = (np.exp(-2 * scatter / radius), 1 - flatness)
    return np.stack([along_tree(parent, np.where(count > 0, column, 0.0), rounds=1) for column in columns], axis=1)


def _tangents(nodes: Array, parent: NDArray[Any]) -> Array:
    """Return (J, 3) unit directions: from the parent to the mean of the children."""
    edge = nodes[1:] - nodes[parent[1:]]
    direction = np.zeros_like(nodes)
    direction[1:] += edge
    np.add.at(direction, parent[1:], edge)
    return direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)


def stem_gain(tree: RawTree) -> Array:
    """Return (J,) the path gain (P10) by inscribed radius and roundness: a blade is thin however wide it is."""
    gain = path_gain(tree.nodes, tree.parent, tree.thickness)
    return gain * _roundness(tree)


class PlantBase(NamedTuple):
    """The stem's base node, its probability, and the second candidate (itself, if there is none)."""

    node: int
    probability: float
    rival: int


def find_root(tree: RawTree, candidates: int = 60) -> PlantBase:
    """Return the tip in the lower half of the plant, among the lowest `candidates`, that is most likely the stem's
    base.

    The tips are the choices of a conditional logit, nested in whether the base is in the cloud (McFadden 1978).
    """
    tips, evidence = base_evidence(tree, candidates)
    # weights of the evidence in the utility of a base; constant and weight of the best utility in the log-odds that the
    # base is in the cloud at all: `python -m evaluation.perception.fit_confidence`
    of_base, of_seen = (-19.95, 12.54, 14.04), (2.79, 0.36)
    utility = evidence @ np.asarray(of_base)
    best = int(np.argmax(utility))
    odds, same = np.exp(utility - utility[best]), same_place(tree, tips, best)
    seen = float(probability(of_seen, utility[best : best + 1] + np.log(odds.sum())))
    rival = best if same.all() else int(np.argmax(np.where(same, -1, odds)))
    return PlantBase(int(tips[best]), seen * float(odds[same].sum() / odds.sum()), int(tips[rival]))


def same_place(tree: RawTree, tips: NDArray[np.int64], best: int) -> NDArray[np.bool_]:
    """Return which of the tips (C,) are the same base as the best of them: within a tenth of the plant through it."""
    parent, order = reroot(tree.parent, int(tips[best]))
    way = np.empty(len(order))
    way[order] = sum_above(parent, edge_lengths(tree.nodes[order], parent))
    return way[tips] <= 0.1 * _extent(tree)


def base_evidence(tree: RawTree, candidates: int) -> tuple[NDArray[np.int64], Array]:
    """Return the candidate tips (C,) for the base and their evidence (C, 3), relative to the plant's extent.

    Columns: the mean way through the tree to all that it would carry (a base is near to all); how much the plant's
    wood would rise, each edge by its squared inscribed radius and roundness (a stem is thick and grows up, a drooping
    leaf grows down); how far it lies below the top.
    """
    middle = int(np.argmin(_mean_way(tree)))
    parent, order = reroot(tree.parent, middle)
    tree, extent = tree.taking(parent, order), _extent(tree)
    z = tree.nodes[:, 2]
    tips = np.flatnonzero(np.bincount(parent[1:], minlength=len(parent)) + (parent >= 0) == 1)
    tips = tips[np.argsort(z[tips])]
    low = np.count_nonzero(z[tips] <= z.min() + 0.5 * np.ptp(z))
    tips = tips[: min(max(low, 1), candidates)]  # a plant that hangs in an arc has no low tip
    wood = tree.thickness * _roundness(tree)
    wood = np.minimum(wood / max(float(np.quantile(wood, 0.95)), 1e-12), 1.5) ** 2.0  # a pot left over is no stem
    rising = (z - z[np.maximum(parent, 0)]) * wood  # from another root the way there is walked the other way round
    rise = rising.sum() - 2 * sum_above(parent, rising)
    return order[tips], np.stack([_mean_way(tree)[tips], rise[tips], z.max() - z[tips]], axis=1) / extent


def _mean_way(tree: RawTree) -> Array:
    """Return (J,) the mean way through the tree from each node to all of its length [m]."""
    length = edge_lengths(tree.nodes, tree.parent)
    total = max(float(length.sum()), 1e-12)
    nearer = length * (1 - 2 * sum_below(tree.parent, length) / total)  # a step nears what lies beyond, leaves the rest
    nearer[0] = np.average(sum_above(tree.parent, length), weights=length) if length.any() else 0
    return sum_above(tree.parent, nearer)


def _roundness(tree: RawTree) -> Array:
    """Return (J,) about 1 on a stem, near 0 on a blade."""
    return np.minimum(tree.thickness / tree.width, 1) * (1.1 - tree.flatness)


def _extent(tree: RawTree) -> float:
    """Return the diagonal of the tree's bounding box [m]."""
    return max(float(np.linalg.norm(np.ptp(tree.nodes, axis=0))), 1e-12)


def distance_to_soil(base: Array, upward: Array, obstacles: Array) -> float:
    """Return how far below its lowest seen point (3,) the stem, straight on, meets the soil [m]; 0 if unknown.

    Soil counts within 50 mm, from five cells on, below a stem that leans by 45 degrees at most.

    `upward` (3,) is the stem's unit vector there; the obstacles (M, 3) are points of pot and soil [m].
    """
    aside = np.linalg.norm(obstacles[:, :2] - base[:2], axis=1)
    below = base[2] - obstacles[:, 2]
    soil = below[(aside <= 0.05) & (np.abs(below) <= 0.05)]
    if len(soil) < 5 or upward[2] < 0.7:
        return 0.0
    return max(float(np.median(soil)) / float(upward[2]), 0.0)
