"""The steps that make one clean cloud of many views: pixels, voxel fusion, agreement, connected parts, obstacles.

Flying pixels are dropped, and a local plane is fitted to each pixel: in a pinhole image the inverse depth of a plane is
linear in the pixel coordinates, so it is a linear least squares of the neighbours.
Dimensions: V views, H x W pixels, N points.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from anther.core.compiling import OPTIONS, compiled, inlined, numba, read_only
from anther.core.geometry import Array, Box, Intrinsics, inverse, transform_points
from anther.perception.capture import in_threads
from anther.perception.masks import FLOWER, PLANT

_TOLERANCE = np.float32(0.012)
"""Inverse depths of one surface differ by no more [1/m]: 3 mm at 0.5 m, and as z squared, as stereo noise does."""
FIT_WINDOW = 3
"""Half-width of the window that a plane is fitted in [px]: 5 x 5 pixels give normals twice as noisy."""
SEEN_THROUGH = 0.02
"""A view contradicts a point where it sees at least this far behind it [m]."""
GAP = 0.012
"""Parts closer than this to the rest belong to it [m]."""


def surface_pixels(
    depth: NDArray[Any], mask: NDArray[np.bool_], intrinsics: Intrinsics, least: int = 5
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Return the pixels (H, W) that show a surface, and its unit normals (N, 3) there, to the camera, row by row.

    They are those of `mask` (H, W) whose depth (H, W) [m] is that of `least` of the 5 x 5 pixels around. A flying pixel
    lies between two surfaces and few share its depth; a petiole one pixel wide has its other pixels. A gradient filter
    would drop both (facts: perception, a 15 mm edge filter eats petioles).
    """
    around, keep = _around(mask), np.zeros(mask.shape, dtype=bool)
    v, u = (part.start for part in around)
    camera, inverse = intrinsics.pinhole - [0, 0, u, v], np.pad(_inverse(depth[around]), FIT_WINDOW)
    masked = np.ascontiguousarray(mask[around])
    supported, normals = np.zeros(masked.shape, dtype=bool), np.empty((np.count_nonzero(masked), 3), dtype=np.float32)
    found = _fitted_planes(inverse, masked, least, camera, supported, normals)
    keep[around] = supported
    return keep, normals[:found]


