"""The main stem's path through the skeleton (paper P10, P11). J nodes, S stem nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.geometry import Array
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.raw_tree import edge_lengths, longest_way, path_gain, sum_above
from anther.perception.stem._organs import BRANCH, PLANAR_BLADE, SPUR, stem_breadth

SHORTEST = 0.05
"""A shorter stem is no stem (share of the plant's size)."""
_TURN = 45.0  # degrees: a step that turns from the growth axis by more, or a fork that leans more, is not stem-like
_ROUND = 1.5  # sections up to this much broader than thick count as round: noise and one-sided views do that


def fork_at(skeleton: Skeleton, path: NDArray[Any], organ: NDArray[Any], at: int) -> int | None:
    """Return where a branch that leaves the stem at position `at` of the path forks it, None where none does.

    A branch forks the stem when it is as much a stem as what goes on: it rises as high, leaves included, and its axis,
    without them, is upright and as thick as the stem over the same nodes. The fork is where the two separate: a
    skeleton can have two lines side by side within one stem.
    """
    base = skeleton.nodes[path[at]]
    beyond = path[at + 1 :]
    if not len(beyond):
        return None
    rise = float(skeleton.nodes[beyond, 2].max() - base[2])
    forks = []
    share = 0.6  # as thick, as high: branches rise 0.85 times as high, petioles 0.48 (docs/reports/skeletons.md)
    for child in np.flatnonzero((skeleton.parent == path[at]) & (organ == BRANCH)):
        limb = _highest_path(skeleton, int(child))
        axis = limb[organ[limb] == BRANCH]
        lean = _angle(skeleton.nodes[axis[-1]] - base, np.array([0.0, 0.0, 1.0]))
        higher = skeleton.nodes[limb[-1], 2] - base[2] >= share * rise
        thick = np.median(skeleton.radius[beyond[: len(axis)]])
        thicker = np.median(skeleton.radius[axis]) >= share * thick
        if higher and thicker and lean < _TURN:
            forks.append(at + _side_by_side(skeleton, path[at:], axis))
    return min(forks, default=None)


def _side_by_side(skeleton: Skeleton, path: NDArray[Any], axis: NDArray[Any]) -> int:
    """Return up to which position of the path an axis that leaves its first node lies within the same stem."""
    away, nearest = map(np.asarray, KDTree(skeleton.nodes[path]).query(skeleton.nodes[axis]))
    within = away <= 2 * stem_breadth(skeleton, path)
    last = len(axis) if within.all() else int(np.argmin(within))
    return int(nearest[:last].max(initial=0)) if last > 3 else 0  # all limbs begin in the stem's own section


def _highest_path(skeleton: Skeleton, start: int) -> NDArray[Any]:
    """Return the nodes from `start` to the highest node of its subtree."""
    inside = np.zeros(len(skeleton.nodes), dtype=bool)
    inside[start] = True
    for j in range(start + 1, len(skeleton.nodes)):
        inside[j] = inside[skeleton.parent[j]]
    top = int(np.argmax(np.where(inside, skeleton.nodes[:, 2], -np.inf)))
    whole = skeleton.path_from_root(top)
    return whole[np.flatnonzero(whole == start)[0] :]


def main_axis(skeleton: Skeleton, size: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the nodes of the main stem, root first, and the path to a tip of which they are the first.

    A stem bears limbs: of all paths to a tip it is the one with the largest score (P10) up to the last limb before it
    stops being a stem (P11), of those alike the one with the largest in all. What lies beyond says little about it: it
    may be a leaf, of a neighbour perhaps.
    """
    score = sum_above(skeleton.parent, path_score(skeleton))
    way = longest_way(skeleton.parent, edge_lengths(skeleton.nodes, skeleton.parent))
    tips = np.flatnonzero(skeleton.children_count == 0)
    best, found = -np.inf, None
    for tip in tips[np.argsort(-score[tips], kind="stable")]:
        if score[tip] <= best:
            break
        path = skeleton.path_from_root(int(tip))
        end, limb = growth_end(skeleton, path, size, way)
        if score[path[limb]] > best:
            best, found = score[path[limb]], (path[:end], path)
    assert found is not None
    return found


def path_score(skeleton: Skeleton) -> Array:
    """Return what each edge adds to the path score (P10); less on a blade, by how much broader than thick it is."""
    gain = path_gain(skeleton.nodes, skeleton.parent, skeleton.radius)
    return gain * np.minimum(_ROUND * skeleton.radius / skeleton.breadth, 1)


def growth_end(skeleton: Skeleton, path: NDArray[Any], size: float, way: Array) -> tuple[int, int]:
    """Return how many nodes of the path belong to the stem (P11), and at which the last limb leaves it; 0: at none.

    `way` (J,) is the longest way out through each node of the tree [m], from its parent.

    A step is stem-like unless it turns from the growth axis (root to here), thins, or is a blade: planar, and broader
    than the stem below. The stem ends where the length that is stem-like, less twice the rest, is largest: a leaf that
    touches the stem does not end it, but the blade after which nothing stem-like comes does.

    A stem bears limbs. What goes on above the last one bears nothing, so nothing shows that it is a stem: if any of it
    is broader than the stem, or not stem-like, or 1.5 times as long as every internode, it is the youngest leaf,
    however round its petiole, its neck or its rolled blade. If it is longer than every limb, or if two limbs or more
    leave the path further on, limbs were missed: a leaf bears none, but a blade can have a second line.
    """
    nodes = skeleton.nodes[path]
    length = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    arc = np.concatenate([[0], np.cumsum(length)])
    window = 0.06  # over which a step is judged, of the plant's size
    straight, slim, solid = _stem_like(skeleton, path, arc, window * size)
    gain = np.cumsum(length * np.where(straight & (slim | solid), 1.0, -2.0))
    end = int(np.argmax(gain)) + 2
    limbs, further, longest = _limbs(skeleton, path, end, way)
    last, bare = int(limbs[-1]), arc[end - 1] - arc[limbs[-1]]
    reliable = last > 0 and arc[last] >= SHORTEST * size and bare <= longest and further < 2
    stem_like = (straight & slim)[last:].all() and bare <= 1.5 * np.diff(arc[limbs]).max(initial=0)
    return (last + 1 if reliable and not stem_like else end), last


def _limbs(skeleton: Skeleton, path: NDArray[Any], end: int, way: Array) -> tuple[NDArray[np.int64], int, float]:
    """Return 0 and which of the first `end` positions of the path a limb leaves; how many leave it further on; and the
    longest limb of those first ones [m].

    Leaflets are no limbs: the way up the youngest compound leaf bears them too.
    """
    side = np.isin(skeleton.parent, path[1:])
    side[path] = False
    side &= way > SPUR * stem_breadth(skeleton, path[:end])
    at, way = np.searchsorted(path, skeleton.parent[side]), way[side]  # a child's number is larger than its parent's
    longest = float(way[at < end].max(initial=0))
    leaflet = 0.2  # of the longest limb: larger shares shorten simulated stems
    limbs = at[way > leaflet * longest]
    return np.union1d(0, limbs[limbs < end]), int(np.sum(limbs >= end)), longest


def _stem_like(
    skeleton: Skeleton, path: NDArray[Any], arc: Array, window: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return for each step of the path, over the window ahead of it, (S - 1,) each: whether it keeps the growth axis
    and is not thin; whether it is not broader than the stem below; whether its surroundings are not a plane."""
    nodes, radius = skeleton.nodes[path], skeleton.radius[path]
    width = skeleton.breadth[path]
    flatness = np.ones(len(path)) if skeleton.flatness is None else skeleton.flatness[path]
    ahead = np.minimum(np.searchsorted(arc, arc + window), len(path) - 1)
    coming = [slice(i, max(ahead[i], i + 1) + 1) for i in range(len(path) - 1)]
    breadth = np.array([np.median(width[there]) for there in coming])
    narrowest = np.minimum.accumulate(breadth)
    straight, slim, solid = np.ones((3, len(path) - 1), dtype=bool)
    broadest = 1.5  # times the narrowest below: a stem does not broaden upward, a leaf does after its neck
    thinnest = 0.35  # of the median radius so far
    for i in np.flatnonzero(arc[:-1] >= window):
        turned = _angle(nodes[i] - nodes[0], nodes[coming[i]][-1] - nodes[i]) > _TURN
        thin = np.median(radius[coming[i]]) < thinnest * np.median(radius[: i + 1])
        straight[i] = not (turned or thin)
        slim[i] = breadth[i] <= max(broadest * narrowest[i], np.median(width[: i + 1]))
        round_ = breadth[i] <= _ROUND * np.median(radius[coming[i]])  # the wall of a thick trunk is a plane, and round
        solid[i] = round_ or np.median(flatness[coming[i]]) < PLANAR_BLADE
    return straight, slim, solid


def _angle(one: Array, other: Array) -> float:
    """Return the angle between two vectors [degrees]."""
    cosine = one @ other / max(float(np.linalg.norm(one) * np.linalg.norm(other)), 1e-12)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
