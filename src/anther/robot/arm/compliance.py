"""How the grip moves when the motors swing: every joint is a spring between its motor and its link.

Motors follow their references by position servos with the torques of a rigid arm besides; an arm reads its motors, not
its links. The equations are those of an elastic-joint robot (Spong 1987), linear about one place, with the arm's own
masses. How stiff the springs are is a belief: above some 5 Hz the grip does what neither the command nor the readings
say.
S drawn arms, Q frequencies, J joints, D directions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from anther.core.geometry import Array, ComplexArray
from anther.robot.arm.model import ArmModel
from anther.robot.arm.motions import inertia
from anther.robot.cell import JOINT_SCATTER

STIFFNESS, STIFFNESS_SPREAD = 19.0, 0.7
"""Joint springs over `ArmModel.stiffness`: median, and standard deviation of the logarithm. A guess: Sawyer's large
joints then have 4e3 to 6e4 N m/rad, where harmonic drives of that size have 1e4 to 3e4 (remembered)."""
BANDWIDTH, BANDWIDTH_SPREAD = 8.0, 0.3
"""Of position servos [Hz], and standard deviation of its logarithm. A guess."""
FEEDFORWARD_ERROR = 0.15
"""Standard deviation of a joint's relative error in the torque that its servo expects: loads unknown to the arm's
model. A guess."""
DAMPING = 0.05
"""Damping ratio of each spring with its own link: a guess."""
DRAWN = 16


class Drives(NamedTuple):
    """Drawn joints.

    Attributes:
        stiffness: (S, J) over `ArmModel.stiffness`.
        bandwidth: (S,) of the servos [Hz].
        feedforward: (S, J) torque that a servo expects over what a rigid arm would need.
    """

    stiffness: Array
    bandwidth: Array
    feedforward: Array


def draw_drives(joints: int, count: int = DRAWN) -> Drives:
    """Return joints drawn from what is believed, each quantity evenly."""
    rng, even = np.random.default_rng(0), np.asarray(ndtri((np.arange(count) + 0.5) / count), dtype=np.float64)
    bandwidth, *errors = (rng.permutation(even) for _ in range(1 + 2 * joints))
    own, expected = np.stack(errors, axis=1).reshape(count, 2, joints).swapaxes(0, 1)
    return Drives(
        STIFFNESS * np.exp(STIFFNESS_SPREAD * (even[:, None] + JOINT_SCATTER * own)),
        BANDWIDTH * np.exp(BANDWIDTH_SPREAD * bandwidth),
        1 + FEEDFORWARD_ERROR * expected,
    )


def grip_motion(arm: ArmModel, q: Array, motors: ComplexArray, frequencies: Array, deviates: Array) -> ComplexArray:
    """Return (S, Q, 3) phasors of the grip, base frame [m], that motors cause through springs.

    Args:
        arm: its description.
        q: (J,) joints about which it swings [rad].
        motors: (Q, J) phasors of what the motors do [rad].
        frequencies: (Q,) [Hz].
        deviates: (S,) how many standard deviations stiffer the springs are than is believed, or (S, J) each of them.
    """
    omega, mass, springs = _springs(arm, q, frequencies, STIFFNESS * np.exp(STIFFNESS_SPREAD * deviates))
    links = np.linalg.solve(_diagonal(springs) - omega**2 * mass, (springs * motors)[..., None])[..., 0]
    return np.asarray(links @ _grip_jacobian(arm, q).T)


def delivered(arm: ArmModel, q: Array, directions: Array, frequencies: Array) -> tuple[Array, Array]:
    """Return mean and standard deviation (Q, D) of ln of what the grip does along a line over what is commanded.

    Args:
        arm: its description.
        q: (J,) joints about which it swings [rad].
        directions: (D, 3) unit.
        frequencies: (Q,) [Hz].
    """
    drives = draw_drives(arm.count)
    omega, mass, springs = _springs(arm, q, frequencies, drives.stiffness)
    rotor = np.asarray(arm.rotor_inertia)
    tuned, servo = np.diag(inertia(arm, arm.neutral)) + rotor, 2 * np.pi * drives.bandwidth[:, None, None]
    gain = tuned * servo**2 + 2j * omega[..., 0] * tuned * servo  # critically damped at neutral
    jacobian, count = _grip_jacobian(arm, q), arm.count
    told = np.linalg.pinv(arm.jacobian(q))[:, :3] @ directions.T
    rigid = drives.feedforward[:, None, :, None] * ((mass + np.diag(rotor)) @ told)
    pushed = gain[..., None] * told - omega**2 * rigid
    matrix = np.zeros((*springs.shape[:2], 2 * count, 2 * count), dtype=np.complex128)
    matrix[..., :count, :count] = _diagonal(springs) - omega**2 * mass
    matrix[..., :count, count:] = matrix[..., count:, :count] = -_diagonal(springs)
    matrix[..., count:, count:] = _diagonal(springs + gain - omega[..., 0] ** 2 * rotor)
    links = np.linalg.solve(matrix, np.concatenate([np.zeros_like(pushed), pushed], axis=2))[:, :, :count]
    along = np.log(np.maximum(np.abs(np.einsum("dk,kj,sqjd->sqd", directions, jacobian, links)), 1e-12))
    return along.mean(axis=0), along.std(axis=0)


def _springs(arm: ArmModel, q: Array, frequencies: Array, stiffness: Array) -> tuple[Array, Array, ComplexArray]:
    """Return 2 pi f (Q, 1, 1), the links' mass matrix (J, J), and the springs' complex stiffness (S, Q, J)."""
    mass, omega = inertia(arm, q), 2 * np.pi * np.asarray(frequencies, dtype=np.float64)[:, None, None]
    stiff = stiffness.reshape(len(stiffness), 1, -1) * np.asarray(arm.stiffness)
    return omega, mass, stiff + 2j * omega[..., 0] * DAMPING * np.sqrt(stiff * np.diag(mass))


def _diagonal(values: NDArray[Any]) -> NDArray[Any]:
    return values[..., None] * np.eye(values.shape[-1])


def _grip_jacobian(arm: ArmModel, q: Array) -> Array:
    """Return (3, J) how the joints move the middle between the pads [m/rad]."""
    turned, held = arm.jacobian(q), arm.forward(q)[:3, :3] @ arm.tool.T_flange_grasp[:3, 3]
    return np.asarray(turned[:3] + np.cross(turned[3:], held, axisa=0).T)
