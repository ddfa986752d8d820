"""The plant as a set of occupied voxels, its shells closed and filled. N voxels, K components.

Scans are hollow: thinning a shell gives a cage, not a line (measured: 15,629 cycles on one mesh, 5 after
closing and filling). Everything here works on the occupied voxels alone, never on a dense grid, so that a
stray point far away costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from anther.geometry import Array

_HALF_NEIGHBOURS = [o for o in product((-1, 0, 1), repeat=3) if o > (0, 0, 0)]
_FACES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]


@dataclass(frozen=True, slots=True, eq=False)
class VoxelSolid:
    """Occupied voxels, sorted.

    Attributes:
        index: (N, 3) int64 voxel indices, all > 0.
        origin: (3,) centre of voxel (0, 0, 0) [m].
        voxel: edge length [m].
        thickness: (N,) distance to the nearest empty voxel [m] (Euclidean distance transform, P8).
    """

    index: NDArray[Any]
    origin: Array
    voxel: float
    thickness: Array

    @property
    def points(self) -> Array:
        """(N, 3) voxel centres [m]."""
        return self.origin + self.index * self.voxel


@dataclass(frozen=True, slots=True, eq=False)
class Voxels:
    """Occupied voxels joined into one piece, and what the plant looks like around each.

    Attributes:
        points: (N, 3) centres [m].
        edges: (E, 2) links: neighbours, and bridges across gaps.
        voxel: edge length [m].
        thickness: (N,) distance to the nearest empty voxel [m].
        flatness: (N,) 0 on a stem or petiole, 1 on a blade.
        off_middle: (N,) distance to the middle of the surroundings, as a share of their reach.
    """

    points: Array
    edges: NDArray[Any]
    voxel: float
    thickness: Array
    flatness: Array
    off_middle: Array


def point_spacing(points: Array) -> float:
    """Return the typical distance between neighbouring points [m] (median over a sample)."""
    sample = points[:: max(1, len(points) // 2000)]
    distance, _ = KDTree(points, balanced_tree=False, compact_nodes=False).query(sample, k=min(4, len(points)))
    return float(np.median(distance[:, -1]))


def solidify(points: Array, voxel: float, *, close: int, fill: float) -> VoxelSolid:
    """Voxelise points, close small gaps, fill hollow stems.

    Args:
        points: (N, 3) [m].
        voxel: edge length [m].
        close: gaps of up to this many voxels along an axis are closed.
        fill: a hollow narrower than this [m] along at least two axes is filled: a stem of any direction,
            but not the space between two leaves.
    """
    origin = points.min(axis=0) - voxel
    keys = _keys(np.rint((points - origin) / voxel).astype(np.int64))
    keys = _distinct(keys)
    keys = _distinct(np.concatenate([keys, *(_between(keys, axis, close) for axis in range(3))]))
    votes = np.sort(np.concatenate([_between(keys, axis, int(fill / voxel)) for axis in range(3)]))
    keys = _distinct(np.concatenate([keys, votes[1:][votes[1:] == votes[:-1]]]))  # enclosed along two axes or three
    index = _unkeys(keys)
    return VoxelSolid(index, origin, voxel, _thickness(keys) * voxel)


def neighbour_edges(solid: VoxelSolid) -> NDArray[Any]:
    """Return (E, 2) pairs of voxels that touch by face, edge or corner."""
    keys = _keys(solid.index)
    pairs = []
    for offset in _HALF_NEIGHBOURS:
        other = keys + _keys(np.array(offset))
        at = np.minimum(np.searchsorted(keys, other), len(keys) - 1)
        hit = np.flatnonzero(keys[at] == other)
        pairs.append(np.stack([hit, at[hit]], axis=1))
    return np.concatenate(pairs)


def components(count: int, edges: NDArray[Any]) -> NDArray[Any]:
    """Return (count,) component numbers, 0 being the largest."""
    graph = sparse.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (count, count))
    _, label = connected_components(graph, directed=False)
    order = np.argsort(-np.bincount(label), kind="stable")
    return np.argsort(order)[label]


def _keys(index: NDArray[Any]) -> NDArray[Any]:
    return (index[..., 0] << 42) + (index[..., 1] << 21) + index[..., 2]


def _unkeys(keys: NDArray[Any]) -> NDArray[Any]:
    mask = (1 << 21) - 1
    return np.stack([keys >> 42, (keys >> 21) & mask, keys & mask], axis=-1)


def _between(keys: NDArray[Any], axis: int, gap: int) -> NDArray[Any]:
    """Return keys of the empty voxels between two occupied ones on a line, at most `gap` voxels apart."""
    shift = (42, 21, 0)[axis]
    index = _unkeys(keys)
    along = index[:, axis]
    line = keys - (along << shift)
    order = np.lexsort((along, line))
    line, along = line[order], along[order]
    empty = np.diff(along) - 1
    starts = np.flatnonzero((np.diff(line) == 0) & (empty > 0) & (empty <= gap))
    counts = empty[starts]
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    return np.repeat(line[starts], counts) + ((np.repeat(along[starts], counts) + step) << shift)


def _thickness(keys: NDArray[Any]) -> Array:
    """Return distance in voxels to the nearest empty voxel: exact, by KD-tree to the background shell.

    Voxels with an empty face neighbour, which are most, are at distance 1 and need no search.
    """
    around = [keys + _keys(np.array(face)) for face in _FACES]
    occupied = [_contains(keys, beside) for beside in around]
    inside = np.all(occupied, axis=0)
    shell = _distinct(np.concatenate([beside[~held] for beside, held in zip(around, occupied, strict=True)]))
    distance = np.ones(len(keys))
    distance[inside] = KDTree(_unkeys(shell)).query(_unkeys(keys[inside]), workers=-1)[0]
    return distance


def _distinct(keys: NDArray[Any]) -> NDArray[Any]:
    """Return the sorted distinct keys (sorting is several times faster here than numpy's hashing `unique`)."""
    keys = np.sort(keys)
    return keys[np.concatenate([[True], keys[1:] != keys[:-1]])] if len(keys) else keys


def _contains(keys: NDArray[Any], wanted: NDArray[Any]) -> NDArray[np.bool_]:
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return keys[at] == wanted
