"""Which points hang together. N points, C cells."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.geometry import Array

GAP = 0.012
"""Parts closer than this to the rest belong to it [m]."""
FAR_GAP = 0.05
"""Large parts belong to the plant up to this distance [m] (a real plant's cloud has gaps of 5 cm)."""
FAR_SHARE = 0.002
"""Least share of all points that such a large part has."""


def voxel_groups(points: Array, voxel: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return each point's voxel number (N,), in order of first appearance, and the number of points of every voxel.

    Args:
        points: (N, 3) [m], less than 2^20 voxels from the origin.
        voxel: edge of a voxel [m].
    """
    group, count = _hashed(np.ascontiguousarray(points), 1 / voxel)
    return group, count


def voxel_means(points: Array, voxel: float) -> Array:
    """Return the mean point (M, 3) of each voxel; arguments as in `voxel_groups`."""
    group, count = voxel_groups(points, voxel)
    sums = [np.bincount(group, weights=column, minlength=len(count)) for column in points.T]
    return np.stack(sums, axis=1) / count[:, None]


@numba.njit(nogil=True, cache=True)
def _hashed(points, per_metre):
    """Number the voxels with a hash table of open addressing; a key holds three 21-bit cell numbers."""
    size = 16
    while size < 2 * points.shape[0]:
        size *= 2
    table = np.full(size, -1, dtype=np.int32)
    keys = np.empty(points.shape[0], dtype=np.int64)
    count = np.zeros(points.shape[0], dtype=np.int64)
    group = np.empty(points.shape[0], dtype=np.int64)
    found = 0
    for n in range(points.shape[0]):
        key = np.int64(0)
        for axis in range(3):
            key = (key << 21) | (np.int64(np.floor(points[n, axis] * per_metre)) & 0x1FFFFF)
        slot = ((key * np.int64(-7046029254386353131)) >> 20) & (size - 1)
        while table[slot] >= 0 and keys[table[slot]] != key:
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot], keys[found] = found, key
            found += 1
        group[n] = table[slot]
        count[group[n]] += 1
    return group, count[:found]


def clusters(points: Array, gap: float) -> NDArray[np.int64]:
    """Return the cluster number (N,) of each point: DBSCAN with eps = gap and min_samples = 1, exactly.

    With one sample DBSCAN's clusters are the connected components of all pairs within `gap`. Points of one cell with
    a diagonal of `gap` are connected already, so only points of different, not yet connected cells are compared.

    Args:
        points: (N, 3) [m].
        gap: [m].
    """
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    edge = gap / np.sqrt(3) * (1 - 1e-9)
    cell, count = voxel_groups(points, edge)
    order = np.argsort(cell, kind="stable")
    start = np.concatenate([[0], np.cumsum(count)])
    centres = (np.floor(points[order[start[:-1]]] / edge) + 0.5) * edge
    pairs = KDTree(centres).query_pairs(2 * gap, output_type="ndarray")
    nearest_first = np.argsort(np.sum((centres[pairs[:, 0]] - centres[pairs[:, 1]]) ** 2, axis=1))
    part = _connected(points[order], start, pairs[nearest_first], gap * gap)
    return np.unique(part, return_inverse=True)[1][cell]


def attached_points(points: Array) -> NDArray[np.bool_]:
    """Return which points (N, 3) [m] belong to the plant: the largest cluster, and large ones that come near it.

    The strict largest cluster would lose most of a real plant, whose cloud has gaps (facts: skeleton_peers, trap 3).
    """
    part = clusters(points, GAP)
    size = np.bincount(part)
    keep = np.zeros(len(size), dtype=bool)
    keep[np.argmax(size)] = True
    large = size >= FAR_SHARE * len(points)
    while True:
        rest = np.flatnonzero((large & ~keep)[part])
        if len(rest) == 0:
            break
        distance, _ = KDTree(points[keep[part]]).query(points[rest], distance_upper_bound=FAR_GAP)
        joins = np.unique(part[rest[distance < FAR_GAP]])
        if len(joins) == 0:
            break
        keep[joins] = True
    return keep[part]


@numba.njit(nogil=True, cache=True)
def _connected(points, start, pairs, gap2):
    """Return a root cell (C,) for each cell; union-find over pairs of cells, whose points start at `start`."""
    root = np.arange(start.size - 1)
    for p in range(pairs.shape[0]):
        a, b = _root(root, pairs[p, 0]), _root(root, pairs[p, 1])
        if a != b and _touch(points, start, pairs[p, 0], pairs[p, 1], gap2):
            root[a] = b
    for c in range(root.size):
        root[c] = _root(root, c)
    return root


@numba.njit(nogil=True, cache=True)
def _root(root: NDArray[Any], cell: int) -> int:
    while root[cell] != cell:
        root[cell] = root[root[cell]]
        cell = root[cell]
    return cell


@numba.njit(nogil=True, cache=True)
def _touch(points, start, a, b, gap2):
    for i in range(start[a], start[a + 1]):
        for j in range(start[b], start[b + 1]):
            square = 0.0
            for axis in range(3):
                square += (points[i, axis] - points[j, axis]) ** 2
            if square <= gap2:
                return True
    return False
