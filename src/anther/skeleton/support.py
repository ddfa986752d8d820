"""How well the cloud supports each node of a skeleton, and the confidence that follows. J nodes, N points.

A node is believed when a surface lies around it at one radius, all the way round, along an organ that is longer than
broad. Bridges have no surface, blades are broad, and where views disagree the surface is thick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anther.geometry import Array

SECTORS = 8
"""The directions around a node in which a surface is looked for."""

_ENOUGH = 40_000  # more points than this make the node statistics no better

FITTED = (-4.5, 1.0, 4.5, 4.5)
"""Constant and weights of `node_support` in the log-odds: `python experiments/confidence.py --fit`."""


def node_confidence(nodes: Array, parent: NDArray[Any], radius: Array, width: Array, points: Array) -> Array:
    """Return (J,) the probability that an organ's axis lies within 5 mm of each node.

    An axis is that of a stem, branch, petiole, rachis or truss: on the blade of a leaf the confidence is low.
    See `node_support` for the arguments.
    """
    return probability(FITTED, node_support(nodes, parent, radius, width, points))


def probability(fitted: Sequence[float], evidence: Array) -> Array:
    """Return the logistic model's probabilities (...,) of evidence (..., K), `fitted` being constant and weights."""
    return 1 / (1 + np.exp(-(fitted[0] + evidence @ np.asarray(fitted[1:]))))


def logit(share: ArrayLike) -> Array:
    """Return the log-odds of probabilities, which are kept within 0.02 .. 0.98."""
    p = np.clip(share, 0.02, 0.98)
    return np.log(p / (1 - p))


def node_support(nodes: Array, parent: NDArray[Any], radius: Array, width: Array, points: Array) -> Array:
    """Return what the cloud says of every node, (J, 3), each 0 .. 1, larger for a better one, 0 without points.

    Columns: the share of SECTORS around the node that hold points; thickness over breadth; how sharply the surface
    lies at one radius, exp(-2 scatter / radius).

    Args:
        nodes: (J, 3) [m].
        parent: (J,) of a rooted tree, parent[0] = -1.
        radius, width: (J,) half thickness and half breadth [m].
        points: (N, 3) the cloud [m].
    """
    points = points[:: max(len(points) // _ENOUGH, 1)]
    owner = np.asarray(KDTree(nodes).query(points)[1])
    tangent = _tangents(nodes, parent)
    one, two = _across(tangent)
    offset = points - nodes[owner]
    x, y = np.sum(offset * one[owner], axis=1), np.sum(offset * two[owner], axis=1)
    away = np.hypot(x, y)
    reach = np.maximum(2.5 * radius, 2 * np.median(radius))
    near = away <= reach[owner]
    sector = np.floor((np.arctan2(y, x) / (2 * np.pi) + 0.5) * SECTORS).astype(np.int64) % SECTORS
    held = np.zeros((len(nodes), SECTORS), dtype=bool)
    held[owner[near], sector[near]] = True
    count = np.bincount(owner[near], minlength=len(nodes))
    spread = np.bincount(owner[near], np.abs(away - radius[owner])[near], minlength=len(nodes)) / np.maximum(count, 1)
    columns = (
        held.mean(axis=1),
        np.where(count > 0, np.minimum(radius / width, 1), 0.0),
        np.where(count > 0, np.exp(-2 * spread / radius), 0.0),
    )
    return np.stack([_along(column, parent) for column in columns], axis=1)


def _along(values: Array, parent: NDArray[Any]) -> Array:
    """Return the values averaged with those of the parent and of the children."""
    total, count = values.copy(), np.ones(len(values))
    np.add.at(total, parent[1:], values[1:])
    np.add.at(count, parent[1:], 1)
    total[1:] += values[parent[1:]]
    count[1:] += 1
    return total / count


def _tangents(nodes: Array, parent: NDArray[Any]) -> Array:
    """Return (J, 3) unit directions: from the parent to the mean of the children."""
    edge = nodes[1:] - nodes[parent[1:]]
    direction = np.zeros_like(nodes)
    direction[1:] += edge
    np.add.at(direction, parent[1:], edge)
    return direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)


def _across(tangent: Array) -> tuple[Array, Array]:
    """Return two unit vectors (J, 3) across each unit tangent."""
    helper = np.eye(3)[np.argmin(np.abs(tangent), axis=1)]
    one = np.cross(tangent, helper)
    one = np.asarray(one / np.maximum(np.linalg.norm(one, axis=1, keepdims=True), 1e-12), dtype=np.float64)
    return one, np.asarray(np.cross(tangent, one), dtype=np.float64)
