"""Damped Newton steps of an arm towards a flange pose, compiled. K joint vectors."""

from __future__ import annotations

import numpy as np
from numba import njit

from anther.arm.model import ArmModel
from anther.geometry import Array


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
    targets = np.ascontiguousarray(np.broadcast_to(target, (len(q), 4, 4)))
    _steps(np.ascontiguousarray(q), targets, damping, arm.local, arm.T_last_flange, steps, errors)
    return steps, errors


@njit(cache=True)
def _steps(q, targets, damping, local, tip, steps, errors):
    count = q.shape[1]
    pose, turned, square = np.empty((3, 4)), np.empty((4, 4)), np.empty((6, 6))
    axes, origins, jacobian = np.empty((count, 3)), np.empty((count, 3)), np.empty((6, count))
    for k in range(len(q)):
        pose[:] = 0.0
        for a in range(3):
            pose[a, a] = 1.0
        for i in range(count):
            c, s = np.cos(q[k, i]), np.sin(q[k, i])
            for a in range(3):
                turned[a, 0] = local[i, a, 0] * c + local[i, a, 1] * s
                turned[a, 1] = local[i, a, 1] * c - local[i, a, 0] * s
                turned[a, 2], turned[a, 3] = local[i, a, 2], local[i, a, 3]
            _append(pose, turned)
            axes[i], origins[i] = pose[:, 2], pose[:, 3]
        _append(pose, tip)
        _pose_error(pose, targets[k], errors[k])
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
        _solve_into(square, jacobian, errors[k], steps[k])


@njit(cache=True)
def _append(pose, local):
    """Make `pose` (3, 4) the pose of a frame that stands at `local` (3 or 4, 4) in it."""
    for a in range(3):
        x, y, z = pose[a, 0], pose[a, 1], pose[a, 2]
        for b in range(4):
            pose[a, b] = x * local[0, b] + y * local[1, b] + z * local[2, b] + (pose[a, 3] if b == 3 else 0.0)


@njit(cache=True)
def _pose_error(pose, target, error):
    """Write translation [m] and rotation vector [rad], in the base frame, from `pose` to `target` into `error` (6,)."""
    turn = np.zeros((3, 3))
    for a in range(3):
        error[a] = target[a, 3] - pose[a, 3]
        for b in range(3):
            for i in range(3):
                turn[a, b] += target[a, i] * pose[b, i]
    skew = ((turn[2, 1] - turn[1, 2]) / 2, (turn[0, 2] - turn[2, 0]) / 2, (turn[1, 0] - turn[0, 1]) / 2)
    sine = np.sqrt(skew[0] ** 2 + skew[1] ** 2 + skew[2] ** 2)
    angle = np.arctan2(sine, (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1) / 2)
    factor = angle / sine if sine > 1e-9 else 1.0
    for a in range(3):
        error[a + 3] = skew[a] * factor


@njit(cache=True)
def _solve_into(square, jacobian, error, step):
    """Write J^T A^-1 e into `step` (J,), A given by its lower triangle, which is overwritten (Cholesky)."""
    x = error.copy()
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
