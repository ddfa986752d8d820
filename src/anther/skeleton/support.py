"""How well the cloud supports each node of a skeleton, and the confidence that follows. J nodes, N points.

A node is believed when a surface lies around it at one radius and its surroundings are not a plane. Bridges have no
surface, blades are planes, and where views disagree the surface is smeared.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.geometry import Array
from anther.skeleton._nearby import nearest
from anther.skeleton.raw_tree import along_tree

_ENOUGH = 40_000  # more points than this make the node statistics no better

FITTED = (-4.12, 4.63, 6.58)
"""Constant and weights of `node_support` in the log-odds: `python experiments/confidence.py --fit`."""


def node_confidence(nodes: Array, parent: NDArray[Any], radius: Array, flatness: Array, points: Array) -> Array:
    """Return (J,) the probability that an organ's axis lies within 5 mm of each node.

    An axis is that of a stem, branch, petiole, rachis or truss: on the blade of a leaf the confidence is low.
    See `node_support` for the arguments.
    """
    return probability(FITTED, node_support(nodes, parent, radius, flatness, points))


def probability(fitted: Sequence[float], evidence: Array) -> Array:
    """Return the logistic model's probabilities (...,) of evidence (..., K), `fitted` being constant and weights."""
    return 1 / (1 + np.exp(-(fitted[0] + evidence @ np.asarray(fitted[1:]))))


def logit(share: ArrayLike) -> Array:
    """Return the log-odds of probabilities, which are kept within 0.02 .. 0.98."""
    p = np.clip(share, 0.02, 0.98)
    return np.log(p / (1 - p))


def node_support(nodes: Array, parent: NDArray[Any], radius: Array, flatness: Array, points: Array) -> Array:
    """Return what the cloud says of every node, (J, 2), each 0 .. 1, larger for a better one, 0 without points.

    Columns: how sharply the surface lies at one radius, exp(-2 scatter / radius); how little the surroundings are a
    plane, 1 - flatness.

    Args:
        nodes: (J, 3) [m].
        parent: (J,) of a rooted tree, parent[0] = -1.
        radius: (J,) half thickness [m].
        flatness: (J,) see `Skeleton`.
        points: (N, 3) the cloud [m].
    """
    points = points[:: max(len(points) // _ENOUGH, 1)]
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
