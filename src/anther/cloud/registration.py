"""Joint registration of all views with a kinematic prior.

Sequential ICP drifts on plants (facts: perception, 2.4-5.4 mm against 3.6 mm for the arm's own poses). Here every
view may move a little: all views' corrections are found together by Gauss-Newton on robust (Welsch) distances between
neighbouring points of different views, held back by what is known of the arm and the hand-eye calibration.
Dimensions: V views, N points, P pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.checks import check_range
from anther.geometry import Array, inverse, small_transform


@dataclass(frozen=True, slots=True)
class Params:
    """How far the views may move and how their points are matched.

    Attributes:
        rotation_sigma, translation_sigma: standard deviation of one view's pose error, per axis [rad], [m]
            (facts: perception, 0.2 deg and 1.5 mm).
        hand_eye_rotation_sigma, hand_eye_translation_sigma: of the error common to all views, in the camera frame.
        voxel: views are thinned to this spacing for matching [m].
        points_per_view: at most this many points of each view are matched, drawn evenly.
        neighbours: candidates looked up for each point among all views' points.
        match_distances: greatest distance of a match [m], one per round; the map is rebuilt in each.
        source_share: share of these points for which neighbours are looked up in each round.
        normal_angle: matched points' normals differ by at most this [rad]; it keeps the two sides of a stem apart.
        point_sigma: distance scale of the matches [m]; also the Welsch scale in the last round.
        points_per_constraint: neighbouring residuals are alike; this many count as one independent measurement.
        held_out_share: share of the points that judges the result and takes no part in it.
        least_gain: the held-out distance must fall at least by this share, else the arm's own poses are kept.
    """

    rotation_sigma: float = float(np.deg2rad(0.2))
    translation_sigma: float = 0.0015
    hand_eye_rotation_sigma: float = float(np.deg2rad(0.2))
    hand_eye_translation_sigma: float = 0.001
    voxel: float = 0.004
    points_per_view: int = 1500
    neighbours: int = 12
    match_distances: tuple[float, ...] = (0.012, 0.009, 0.007, 0.005)
    source_share: float = 0.4
    normal_angle: float = float(np.deg2rad(40))
    point_sigma: float = 0.0015
    points_per_constraint: float = 8.0
    held_out_share: float = 0.2
    least_gain: float = 0.02

    def __post_init__(self) -> None:
        check_range("registration rotation sigma", self.rotation_sigma, 1e-6, 1, "rad")
        check_range("registration translation sigma", self.translation_sigma, 1e-6, 1, "m")
        check_range("registration voxel", self.voxel, 1e-4, 0.1, "m")


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The registered poses and how they were judged.

    Attributes:
        T_world_cam: (V, 4, 4) camera poses; the given ones where registration declined.
        accepted: whether the poses changed.
        distance_before, distance_after: median robust distance of held-out points to other views' surfaces [m].
        notes: what the user should know.
    """

    T_world_cam: Array
    accepted: bool
    distance_before: float
    distance_after: float
    notes: tuple[str, ...] = ()


def register(points_cam: list[Array], T_world_cam: Array, params: Params | None = None) -> Registration:
    """Return camera poses under which the views agree best, given how far the arm can be wrong.

    Args:
        points_cam: per view (N_v, 3) plant points in its camera frame [m].
        T_world_cam: (V, 4, 4) poses from the arm.
        params: see `Params`.
    """
    params = params or Params()
    views = _thin(points_cam, params.voxel, params.points_per_view)
    given = np.asarray(T_world_cam)
    if len(np.unique(views.view)) < 2:
        return Registration(given, False, np.nan, np.nan, ("registration: fewer than two views show the plant",))
    draw = np.random.default_rng(0).random(len(views.points))
    held_out, source = draw < params.held_out_share, draw > 1 - params.source_share
    poses, pairs = np.array(given), np.zeros((0, 2), dtype=np.int64)
    information = _prior_information(len(given), params)
    for distance in params.match_distances:
        pairs = _match(views, poses, distance, params, source)
        scale = max(params.point_sigma, distance / 3)
        for _ in range(2):
            poses = _gauss_newton_step(views, poses, given, pairs, information=information, scale=scale, params=params)
    if len(pairs) == 0:
        return Registration(given, False, np.nan, np.nan, ("registration: the views share no surface",))
    before, after = (_disagreement(views, T, params, held_out) for T in (given, poses))
    if not after < (1 - params.least_gain) * before:
        note = (
            f"registration declined: held-out points disagree by {1e3 * after:.2f} mm after it, {1e3 * before:.2f} mm "
            "before; the arm's own poses are used"
        )
        return Registration(given, False, before, after, (note,))
    return Registration(poses, True, before, after)


@dataclass(frozen=True, slots=True, eq=False)
class _Views:
    """Thinned points of all views in their camera frames, with unit normals towards the camera."""

    points: Array
    normals: Array
    view: NDArray[Any]

    def world(self, poses: Array) -> tuple[Array, Array]:
        """Return points and normals in the world frame."""
        R = poses[self.view, :3, :3]
        return (
            np.einsum("nij,nj->ni", R, self.points) + poses[self.view, :3, 3],
            np.einsum("nij,nj->ni", R, self.normals),
        )