def _around(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the part of an image (H, W) that holds the `mask` and what its pixels are compared with."""
    parts = []
    for axis in (1, 0):
        held = np.flatnonzero(mask.any(axis=axis))
        parts.append(slice(max(0, held[0] - FIT_WINDOW), held[-1] + 1 + FIT_WINDOW) if len(held) else slice(0, 0))
    return parts[0], parts[1]


def slant(points: Array, normals: NDArray[Any]) -> Array:
    """Return (N,) how fast the depth of surfaces changes with the viewing angle, relative to it [1/rad].

    A plane n . p = c has the depth z = c / (n . ray), so |dz| / z = |(n_x, n_y)| / |n . ray|; at most 10 (84 deg).
    """
    towards = np.abs(np.einsum("ni,ni->n", normals, points)) / np.maximum(points[:, 2], 1e-9)
    return np.hypot(normals[:, 0], normals[:, 1]) / np.maximum(towards, 0.1)


# fastmath lets the compiler use vector instructions; with NumPy's error model it takes a tenth longer
@numba.njit(**OPTIONS | {"fastmath": {"reassoc", "contract"}, "error_model": "python"})
def _fitted_planes(inverse, mask, least, camera, keep, normals):
    """Fill what `surface_pixels` returns, and return how many; `inverse`, of depth, has a margin."""
    height, width = mask.shape
    found, near = 0, range(FIT_WINDOW - 2, FIT_WINDOW + 3)
    for v in range(height):
        for u in range(width):
            middle, count = inverse[v + FIT_WINDOW, u + FIT_WINDOW], 0
            if not mask[v, u] or middle <= 0:
                continue
            for dv in near:
                if count >= least:
                    break
                for du in near:
                    count += abs(inverse[v + dv, u + du] - middle) <= _TOLERANCE
            if count >= least:
                keep[v, u] = True
                _fit_plane(inverse, v, u, camera, normals[found])
                found += 1
    return found


@inlined
def _fit_plane(inverse, v, u, camera, normal):
    """Fill the normal (3,) of the inverse-depth plane through a pixel's neighbours."""
    middle = inverse[v + FIT_WINDOW, u + FIT_WINDOW]
    n = su = sv = suu = suv = svv = sq = suq = svq = np.float32(0)
    for dv in range(-FIT_WINDOW, FIT_WINDOW + 1):
        for du in range(-FIT_WINDOW, FIT_WINDOW + 1):
            q = inverse[v + dv + FIT_WINDOW, u + du + FIT_WINDOW] - middle
            w = np.float32(abs(q) <= _TOLERANCE)
            wu, wv = w * np.float32(du), w * np.float32(dv)
            n += w
            su, sv, sq = su + wu, sv + wv, sq + w * q
            suu, suv, svv = suu + wu * np.float32(du), suv + wu * np.float32(dv), svv + wv * np.float32(dv)
            suq, svq = suq + wu * q, svq + wv * q
    ridge = 8.0  # [px^2], of 196 in a full window: across a petiole two pixels wide no slope can be observed
    a, b, c = suu - su * su / n + ridge, suv - su * sv / n, svv - sv * sv / n + ridge
    e, f = suq - su * sq / n, svq - sv * sq / n
    # 1/z = normal . ray; its derivatives along u and v are the normal's x and y over the focal lengths.
    x = camera[0] * (c * e - b * f) / (a * c - b * b)
    y = camera[1] * (a * f - b * e) / (a * c - b * b)
    w = middle - x * (u - camera[2]) / camera[0] - y * (v - camera[3]) / camera[1]
    length = -np.sqrt(x * x + y * y + w * w)
    normal[0], normal[1], normal[2] = x / length, y / length, w / length


def _inverse(depth: NDArray[Any]) -> NDArray[np.float32]:
    """Return 1 / depth [1/m]; 0 without a reading, which is no neighbour of anything.

    Differences dz of depth at z are z^2 times those of its inverse, so one tolerance for these grows as stereo noise.
    """
    return np.divide(1, depth, out=np.zeros(depth.shape, dtype=np.float32), where=depth > 0)


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Points of the plant's surface: one view's pixels in its camera frame, or all views' voxels in the world.

    Attributes:
        points: (N, 3) [m].
        normals: (N, 3) unit, to the side the points were seen from.
        labels: (N,) uint8.
        colors: (N, 3) uint8; zeros without colour.
    """

    points: Array
    normals: NDArray[Any]
    labels: NDArray[Any]
    colors: NDArray[Any]

    def only(self, keep: NDArray[Any]) -> SurfacePoints:
        """Return the points chosen by a mask (N,) or by indices."""
        if keep.dtype == bool:
            if keep.all():
                return self
            keep = np.flatnonzero(keep)
        return SurfacePoints(self.points[keep], self.normals[keep], self.labels[keep], self.colors[keep])

    def unbiased(self, reach: float) -> SurfacePoints:
        """Return a view's points with slanted surfaces moved back along the rays; see `_wrong_views.Estimate`."""
        factor = 1 + reach * slant(self.points, self.normals)
        return SurfacePoints(self.points * factor[:, None], self.normals, self.labels, self.colors)


def voxel_groups(points: Array, voxel: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return each point's voxel number (N,), in order of first appearance, and the number of points of every voxel.

    Points (N, 3) [m] are less than 2^20 voxels from the origin.
    """
    voxels = _Voxels(len(points), voxel)
    return voxels.add(points), voxels.counts.astype(np.int64)


def voxel_means(points: Array, voxel: float) -> Array:
    """Return the mean point (M, 3) of each voxel; arguments as in `voxel_groups`."""
    voxels = _Voxels(len(points), voxel)
    voxels.add(points)
    return voxels.means


class _Voxels:
    """Means of what lies in each voxel, in order of first appearance: of K columns, the first three points [m].

    Attributes:
        counts: (M,) number of values in every voxel.
        means: (M, K) of these.
    """

    def __init__(self, most: int, voxel: float, columns: int = 3) -> None:
        """Make room for `most` values, of voxels with an edge of `voxel` [m]."""
        self._scale, self._found = 1 / voxel, 0
        self._slots = np.full(1 << (2 * most).bit_length(), -1, dtype=np.int32)
        self._keys, self._sums = np.zeros(most, np.int64), np.zeros((most, columns + 1))

    def add(self, values: Array) -> NDArray[np.int64]:
        """Add values (N, K), and return the numbers (N,) of their voxels."""
        group = np.empty(len(values), dtype=np.int64)
        self._found = _add_to_voxels(
            read_only(values), self._scale, self._slots, group, self._keys, self._sums, self._found
        )
        return group

    @property
    def counts(self) -> Array:
        return self._sums[: self._found, -1]

    @property
    def means(self) -> Array:
        return self._sums[: self._found, :-1] / self.counts[:, None]


@compiled
def _add_to_voxels(values, scale, slots, group, keys, sums, voxels):
    """Number and sum up values' voxels, and return how many there are; `voxels` of them were found before.

    `slots` is a hash table of their numbers, of a power of two, at first all -1; `keys` has the key of each.
    """
    last, here, columns = -1, np.int64(0), values.shape[1]
    for n in range(len(values)):
        key = 0
        for a in range(3):
            key = key << 21 | (np.int64(np.floor(values[n, a] * scale)) & 0x1FFFFF)
        if key != last:  # of pixels side by side it is the same
            corner = (
                key & 0xC0000600003
            )  # two bits each: of a block of 64 voxels, whose slots are side by side in memory
            block, within = key ^ corner, (corner >> 38 | corner >> 19 | corner) & 63
            slot = ((block ^ block >> 29) * 0x5851F42D4C957F2D >> 31 << 6 | within) & (len(slots) - 1)  # MMIX's (Knuth)
            while slots[slot] >= 0 and keys[slots[slot]] != key:
                slot = (slot + 1) & (len(slots) - 1)
            if slots[slot] < 0:
                slots[slot], keys[voxels] = voxels, key
                voxels += 1
            here, last = np.int64(slots[slot]), key
        group[n] = here
        for k in range(columns):
            sums[here, k] += values[n, k]
        sums[here, columns] += 1.0
    return voxels


def fuse_voxels(pixels: list[SurfacePoints], poses: Array, box: Box, voxel: float) -> SurfacePoints:
    """Return the mean point, normal, label and colour of every occupied voxel within the box."""
    voxels = _Voxels(sum(len(view.points) for view in pixels), voxel, columns=10)
    with ThreadPoolExecutor(1) as ahead:  # places the next view while one is added
        coming = ahead.submit(_placed, pixels[0], poses[0], box)
        for seen, pose in zip(pixels[1:], poses[1:], strict=True):
            values, coming = coming.result(), ahead.submit(_placed, seen, pose, box)
            voxels.add(values)
        voxels.add(coming.result())
    means = voxels.means
    facing = means[:, 3:6] / np.maximum(np.linalg.norm(means[:, 3:6], axis=1, keepdims=True), 1e-9)
    majority = np.where(means[:, 6] >= 0.5, FLOWER, PLANT).astype(np.uint8)
    return SurfacePoints(means[:, :3].copy(), facing, majority, np.round(means[:, 7:]).astype(np.uint8))


def _placed(seen: SurfacePoints, T_world_cam: Array, box: Box) -> Array:
    """Return (N, 10) what `fuse_voxels` takes the means of: points, normals, whether of a flower, colours."""
    values = np.empty((len(seen.points), 10))
    values[:, :3] = transform_points(T_world_cam, seen.points)
    values[:, 3:6] = seen.normals @ T_world_cam[:3, :3].T
    values[:, 6] = seen.labels == FLOWER
    values[:, 7:] = seen.colors
    inside = box.contains(values[:, :3])
    return values if inside.all() else values[inside]


def agreeing_points(points: Array, depth: Sequence[NDArray[Any]], intrinsics: Intrinsics, poses: Array) -> NDArray[Any]:
    """Return which points (N,) no more views contradict than support; see `balances`."""
    halves = np.array_split(np.arange(len(points)), 2)

    def agree(half: int) -> NDArray[np.bool_]:
        some, balance = points[halves[half]], np.zeros(len(halves[half]), dtype=np.int16)
        for done, (image, T) in enumerate(zip(depth, poses, strict=True)):
            _balance(some, image, intrinsics, T, balance, len(poses) - done)
        return balance >= 0

    return np.concatenate(in_threads(agree, range(2)))


def balances(points: Array, depth: NDArray[Any], intrinsics: Intrinsics, T_world_cam: Array) -> NDArray[np.int16]:
    """Return what one view says of points (N, 3): 1 supports, -1 contradicts, 0 nothing.

    A view contradicts a point if everything it sees there and one pixel around is at least `SEEN_THROUGH` [m] behind
    it; it supports a point if something there lies within half of that.
    """
    balance = np.zeros(len(points), dtype=np.int16)
    _balance(points, depth, intrinsics, T_world_cam, balance, 1)
    return balance


def _balance(
    points: Array, depth: NDArray[Any], intrinsics: Intrinsics, pose: Array, balance: NDArray[np.int16], left: int
) -> None:
    """Add to `balance` (N,) what a view says of points, where the `left` views, with this one, can make it negative."""
    camera = intrinsics.pinhole, np.ascontiguousarray(inverse(pose))
    _balances(read_only(points), read_only(depth), *camera, balance, left)


@compiled
def _balances(points, depth, k, T, balance, left):
    height, width = depth.shape
    for n in range(points.shape[0]):
        if balance[n] >= left:
            continue
        x, y, w = points[n, 0], points[n, 1], points[n, 2]
        z = T[2, 0] * x + T[2, 1] * y + T[2, 2] * w + T[2, 3]
        if z <= 0:
            continue
        u = np.int64(np.rint(k[0] * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * w + T[0, 3]) / z + k[2]))
        v = np.int64(np.rint(k[1] * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * w + T[1, 3]) / z + k[3]))
        if u < 1 or v < 1 or u >= width - 1 or v >= height - 1:
            continue
        if depth[v, u] > 0 and abs(depth[v, u] - z) < SEEN_THROUGH / 2:
            balance[n] += 1  # of most points the pixel itself says so
            continue
        nearest = least = np.inf
        for j in range(v - 1, v + 2):
            for i in range(u - 1, u + 2):
                seen = np.float64(depth[j, i])
                off = abs(seen - z)
                nearest, least = off if off < nearest else nearest, seen if seen < least else least
        balance[n] += 1 if nearest < SEEN_THROUGH / 2 else (-1 if least > z + SEEN_THROUGH else 0)


def clusters(points: Array, gap: float) -> NDArray[np.int64]:
    """Return the cluster number (N,) of each point (N, 3) [m]: DBSCAN with eps = gap and min_samples = 1, exactly.

    With one sample DBSCAN's clusters are the connected components of all pairs within `gap`. Points of one cell with
    a diagonal of `gap` are connected already, so only points of different cells are compared, those of near cells
    first and those of cells that are already connected no more.
    """
    edge = gap / np.sqrt(3) * (1 - 1e-9)
    cell, count = voxel_groups(points, edge)
    order = np.argsort(cell, kind="stable")
    start, ordered = np.concatenate([[0], np.cumsum(count)]), points[order]
    centres = (np.floor(ordered[start[:-1]] / edge) + 0.5) * edge
    pairs = KDTree(centres).query_pairs(2 * gap, output_type="ndarray") if len(count) else np.zeros((0, 2), np.int64)
    near = np.sum((centres[pairs[:, 0]] - centres[pairs[:, 1]]) ** 2, axis=1) <= gap * gap
    joined = np.arange(len(count))
    for some in (pairs[near], pairs[~near]):
        _join(ordered, start, some, gap * gap, joined)
    return np.unique(joined, return_inverse=True)[1][cell]


@compiled
def _join(points, start, pairs, gap2, joined):
    """Join cells, whose points begin at `start`, that have points within a squared distance: to the lowest number.

    `joined` (M,) is a cell of the same cluster, that of the lowest number in the end; before the first pairs each its
    own.
    """
    for p in range(len(pairs)):
        a, b = pairs[p, 0], pairs[p, 1]
        one, two = a, b
        while joined[one] != one:
            one = joined[one]
        while joined[two] != two:
            two = joined[two]
        if one == two:
            continue
        touching = False
        for i in range(start[a], start[a + 1]):
            for j in range(start[b], start[b + 1]):
                x, y, z = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
                if x * x + y * y + z * z <= gap2:
                    touching = True
                    break
            if touching:
                break
        if touching:
            if one < two:
                joined[two] = one
            else:
                joined[one] = two
    for c in range(len(joined)):
        joined[c] = joined[joined[c]]


def attached_points(points: Array) -> NDArray[np.bool_]:
    """Return which points (N, 3) [m] belong to plants: the largest clusters, and large ones within 50 mm of them.

    The largest have a fifth of the points of the very largest (a guess): a smaller plant beside it stays in view. A
    large one has 0.2 % of the points. The strict largest cluster would lose most of a real plant, whose cloud has
    gaps (facts: skeleton_peers, trap 3).
    """
    part, far = clusters(points, GAP), 0.05
    size = np.bincount(part)
    largest = size >= 0.2 * size.max()
    large = np.flatnonzero((largest | (size >= 0.002 * len(points)))[part])
    group = clusters(points[large], far)  # what joins what, one by one, in one go
    keep = np.zeros(len(points), dtype=np.bool_)
    keep[large] = np.isin(group, group[largest[part[large]]])
    return keep


def occupied_cells(points: Array, views: NDArray[Any], plant: Array, voxel: float) -> Array:
    """Return the centres (M, 3) [m] of cells that really hold a surface other than the plant's.

    A cell needs points (N, 3) of two `views` (N,), a neighbourhood of such cells, and none of the plant (K, 3): pixels
    at the plant's edges, wrongly placed next to it, do not make an obstacle.
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
