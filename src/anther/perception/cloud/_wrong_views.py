"""Which points of different views lie on the same surface; views that the others contradict, and where they belong.

Dimensions: V views, N points, P pairs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core.geometry import Array, inverse
from anther.perception.capture import in_threads
from anther.perception.cloud._fusion import slant, voxel_means

THREADS = 2
SEARCH = 0.04
"""How far around its given place a view that the others contradict is searched for [m]; a guess."""
NEIGHBOURS = 12
"""Points that a normal is fitted to, and candidates looked up for each point among all views' points."""


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
    def of(cls, points_cam: list[Array], voxel: float, most: int) -> Sample:
        """Return at most `most` points of each view, thinned to `voxel` [m]; normals are fitted to `NEIGHBOURS`."""
        rng = np.random.default_rng(0)
        draws = [rng.permutation(len(cloud)) for cloud in points_cam]

        def thinned(view: int) -> tuple[Array, Array]:
            fine, order = voxel_means(points_cam[view], voxel), draws[view]
            if len(fine) < NEIGHBOURS:
                return np.zeros((0, 3)), np.zeros((0, 3))
            chosen = fine[order[order < len(fine)][:most]]
            return chosen, normals_at(chosen, fine)

        views = in_threads(thinned, range(len(points_cam)))
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


