"""Flowers: where they are and which skeleton node carries each. F flowers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.choices import Crop
from anther.core.geometry import Array, interpolate, transform_points
from anther.core.records import Range, Shape, Stored
from anther.perception.cloud import Cloud
from anther.perception.hanging import StringLine
from anther.perception.masks import FLOWER
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.raw_tree import edge_lengths, longest_way
from anther.perception.skeleton.voxel_solid import components
from anther.perception.stem import BRANCH, LEAF, PEDICEL, TRUSS, Stem

APART = 0.012
"""Least distance between the centres of two flowers [m]: about the width of a corolla (facts: pollination 2)."""


REACH = 0.007
"""So far off the main stem's surface a flower reaches at least [m], nine in ten of its points: a corolla is 10 mm wide
(facts: pollination 2). Clips and strings on a stem reached 3 to 7 mm, flowers beside it 8 to 13 (simulated)."""


@dataclass(frozen=True, slots=True, eq=False)
class Flowers(Stored):
    """The detected flowers; there may be none (F = 0).

    Attributes:
        positions: (F, 3) flower centres, world frame [m].
        attachment: (F,) skeleton node each flower's pedicel hangs on.
        notes: what the stage wants the user to know.
    """

    KIND, SCHEMA, CALLED = "flowers", 2, "flower"
    positions: Annotated[Array, Shape("F", 3), Range(unit="m")]
    attachment: Annotated[NDArray[np.int64], Shape("F")]
    notes: tuple[str, ...] = ()

    def moved(self, T: Array) -> Flowers:
        """Return them moved by T (4, 4)."""
        return replace(self, positions=transform_points(T, self.positions))


def find_flowers(
    cloud: Cloud,
    skeleton: Skeleton,
    stem: Stem,
    *,
    centres: Array | None = None,
    string: StringLine | None = None,
    crop: Crop | None = None,
) -> Flowers:
    """Return the flowers among the points labelled so, each with the skeleton node that carries it.

    No flower is a valid result, with a note.

    Args:
        cloud: points with labels, world frame.
        skeleton: the tree the flowers hang on.
        stem: its main stem and organs.
        centres: what `flower_centres` gave for this cloud, if that was asked before.
        string: on which the stem hangs, if it does: flowers nearer to another one are of the stem that hangs there.
        crop: where it is known, its petals' colour tells flowers from clips and string.
    """
    centres = flower_centres(cloud) if centres is None else centres
    own, notes = _own_points(centres, cloud), list[str]()
    free = (_reach(own, cloud, skeleton, stem) > REACH) & _has_petals(own, cloud, crop)
    if not free.all():
        notes.append(f"{np.count_nonzero(~free)} flower-like clusters were left out: a clip or a string")
    centres = centres[free]
    if string is not None:
        away = np.linalg.norm(centres[:, None] - skeleton.nodes[stem.node_ids], axis=2).min(axis=1, initial=np.inf)
        others = string.is_of_another(centres, away)
        if others.any():
            notes.append(f"{np.count_nonzero(others)} flowers nearer to another string than to the stem were left out")
        centres = centres[~others]
    distance, carrier = _carriers(centres, skeleton, stem)
    near = distance <= 0.08  # [m]: farther away, its carrier was not seen
    if not near.any():
        notes.append(f"no flowers: {np.count_nonzero(cloud.labels == FLOWER)} points are labelled as flower")
    if not near.all():
        notes.append(f"{np.count_nonzero(~near)} flower-like clusters too far from the plant were left out")
    return Flowers(centres[near], carrier[near], tuple(notes))


def flower_centres(cloud: Cloud) -> Array:
    """Return flower centres (F, 3) [m], attached or not: `find_stem` recognizes trusses by them.

    Clusters of points labelled flower, 5 mm apart, that are at most 33 mm long, as flowers are: longer ones are split,
    pieces joined, specks dropped.
    """
    points = cloud.points[cloud.labels == FLOWER]
    if not len(points):
        return np.zeros((0, 3))
    edge = 0.0015  # m of the cubes that hold one point each, once thinned: the cloud's own spacing
    _, first = np.unique(np.rint(points / edge).astype(np.int64), axis=0, return_index=True)
    points = points[first]
    pieces = [part for group in _groups(points, 0.005) for part in _split(points[group])]
    middles = np.array([piece.mean(axis=0) for piece in pieces])
    joined = [np.concatenate([pieces[k] for k in group]) for group in _groups(middles, APART)]
    real = [flower.mean(axis=0) for flower in joined if _is_flower(flower, edge)]
    return np.array(real).reshape(-1, 3)


def _is_flower(points: Array, edge: float) -> bool:
    """Return whether points (N, 3), one a cube, are no speck, 3 mm or 8 points, and no scatter of specks on a leaf."""
    extent = _extent(points)
    covered = len(points) * edge**2 / (np.pi / 4 * max(extent, edge) ** 2)
    return len(points) >= 8 and extent >= 0.003 and covered >= 0.45


def _groups(points: Array, gap: float) -> list[NDArray[Any]]:
    """Return the indices of each set of points linked by steps not longer than `gap`."""
    pairs = KDTree(points).query_pairs(gap, output_type="ndarray")
    label = components(len(points), pairs)
    return [np.flatnonzero(label == k) for k in range(int(label.max()) + 1)]


def _split(cluster: Array) -> list[Array]:
    """Return a cluster too large for a flower as several, by mean shift with a flat kernel."""
    if _extent(cluster) <= 0.033:
        return [cluster]
    tree = KDTree(cluster)
    peaks, reach = cluster[:: -(-len(cluster) // 400)].copy(), 2 / 3 * APART
    moving = np.arange(len(peaks))
    for _ in range(10):
        shifted = _means_within(tree, peaks[moving], reach)
        moved = np.any(shifted != peaks[moving], axis=1)
        peaks[moving] = shifted
        moving = moving[moved]
        if not len(moving):
            break
    weight = tree.query_ball_point(peaks, reach, return_length=True)
    modes = _heaviest(peaks[np.argsort(weight)[::-1]], APART)
    _, owner = KDTree(modes).query(cluster)
    return [cluster[owner == k] for k in range(len(modes)) if np.any(owner == k)]


def _means_within(tree: KDTree, centres: Array, reach: float) -> Array:
    """Return (F, 3) the mean of the tree's points within reach of each centre."""
    near = tree.query_ball_point(centres, reach)
    count = np.array([len(group) for group in near])
    start = np.cumsum(count) - count
    return np.add.reduceat(tree.data[np.concatenate(near)], start) / count[:, None]


