"""How hard an arm can shake, and the joint motion of a shake. Q frequencies, D displacements along the shake."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from anther.core.checks import check_array, check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array
from anther.robot.arm import _kinematics
from anther.robot.arm.model import ArmModel
from anther.robot.devices import JointTrajectory
from anther.robot.swing import Swing, motion


def unit(direction: ArrayLike) -> Array:
    """Return `direction` (3,) with length 1.

    Raises:
        InputError: wrong shape, not finite or zero.
    """
    ray = check_array("shake direction", direction, (3,))
    size = float(np.linalg.norm(ray))
    if size < 1e-9:
        raise bad_input("shake direction", given="a zero vector", allowed="any other", do="Give x, y, z.")
    return ray / size


def amplitude_limit(arm: ArmModel, q: ArrayLike, direction: ArrayLike, frequencies: ArrayLike) -> Array:
    """Return the largest amplitude [m] of a sinusoid of the flange, orientation held, within the joints' limits.

    A flange sinusoid of amplitude A moves joint i with A omega |dq_i/ds| and A omega^2 |dq_i/ds| at most. Among the
    joint motions that carry the flange along `direction` (of seven joints one parameter is free: the elbow) the one
    with the smallest worst joint counts. Torques: `dynamics.shake_amplitude`.

    Args:
        arm: its description.
        q: (..., J) joints [rad].
        direction: (3,) of the shake, world.
        frequencies: (Q,) [Hz].

    Returns:
        (..., Q) amplitudes [m].
    """
    omega = 2 * np.pi * check_array("shake frequencies", np.atleast_1d(np.asarray(frequencies)), (None,))
    return 1 / _slowest_motion(arm, q, unit(direction), omega)[1]


def joint_rates(arm: ArmModel, q: ArrayLike, direction: ArrayLike, frequencies: ArrayLike) -> Array:
    """Return the joint motions (Q, J) [rad/m] that `amplitude_limit` counts at joints q (J,), one per frequency."""
    omega = 2 * np.pi * np.atleast_1d(np.asarray(frequencies, dtype=np.float64))
    return _slowest_motion(arm, q, unit(direction), omega)[0]


def swing_trajectory(
    arm: ArmModel, q: ArrayLike, direction: ArrayLike, pieces: Sequence[Swing], reach: float
) -> JointTrajectory:
    """Return the joint motion that moves the flange to and fro along a straight line, its orientation held.

    The joints are found as a function of the displacement once, so every period is the same and nothing drifts. They
    depend on `reach`: motions of the same reach join.

    Args:
        arm: its description.
        q: (J,) joints at rest [rad].
        direction: (3,) of the shake, world.
        pieces: what the flange does along it, one after the other.
        reach: that no piece goes beyond [m].

    Raises:
        InputError: a number out of range.
        StageFailure: "limits_exceeded" or "unreachable".
    """
    highest, size = float(max(piece.frequencies.max() for piece in pieces)), max(piece.reach for piece in pieces)
    seconds = sum(piece.seconds for piece in pieces)
    check_range("reach of a swing", reach, 1e-6, 0.2, "m")
    check_range("shake frequency", highest, 0.1, 50, "Hz")
    check_range("displacement of a swing", size, 0, 1.0001 * reach, "m")
    rate = 500.0  # samples of a shake per second; 40 per period if that is more
    times = np.linspace(0, seconds, int(np.ceil(seconds * max(rate, 40 * highest))) + 1)
    d, d_rate = motion(pieces, times)
    path = _joints_along(arm, np.asarray(q, dtype=np.float64), unit(direction), reach, highest)
    trajectory = JointTrajectory(times, path(d), path(d, 1) * d_rate[:, None])
    _check_limits(arm, trajectory, np.asarray(q), direction, size, highest)
    return trajectory


def _joints_along(arm: ArmModel, q: Array, direction: Array, amplitude: float, frequency: float) -> CubicSpline:
    """Return the joints as a function of the displacement [m] from -A to A."""
    count = max(4, int(np.ceil(amplitude / 5e-4)))
    d = np.linspace(0, 1.02 * amplitude, count + 1)
    rest, elbow = arm.forward(q), float(_slowest_motion(arm, q, direction, np.array([2 * np.pi * frequency]))[2][0])
    sides = []
    for sign in (1, -1):
        targets = np.repeat(rest[None], len(d), axis=0)
        targets[:, :3, 3] += sign * d[:, None] * direction
        sides.append(_follow_with_elbow(arm, q, targets, sign * direction, elbow * sign, d[1]))
    joints = np.concatenate([sides[1][:0:-1], sides[0]])
    if not np.isfinite(joints).all():
        raise StageFailure(
            "unreachable", f"the arm cannot follow a shake of {1e3 * amplitude:.1f} mm along {direction}."
        )
    return CubicSpline(np.concatenate([-d[:0:-1], d]), joints)


def _follow_with_elbow(arm: ArmModel, q: Array, targets: Array, direction: Array, elbow: float, step: float) -> Array:
    """Return joints (D, J) through the targets, moving the elbow at a constant share `elbow` of the null motion."""
    path, null = [q], _particular_and_null(arm, q, direction)[1]
    for target in targets[1:]:
        particular, new_null = _particular_and_null(arm, path[-1], direction)
        null = new_null * np.sign(new_null @ null)
        guess = path[-1] + step * (particular + elbow * null)
        path.append(_kinematics.follow(arm, guess[None], target[None])[0, 0])
        if not np.isfinite(path[-1]).all():
            return np.full((len(targets), arm.count), np.nan)
    return np.array(path)


def _particular_and_null(arm: ArmModel, q: ArrayLike, direction: Array) -> tuple[Array, Array]:
    """Return the least joint rates (..., J) per metre along `direction`, and unit rates that leave the flange still.

    The sign of the second is fixed by its largest component. With six joints it is zero, with more than seven one of
    several.
    """
    J = arm.jacobian(q)
    particular = (np.linalg.pinv(J) @ np.concatenate([direction, np.zeros(3)])[:, None])[..., 0]
    null = np.linalg.svd(J)[2][..., 6, :] if arm.count > 6 else np.zeros_like(particular)
    largest = np.take_along_axis(null, np.abs(null).argmax(axis=-1)[..., None], axis=-1)
    return particular, null * np.sign(largest)


def _slowest_motion(arm: ArmModel, q: ArrayLike, direction: Array, omega: Array) -> tuple[Array, Array, Array]:
    """Return, for each angular frequency, the joint rates per metre whose worst weighted joint is least.

    Minimises max_i |a_i + t b_i| over t: convex and piecewise linear, so the minimum is at a zero of one term or where
    two are equal; all are tried.

    Returns:
        (..., Q, J) rates, (..., Q) that worst, and (..., Q) the share t of the null motion.
    """
    particular, null = (rates[..., None, :] for rates in _particular_and_null(arm, q, direction))
    per_joint = omega[:, None]
    weights = np.maximum(per_joint / arm.velocity, per_joint**2 / arm.acceleration)  # of 1 rad/m, in shares of limits
    a, b = particular * weights, null * weights
    i, j = np.triu_indices(arm.count, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        zeros = -a / b
        equal = -(a[..., i] - a[..., j]) / (b[..., i] - b[..., j])
        opposite = -(a[..., i] + a[..., j]) / (b[..., i] + b[..., j])
    t = np.nan_to_num(np.concatenate([zeros, equal, opposite], axis=-1), nan=0.0, posinf=0.0, neginf=0.0)
    worst = np.abs(a[..., None, :] + t[..., None] * b[..., None, :]).max(axis=-1)
    best = worst.argmin(axis=-1)[..., None]
    share = np.take_along_axis(t, best, axis=-1)
    return particular + share * null, np.take_along_axis(worst, best, axis=-1)[..., 0], share[..., 0]


def _check_limits(
    arm: ArmModel, path: JointTrajectory, q: Array, direction: ArrayLike, amplitude: float, frequency: float
) -> None:
    acceleration = np.gradient(path.velocities, path.times, axis=0)
    share = max(np.abs(path.velocities / arm.velocity).max(), np.abs(acceleration / arm.acceleration).max())
    outside = np.any((path.positions < arm.lower) | (path.positions > arm.upper))
    if share > 1 or outside:
        limit = 1e3 * float(amplitude_limit(arm, q, direction, [frequency])[0])
        given = f"a shake of {1e3 * amplitude:.2f} mm at {frequency:g} Hz needs {100 * share:.0f} % of the joint limits"
        raise StageFailure("limits_exceeded", f"{given}; about {limit:.2f} mm are possible. Shake less or slower.")
