"""How an answer compares with what is known of the plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from anther.core import Array
from anther.perception import Cloud
from evaluation.perception.real.answers import Answer, Seen
from evaluation.perception.real.plants import Labelled, Reference, nearest, plant_size

STEPS = 400
"""A centreline is sampled every plant size / STEPS."""
TOLERANCES = (1, 3)
"""Tolerances of precision and recall against published graphs, in 200ths of the plant's diagonal (facts: peers)."""

SPUR = 5
"""Ends of branches shorter than this [voxels, 200 to the diagonal] count for no method (facts: peers)."""
SHORT_OF = 0.15
"""A published end may be so far from the end that is meant [plant sizes]: some end 0.13 short of the blade's tip."""

REACH = 0.05
"""A point farther than this share of the plant's size from the skeleton belongs to a part that was dropped."""


@dataclass(frozen=True)
class Outcome:
    """What one method gave on one labelled plant. Without an answer everything counts as missed.

    Attributes:
        plant: its name.
        grasp_on_stem: the point nearest to the grasp is labelled stem, and not farther than two stem radii.
        stem_share: share of the main stem's length within two stem radii of points labelled stem.
        stem_reach: share of the height of the points labelled stem that the main stem's height covers.
        distance: median distance from the main stem to the nearest point labelled stem [m].
        is_tree: one piece, no cycles.
        pieces: how many pieces the skeleton has.
        tips_per_leaf: ends of the skeleton but the root, over labelled leaves; NaN where leaves are not labelled.
        seconds: processor time.
        failure: None, or why there is no answer.
    """

    plant: str
    grasp_on_stem: bool = False
    stem_share: float = 0.0
    stem_reach: float = 0.0
    distance: float = np.nan
    is_tree: bool = False
    pieces: int = 0
    tips_per_leaf: float = np.nan
    seconds: float = np.nan
    failure: str | None = None


@dataclass(frozen=True, eq=False)
class Tolerance:
    """Two stem radii, as Anther measured them where it saw the main stem; the same for every method.

    Attributes:
        nodes: (S, 3) main stem [m].
        radius: (S,) [m].
    """

    nodes: Array
    radius: Array

    def at(self, points: Array) -> Array:
        """Return (M,) the tolerance at each of M points [m]: that of the nearest place on the main stem."""
        return 2 * self.radius[np.asarray(KDTree(self.nodes).query(points)[1])]


def judge(plant: Labelled, answer: Answer | str, tolerance: Tolerance) -> Outcome:
    """Return how an answer, or the reason why there is none, compares with the labels."""
    if isinstance(answer, str):
        return Outcome(plant.name, failure=answer)
    size, stem_points = plant_size(plant.cloud.points), plant.stem_points
    line = sampled(answer.nodes, answer.stem, size / STEPS)
    away = nearest(stem_points, line)
    gap, at = KDTree(plant.cloud.points).query(answer.grasp)
    low, high = np.quantile(stem_points[:, 2], [0.005, 0.995])
    return Outcome(
        plant.name,
        grasp_on_stem=bool(plant.is_stem[at]) and float(gap) <= float(tolerance.at(answer.grasp)),
        stem_share=float(np.mean(away <= tolerance.at(line))),
        stem_reach=float(np.ptp(np.clip(line[:, 2], low, high)) / (high - low)),
        distance=float(np.median(away)),
        is_tree=answer.is_tree,
        pieces=answer.pieces,
        tips_per_leaf=(answer.tips - 1) / plant.leaves if plant.leaves else np.nan,
        seconds=answer.seconds,
    )


def radius_over_points(plant: Labelled, seen: Seen) -> float:
    """Return the main stem's radius over the distance of its points from it, median over points; 1 is right.

    The points are those labelled stem to which no other part of the skeleton is nearer.
    """
    at = np.asarray(KDTree(seen.skeleton.nodes).query(plant.stem_points)[1])
    own = np.isin(at, seen.stem.node_ids)
    step = plant_size(plant.cloud.points) / STEPS / 4
    away = nearest(sampled(seen.answer.nodes, seen.answer.stem, step), plant.stem_points[own])
    return float(np.median(seen.skeleton.radius[at[own]]) / np.median(away))


def agreement(plant: Reference, answer: Answer) -> dict[str, float]:
    """Return precision and recall of the centrelines against a published graph, at every tolerance."""
    size = plant_size(plant.cloud.points)
    ours = sampled(answer.nodes, answer.edges, size / STEPS)
    published = sampled(plant.nodes, plant.edges, size / STEPS)
    precision, recall = nearest(published, ours), nearest(ours, published)
    found = {}
    for voxels in TOLERANCES:
        limit = voxels * size / 200
        found[f"precision_{voxels}v"] = float(np.mean(precision <= limit))
        found[f"recall_{voxels}v"] = float(np.mean(recall <= limit))
    return found


def spurious_tips(plant: Reference, answer: Answer) -> int:
    """Return how many ends of a skeleton no published end claims, one to one within SHORT_OF."""
    size = plant_size(plant.cloud.points)
    found = ends(answer.nodes, answer.edges, SPUR * size / 200)
    gap = cdist(found, ends(plant.nodes, plant.edges, 0.0))
    allowed = gap <= SHORT_OF * size
    pairs = linear_sum_assignment(np.where(allowed, gap, 1e3 * size))
    return len(found) - int(allowed[pairs].sum())


def ends(nodes: Array, edges: NDArray[Any], shortest: float) -> Array:
    """Return the ends (T, 3) of a graph whose branches, up to the next fork, are not shorter than `shortest` [m]."""
    beside: list[list[int]] = [[] for _ in nodes]
    for one, other in edges.tolist():
        beside[one].append(other)
        beside[other].append(one)
    kept = []
    for end in (n for n, near in enumerate(beside) if len(near) == 1):
        before, at, length = end, beside[end][0], float(np.linalg.norm(nodes[end] - nodes[beside[end][0]]))
        while len(beside[at]) == 2:
            before, at = at, sum(beside[at]) - before
            length += float(np.linalg.norm(nodes[at] - nodes[before]))
        if length >= shortest:
            kept.append(end)
    return nodes[kept]


def reached(cloud: Cloud, answer: Answer | str) -> float:
    """Return the share of the points that are within REACH plant sizes of the skeleton's largest piece."""
    if isinstance(answer, str):
        return 0.0
    size = plant_size(cloud.points)
    body = sampled(answer.nodes, _largest_piece(answer), size / STEPS)
    return float(np.mean(nearest(body, cloud.points) <= REACH * size))


def sampled(nodes: Array, edges: NDArray[Any], step: float) -> Array:
    """Return points along the edges, about `step` [m] apart, each standing for the same length."""
    start, along = nodes[edges[:, 0]], nodes[edges[:, 1]] - nodes[edges[:, 0]]
    length = np.linalg.norm(along, axis=1)
    ends = np.cumsum(length)
    count = max(round(ends[-1] / step), 1)
    at = (np.arange(count) + 0.5) * ends[-1] / count
    edge = np.searchsorted(ends, at)
    share = 1 - (ends[edge] - at) / length[edge]
    return start[edge] + share[:, None] * along[edge]


def _largest_piece(answer: Answer) -> NDArray[Any]:
    """Return the edges of the piece with the most nodes."""
    label = answer.piece_of_node
    return answer.edges[label[answer.edges[:, 0]] == np.bincount(label).argmax()]
