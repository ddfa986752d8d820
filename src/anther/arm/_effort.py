"""Joint torques of an arm with its gripper and wrist camera. T samples, Q frequencies.

Rigid-body inverse dynamics (recursive Newton-Euler, pinocchio) with the URDF's inertias, the tool's mass and rotor
inertia. A motion that needs more than `USABLE` of the URDF's efforts is refused: the arm could not follow it.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pinocchio
from numpy.typing import ArrayLike

from anther.arm._collision import urdf
from anther.arm.model import ArmModel
from anther.devices import JointTrajectory
from anther.errors import StageFailure
from anther.geometry import Array

pin: Any = pinocchio  # its names come from C++ at run time; type checkers do not see them

USABLE = 0.9
"""Share of each effort limit that weight and inertia may take. The rest is for friction, of which nothing is published
for the robot: the numbers in Rethink's Gazebo model (facts: sawyer 1) calm a simulation, and with them the wrist could
not reach the SDK's own speed limit. An estimate."""
SLOWER = (1.0, 1.02, 1.05, 1.1, 1.2)
"""Factors of time tried for a motion that needs more."""


def torques(arm: ArmModel, q: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Array:
    """Return the motors' torques (T, J) [N m] for joints, rates and accelerations, each (T, J) [rad, s]."""
    model, data = _model(arm)
    rows = (np.atleast_2d(np.asarray(x, dtype=np.float64)) for x in (q, velocity, acceleration))
    return np.array([pin.rnea(model, data, *row) for row in zip(*rows, strict=True)])


def effort_share(arm: ArmModel, trajectory: JointTrajectory) -> Array:
    """Return (J,) the largest share of each joint's effort limit that a motion needs."""
    acceleration = np.gradient(trajectory.velocities, trajectory.times, axis=0)
    needed = torques(arm, trajectory.positions, trajectory.velocities, acceleration)
    return np.abs(needed / arm.effort).max(axis=0)


def check_effort(arm: ArmModel, trajectory: JointTrajectory) -> JointTrajectory:
    """Return the motion if the motors are strong enough for it.

    Raises:
        StageFailure: limits_exceeded.
    """
    share = effort_share(arm, trajectory)
    worst = int(np.argmax(share))
    if share[worst] > USABLE:
        needed, allowed = share[worst] * arm.effort[worst], USABLE * arm.effort[worst]
        given = f"the motion needs {needed:.1f} N m of joint {worst}; allowed: <= {allowed:.1f}"
        raise StageFailure("limits_exceeded", f"{given}. Move slower or shake less.")
    return trajectory


def within_effort(arm: ArmModel, trajectory: JointTrajectory) -> JointTrajectory:
    """Return the motion, slowed down evenly by up to a fifth where the motors are not strong enough for it."""
    motions = (JointTrajectory(trajectory.times * k, trajectory.positions, trajectory.velocities / k) for k in SLOWER)
    return next((motion for motion in motions if effort_share(arm, motion).max() <= USABLE), trajectory)


def shake_amplitude(arm: ArmModel, q: Array, rates: Array, frequencies: ArrayLike) -> Array:
    """Return the amplitudes (Q,) [m] of a flange sinusoid at which the first motor gives all that is `USABLE`.

    Args:
        q: (J,) joints [rad].
        rates: (Q, J) joint motion per metre of the flange's [rad/m].
        frequencies: (Q,) [Hz].
    """
    still = np.zeros(arm.count)
    weight = torques(arm, q, still, still)
    basis = torques(arm, np.tile(q, (arm.count, 1)), np.zeros((arm.count, arm.count)), np.eye(arm.count)) - weight
    swung = rates @ basis
    omega = 2 * np.pi * np.atleast_1d(np.asarray(frequencies, dtype=np.float64))[:, None]
    room = USABLE * arm.effort - np.abs(weight)
    return np.maximum(room / (np.abs(swung) * omega**2), 0.0).min(axis=1)


@cache
def _model(arm: ArmModel) -> tuple[Any, Any]:
    model = pin.buildModelFromXML(urdf(arm))
    model.armature = arm.rotor_inertia
    return model, model.createData()
