"""Inverse kinematics of an arm: all useful branches, and joint paths that follow the flange.

B branches, K seeds, N poses.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy  # loads `scipy.stats`, which takes long, where it is used
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from anther.core.checks import check_transform
from anther.core.compiling import inlined, njit, read_only
from anther.core.geometry import Array
from anther.robot.arm.model import ArmModel


def inverse(arm: ArmModel, T_world_flange: ArrayLike, *, near: ArrayLike | None = None, seeds: int = 48) -> Array:
    """Return joint solutions (B, J) [rad] of one flange pose, B = 0 when it is out of reach.

    Damped Newton steps (Levenberg-Marquardt) from many seeds at once: those of a fixed table of arm postures whose
    flange is nearest to the pose. With more than six joints the solutions form curves (the elbow turns); they are
    sampled, 0.25 rad apart. Joints that turn more than once are tried a full turn either way.

    Args:
        T_world_flange: (4, 4).
        near: (J,) joints; solutions come ordered by distance from them. None orders by room to the joint limits.
        seeds: how many postures to start from.
    """
    origin = None if near is None else np.asarray(near, dtype=np.float64)
    return inverse_many(arm, check_transform("flange pose", T_world_flange)[None], near=origin, seeds=seeds)[0]


def inverse_many(arm: ArmModel, T_world_flange: Array, *, near: Array | None = None, seeds: int = 16) -> list[Array]:
    """Return joint solutions (B, J) of each of (N, 4, 4) flange poses, solved together; see `inverse`."""
    within = np.flatnonzero(np.linalg.norm(T_world_flange[:, :3, 3] - arm.shoulder, axis=1) <= arm.reach)
    first = np.zeros((0, arm.count)) if near is None else near[None]
    starts = [np.concatenate([first, _nearest_postures(arm, T_world_flange[i], seeds)]) for i in within]
    pose = np.repeat(within, len(first) + seeds)
    found, of_pose = _solve(arm, T_world_flange, pose, np.concatenate([np.zeros((0, arm.count)), *starts]))
    return [_useful(arm, found[of_pose == i], near) for i in range(len(T_world_flange))]


def _useful(arm: ArmModel, q: Array, near: Array | None) -> Array:
    """Return the distinct solutions within limits in order of preference."""
    margin = 0.05  # kept free at both ends of every joint's range [rad]
    q = _add_full_turns(arm, q)
    q = q[np.all((q >= arm.lower + margin) & (q <= arm.upper - margin), axis=1)]
    half = (arm.upper - arm.lower) / 2
    towards_limits = np.max(np.abs(q - (arm.lower + half)) / half, axis=-1)
    cost = towards_limits - 1 if near is None else np.abs(q - near).max(axis=1)
    return _distinct(q[np.argsort(cost, kind="stable")])


def follow(arm: ArmModel, q: Array, targets: Array) -> Array:
    """Return joints (B, N, J) that carry the flange from branches q (B, J) through poses (N, 4, 4), or NaN where lost.

    Each step is the smallest joint motion; a branch is lost when the pose cannot be met to 1e-7 m and rad.
    """
    path = np.empty((len(q), len(targets), arm.count))
    now = np.array(q, dtype=np.float64)
    for n, target in enumerate(targets):
        now, missed = _meet(arm, now, target)
        outside = np.any((now < arm.lower) | (now > arm.upper), axis=-1)
        now = np.where((missed | outside)[:, None], np.nan, now)
        path[:, n] = now
    return path


def _meet(arm: ArmModel, q: Array, target: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return joints (B, J) near q whose flange is at the pose, and which of them (B,) miss it."""
    step, error = newton_step(arm, q, target, damping=1e-8)
    for _ in range(6):
        if np.all(np.abs(error) < 1e-7):
            break
        q = q + step
        step, error = newton_step(arm, q, target, damping=1e-8)
    return q, ~np.all(np.abs(error) < 1e-7, axis=-1)