def _thin(points_cam: list[Array], voxel: float, most: int) -> _Views:
    rng = np.random.default_rng(0)
    points, normals, view = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
    for v, cloud in enumerate(points_cam):
        if len(cloud) < 20:
            continue
        fine = small_gicp.voxelgrid_sampling(np.asarray(cloud), voxel)
        small_gicp.estimate_normals(fine, num_neighbors=12)
        p, n = fine.points()[:, :3], fine.normals()[:, :3]
        n = np.where(np.sum(n * p, axis=1, keepdims=True) > 0, -n, n)
        chosen = rng.permutation(len(p))[:most]
        points.append(p[chosen])
        normals.append(n[chosen])
        view.append(np.full(len(chosen), v, dtype=np.int64))
    return _Views(np.concatenate(points), np.concatenate(normals), np.concatenate(view))


def _prior_information(views: int, params: Params) -> Array:
    """Return the (6V, 6V) inverse covariance of the corrections: each view's own error plus one common to all."""
    own = np.repeat([params.rotation_sigma**2, params.translation_sigma**2], 3)
    common = np.repeat([params.hand_eye_rotation_sigma**2, params.hand_eye_translation_sigma**2], 3)
    covariance = np.kron(np.eye(views), np.diag(own)) + np.kron(np.ones((views, views)), np.diag(common))
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def _match(views: _Views, poses: Array, distance: float, params: Params, use: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return (P, 2) pairs of near points of different views with similar normals; the first ones are in `use`."""
    points, normals = views.world(poses)
    tree = small_gicp.KdTree(np.ascontiguousarray(points))
    first = np.flatnonzero(use)
    near, squared = tree.batch_knn_search(points[first], params.neighbours, num_threads=2)
    a = np.repeat(first, params.neighbours)
    b = near.ravel().astype(np.int64)
    ok = (squared.ravel() < distance**2) & (views.view[a] != views.view[b])
    a, b = a[ok], b[ok]
    alike = np.einsum("pi,pi->p", normals[a], normals[b]) > np.cos(params.normal_angle)
    return np.stack([a[alike], b[alike]], axis=1)


def _gauss_newton_step(
    views: _Views,
    poses: Array,
    given: Array,
    pairs: NDArray[Any],
    *,
    information: Array,
    scale: float,
    params: Params,
) -> Array:
    """Return the poses after one step of the joint problem; corrections act in each camera's frame."""
    hessian, gradient = np.zeros_like(information), np.zeros(len(information))
    world, normals = views.world(poses)
    _accumulate(pairs, views.points, views.view, world, normals, poses, scale, hessian, gradient)
    weight = 1 / (params.point_sigma**2 * params.points_per_constraint)
    error = (inverse(given) @ poses).copy()
    moved = np.concatenate([Rotation.from_matrix(error[:, :3, :3]).as_rotvec(), error[:, :3, 3]], axis=1).ravel()
    step = np.linalg.solve(weight * hessian + information, -(weight * gradient + information @ moved))
    return np.stack([T @ small_transform(d[:3], d[3:]) for T, d in zip(poses, step.reshape(-1, 6), strict=True)])


@numba.njit(cache=True)
def _accumulate(pairs, points, view, world, normals, poses, scale, hessian, gradient):
    """Add the pairs' Welsch-weighted normal equations; weight exp(-(r / scale)^2), Welsch (Holland 1977)."""
    J = np.empty((2, 6))
    for p in range(pairs.shape[0]):
        a, b = pairs[p, 0], pairs[p, 1]
        n = normals[a] + normals[b]
        n /= np.sqrt(n @ n)
        d = world[a] - world[b]
        r = n @ d
        w = np.exp(-(r * r) / (scale * scale))
        for side in range(2):
            i = a if side == 0 else b
            sign = 1.0 if side == 0 else -1.0
            for c in range(3):
                J[side, 3 + c] = 0.0
                for e in range(3):
                    J[side, 3 + c] += sign * poses[view[i], e, c] * n[e]
            J[side, 0] = points[i, 1] * J[side, 5] - points[i, 2] * J[side, 4]
            J[side, 1] = points[i, 2] * J[side, 3] - points[i, 0] * J[side, 5]
            J[side, 2] = points[i, 0] * J[side, 4] - points[i, 1] * J[side, 3]
        for s in range(2):
            base = 6 * view[a if s == 0 else b]
            for k in range(6):
                gradient[base + k] += w * r * J[s, k]
                for t in range(2):
                    other = 6 * view[a if t == 0 else b]
                    for m in range(6):
                        hessian[base + k, other + m] += w * J[s, k] * J[t, m]


def _disagreement(views: _Views, poses: Array, params: Params, held_out: NDArray[np.bool_]) -> float:
    """Return the median distance [m] of held-out points to the tangent planes of other views' points."""
    pairs = _match(views, poses, params.match_distances[0], params, held_out)
    if len(pairs) == 0:
        return np.inf
    world, normals = views.world(poses)
    offset = world[pairs[:, 0]] - world[pairs[:, 1]]
    return float(np.median(np.abs(np.einsum("pi,pi->p", normals[pairs[:, 1]], offset))))