def _heaviest(peaks: Array, apart: float) -> Array:
    """Return the first peaks that are at least `apart` from those before them."""
    kept = []
    while len(peaks):
        kept.append(peaks[0])
        peaks = peaks[np.linalg.norm(peaks - peaks[0], axis=1) > apart]
    return np.array(kept)


def _extent(points: Array) -> float:
    """Return the length of a cluster along its longest axis [m]."""
    centred = points - points.mean(axis=0)
    return float(np.ptp(centred @ np.linalg.svd(centred, full_matrices=False)[2][0]))


def _carriers(centres: Array, skeleton: Skeleton, stem: Stem) -> tuple[Array, NDArray[Any]]:
    """Return (distance, node) of the most plausible carrier of each flower.

    A node on a leaf counts as four times farther away: flowers hang on trusses and stems.
    """
    if not len(centres):
        return np.zeros(0), np.zeros(0, dtype=np.int64)
    away = np.linalg.norm(centres[:, None] - skeleton.nodes, axis=2)
    carrier = np.argmin(away * np.where(stem.organ == LEAF, 4.0, 1.0), axis=1)
    carrier = _pedicel_bases(skeleton, stem)[carrier]
    return away[np.arange(len(centres)), carrier], carrier


def _own_points(centres: Array, cloud: Cloud) -> list[NDArray[np.int64]]:
    """Return for each flower (F, 3) which of the cloud's points it is made of."""
    petals = np.flatnonzero(cloud.labels == FLOWER)
    if not len(centres) or not len(petals):
        return [petals[:0]] * len(centres)
    near = KDTree(cloud.points[petals]).query_ball_point(centres, APART)
    return [petals[np.asarray(some, dtype=np.int64)] for some in near]


