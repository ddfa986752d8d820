"""The steps that make one clean cloud of many views: voxel fusion, agreement, obstacles.

Dimensions: V views, H x W pixels, N points.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from anther.cloud._clusters import voxel_groups
from anther.cloud._pixels import slant
from anther.geometry import Array, Box, Intrinsics, inverse, transform_points
from anther.masks import FLOWER, PLANT

THREADS = 2
SEEN_THROUGH = 0.02
"""A view contradicts a point where it sees at least this far behind it [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewPoints:
    """One view's plant pixels.

    Attributes:
        points: (N, 3) in the camera frame [m].
        normals: (N, 3) unit, towards the camera, in its frame.
        labels: (N,) uint8.
        colors: (N, 3) uint8; zeros without colour.
    """

    points: Array
    normals: NDArray[Any]
    labels: NDArray[Any]
    colors: NDArray[Any]

    def only(self, keep: NDArray[Any]) -> ViewPoints:
        """Return the points chosen by a mask (N,) or by indices."""
        return ViewPoints(self.points[keep], self.normals[keep], self.labels[keep], self.colors[keep])

    def unbiased(self, reach: float) -> ViewPoints:
        """Return the same with slanted surfaces moved back along the rays; see `matching.Estimate`."""
        factor = 1 + reach * slant(self.points, self.normals)
        return ViewPoints(self.points * factor[:, None], self.normals, self.labels, self.colors)


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """Voxel means of all views' points.

    Attributes:
        points: (N, 3) world [m].
        normals: (N, 3) unit, to the side the points were seen from.
        labels: (N,) uint8, by majority.
        colors: (N, 3) uint8, the mean; zeros without colour.
    """

    points: Array
    normals: Array
    labels: NDArray[Any]
    colors: NDArray[Any]

    def only(self, keep: NDArray[np.bool_]) -> Fused:
        """Return the points for which `keep` (N,) is true."""
        return Fused(self.points[keep], self.normals[keep], self.labels[keep], self.colors[keep])


def fuse_voxels(pixels: list[ViewPoints], poses: Array, box: Box, voxel: float) -> Fused:
    """Return the mean point, normal, label and colour of every occupied voxel within the box."""

    def placed(view: int) -> tuple[Array, ViewPoints]:
        world = transform_points(poses[view], pixels[view].points)
        inside = box.contains(world)
        return (world, pixels[view]) if inside.all() else (world[inside], pixels[view].only(inside))

    with ThreadPoolExecutor(THREADS) as pool:
        world, seen = zip(*pool.map(placed, range(len(poses))), strict=True)
    points = np.concatenate(world)
    group, count = voxel_groups(points, voxel)
    sums = np.zeros((len(count), 10))
    first = 0
    for view, T in zip(seen, poses, strict=True):
        last = first + len(view.points)
        _add_points(group[first:last], points[first:last], view.normals, view.labels, view.colors, T, sums)
        first = last
    means = sums / count[:, None]
    facing = means[:, 3:6] / np.maximum(np.linalg.norm(means[:, 3:6], axis=1, keepdims=True), 1e-9)
    majority = np.where(means[:, 6] >= 0.5, FLOWER, PLANT).astype(np.uint8)
    return Fused(means[:, :3].copy(), facing, majority, np.round(means[:, 7:]).astype(np.uint8))


@numba.njit(nogil=True, cache=True)
def _add_points(group, points, normals, labels, colors, T, sums):
    """Add point, world normal, whether it is a flower's, and colour to the sums (N, 10) of each one's group."""
    for n in range(group.size):
        row = sums[group[n]]
        for c in range(3):
            row[c] += points[n, c]
            row[3 + c] += T[c, 0] * normals[n, 0] + T[c, 1] * normals[n, 1] + T[c, 2] * normals[n, 2]
            row[7 + c] += colors[n, c]
        row[6] += labels[n] == FLOWER


def agreeing_points(
    points: Array, depth: Sequence[NDArray[Any]], intrinsics: Intrinsics, poses: Array
) -> NDArray[np.bool_]:
    """Return which points (N,) the views do not contradict.

    A view contradicts a point if everything it sees there and one pixel around is at least `SEEN_THROUGH` [m] behind
    it; it supports a point if something there lies within half of that. A point stays if no more views contradict
    than support it.
    """
    k = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy])
    balance = np.zeros(len(points), dtype=np.int64)
    cameras = np.ascontiguousarray(inverse(poses))

    def judge(part: slice) -> None:
        for view, T in zip(depth, cameras, strict=True):
            _add_agreement(points[part], view, k, T, SEEN_THROUGH, balance[part])

    with ThreadPoolExecutor(THREADS) as pool:
        list(
            pool.map(
                judge, [slice(i * len(points) // THREADS, (i + 1) * len(points) // THREADS) for i in range(THREADS)]
            )
        )
    return balance >= 0


def balances(points: Array, depth: NDArray[Any], intrinsics: Intrinsics, T_world_cam: Array) -> NDArray[np.int64]:
    """Return what one view says of points (N, 3): 1 supports, -1 contradicts, 0 nothing; see `agreeing_points`."""
    k = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy])
    balance = np.zeros(len(points), dtype=np.int64)
    _add_agreement(
        np.ascontiguousarray(points), depth, k, np.ascontiguousarray(inverse(T_world_cam)), SEEN_THROUGH, balance
    )
    return balance


