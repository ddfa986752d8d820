"""The paper's skeleton (P5, P7-P12) and nothing else: voxels, largest cluster, Lee thinning, kNN graph, spanning tree.

None of Anther's steps: no closing, no filling, no bridging, no centring, no pruning of spurs, no repair of what the
thinning deletes. `closed` is the exception: the same, closed and filled first, as thinning is most used. M voxels.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import binary_closing, binary_fill_holes, distance_transform_edt
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import KDTree
from skimage.morphology import skeletonize as thin

from anther.core import Array
from anther.perception import Cloud
from evaluation.perception.real.answers import Answer, NoAnswer
from evaluation.perception.real.paper_rule import core_stem
from evaluation.perception.real.plants import plant_size

KIND, FINE = 80, 200
"""Voxels along the plant's diagonal. KIND: about the best for this method of 60, 80, 100, 120, 150, 200, 300 on every
seventh scan (stems are two to three voxels thick; finer voxels leave the hollow stems of a scan hollow, and thinning
makes a cage of them). FINE: what peers were compared at before (facts: skeleton peers); the paper says
"high-resolution".
"""
NEAR = 3.5
"""Two voxels within so many edges are in one cluster (facts: skeleton peers)."""
NEIGHBOURS = 8
CLOSED = 3
"""How far gaps are closed [voxels] (facts: skeleton peers)."""


def plain_thinning(cloud: Cloud, resolution: int = KIND, *, closed: int = 0) -> Answer:
    """Return the answer of the paper's algorithm as written.

    Args:
        cloud: the plant.
        resolution: voxels along its diagonal.
        closed: if not 0, gaps are closed so far [voxels] and holes filled first.

    Raises:
        NoAnswer: the thinning leaves nothing, or no stem is found.
    """
    begin = time.process_time()
    voxel = plant_size(cloud.points) / resolution
    index = largest_cluster(cloud.points, voxel)
    solid, low = occupancy(index, border=1 + closed)
    if closed:
        solid = np.asarray(binary_fill_holes(binary_closing(solid, np.ones((3, 3, 3)), iterations=closed)))
    line = np.argwhere(thin(solid, method="lee"))
    if len(line) < 2:
        raise NoAnswer("no skeleton: the thinning left nothing")
    nodes: Array = np.array((line + low) * voxel, dtype=np.float64)
    radius = depth(solid)[tuple(line.T)] * voxel
    edges = spanning_tree(nodes, radius)
    stem, grasp = core_stem(nodes, edges, radius)
    return Answer(nodes, edges, stem, grasp, time.process_time() - begin)


def largest_cluster(points: Array, voxel: float) -> NDArray[Any]:
    """Return (M, 3) indices of the occupied voxels in the largest cluster (P5; DBSCAN with one neighbour)."""
    index = np.unique(np.rint(points / voxel).astype(np.int64), axis=0)
    pairs = KDTree(index).query_pairs(NEAR, output_type="ndarray")
    graph = sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (len(index),) * 2)
    label = connected_components(graph, directed=False)[1]
    return index[label == np.bincount(label).argmax()]


def occupancy(index: NDArray[Any], border: int = 1) -> tuple[NDArray[np.bool_], NDArray[Any]]:
    """Return (binary grid with an empty border, index of its first voxel)."""
    low = index.min(axis=0) - border
    grid = np.zeros(index.max(axis=0) - low + 1 + border, dtype=bool)
    grid[tuple((index - low).T)] = True
    return grid, low


def depth(solid: NDArray[np.bool_]) -> Array:
    """Return each voxel's distance to the nearest empty one [voxels]: the radius of the paper's score (P8)."""
    return np.asarray(distance_transform_edt(solid), dtype=np.float64)


def spanning_tree(nodes: Array, radius: Array) -> NDArray[Any]:
    """Return the edges of the minimum spanning tree of the kNN graph; thick, vertical links are cheap (P8, P9)."""
    distance, other = map(np.asarray, KDTree(nodes).query(nodes, k=min(NEIGHBOURS + 1, len(nodes))))
    start, end = np.repeat(np.arange(len(nodes)), other.shape[1] - 1), other[:, 1:].ravel()
    length = distance[:, 1:].ravel()
    upright = 1 + np.abs(nodes[end, 2] - nodes[start, 2]) / length
    cost = length / ((radius[start] + radius[end]) / 2 / radius.max() * upright)
    tree = minimum_spanning_tree(sparse.coo_matrix((cost, (start, end)), (len(nodes),) * 2).tocsr()).tocoo()
    return np.stack([tree.row, tree.col], axis=1).astype(np.int64)
