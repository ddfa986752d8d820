"""A rooted tree on its way to a skeleton, and the operations on it. J nodes; parent[0] = -1, parent[j] < j."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order
from scipy.spatial import KDTree

from anther.geometry import Array
from anther.skeleton._nearby import nearest
from anther.skeleton.voxel_solid import Voxels

Parents = NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class RawTree:
    """A rooted tree before it is a `Skeleton`.

    Attributes:
        nodes: (J, 3) [m].
        parent: (J,) parent[0] = -1, parent[j] < j.
        thickness: (J,) inscribed radius of the solid [m]: a stem's radius, a blade's half thickness.
        width: (J,) lateral half extent [m]: a stem's radius, a blade's half width.
        flatness: (J,) planarity of what is around: 0 on a stem, 1 on a blade.
    """

    nodes: Array
    parent: Parents
    thickness: Array
    width: Array
    flatness: Array

    def taking(self, parent: Parents, order: NDArray[Any]) -> RawTree:
        """Return the nodes in `order` under new parents."""
        return RawTree(self.nodes[order], parent, self.thickness[order], self.width[order], self.flatness[order])


def with_extents(nodes: Array, parent: Parents, voxels: Voxels) -> RawTree:
    """Return the tree with thickness, width and flatness of the voxels that are nearest to each node."""
    distance, owner = nearest(voxels.points, nodes)
    count = np.maximum(np.bincount(owner, minlength=len(nodes)), 1)
    thickness = np.full(len(nodes), voxels.voxel)
    np.maximum.at(thickness, owner, voxels.thickness)
    spread = np.sqrt(np.bincount(owner, weights=distance**2, minlength=len(nodes)) / count)
    flatness = np.bincount(owner, weights=voxels.flatness, minlength=len(nodes)) / count
    return RawTree(nodes, parent, thickness, np.maximum(spread, thickness), along_tree(parent, flatness))


def along_tree(parent: Parents, values: Array, rounds: int = 4) -> Array:
    """Return the values (J,) averaged with those of the neighbours on the tree, so many times."""
    child, above = np.arange(1, len(parent)), parent[1:]
    neighbours = 1 + np.bincount(above, minlength=len(parent)) + (parent >= 0)
    for _ in range(rounds):
        total = values + np.bincount(above, weights=values[child], minlength=len(parent))
        total[1:] += values[above]
        values = total / neighbours
    return values


def edge_lengths(nodes: Array, parent: Parents) -> Array:
    """Return (J,) distance of each node to its parent [m]; 0 at the root."""
    length = np.zeros(len(nodes))
    length[1:] = np.linalg.norm(nodes[1:] - nodes[parent[1:]], axis=1)
    return length


ALPHA, V_BIAS = 2.0, 1.0
"""Exponent of the mean radius, and weight of verticality, in the path score S (paper P10)."""


def path_gain(nodes: Array, parent: Parents, radius: Array) -> Array:
    """Return (J,) what the edge above each node adds to the path score S (paper P10).

    S = sum over edges of L_e * r_e^ALPHA * (1 + V_BIAS * dz_e / L_e), with r_e relative to the thickest node, so that
    S does not depend on units. The paper has |dz_e|; there a drooping leaf counts as upright, so here falling edges
    lose what rising ones gain.
    """
    length = edge_lengths(nodes, parent)
    above = np.maximum(parent, 0)
    mean_radius = (radius + radius[above]) / 2 / radius.max()
    rise = nodes[:, 2] - nodes[above, 2]
    return length * mean_radius**ALPHA * np.maximum(1 + V_BIAS * rise / np.maximum(length, 1e-12), 0)


def subtree_best(parent: Parents, gain: Array) -> Array:
    """Return (J,) the largest sum of `gain` over the edges of a path from each node down to a tip (>= 0)."""
    best = [0.0] * len(parent)
    parents, gains = parent.tolist(), gain.tolist()
    for node in range(len(parents) - 1, 0, -1):
        best[parents[node]] = max(best[parents[node]], best[node] + gains[node])
    return np.array(best)


def chains(parent: Parents, gain: Array) -> list[NDArray[Any]]:
    """Split a tree into chains: each goes on into the child with the largest remaining path gain.

    Every chain but the first starts with the node of an earlier chain that it leaves.
    """
    through = subtree_best(parent, gain) + gain
    heir = np.full(len(parent), -1)
    for node in range(1, len(parent)):
        p = parent[node]
        if heir[p] < 0 or through[node] > through[heir[p]]:
            heir[p] = node
    starts = [0] + [node for node in range(1, len(parent)) if heir[parent[node]] != node]
    return [_follow(start, parent, heir) for start in starts]


def rerooted(parent: Parents, root: int) -> tuple[Parents, NDArray[Any]]:
    """Return (parent, order): the same tree rooted at `root`, and the old number of each new node."""
    return rooted(np.stack([parent[1:], np.arange(1, len(parent))], axis=1), len(parent), root)


def rooted(links: NDArray[Any], count: int, root: int) -> tuple[Parents, NDArray[Any]]:
    """Return (parent, order) of the tree with these (T, 2) links: node `order[j]` becomes node j."""
    graph = sparse.coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), (count, count)).tocsr()
    order, before = breadth_first_order(graph, root, directed=False)
    rank = np.full(count, -1)
    rank[order] = np.arange(len(order))
    parent = np.full(len(order), -1)
    parent[1:] = rank[before[order[1:]]]
    return parent, order


def subset(parent: Parents, keep: NDArray[np.bool_]) -> tuple[Parents, NDArray[Any]]:
    """Return (parent, order) of the kept nodes; what is kept must be closed towards the root."""
    order = np.flatnonzero(keep)
    rank = np.cumsum(keep) - 1
    return np.where(parent[order] >= 0, rank[parent[order]], -1), order


def without_spurs(tree: RawTree, *, per_width: float, at_least: float) -> RawTree:
    """Return the tree without side branches shorter than the organ they leave is wide.

    Args:
        tree: the tree.
        per_width: a side branch goes when it is not longer than this times the lateral half extent at its fork.
        at_least: and always when it is not longer than this [m].
    """
    length = edge_lengths(tree.nodes, tree.parent)
    keep = np.ones(len(tree.parent), dtype=bool)
    for chain in chains(tree.parent, length)[1:]:
        if length[chain[1:]].sum() <= max(per_width * tree.width[chain[0]], at_least):
            keep[chain[1:]] = False
    return _kept(tree, keep)


def without_veins(tree: RawTree, wood: float) -> RawTree:
    """Return the tree without side branches that begin on a blade and hold less than `wood` [m] of stem or petiole."""
    length = edge_lengths(tree.nodes, tree.parent)
    woody = length * np.clip((_FLATTEST - tree.flatness) / 0.2, 0, 1)
    keep = np.ones(len(tree.parent), dtype=bool)
    for chain in chains(tree.parent, woody + 0.01 * length)[1:]:
        if np.mean(tree.flatness[chain[:_BEGINNING]]) > _BLADE and woody[chain[1:]].sum() < wood:
            keep[chain[1:]] = False
    return _kept(tree, keep)


def parted(tree: RawTree, gain: Array) -> RawTree:
    """Return the tree with each side branch leaving where it comes out of what carries it.

    Shortest paths run side by side within a stem before they part, or never part.
    """
    parent, keep = tree.parent.copy(), np.ones(len(tree.parent), dtype=bool)
    same_as, home = np.arange(len(parent)), np.zeros(len(parent), dtype=np.int64)
    first, *others = chains(tree.parent, gain)
    hosts = [first]
    for chain in others:
        host = hosts[home[same_as[chain[0]]]]
        distance, nearest = map(np.asarray, KDTree(tree.nodes[host]).query(tree.nodes[chain[1:]]))
        within = distance <= _OUT * tree.thickness[host[nearest]]
        inside = len(within) if within.all() else int(np.argmin(within))
        keep[chain[1 : 1 + inside]] = False
        same_as[chain[1 : 1 + inside]] = host[nearest[:inside]]
        rest = chain[1 + inside :]
        if len(rest):
            parent[rest[0]] = same_as[chain[inside]]
            home[rest] = len(hosts)
            hosts.append(rest)
    links = np.stack([parent, np.arange(len(parent))], axis=1)[keep & (parent >= 0)]
    return tree.taking(*rooted(links, len(parent), 0))


_OUT = 1.3
"""A branch is out of its carrier where it is farther from the middle than this times the inscribed radius."""

_FLATTEST = 0.75
_BLADE, _BEGINNING = 0.65, 4
"""A branch begins on a blade when the mean flatness of so many first nodes exceeds this."""


def _kept(tree: RawTree, keep: NDArray[np.bool_]) -> RawTree:
    """Return the kept nodes whose ancestors are all kept."""
    for node in range(1, len(keep)):
        keep[node] &= keep[tree.parent[node]]
    return tree.taking(*subset(tree.parent, keep))


def _follow(start: int, parent: Parents, heir: NDArray[Any]) -> NDArray[Any]:
    path = [] if start == 0 else [int(parent[start])]
    node = start
    while node >= 0:
        path.append(node)
        node = int(heir[node])
    return np.array(path)