def _solve(arm: ArmModel, targets: Array, pose: NDArray[np.intp], q: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the seeds (K, J), each for the target its `pose` (K,) names, that converged, and their poses."""
    solved, of_pose = [np.zeros((0, arm.count))], [pose[:0]]
    for k in range(25):  # Newton steps; seeds that need more are given up
        step, error = newton_step(arm, q, targets[pose], damping=1e-6 if k > 6 else 1e-3)
        done = np.abs(error).max(axis=1) < 1e-7
        solved.append(q[done])
        of_pose.append(pose[done])
        q, pose = np.clip(q[~done] + np.clip(step[~done], -0.5, 0.5), arm.lower, arm.upper), pose[~done]
        if len(q) == 0:
            break
    return np.concatenate(solved), np.concatenate(of_pose)


@cache
def _postures(arm: ArmModel) -> tuple[Array, Array]:
    """Return a fixed table of joints (4096, J) within limits and the flange poses (4096, 4, 4) they give."""
    q = scipy.stats.qmc.scale(scipy.stats.qmc.Sobol(arm.count, scramble=False).random_base2(12), arm.lower, arm.upper)
    return q, arm.forward(q)


def _nearest_postures(arm: ArmModel, target: Array, count: int) -> Array:
    q, poses = _postures(arm)
    turn = np.einsum("kij,ij->k", poses[:, :3, :3], target[:3, :3])  # trace of the rotation between
    distance = np.linalg.norm(poses[:, :3, 3] - target[:3, 3], axis=1) + 0.15 * (3 - turn)
    return q[np.argpartition(distance, count)[:count]]


def _add_full_turns(arm: ArmModel, q: Array) -> Array:
    """Return the solutions with each joint that turns more than once also a full turn either way."""
    for joint in np.flatnonzero(arm.upper - arm.lower > 2 * np.pi):
        turn = np.zeros(arm.count)
        turn[joint] = 2 * np.pi
        q = np.concatenate([q, q + turn, q - turn])
    return q


def _distinct(q: Array) -> Array:
    same = 0.25  # solutions closer than this in every joint count as one branch [rad]
    kept = np.empty_like(q)
    count = 0
    for candidate in q:
        if np.all(np.abs(kept[:count] - candidate).max(axis=1) > same):
            kept[count] = candidate
            count += 1
    return kept[:count]


def newton_step(arm: ArmModel, q: Array, target: Array, *, damping: float) -> tuple[Array, Array]:
    """Return the damped joint steps (K, J) [rad] towards `target`, and the pose errors (K, 6) before them.

    A step is J^T (J J^T + damping I)^-1 e (Levenberg-Marquardt; Nakamura and Hanafusa 1986), e the
    translation [m] and rotation vector [rad], in the base frame, from where the flange is to the target.

    Args:
        q: (K, J) joints [rad].
        target: (4, 4) flange pose of all, or (K, 4, 4) of each.
        damping: added to the diagonal.
    """
    steps, errors = np.empty(q.shape), np.empty((len(q), 6))
    targets = read_only(np.broadcast_to(target, (len(q), 4, 4)))
    _steps(read_only(q), targets, damping, read_only(arm.local), arm.T_last_flange, steps, errors)
    return steps, errors


@njit(cache=True)
def _steps(q, targets, damping, local, tip, steps, errors):
    """Fill in steps and errors, number by number: each of NumPy's own operations would be compiled as well."""
    count = q.shape[1]
    pose, turned, square = np.empty((3, 4)), np.empty((4, 4)), np.empty((6, 6))
    axes, origins, jacobian, scratch = np.empty((count, 3)), np.empty((count, 3)), np.empty((6, count)), np.empty(6)
    for k in range(len(q)):
        for a in range(3):
            for b in range(4):
                pose[a, b] = 1.0 if a == b else 0.0
        for i in range(count):
            c, s = np.cos(q[k, i]), np.sin(q[k, i])
            for a in range(3):
                turned[a, 0] = local[i, a, 0] * c + local[i, a, 1] * s
                turned[a, 1] = local[i, a, 1] * c - local[i, a, 0] * s
                turned[a, 2], turned[a, 3] = local[i, a, 2], local[i, a, 3]
            _append(pose, turned)
            for a in range(3):
                axes[i, a], origins[i, a] = pose[a, 2], pose[a, 3]
        _append(pose, tip)
        _pose_error(pose, targets[k], turned, errors[k])
        for i in range(count):
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                arm_b, arm_c = pose[b, 3] - origins[i, b], pose[c, 3] - origins[i, c]
                jacobian[a, i] = axes[i, b] * arm_c - axes[i, c] * arm_b
                jacobian[a + 3, i] = axes[i, a]
        for a in range(6):
            for b in range(a + 1):
                square[a, b] = damping if a == b else 0.0
                for i in range(count):
                    square[a, b] += jacobian[a, i] * jacobian[b, i]
        _solve_into(square, jacobian, errors[k], scratch, steps[k])


@inlined
def _append(pose, local):
    """Make `pose` (3, 4) the pose of a frame that stands at `local` (3 or 4, 4) in it."""
    for a in range(3):
        x, y, z = pose[a, 0], pose[a, 1], pose[a, 2]
        for b in range(4):
            pose[a, b] = x * local[0, b] + y * local[1, b] + z * local[2, b] + (pose[a, 3] if b == 3 else 0.0)


@inlined
def _pose_error(pose, target, turn, error):
    """Write translation [m] and rotation vector [rad], in the base frame, from `pose` to `target` into `error` (6,).

    `turn` (3 or more, 3 or more) is scratch.
    """
    for a in range(3):
        error[a] = target[a, 3] - pose[a, 3]
        for b in range(3):
            turn[a, b] = 0.0
            for i in range(3):
                turn[a, b] += target[a, i] * pose[b, i]
    skew = ((turn[2, 1] - turn[1, 2]) / 2, (turn[0, 2] - turn[2, 0]) / 2, (turn[1, 0] - turn[0, 1]) / 2)
    sine = np.sqrt(skew[0] ** 2 + skew[1] ** 2 + skew[2] ** 2)
    angle = np.arctan2(sine, (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1) / 2)
    factor = angle / sine if sine > 1e-9 else 1.0
    for a in range(3):
        error[a + 3] = skew[a] * factor


@inlined
def _solve_into(square, jacobian, error, x, step):
    """Write J^T A^-1 e into `step` (J,), A given by its lower triangle, overwritten (Cholesky); `x` is scratch."""
    for a in range(6):
        x[a] = error[a]
    for a in range(6):
        for b in range(a + 1):
            left = square[a, b]
            for i in range(b):
                left -= square[a, i] * square[b, i]
            square[a, b] = np.sqrt(left) if a == b else left / square[b, b]
        for i in range(a):
            x[a] -= square[a, i] * x[i]
        x[a] /= square[a, a]
    for a in range(5, -1, -1):
        for i in range(a + 1, 6):
            x[a] -= square[i, a] * x[i]
        x[a] /= square[a, a]
    for i in range(len(step)):
        step[i] = 0.0
        for a in range(6):
            step[i] += jacobian[a, i] * x[a]


def poses_between(start: Array, end: Array, step: float) -> Array:
    """Return poses (N, 4, 4) evenly on the straight line between two, both included, about `step` [m] apart, N >= 9."""
    length = np.linalg.norm(end[:3, 3] - start[:3, 3])
    t = np.linspace(0, 1, max(int(np.ceil(length / step - 1e-6)), int(angle(start, end) / 0.02), 8) + 1)
    poses = np.tile(np.eye(4), (len(t), 1, 1))
    poses[:, :3, :3] = Slerp([0, 1], Rotation.from_matrix([start[:3, :3], end[:3, :3]]))(t).as_matrix()
    poses[:, :3, 3] = start[:3, 3] + t[:, None] * (end[:3, 3] - start[:3, 3])
    return poses


def angle(a: Array, b: Array) -> float:
    """Return by how much two poses (4, 4) are turned against each other [rad]."""
    return float(Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).magnitude())
