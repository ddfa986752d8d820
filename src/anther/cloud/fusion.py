"""The steps that make one clean cloud of many views: pixel support, voxel fusion, agreement, attachment.

Dimensions: V views, H x W pixels, N points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.spatial import KDTree

from anther.geometry import Array, Box, Intrinsics, inverse, transform_points
from anther.masks import FLOWER, PLANT


@dataclass(frozen=True, slots=True, eq=False)
class ViewPoints:
    """One view's plant pixels.

    Attributes:
        points: (N, 3) in the camera frame [m].
        labels: (N,) uint8.
        colors: (N, 3) uint8, or None.
    """

    points: Array
    labels: NDArray[Any]
    colors: NDArray[Any] | None


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """Voxel means of all views' points.

    Attributes:
        points: (N, 3) world [m].
        labels: (N,) uint8, by majority.
        colors: (N, 3) uint8, the mean; zeros without colour.
        towards_camera: (N, 3) unit vectors, the mean direction to the cameras.
    """

    points: Array
    labels: NDArray[Any]
    colors: NDArray[Any]
    towards_camera: Array

    def only(self, keep: NDArray[np.bool_]) -> Fused:
        """Return the points for which `keep` (N,) is true."""
        return Fused(self.points[keep], self.labels[keep], self.colors[keep], self.towards_camera[keep])


def supported_pixels(
    depth: NDArray[Any], mask: NDArray[np.bool_], window: int, support: int, tolerance: float
) -> NDArray[np.bool_]:
    """Return the pixels (H, W) of `mask` whose depth is shared by enough of their neighbours.

    A flying pixel hangs between two surfaces and few neighbours share its depth; a pixel of a petiole has the
    petiole's other pixels. A gradient filter would drop both (facts: perception, a 15 mm edge filter eats petioles).

    Args:
        depth: (H, W) [m].
        mask: (H, W).
        window: half-width of the neighbourhood [px].
        support: least number of pixels in it, itself included, at its depth.
        tolerance: how far their depth may differ at 0.5 m [m]; it grows with z squared, as stereo noise does.
    """
    return _supported(depth, mask, window, support, tolerance / 0.25)


@numba.njit(nogil=True, cache=True)
def _supported(depth, mask, window, support, tolerance):
    height, width = depth.shape
    keep = np.zeros(depth.shape, dtype=np.bool_)
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if not mask[v, u] or z <= 0:
                continue
            count = 0
            for j in range(max(0, v - window), min(height, v + window + 1)):
                for i in range(max(0, u - window), min(width, u + window + 1)):
                    if depth[j, i] > 0 and abs(depth[j, i] - z) <= tolerance * z * z:
                        count += 1
            keep[v, u] = count >= support
    return keep


def fuse_voxels(pixels: list[ViewPoints], poses: Array, box: Box, voxel: float) -> Fused:
    """Return the mean point, label and colour of every occupied voxel within the box."""
    world = [transform_points(T, p.points) for T, p in zip(poses, pixels, strict=True)]
    points = np.concatenate(world)
    towards = np.concatenate([T[:3, 3] - w for T, w in zip(poses, world, strict=True)])
    labels = np.concatenate([p.labels for p in pixels])
    colors = np.concatenate([np.zeros((len(p.points), 3)) if p.colors is None else p.colors for p in pixels])
    inside = box.contains(points)
    points, towards, labels, colors = points[inside], towards[inside], labels[inside], colors[inside]
    if len(points) == 0:
        return Fused(points, labels, colors.astype(np.uint8), towards)
    group, count = _voxel_groups(points, box.lower, voxel)

    def mean(values: Array) -> Array:
        sums = [np.bincount(group, weights=column, minlength=len(count)) for column in values.T]
        return np.stack(sums, axis=1) / count[:, None]

    petals = np.bincount(group, weights=labels == FLOWER, minlength=len(count)) / count
    direction = mean(towards)
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    majority = np.where(petals >= 0.5, FLOWER, PLANT).astype(np.uint8)
    return Fused(mean(points), majority, np.round(mean(colors)).astype(np.uint8), direction)


def _voxel_groups(points: Array, lower: Array, voxel: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return each point's voxel number (N,) and the number of points of every voxel."""
    cell = np.floor((points - lower) / voxel).astype(np.int64)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    _, group, count = np.unique(key, return_inverse=True, return_counts=True)
    return group, count


def agreeing_points(
    points: Array, depth: NDArray[Any], intrinsics: Intrinsics, poses: Array, seen_through: float
) -> NDArray[np.bool_]:
    """Return which points (N,) the views do not contradict.

    A view contradicts a point if everything it sees there and one pixel around is at least `seen_through` [m] behind
    it; it supports a point if something there lies within half of that. A point stays if no more views contradict
    than support it.
    """
    k = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy])
    balance = np.zeros(len(points), dtype=np.int64)
    for view, T in zip(depth, inverse(poses), strict=True):
        _add_agreement(points, view, k, np.ascontiguousarray(T), seen_through, balance)
    return balance >= 0


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
        supports, contradicts = False, True
        for j in range(v - 1, v + 2):
            for i in range(u - 1, u + 2):
                seen = depth[j, i]
                contradicts = contradicts and seen > z + seen_through
                supports = supports or (seen > 0 and abs(seen - z) < seen_through / 2)
        balance[n] += int(supports) - int(contradicts)


def attached_points(points: Array, gap: float, far_gap: float, far_share: float) -> NDArray[np.bool_]:
    """Return which points (N,) belong to the plant: the largest part and what is attached to it, near or large.

    The strict largest cluster would lose most of a real plant, whose cloud has gaps (facts: skeleton_peers, trap 3).

    Args:
        points: (N, 3) [m].
        gap: points closer than this are connected, and any part this close to the plant belongs to it [m].
        far_gap: parts with at least `far_share` of all points belong to it up to this distance [m].
        far_share: 0..1.
    """
    cells, cell_of = np.unique(np.floor(points / (gap / 2)).astype(np.int64), axis=0, return_inverse=True)
    centres = (cells + 0.5) * (gap / 2)
    pairs = KDTree(centres).query_pairs(gap, output_type="ndarray")
    graph = sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    _, part = sparse.csgraph.connected_components(graph, directed=False)
    size = np.bincount(part[cell_of])
    keep = np.zeros(len(size), dtype=bool)
    keep[np.argmax(size)] = True
    while True:
        rest = np.flatnonzero(~keep[part])
        if len(rest) == 0:
            break
        distance, _ = KDTree(centres[keep[part]]).query(centres[rest], distance_upper_bound=far_gap)
        nearest = np.full(len(size), np.inf)
        np.minimum.at(nearest, part[rest], distance)
        joins = ~keep & (nearest < far_gap) & (size >= far_share * len(points))
        if not joins.any():
            break
        keep |= joins
    return keep[part[cell_of]]


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
    counts = np.zeros(shape, dtype=np.int64)
    np.add.at(counts, tuple(index.T), 1)
    first, last = np.full(shape, np.iinfo(np.int64).max), np.full(shape, -1)
    np.minimum.at(first, tuple(index.T), views)
    np.maximum.at(last, tuple(index.T), views)
    held = (counts >= 3) & (last > first)
    held[tuple(np.floor((plant - lower) / voxel).astype(np.int64).T)] = False
    parts = np.zeros(shape, dtype=np.int32)
    ndimage.label(held, structure=np.ones((3, 3, 3)), output=parts)
    large = np.bincount(parts.ravel()) >= 30
    large[0] = False
    return lower + (np.argwhere(large[parts]) + 0.5) * voxel
