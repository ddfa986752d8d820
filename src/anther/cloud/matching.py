"""Points of different views that lie on the same surface. Dimensions: V views, N points, P pairs."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import small_gicp
from numpy.typing import NDArray

from anther.cloud.clusters import voxel_means
from anther.cloud.pixels import slant
from anther.geometry import Array

THREADS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What registration is after.

    Attributes:
        poses: (V, 4, 4) T_world_cam.
        reach: of the stereo camera's matching window, within which the nearest depth wins [rad]: a surface is seen
            too near by its slant times this.
    """

    poses: Array
    reach: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Thinned points of all views in their camera frames.

    Attributes:
        points: (N, 3) [m].
        normals: (N, 3) unit, towards the camera.
        slant: (N,) relative change of depth per viewing angle [1/rad].
        view: (N,) the view of each, rising.
    """

    points: Array
    normals: Array
    slant: Array
    view: NDArray[np.int64]

    @classmethod
    def of(cls, points_cam: list[Array], voxel: float, most: int, neighbours: int = 12) -> Sample:
        """Return at most `most` points of each view, thinned to `voxel` [m]; normals are fitted to `neighbours`."""
        rng = np.random.default_rng(0)
        draws = [rng.permutation(len(cloud)) for cloud in points_cam]

        def thinned(cloud: Array, order: NDArray[Any]) -> tuple[Array, Array]:
            fine = voxel_means(cloud, voxel)
            if len(fine) < neighbours:
                return np.zeros((0, 3)), np.zeros((0, 3))
            chosen = fine[order[order < len(fine)][:most]]
            return chosen, _normals(chosen, fine, neighbours)

        with ThreadPoolExecutor(THREADS) as pool:
            views = list(pool.map(thinned, points_cam, draws))
        p, n = (np.concatenate([np.zeros((0, 3)), *columns]) for columns in zip(*views, strict=True))
        return cls(p, n, slant(p, n), np.repeat(np.arange(len(views)), [len(q) for q, _ in views]))

    def only(self, keep: NDArray[np.bool_]) -> Sample:
        """Return the points for which `keep` (N,) is true."""
        return Sample(self.points[keep], self.normals[keep], self.slant[keep], self.view[keep])

    def unbiased(self, reach: float) -> Array:
        """Return the points (N, 3) [m] of the camera frames with the sensor's bias taken off."""
        return self.points * (1 + reach * self.slant)[:, None]

    def world(self, at: Estimate) -> tuple[Array, Array]:
        """Return points and normals (N, 3) in the world frame."""
        points, normals = self.unbiased(at.reach), np.empty_like(self.normals)
        start = np.searchsorted(self.view, np.arange(len(at.poses) + 1))
        for T, a, b in zip(at.poses, start[:-1], start[1:], strict=True):
            points[a:b] = points[a:b] @ T[:3, :3].T + T[:3, 3]
            normals[a:b] = self.normals[a:b] @ T[:3, :3].T
        return points, normals


def match(
    sample: Sample, at: Estimate, use: NDArray[np.bool_], *, neighbours: int, distance: float, angle: float
) -> NDArray[np.int64]:
    """Return (P, 2) pairs of near points of different views with similar normals; the first ones are in `use`.

    Args:
        sample: the points.
        at: where the views are.
        use: (N,) points for which neighbours are looked up.
        neighbours: candidates of each.
        distance: greatest distance of a pair [m].
        angle: greatest angle between the normals [rad].
    """
    points, normals = sample.world(at)
    first = np.flatnonzero(use)
    if len(first) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    tree = small_gicp.KdTree(np.ascontiguousarray(points), num_threads=THREADS)
    near, squared = tree.batch_knn_search(points[first], neighbours, num_threads=THREADS)
    return _pairs(first, near.astype(np.int64), squared, sample.view, normals, distance**2, np.cos(angle))


@numba.njit(nogil=True, cache=True)
def _pairs(first, near, squared, view, normals, distance2, cosine):
    pairs = np.empty((near.size, 2), dtype=np.int64)
    count = 0
    for k in range(first.size):
        a = first[k]
        for c in range(near.shape[1]):
            b = near[k, c]
            alike = normals[a, 0] * normals[b, 0] + normals[a, 1] * normals[b, 1] + normals[a, 2] * normals[b, 2]
            if squared[k, c] < distance2 and view[a] != view[b] and alike > cosine:
                pairs[count, 0], pairs[count, 1] = a, b
                count += 1
    return pairs[:count]


def plane_distances(sample: Sample, at: Estimate, pairs: NDArray[Any]) -> Array:
    """Return (P,) distances [m] along the mean normal of each pair."""
    world, normals = sample.world(at)
    mean = normals[pairs[:, 0]] + normals[pairs[:, 1]]
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    return np.abs(np.einsum("pi,pi->p", mean, world[pairs[:, 0]] - world[pairs[:, 1]]))


def _normals(points: Array, cloud: Array, neighbours: int) -> Array:
    """Return the unit normals (N, 3), towards the camera, of planes through the nearest points of `cloud` (M, 3)."""
    near, _ = small_gicp.KdTree(cloud).batch_knn_search(points, neighbours)
    around = cloud[near.astype(np.int64)]
    around -= around.mean(axis=1, keepdims=True)
    n = np.linalg.eigh(np.swapaxes(around, 1, 2) @ around)[1][:, :, 0]
    return np.where(np.einsum("ni,ni->n", n, points)[:, None] > 0, -n, n)
