"""A tree of shortest paths that prefer the middle of stems, from the farthest tips to the root.

After TEASAR (Sato et al. 2000, "TEASAR: tree-structure extraction algorithm for accurate and robust skeletons"): the
farthest voxel not yet covered is joined to the tree by its shortest path, which covers what is around it, until nothing
is left. Here a way across a blade costs more than along a stem, so that where blades touch branches the paths still run
up the branch; and a path on a blade covers a wide strip, so that a blade has one line. N voxels, J on the tree.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from anther.checks import check_parameters, check_range
from anther.geometry import Array
from anther.skeleton.nearby import blocks
from anther.skeleton.raw_tree import RawTree, with_extents
from anther.skeleton.voxel_solid import Voxels

_AT_THE_EDGE = 0.4
"""A voxel this far off the middle of its surroundings [of their reach] is at the surface (a half plane has 0.42)."""


@dataclass(frozen=True, slots=True)
class Params:
    """What a path prefers and covers; measured on simulated captures and labelled seedlings.

    Attributes:
        flat: how many times its length a way across a blade costs more.
        edge: how many times its length a way along a surface costs more than through the middle.
        cover: how far a path along a stem covers its surroundings [voxels].
        cover_flat: how much farther a path on a blade does [voxels].
    """

    flat: float = 3.0
    edge: float = 3.0
    cover: float = 4.0
    cover_flat: float = 10.0

    def __post_init__(self) -> None:
        check_parameters(self)
        check_range("cover", self.cover, 0.5, 100, "voxels")
        check_range("cover_flat", self.cover_flat, 0, 100, "voxels")


def geodesic_tree(voxels: Voxels, source: int, params: Params) -> RawTree:
    """Return the tree of shortest paths to the voxel `source`."""
    cost = 1 + params.flat * voxels.flatness + params.edge * np.minimum(voxels.off_middle / _AT_THE_EDGE, 1) ** 2
    distance, before = shortest_paths(voxels.points, voxels.edges, cost, source)
    cover = voxels.voxel * (params.cover + params.cover_flat * np.clip((voxels.flatness - 0.5) / 0.3, 0, 1))
    import os
    if os.environ.get("LS"):
        D = float(os.environ["LS"])
        way, _ = shortest_paths(voxels.points, voxels.edges, np.ones(len(cost)), source)
        level = (way // (D * voxels.voxel)).astype(np.int64)
        same = voxels.edges[level[voxels.edges[:, 0]] == level[voxels.edges[:, 1]]]
        from anther.skeleton.voxel_solid import components
        label = components(len(way), same)
        tips = np.argsort(-distance, kind="stable")
        on = _claimed(tips, before, label, way, int(label.max()) + 1, float(os.environ.get("LEAST", 0)) * voxels.voxel)
        chosen = np.flatnonzero(on)
        chosen = chosen[np.lexsort((chosen, distance[chosen]))]
    else:
        chosen = covering_paths(voxels.points, distance, before, cover)
    rank = np.full(len(voxels.points), -1)
    rank[chosen] = np.arange(len(chosen))
    parent = np.where(before[chosen] >= 0, rank[before[chosen]], -1)
    return with_extents(voxels.points[chosen], parent, voxels)


def shortest_paths(points: Array, edges: NDArray[Any], cost: Array, source: int) -> tuple[Array, NDArray[Any]]:
    """Return (N,) cost of the cheapest way from the source [m], and (N,) the voxel before each on it, -1 at the source.

    Args:
        points: (N, 3) voxel centres [m].
        edges: (E, 2) links; the graph is connected.
        cost: (N,) >= 1, how much longer a way seems at each voxel.
        source: where all paths begin.
    """
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) * cost[edges].mean(axis=1)
    graph = sparse.coo_matrix((length, (edges[:, 0], edges[:, 1])), (len(points), len(points))).tocsr()
    distance, before = dijkstra(graph, directed=False, indices=source, return_predecessors=True)
    return distance, np.where(before < 0, -1, before)


def covering_paths(points: Array, distance: Array, before: NDArray[Any], cover: Array) -> NDArray[Any]:
    """Return the voxels (J,) on the paths that cover all voxels, nearest the source first.

    Args:
        points: (N, 3) voxel centres [m].
        distance, before: of `shortest_paths`.
        cover: (N,) how far a path covers the surroundings of a voxel [m].
    """
    edge = float(cover.min())
    at = blocks(points, edge)
    rank = np.empty(len(points), dtype=np.int64)
    rank[at.order] = np.arange(len(points))
    tips = rank[np.argsort(-distance, kind="stable")]
    before = np.where(before >= 0, rank[before], -1)[at.order]
    on_tree = _walked(points[at.order], tips, before, cover[at.order], edge, at.key, at.held, at.start, at.stride)
    chosen = at.order[on_tree]
    return chosen[np.lexsort((chosen, distance[chosen]))]


@numba.njit(cache=True, nogil=True)
def _walked(points, tips, before, cover, edge, key, held, start, stride):
    """Return (N,) which voxels are on a path; points are sorted as in `nearby.Blocks` of side `edge`.

    A run of blocks may go round a corner of the grid: what it then holds is too far away to be covered.
    """
    waiting, on_tree = np.ones(len(points), np.bool_), np.zeros(len(points), np.bool_)
    for tip in tips:
        n = tip if waiting[tip] else -1
        while n >= 0 and not on_tree[n]:
            on_tree[n] = True
            reach = int(np.ceil(cover[n] / edge))
            for a in range(-reach, reach + 1):
                for b in range(-reach, reach + 1):
                    first = key[n] + a * stride[0] + b * stride[1] - reach
                    low, high = np.searchsorted(held, first), np.searchsorted(held, first + 2 * reach + 1)
                    for m in range(start[low], start[high]):
                        if waiting[m]:
                            x, y, z = points[m] - points[n]
                            waiting[m] = x * x + y * y + z * z > cover[n] ** 2
            n = before[n]
    return on_tree


@numba.njit(cache=True)
def _claimed(tips, before, label, way, count, least):
    claimed, on_tree = np.zeros(count, np.bool_), np.zeros(len(label), np.bool_)
    for tip in tips:
        if claimed[label[tip]]:
            continue
        n = tip
        while n >= 0 and not claimed[label[n]]:
            n = before[n]
        if n >= 0 and way[tip] - way[n] < least:
            continue
        n = tip
        while n >= 0 and not on_tree[n]:
            on_tree[n] = True
            claimed[label[n]] = True
            n = before[n]
    return on_tree
