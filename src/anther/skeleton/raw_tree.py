"""A rooted tree on its way to a skeleton, and the operations on it. J nodes; parent[0] = -1, parent[j] < j."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order

from anther.geometry import Array

Parents = NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class RawTree:
    """A rooted tree before it is a `Skeleton`.

    Attributes:
        nodes: (J, 3) [m].
        parent: (J,) parent[0] = -1, parent[j] < j.
        thickness: (J,) inscribed radius of the solid [m]: a stem's radius, a blade's half thickness.
        width: (J,) lateral half extent [m]: a stem's radius, a blade's half width.
    """

    nodes: Array
    parent: Parents
    thickness: Array
    width: Array

    def taking(self, parent: Parents, order: NDArray[Any]) -> RawTree:
        """Return the nodes in `order` under new parents."""
        return RawTree(self.nodes[order], parent, self.thickness[order], self.width[order])


def edge_lengths(nodes: Array, parent: Parents) -> Array:
    """Return (J,) distance of each node to its parent [m]; 0 at the root."""
    length = np.zeros(len(nodes))
    length[1:] = np.linalg.norm(nodes[1:] - nodes[parent[1:]], axis=1)
    return length


def path_gain(nodes: Array, parent: Parents, radius: Array, *, alpha: float, v_bias: float) -> Array:
    """Return (J,) what the edge above each node adds to the path score S (paper P10).

    S = sum over edges of L_e * r_e^alpha * (1 + v_bias * dz_e / L_e), with r_e relative to the thickest node, so that
    S does not depend on units. The paper has |dz_e|; there a drooping leaf counts as upright, so here falling edges
    lose what rising ones gain.
    """
    length = edge_lengths(nodes, parent)
    above = np.maximum(parent, 0)
    mean_radius = (radius + radius[above]) / 2 / radius.max()
    rise = nodes[:, 2] - nodes[above, 2]
    return length * mean_radius**alpha * np.maximum(1 + v_bias * rise / np.maximum(length, 1e-12), 0)


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
