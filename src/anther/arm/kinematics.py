"""Inverse kinematics of the Sawyer: all useful branches, and joint paths that follow the flange.

B branches, K seeds, N poses.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import qmc

from anther.arm import sawyer
from anther.arm.newton import newton_step
from anther.checks import check_transform
from anther.geometry import Array

LIMIT_MARGIN = 0.05  # rad kept free at both ends of every joint's range
SAME = 0.25  # rad, solutions closer than this in every joint count as one branch
SHOULDER = np.array([0.0, 0.0, 0.317])
ITERATIONS = 25  # of Newton; seeds that need more are given up
REACH = 1.13  # m, farthest flange from the shoulder (facts: sawyer 2)


def inverse(T_world_flange: ArrayLike, *, near: ArrayLike | None = None, seeds: int = 48) -> Array:
    """Return joint solutions (B, 7) [rad] of one flange pose, B = 0 when it is out of reach.

    Damped Newton steps (Levenberg-Marquardt) from many seeds at once: those of a fixed table of arm postures whose
    flange is nearest to the pose. With seven joints the solutions form curves (the elbow turns); they are sampled,
    `SAME` apart, and right_j6 is tried a full turn either way.

    Args:
        T_world_flange: (4, 4).
        near: (7,) joints; solutions come ordered by distance from them. None orders by room to the joint limits.
        seeds: how many postures to start from.
    """
    origin = None if near is None else np.asarray(near, dtype=np.float64)
    return inverse_many(check_transform("flange pose", T_world_flange)[None], near=origin, seeds=seeds)[0]


def inverse_many(T_world_flange: Array, *, near: Array | None = None, seeds: int = 16) -> list[Array]:
    """Return joint solutions (B, 7) of each of (N, 4, 4) flange poses, solved together; see `inverse`."""
    within = np.flatnonzero(np.linalg.norm(T_world_flange[:, :3, 3] - SHOULDER, axis=1) <= REACH)
    first = np.zeros((0, 7)) if near is None else near[None]
    starts = [np.concatenate([first, _nearest_postures(T_world_flange[i], seeds)]) for i in within]
    pose = np.repeat(within, len(first) + seeds)
    found, of_pose = _solve(T_world_flange, pose, np.concatenate([np.zeros((0, 7)), *starts]))
    return [_useful(found[of_pose == i], near) for i in range(len(T_world_flange))]


def _useful(q: Array, near: Array | None) -> Array:
    """Return the distinct solutions within limits in order of preference."""
    q = _turned(q)
    q = q[np.all((q >= sawyer.LOWER + LIMIT_MARGIN) & (q <= sawyer.UPPER - LIMIT_MARGIN), axis=1)]
    cost = -limit_room(q) if near is None else np.abs(q - near).max(axis=1)
    return _distinct(q[np.argsort(cost, kind="stable")])


def limit_room(q: Array) -> Array:
    """Return (...,) the smallest distance of any joint from its limits, as a share of half its range."""
    half = (sawyer.UPPER - sawyer.LOWER) / 2
    return 1 - np.max(np.abs(q - (sawyer.LOWER + half)) / half, axis=-1)


def follow(q: Array, targets: Array) -> Array:
    """Return joints (B, N, 7) that carry the flange from branches q (B, 7) through poses (N, 4, 4), or NaN where lost.

    Each step is the smallest joint motion; a branch is lost when the pose cannot be met to 1e-7 m and rad.
    """
    path = np.empty((len(q), len(targets), 7))
    now = np.array(q, dtype=np.float64)
    for n, target in enumerate(targets):
        now, missed = _meet(now, target)
        outside = np.any((now < sawyer.LOWER) | (now > sawyer.UPPER), axis=-1)
        now = np.where((missed | outside)[:, None], np.nan, now)
        path[:, n] = now
    return path


def _meet(q: Array, target: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return joints (B, 7) near q whose flange is at the pose, and which of them (B,) miss it."""
    step, error = newton_step(q, target, damping=1e-8)
    for _ in range(6):
        if np.all(np.abs(error) < 1e-7):
            break
        q = q + step
        step, error = newton_step(q, target, damping=1e-8)
    return q, ~np.all(np.abs(error) < 1e-7, axis=-1)


def _solve(targets: Array, pose: NDArray[np.intp], q: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the seeds (K, 7), each for the target its `pose` (K,) names, that converged, and their poses."""
    solved, of_pose = [np.zeros((0, 7))], [pose[:0]]
    for k in range(ITERATIONS):
        step, error = newton_step(q, targets[pose], damping=1e-6 if k > 6 else 1e-3)
        done = np.abs(error).max(axis=1) < 1e-7
        solved.append(q[done])
        of_pose.append(pose[done])
        q, pose = np.clip(q[~done] + np.clip(step[~done], -0.5, 0.5), sawyer.LOWER, sawyer.UPPER), pose[~done]
        if len(q) == 0:
            break
    return np.concatenate(solved), np.concatenate(of_pose)


@cache
def _postures() -> tuple[Array, Array]:
    """Return a fixed table of joints (4096, 7) within limits and the flange poses (4096, 4, 4) they give."""
    q = qmc.scale(qmc.Sobol(7, scramble=False).random_base2(12), sawyer.LOWER, sawyer.UPPER)
    return q, sawyer.forward(q)


def _nearest_postures(target: Array, count: int) -> Array:
    q, poses = _postures()
    turn = np.einsum("kij,ij->k", poses[:, :3, :3], target[:3, :3])  # trace of the rotation between
    distance = np.linalg.norm(poses[:, :3, 3] - target[:3, 3], axis=1) + 0.15 * (3 - turn)
    return q[np.argpartition(distance, count)[:count]]


def _turned(q: Array) -> Array:
    """Return the solutions with right_j6, which turns more than once, also a full turn either way."""
    turn = np.zeros(7)
    turn[6] = 2 * np.pi
    return np.concatenate([q, q + turn, q - turn])


def _distinct(q: Array) -> Array:
    kept = np.empty_like(q)
    count = 0
    for candidate in q:
        if np.all(np.abs(kept[:count] - candidate).max(axis=1) > SAME):
            kept[count] = candidate
            count += 1
    return kept[:count]
