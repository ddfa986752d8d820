"""The paper's skeleton, step by step.

    P7   medial_line            one voxel thick, by 3-D thinning
    P8   knn_links, link_costs  a graph of the nearest neighbours, in which thick, vertical links are cheap
    P9   spanning_tree          without cycles

`thinned_tree` runs them on a plant; `Params(method="thinning")` goes on from there as it does from the default.
N voxels, M of them on the medial line, J nodes of a rooted tree.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial import KDTree
from skimage.morphology import skeletonize as thin

from anther.core.geometry import Array
from anther.perception.skeleton.raw_tree import RawTree, rooted, with_extents
from anther.perception.skeleton.voxel_solid import Voxels, bridges, components


def thinned_tree(voxels: Voxels) -> RawTree:
    """Return the tree of the voxels that thinning leaves, rooted anywhere (P7 to P9)."""
    index = np.rint((voxels.points - voxels.points.min(axis=0)) / voxels.voxel).astype(np.int64)
    edges = voxels.edges
    touching = edges[np.abs(index[edges[:, 0]] - index[edges[:, 1]]).max(axis=1) <= 1]
    line = np.flatnonzero(medial_line(index, touching))
    nodes, radius = voxels.points[line], voxels.thickness[line]
    links = knn_links(nodes, 3 * voxels.voxel)
    links = spanning_tree(len(nodes), links, link_costs(nodes, radius, links))
    links = np.concatenate([links, bridges(nodes, components(len(nodes), links), np.inf)])
    parent, order = rooted(links, len(nodes), 0)
    return with_extents(nodes[order], parent, voxels)


def medial_line(index: NDArray[Any], touching: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (N,) which voxels (N, 3) are left by Lee's thinning (1994), with what it wrongly deletes put back (P7).

    scikit-image deletes straight bars of even width altogether (scikit-image #3757). Voxels left far from any line
    are therefore thinned once more, one voxel wider. `touching` (E, 2) are pairs of touching voxels.
    """
    left = _lee(index)
    lost = _uncovered(index, left)
    if not lost.any():
        return left
    rank = np.cumsum(lost) - 1
    number = np.flatnonzero(lost)
    label = components(len(number), rank[touching[lost[touching].all(axis=1)]])
    for k in range(int(label.max()) + 1):
        left[number[label == k][_wider(index[number[label == k]])]] = True
    return left


def knn_links(nodes: Array, longest: float) -> NDArray[Any]:
    """Return (E, 2) links of each node to its nearest neighbours within `longest` [m] (P8)."""
    distance, other = map(np.asarray, KDTree(nodes).query(nodes, k=min(12, len(nodes)), workers=1))
    distance, other = distance.reshape(len(nodes), -1), other.reshape(len(nodes), -1)
    start = np.broadcast_to(np.arange(len(nodes))[:, None], other.shape)
    use = (distance <= longest) & (start != other)
    return np.unique(np.sort(np.stack([start[use], other[use]], axis=1), axis=1), axis=0)


def link_costs(nodes: Array, radius: Array, links: NDArray[Any]) -> Array:
    """Return the cost (E,) of each link: its length, less where it is thick and vertical (P8, both weights 1)."""
    step = nodes[links[:, 1]] - nodes[links[:, 0]]
    length = np.linalg.norm(step, axis=1)
    mean_radius = radius[links].mean(axis=1) / radius.max()
    return length / (mean_radius * (1 + np.abs(step[:, 2]) / length))


def spanning_tree(count: int, links: NDArray[Any], cost: Array) -> NDArray[Any]:
    """Return the links (T, 2) of the minimum spanning tree, or forest (P9)."""
    graph = sparse.coo_matrix((cost, (links[:, 0], links[:, 1])), (count, count))
    tree = minimum_spanning_tree(graph.tocsr()).tocoo()
    return np.stack([tree.row, tree.col], axis=1).astype(np.int64)


def _lee(index: NDArray[Any]) -> NDArray[np.bool_]:
    low = index.min(axis=0) - 1
    grid = np.zeros(index.max(axis=0) - low + 2, dtype=bool)
    at = tuple((index - low).T)
    grid[at] = True
    return thin(grid, method="lee")[at].astype(bool)


def _uncovered(index: NDArray[Any], left: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (N,) which voxels lie farther from the line than four voxels and three times its spacing."""
    if not left.any():
        return np.ones(len(index), dtype=bool)
    distance, _ = KDTree(index[left]).query(index)
    inside, _ = KDTree(index[left]).query(index[left], k=min(2, int(left.sum())))
    return np.asarray(distance) > 4 + 3 * float(np.median(inside))


def _wider(index: NDArray[Any]) -> NDArray[Any]:
    """Return which voxels of one lost piece lie on the line of the piece made one voxel wider."""
    steps = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    wide = np.unique((index[:, None] + steps).reshape(-1, 3), axis=0)
    line = wide[_lee(wide)]
    if not len(line):
        line = index.mean(axis=0)[None]
    return np.unique(np.asarray(KDTree(index).query(line)[1]))
