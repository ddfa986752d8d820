"""Points into voxels, without a grid: memory grows with the points, not with the volume they span."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array


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
