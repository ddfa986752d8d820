"""A tree of shortest paths that prefer the middle of stems, from the farthest tips to the root.

After TEASAR (Sato et al. 2000, "TEASAR: tree-structure extraction algorithm for accurate and robust skeletons"): the
farthest voxel not yet covered is joined to the tree by its shortest path, until all is covered. Here a way across a
blade costs more than along a stem, so that where blades touch branches the paths still run up the branch; and a path
covers the level sets it goes through (Xu et al. 2007), so that a blade has one line. Last, lines on blades are moved to
the middle of the blade's width. N voxels, J nodes on the tree, M of them on one chain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import gaussian_filter1d
from scipy.sparse.csgraph import dijkstra

from anther.core.compiling import compiled
from anther.core.geometry import Array
from anther.perception.skeleton.raw_tree import RawTree, chains, with_extents
from anther.perception.skeleton.voxel_solid import Voxels, components, nearest


@dataclass(frozen=True, slots=True, eq=False)
class LevelSets:
    """Connected voxels at the same distance from the root: a ring of a stem, a strip across a blade.

    Attributes:
        way: (N,) length of the shortest way from the root through the plant [m].
        number: (N,) number of the level set that holds each voxel.
    """

    way: Array
    number: NDArray[Any]


def level_sets(voxels: Voxels, source: int) -> LevelSets:
    """Return the level sets of the way from the voxel `source`, four voxels deep: deeper ones merge short petioles."""
    way, _ = shortest_paths(voxels.points, voxels.edges, np.ones(len(voxels.points)), source)
    level = (way // (4 * voxels.voxel)).astype(np.int64)
    within = voxels.edges[level[voxels.edges[:, 0]] == level[voxels.edges[:, 1]]]
    return LevelSets(way, components(len(way), within))


def geodesic_tree(voxels: Voxels, source: int, levels: LevelSets, shortest: float) -> RawTree:
    """Return the tree of shortest paths to the voxel `source`, whose level sets are given.

    No path but the first has less than `shortest` [m] of its own.
    """
    at_surface = np.minimum(voxels.off_middle / 0.4, 1) ** 2  # at the edge of a half plane `off_middle` is 0.42
    detour = 3.0  # times its length: a way across a blade or along a surface, against one through a stem's middle
    cost = 1 + detour * (voxels.flatness + at_surface)
    distance, before = shortest_paths(voxels.points, voxels.edges, cost, source)
    chosen = covering_paths(distance, before, levels, shortest)
    rank = np.full(len(voxels.points), -1)
    rank[chosen] = np.arange(len(chosen))
    parent = np.where(before[chosen] >= 0, rank[before[chosen]], -1)
    return with_extents(voxels.points[chosen], parent, voxels)


def shortest_paths(points: Array, edges: NDArray[Any], cost: Array, source: int) -> tuple[Array, NDArray[Any]]:
    """Return (N,) cost of the cheapest way from the source [m], and (N,) the voxel before each on it, -1 at the source.

    `cost` (N,) >= 1 is how much longer a way seems at each voxel; the graph is connected.
    """
    first, second = edges.T.copy()
    x, y, z = (column[first] - column[second] for column in points.T.copy())
    length = np.sqrt(x * x + y * y + z * z) * ((cost[first] + cost[second]) / 2)
    graph = sparse.coo_matrix((length, (first, second)), (len(points), len(points))).tocsr()
    distance, before = dijkstra(graph, directed=False, indices=source, return_predecessors=True)
    return distance, np.where(before < 0, -1, before)


def covering_paths(distance: Array, before: NDArray[Any], levels: LevelSets, shortest: float) -> NDArray[Any]:
    """Return the voxels (J,) on the paths that go through all level sets, nearest the source first.

    Paths with less than `shortest` [m] of their own, in level sets that no path goes through, are left out.
    """
    tips = np.argsort(-distance, kind="stable")
    covered, on_tree = np.zeros(levels.number.max() + 1, np.bool_), np.zeros(len(levels.number), np.bool_)
    _walk(tips, before, levels.number, levels.way, shortest, covered, on_tree)
    chosen = np.flatnonzero(on_tree)
    return chosen[np.lexsort((chosen, distance[chosen]))]


@compiled
def _walk(tips, before, number, way, shortest, covered, on_tree):
    """Fill (N,) which voxels are on a path; `covered`, all False, are the level sets that one goes through."""
    for tip in tips:
        n = tip
        while n >= 0 and not covered[number[n]]:
            n = before[n]
        if n == tip or (n >= 0 and way[tip] - way[n] < shortest):
            continue
        n = tip
        while n >= 0 and not on_tree[n]:
            on_tree[n] = covered[number[n]] = True
            n = before[n]


def centre_on_blades(tree: RawTree, gain: Array, voxels: Voxels, levels: LevelSets) -> RawTree:
    """Return the tree with its nodes, that are voxels, on blades in the middle of the blade's width.

    A chain moves to the centroids of the level sets it goes through, each cut to what is nearer to this chain than to
    another, so that blades that touch keep their own lines. Nodes with a flatness of 0.2 to 0.5 move part of the way:
    a stem scanned from one side has its axis elsewhere.
    """
    every = chains(tree.parent, gain)
    home = np.zeros(len(tree.nodes), dtype=np.int64)
    for number, chain in enumerate(every[1:], 1):
        home[chain[1:]] = number
    away, node = nearest(voxels.points, tree.nodes)
    home, at = home[node], np.zeros(len(tree.nodes), dtype=np.int64)
    at[node[away == 0]] = np.flatnonzero(away == 0)
    order = np.lexsort((levels.way, home))
    first = np.searchsorted(home[order], np.arange(len(every) + 1))
    weight = np.clip((tree.flatness - 0.2) / 0.3, 0, 1)[:, None]
    nodes = tree.nodes.copy()
    for number, chain in enumerate(every):
        mine, own = chain[min(number, 1) :], order[first[number] : first[number + 1]]
        own = own[np.isin(levels.number[own], levels.number[at[mine]])]
        if len(own):
            middle = _middle(voxels.points[own], levels.way[own], levels.way[at[mine]], voxels.voxel)
            nodes[mine] += weight[mine] * (middle - nodes[mine])
    return with_extents(nodes, tree.parent, voxels)


def _middle(points: Array, way: Array, at: Array, voxel: float) -> Array:
    """Return the middle (M, 3) of points, sorted by way, about `at` (M,): the broader they spread, the deeper."""
    thinnest = np.full(len(at), 2 * voxel)
    _, spread = _mean(points, way, at, thinnest)
    return _mean(points, way, at, np.maximum(0.5 * gaussian_filter1d(spread, 4, mode="nearest"), thinnest))[0]


def _mean(points: Array, way: Array, at: Array, half: Array) -> tuple[Array, Array]:
    """Return the mean (M, 3) of the points whose way is within `half` (M,) of `at`, and their spread about it (M,)."""
    points, centre = points - points[0], points[0]
    total = np.cumsum(np.column_stack([points, np.sum(points**2, axis=1)]), axis=0)
    total = np.concatenate([np.zeros((1, 4)), total])
    low = np.minimum(np.searchsorted(way, at - half), len(way) - 1)
    high = np.maximum(np.searchsorted(way, at + half, side="right"), low + 1)
    mean = (total[high] - total[low]) / (high - low)[:, None]
    spread = np.sqrt(np.maximum(mean[:, 3] - np.sum(mean[:, :3] ** 2, axis=1), 0))
    return centre + mean[:, :3], spread
