"""A rooted tree on its way to a skeleton, and the operations on it. J nodes; parent[0] = -1, parent[j] < j."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order
from scipy.spatial import KDTree

from anther.core.geometry import Array
from anther.perception.skeleton.voxel_solid import Voxels, nearest

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
    """Return the values (J,) averaged with those of the neighbours on the tree, `rounds` times."""
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


BLADE = 0.65
"""Flatness beyond which a line runs in a blade: midribs have 0.85 in the median, petioles 0.4 (simulated plants)."""


def path_gain(nodes: Array, parent: Parents, radius: Array) -> Array:
    """Return (J,) what the edge above each node adds to the path score S (paper P10).

    S = sum over edges of L_e * r_e^2 * (1 + dz_e / L_e), with r_e relative to the thickest node, so that S does not
    depend on units. The paper has |dz_e|; there a drooping leaf counts as upright, so here falling edges
    lose what rising ones gain.
    """
    length = edge_lengths(nodes, parent)
    above = np.maximum(parent, 0)
    mean_radius = (radius + radius[above]) / 2 / radius.max()
    rise = nodes[:, 2] - nodes[above, 2]
    return length * mean_radius**2.0 * np.maximum(1 + rise / np.maximum(length, 1e-12), 0)


def longest_way(parent: Parents, gain: Array) -> Array:
    """Return (J,) the largest sum of `gain` (>= 0) over a path from each node's parent through the node to a tip."""
    parents, gains = parent.tolist(), gain.tolist()
    way = gains.copy()
    for node in range(len(way) - 1, 0, -1):
        way[parents[node]] = max(way[parents[node]], gains[parents[node]] + way[node])
    return np.array(way)


def sum_above(parent: Parents, amount: Array) -> Array:
    """Return (J,) the sum of `amount` over each node and all between it and the root."""
    total = amount.copy()
    for j in range(1, len(parent)):
        total[j] += total[parent[j]]
    return total


def sum_below(parent: Parents, amount: Array) -> Array:
    """Return (J,) the sum of `amount` over each node and its descendants."""
    total = np.array(amount, dtype=np.float64)
    for j in range(len(parent) - 1, 0, -1):
        total[parent[j]] += total[j]
    return total


def chains(parent: Parents, gain: Array) -> list[NDArray[Any]]:
    """Split a tree into chains: each goes on into the child with the largest remaining path gain.

    Every chain but the first starts with the node of an earlier chain that it leaves.
    """
    nodes = np.arange(1, len(parent))
    rising = nodes[np.lexsort((-nodes, longest_way(parent, gain)[1:]))]
    heir = np.full(len(parent), -1)
    heir[parent[rising]] = rising  # the last, and best, of a node's children stays
    found = []
    for start in [0, *nodes[heir[parent[1:]] != nodes].tolist()]:
        chain, node = [int(parent[start])] if start else [], start
        while node >= 0:
            chain.append(node)
            node = int(heir[node])
        found.append(np.array(chain))
    return found


def reroot(parent: Parents, root: int) -> tuple[Parents, NDArray[Any]]:
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


def remove_spurs(tree: RawTree, *, per_width: float = 0, at_least: float = 0) -> RawTree:
    """Return the tree without side branches no longer than `per_width` half widths at their fork, or `at_least` [m]."""
    length = edge_lengths(tree.nodes, tree.parent)
    keep = np.ones(len(tree.parent), dtype=bool)
    for chain in chains(tree.parent, length)[1:]:
        if length[chain[1:]].sum() <= max(per_width * tree.width[chain[0]], at_least):
            keep[chain[1:]] = False
    return _kept(tree, keep)


def remove_veins(tree: RawTree, wood: float) -> RawTree:
    """Return the tree without side branches that begin on a blade and hold less than `wood` [m] of stem or petiole."""
    length = edge_lengths(tree.nodes, tree.parent)
    woody = length * np.clip((BLADE - tree.flatness) / 0.2 + 0.5, 0, 1)
    keep = np.ones(len(tree.parent), dtype=bool)
    for chain in chains(tree.parent, woody + 0.01 * length)[1:]:
        if np.mean(tree.flatness[chain[:4]]) > BLADE and woody[chain[1:]].sum() < wood:
            keep[chain[1:]] = False
    return _kept(tree, keep)


def separate_branches(tree: RawTree, gain: Array) -> RawTree:
    """Return the tree with each side branch leaving where it comes out of what carries it.

    Shortest paths run in parallel within a stem before they separate, if at all. A branch is out of its carrier where
    it is farther from the middle than 1.3 times the inscribed radius.
    """
    parent, keep = tree.parent.copy(), np.ones(len(tree.parent), dtype=bool)
    same_as, home = np.arange(len(parent)), np.zeros(len(parent), dtype=np.int64)
    first, *others = chains(tree.parent, gain)
    hosts = [first]
    for chain in others:
        host = hosts[home[same_as[chain[0]]]]
        distance, nearest = map(np.asarray, KDTree(tree.nodes[host]).query(tree.nodes[chain[1:]]))
        within = distance <= 1.3 * tree.thickness[host[nearest]]
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


def _kept(tree: RawTree, keep: NDArray[np.bool_]) -> RawTree:
    """Return the kept nodes whose ancestors are all kept."""
    for node in range(1, len(keep)):
        keep[node] &= keep[tree.parent[node]]
    order, rank = np.flatnonzero(keep), np.cumsum(keep) - 1
    return tree.taking(np.where(tree.parent[order] >= 0, rank[tree.parent[order]], -1), order)