@numba.njit(nogil=True, cache=True)
def _add_agreement(points, depth, k, T, seen_through, balance):
    height, width = depth.shape
    for n in range(points.shape[0]):
        x, y, w = points[n, 0], points[n, 1], points[n, 2]
        z = T[2, 0] * x + T[2, 1] * y + T[2, 2] * w + T[2, 3]
        if z <= 0:
            continue
        u = int(np.round(k[0] * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * w + T[0, 3]) / z + k[2]))
        v = int(np.round(k[1] * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * w + T[1, 3]) / z + k[3]))
        if u < 1 or v < 1 or u >= width - 1 or v >= height - 1:
            continue
        if depth[v, u] > 0 and abs(depth[v, u] - z) < seen_through / 2:
            balance[n] += 1  # of most points the pixel itself says so
            continue
        supports, contradicts = False, True
        for j in range(v - 1, v + 2):
            for i in range(u - 1, u + 2):
                seen = depth[j, i]
                contradicts = contradicts and seen > z + seen_through
                supports = supports or (seen > 0 and abs(seen - z) < seen_through / 2)
        balance[n] += int(supports) - int(contradicts)


def occupied_cells(points: Array, views: NDArray[Any], plant: Array, voxel: float) -> Array:
    """Return the centres (M, 3) [m] of cells that really hold a surface other than the plant's.

    A cell needs points of two views (or half of all it has room for) and a neighbourhood of ten such cells: pixels at
    the plant's edges, wrongly placed beside it, do not make an obstacle.

    Args:
        points: (N, 3) world points that are not plant [m].
        views: (N,) the view of each.
        plant: (K, 3) plant points; cells that hold any are left out.
        voxel: edge of a cell [m].
    """
    if len(points) == 0:
        return np.zeros((0, 3))
    lower = np.minimum(points.min(axis=0), plant.min(axis=0)) - voxel
    index = np.floor((points - lower) / voxel).astype(np.int64)
    shape = tuple(np.maximum(index.max(axis=0), np.floor((plant.max(axis=0) - lower) / voxel).astype(np.int64)) + 2)
    cell = np.ravel_multi_index(tuple(index.T), shape)
    counts = np.bincount(cell, minlength=int(np.prod(shape))).reshape(shape)
    first, last = np.full(shape, np.iinfo(np.int64).max), np.full(shape, -1)
    np.minimum.at(first.ravel(), cell, views)
    np.maximum.at(last.ravel(), cell, views)
    held = (counts >= 3) & (last > first)
    held[tuple(np.floor((plant - lower) / voxel).astype(np.int64).T)] = False
    parts = np.zeros(shape, dtype=np.int32)
    ndimage.label(held, structure=np.ones((3, 3, 3)), output=parts)
    large = np.bincount(parts.ravel()) >= 30
    large[0] = False
    return lower + (np.argwhere(large[parts]) + 0.5) * voxel
