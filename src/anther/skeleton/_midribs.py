"""Lines on blades moved to the middle of the blade's width. N voxels, J nodes, M of them on one chain.

A chain moves to the centroids of the level sets (Xu et al. 2007) it goes through, each cut to what is nearer to this
chain than to another, so that blades that touch keep their own lines.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from anther.geometry import Array
from anther.skeleton._geodesics import LevelSets
from anther.skeleton._nearby import nearest
from anther.skeleton.raw_tree import RawTree, chains, with_extents
from anther.skeleton.voxel_solid import Voxels

_THINNEST = 2.0
"""Least half depth of what is averaged [voxels]."""
_DEPTH = 0.5
"""Half depth of what is averaged, as a share of its spread: a broad blade has a smooth line."""
_ROUND, _FLAT = 0.2, 0.5
"""Nodes flatter than this begin to move, or move all the way: a stem scanned from one side has its axis elsewhere."""


def middled(tree: RawTree, gain: Array, voxels: Voxels, levels: LevelSets) -> RawTree:
    """Return the tree with its nodes on blades in the middle of the blade's width.

    Args:
        tree: its nodes are voxels.
        gain: (J,) path gain that decides which child goes on with its parent's chain.
        voxels: the plant.
        levels: of the tree's root.
    """
    every = chains(tree.parent, gain)
    home = np.zeros(len(tree.nodes), dtype=np.int64)
    for number, chain in enumerate(every[1:], 1):
        home[chain[1:]] = number
    home = home[nearest(voxels.points, tree.nodes)[1]]
    order = np.lexsort((levels.way, home))
    first = np.searchsorted(home[order], np.arange(len(every) + 1))
    at = nearest(tree.nodes, voxels.points)[1]
    weight = np.clip((tree.flatness - _ROUND) / (_FLAT - _ROUND), 0, 1)[:, None]
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
    thinnest = np.full(len(at), _THINNEST * voxel)
    _, spread = _mean(points, way, at, thinnest)
    return _mean(points, way, at, np.maximum(_DEPTH * gaussian_filter1d(spread, 4, mode="nearest"), thinnest))[0]


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