def match(sample: Sample, at: Estimate, use: NDArray[np.bool_], distance: float) -> NDArray[np.int64]:
    """Return (P, 2) pairs of points of different views within `distance` [m], alike in normal, the first in `use`.

    Pairs of the same two views follow each other.
    """
    points, normals = sample.world(at)
    first = np.flatnonzero(use)
    if len(first) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    tree = small_gicp.KdTree(np.ascontiguousarray(points), num_threads=THREADS)
    near, squared = tree.batch_knn_search(points[first], NEIGHBOURS, num_threads=THREADS)
    near, views = near.astype(np.int64), sample.view
    pair = np.flatnonzero((squared < distance**2) & (views[near] != views[first][:, None]))
    first, near = first[pair // NEIGHBOURS], near.ravel()[pair]
    alike = np.einsum("pi,pi->p", normals[first], normals[near]) > np.cos(np.deg2rad(25))  # one side of a stem
    pairs = np.stack([first[alike], near[alike]], axis=1)  # the first points' views rise
    return pairs[np.argsort(views[pairs[:, 1]].astype(np.int16), kind="stable")]  # of 16 bits: many times quicker


def plane_distances(sample: Sample, at: Estimate, pairs: NDArray[Any]) -> Array:
    """Return (P,) distances [m] along the mean normal of each pair."""
    world, normals = sample.world(at)
    mean = normals[pairs[:, 0]] + normals[pairs[:, 1]]
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    return np.abs(np.einsum("pi,pi->p", mean, world[pairs[:, 0]] - world[pairs[:, 1]]))


def normals_at(points: Array, cloud: Array) -> Array:
    """Return the unit normals (N, 3), towards the camera, of planes through the nearest points of `cloud` (M, 3)."""
    near, _ = small_gicp.KdTree(cloud).batch_knn_search(points, NEIGHBOURS)
    around = cloud[near.astype(np.int64)]
    around -= around.mean(axis=1, keepdims=True)
    n = thinnest(np.swapaxes(around, 1, 2) @ around)
    return np.where(np.einsum("ni,ni->n", n, points)[:, None] > 0, -n, n)


def thinnest(scatter: Array) -> Array:
    """Return the unit vectors (N, 3) along which scatters (N, 3, 3), symmetric, are least: across what is flat.

    By the roots of their cubic (Smith 1961), a fifth of LAPACK's time. Zeros where all directions are alike.
    """
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = np.moveaxis(scatter, 0, -1)
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    size = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    half = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / np.maximum(2 * size**3, 1e-300)
    least = 2 * size * np.cos((np.arccos(np.clip(half, -1, 1)) + 2 * np.pi) / 3)
    rows = np.stack([np.stack(row, axis=-1) for row in ((a - least, xy, xz), (xy, b - least, yz), (xz, yz, c - least))])
    across = np.cross(rows, np.roll(rows, -1, axis=0))  # of a matrix of rank two, each pair of rows gives it
    squared = np.sum(across * across, axis=2)
    best = squared.argmax(axis=0), np.arange(len(scatter))
    return across[best] / np.sqrt(np.maximum(squared[best], 1e-300))[:, None]


def correct_views(sample: Sample, given: Array, found: Estimate) -> tuple[Array, NDArray[Any], NDArray[Any], Array]:
    """Correct the poses of views that the others contradict under the estimate `found`; `given` are the arm's poses.

    Returns:
        (V, 4, 4) poses of all views: the contradicted ones where they fit, or as given where they fit nowhere; (V,)
        which are contradicted; (V,) which are used, all but those that fit nowhere; (V,) agreement of all before. A
        contradicted view has less than 0.7 of the median view's agreement.
    """
    agrees = agreement(sample, found, range(len(given)))
    bar = 0.7 * np.nanmedian(agrees) if np.isfinite(agrees).any() else 0.0
    wrong, poses, used = agrees < bar, found.poses.copy(), np.ones(len(given), dtype=bool)
    for view in np.flatnonzero(wrong).tolist():
        others = sample.only(~wrong[sample.view] | (sample.view == view))
        agreed, pose = relocate_view(others, found, view)
        used[view] = agreed >= bar
        poses[view] = pose if used[view] else given[view]
    return poses, wrong, used, agrees


def agreement(sample: Sample, at: Estimate, views: Iterable[int]) -> Array:
    """Return for each of `views` the share of its points that lie on a surface other views see, of those near any.

    0 where a view has points enough but hardly any near what others see; NaN where it has too few. One point
    in four is judged.
    """
    sample = sample.only(np.arange(len(sample.view)) % 4 == 0)
    points, normals = sample.world(at)
    return np.array(in_threads(lambda v: share_on_surfaces(points, normals, sample.view == v), views))


def relocate_view(sample: Sample, at: Estimate, view: int) -> tuple[float, Array]:
    """Return the pose (4, 4) near the view's present one that fits the other views best, and how well it agrees.

    All shifts up to `SEARCH` along each axis are scored by how close the points come to the other views'; the best
    are refined by point-to-plane ICP, and the one that agrees best is returned.
    """
    step = SEARCH / 4
    points, _ = sample.world(at)
    own = sample.view == view
    others = points[~own]
    target, unbiased, tried = with_normals(others), with_normals(sample.unbiased(at.reach)[own]), []
    tree = small_gicp.KdTree(target, num_threads=THREADS)
    for shift in best_shifts(points[own], tree, grid([SEARCH] * 3, step), step, most=3):
        poses = at.poses.copy()
        poses[view, :3, 3] += shift
        poses[view] = refined(target, unbiased, tree, poses[view], step)
        tried.append((float(np.nan_to_num(agreement(sample, Estimate(poses, at.reach), [view])[0])), poses[view]))
    return max(tried, key=lambda found: found[0])


def refined(
    target: small_gicp.PointCloud, source: small_gicp.PointCloud, tree: small_gicp.KdTree, T: Array, step: float
) -> Array:
    """Return T_target_source (4, 4) by point-to-plane ICP from T, which may be half a `step` [m] off.

    small_gicp's own tolerances, 0.1 deg and 1 mm, stop too early (facts: perception).
    """
    for distance in (2 * step, step / 2):
        T = np.asarray(small_gicp.align(
            target, source, tree, T, registration_type="PLANE_ICP",
            max_correspondence_distance=distance, num_threads=THREADS, max_iterations=60,
            rotation_epsilon=1e-5, translation_epsilon=1e-6,
        ).T_target_source)  # fmt: skip
    return T


def follow_way(sample: Sample, given: Array) -> Array:
    """Return (V, 4, 4) poses of views that a cart took on its way, each where it fits those after it.

    Odometry's errors add up backwards from the last view, by more than what matching finds its way from.
    """
    poses = given.copy()
    for view in range(len(given) - 2, -1, -1):
        poses[view] = poses[view + 1] @ inverse(given[view + 1]) @ given[view]
        _, poses[view] = relocate_view(sample.only(sample.view >= view), Estimate(poses), view)
    return poses


def with_normals(points: Array) -> small_gicp.PointCloud:
    """Return points (N, 3) [m] with normals, as small_gicp wants them."""
    cloud = small_gicp.PointCloud(np.ascontiguousarray(points))
    small_gicp.estimate_normals_covariances(cloud, num_neighbors=NEIGHBOURS, num_threads=THREADS)
    return cloud


def share_on_surfaces(points: Array, normals: Array, own: NDArray[np.bool_]) -> float:
    """Return the share of `own` points (N,) on a surface of the others, of those with any of them within 20 mm.

    On a surface: within 2 mm, less than the arm's error, of a neighbour's plane whose normal differs by 40 degrees at
    most; a leaf's two sides count as one. Fewer than 50 points are no evidence.
    """
    near_by, few = 0.02, 50
    if own.all() or not own.any():
        return np.nan
    tree = KDTree(points[~own], compact_nodes=False, balanced_tree=False)  # built in half the time
    distance, near = tree.query(points[own], 6, distance_upper_bound=near_by)
    judged, near = distance[:, 0] < near_by, np.minimum(near, (~own).sum() - 1)
    if judged.sum() < few:
        return 0.0 if own.sum() >= 2 * few else np.nan
    n = normals[~own][near]
    apart = np.abs(np.einsum("nki,nki->nk", n, points[own][:, None] - points[~own][near]))
    alike = np.abs(np.einsum("nki,ni->nk", n, normals[own])) > np.cos(np.deg2rad(40))
    agrees = (alike & (apart < 0.002) & (distance < near_by)).any(axis=1)
    return float(agrees[judged].mean())


def grid(reach: Sequence[float], step: float) -> Array:
    """Return shifts (K, 3) on a grid: up to `reach` (3,) along each axis, `step` apart [m]."""
    axes = [np.arange(-most, most + step / 2, step) for most in reach]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def best_shifts(source: Array, target: small_gicp.KdTree, shifts: Array, step: float, most: int) -> Array:
    """Return those of shifts (K, 3), `step` apart [m], that bring source points closest to the target's, best first."""
    few = source[:: max(1, len(source) // 100)]
    _, squared = target.batch_knn_search((few + shifts[:, None]).reshape(-1, 3), 1, num_threads=THREADS)
    score = np.exp(-squared.reshape(len(shifts), -1) / (step / 2) ** 2).mean(axis=1)
    return shifts[np.argsort(-score)[:most]]