def _reach(own: list[NDArray[np.int64]], cloud: Cloud, skeleton: Skeleton, stem: Stem) -> Array:
    """Return (F,) how far the points that are each flower's `own` reach off the stem's surface [m], nine in ten."""
    at = np.arange(0, len(stem.node_ids) - 1 + 1e-9, 0.1)  # tenths of an edge
    ball = np.column_stack([skeleton.nodes[stem.node_ids], skeleton.radius[stem.node_ids]])
    ball = interpolate(at, np.arange(len(ball)), ball)
    line = KDTree(ball[:, :3])

    def reach(points: Array) -> float:
        away, nearest = line.query(points)
        return float(np.quantile(away - ball[nearest, 3], 0.9))

    return np.array([reach(cloud.points[some]) if len(some) else np.inf for some in own])


def _has_petals(own: list[NDArray[np.int64]], cloud: Cloud, crop: Crop | None) -> NDArray[np.bool_]:
    """Return (F,) which flowers are of the crop's colour: a tomato's are yellow, which no clip or string is.

    Where none is, the light may be to blame, and all may be flowers. `own` are the points of each.
    """
    if crop != "tomato" or cloud.colors is None:
        return np.ones(len(own), dtype=bool)
    rgb = np.array([cloud.colors[some].mean(axis=0) if len(some) else np.full(3, np.nan) for some in own])
    rgb = rgb.reshape(-1, 3)
    least = 0.35  # by which blue is less than red and green: petals 0.43 to 0.9, clips up to 0.25 (four simulated rows)
    yellow = rgb[:, 2] < (1 - least) * rgb[:, :2].mean(axis=1)
    return yellow | ~yellow.any()


def _pedicel_bases(skeleton: Skeleton, stem: Stem) -> NDArray[Any]:
    """Return (J,) the node itself, but for a truss no longer than a pedicel the node it leaves: it is the pedicel."""
    base, foot = np.arange(len(stem.organ)), np.arange(len(stem.organ))
    way = longest_way(skeleton.parent, edge_lengths(skeleton.nodes, skeleton.parent))
    longest = 0.025  # m, a pedicel with its flower: 9 to 22 mm (facts: pollination 2)
    for j in np.flatnonzero(stem.organ == TRUSS):
        p = skeleton.parent[j]
        foot[j] = foot[p] if stem.organ[p] == TRUSS else j
        if way[foot[j]] <= longest:
            base[j] = skeleton.parent[foot[j]]
    return base


def assume_flowers(skeleton: Skeleton, stem: Stem) -> Flowers:
    """Return assumed flowers where occluded ones may be: at the ends of all trusses, or else of the branches, or of the
    stem.

    A plant whose flowers hide behind leaves is shaken for these: each has a pedicel's limits. What they would do is an
    estimate for unseen flowers, and a note says so.
    """
    ends = np.setdiff1d(np.arange(len(skeleton.nodes)), skeleton.parent)
    for organ in (TRUSS, BRANCH):
        tips = ends[stem.organ[ends] == organ]
        if len(tips):
            break
    else:
        tips = stem.node_ids[-1:]
    out = skeleton.nodes[tips] - skeleton.nodes[skeleton.parent[tips]]
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
    note = f"no flower was detected: the shake is chosen for flowers assumed at {len(tips)} of its ends"
    return Flowers(skeleton.nodes[tips] + PEDICEL * out, tips, (note,))
