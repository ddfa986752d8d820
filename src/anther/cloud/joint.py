"""All views' poses at once: Gauss-Newton on robust distances, held back by what is known of the arm.

Unknown are a small correction of each pose, in its camera's frame, and one bias of the sensor: a stereo camera's
matching window lets the nearest depth within it win, so a slanted surface is seen too near, by the window's reach times
the slant (`Estimate.reach`). Views from different sides disagree about it, which tells it from the poses.
Dimensions: V views, P pairs.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.cloud.matching import THREADS, Estimate, Sample
from anther.geometry import Array, inverse, small_transform


def prior_information(views: int, own: tuple[float, float], common: tuple[float, float], reach: float) -> Array:
    """Return the (6V + 1, 6V + 1) inverse covariance of the unknowns.

    Args:
        views: V.
        own: standard deviations [rad], [m] per axis of each view's pose.
        common: of the error that all views share in the camera frame, which is what a hand-eye calibration leaves.
        reach: standard deviation of the window's reach about zero [rad].
    """

    def variances(sigmas: tuple[float, float]) -> Array:
        return np.diag(np.repeat(np.square(sigmas), 3))

    covariance = np.kron(np.eye(views), variances(own)) + np.kron(np.ones((views, views)), variances(common))
    information = np.zeros((6 * views + 1, 6 * views + 1))
    information[:-1, :-1] = np.linalg.inv(covariance)
    information[-1, -1] = reach**-2
    return information


class Problem(NamedTuple):
    """What a Gauss-Newton step needs besides the estimate.

    Attributes:
        sample: the points.
        pairs: (P, 2) from `match`.
        given: (V, 4, 4) poses the prior is about.
        information: from `prior_information`.
        scale: of the Welsch weights [m].
        weight: inverse variance of one pair's distance [1/m^2].
    """

    sample: Sample
    pairs: NDArray[np.int64]
    given: Array
    information: Array
    scale: float
    weight: float


def step(problem: Problem, at: Estimate, *, reach_fixed: bool = False) -> Estimate:
    """Return the estimate after one Gauss-Newton step; with `reach_fixed` only the poses change."""
    information, weight = problem.information, problem.weight
    hessian, gradient = _normal_equations(problem, at)
    hessian += hessian.T - np.diag(np.diag(hessian))
    error = inverse(problem.given) @ at.poses
    turned = Rotation.from_matrix(error[:, :3, :3].copy()).as_rotvec()
    moved = np.append(np.concatenate([turned, error[:, :3, 3]], axis=1).ravel(), at.reach)
    free = slice(-1) if reach_fixed else slice(None)
    change = np.zeros(len(information))
    change[free] = np.linalg.solve(
        (weight * hessian + information)[free, free], -(weight * gradient + information @ moved)[free]
    )
    poses = [T @ small_transform(d[:3], d[3:]) for T, d in zip(at.poses, change[:-1].reshape(-1, 6), strict=True)]
    return Estimate(np.stack(poses), at.reach + change[-1])


def _normal_equations(problem: Problem, at: Estimate) -> tuple[Array, Array]:
    """Return the upper entries of the Hessian (6V + 1, 6V + 1) and the gradient; threads share the pairs."""
    sample, size = problem.sample, len(problem.information)
    world, normals = sample.world(at)
    points, along = sample.unbiased(at.reach), sample.points * sample.slant[:, None]
    hessians, gradients = np.zeros((THREADS, size, size)), np.zeros((THREADS, size))

    def accumulate(t: int) -> None:
        pairs = problem.pairs[t::THREADS]
        _accumulate(
            pairs, points, along, sample.view, world, normals, at.poses, problem.scale, hessians[t], gradients[t]
        )

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(accumulate, range(THREADS)))
    return hessians.sum(axis=0), gradients.sum(axis=0)


@numba.njit(nogil=True, cache=True)
def _accumulate(pairs, points, along, view, world, normals, poses, scale, hessian, gradient):
    """Add the pairs' Welsch-weighted normal equations; weight exp(-(r / scale)^2), Welsch (Holland 1977).

    Of each two symmetric entries of the Hessian only one is added.
    """
    last = len(gradient) - 1
    row, index = np.empty(13), np.empty(13, dtype=np.int64)
    index[12] = last
    for p in range(pairs.shape[0]):
        a, b = pairs[p, 0], pairs[p, 1]
        n0, n1, n2 = normals[a, 0] + normals[b, 0], normals[a, 1] + normals[b, 1], normals[a, 2] + normals[b, 2]
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        n0, n1, n2 = n0 / length, n1 / length, n2 / length
        r = n0 * (world[a, 0] - world[b, 0]) + n1 * (world[a, 1] - world[b, 1]) + n2 * (world[a, 2] - world[b, 2])
        w = np.exp(-(r * r) / (scale * scale))
        row[12] = 0.0
        for side in range(2):
            i = pairs[p, side]
            sign, T = 1.0 - 2.0 * side, poses[view[i]]
            m0 = sign * (T[0, 0] * n0 + T[1, 0] * n1 + T[2, 0] * n2)
            m1 = sign * (T[0, 1] * n0 + T[1, 1] * n1 + T[2, 1] * n2)
            m2 = sign * (T[0, 2] * n0 + T[1, 2] * n1 + T[2, 2] * n2)
            base = 6 * side
            row[base] = points[i, 1] * m2 - points[i, 2] * m1
            row[base + 1] = points[i, 2] * m0 - points[i, 0] * m2
            row[base + 2] = points[i, 0] * m1 - points[i, 1] * m0
            row[base + 3], row[base + 4], row[base + 5] = m0, m1, m2
            row[12] += along[i, 0] * m0 + along[i, 1] * m1 + along[i, 2] * m2
            for k in range(6):
                index[base + k] = 6 * view[i] + k
        for k in range(13):
            weighted, to = w * row[k], index[k]
            gradient[to] += weighted * r
            for q in range(k, 13):
                hessian[to, index[q]] += weighted * row[q]
