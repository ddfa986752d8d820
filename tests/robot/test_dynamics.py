"""Joint torques: what rests on which joint, against energy, and what the planner makes of the motors' limits."""

from __future__ import annotations

import numpy as np
import pytest

from anther.core.errors import StageFailure
from anther.core.geometry import transform
from anther.robot.arm import _kinematics, motions, shaking
from anther.robot.arm.planner import Planner
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.devices import JointTrajectory
from anther.robot.swing import whole_shake

STILL = np.zeros(7)
NOTHING = np.zeros((0, 3))
GRASP = transform(np.array([[0, 0, 1.0], [0, -1, 0], [1, 0, 0]]), [0.6, 0.0, -0.1])


def weight_energy(q):
    """The height of all mass, times its weight [J], by forward kinematics alone."""
    poses = SAWYER.link_poses(q)
    parts = [
        *((poses[i], link.mass, link.com) for i, link in enumerate(SAWYER.links)),
        (
            poses[0],
            SAWYER.riders[0][1].mass,
            np.add(SAWYER.riders[0][1].xyz, SAWYER.riders[0][1].com),
        ),
        (poses[7], TOOL.mass, TOOL.com),
        (poses[7], TOOL.camera_mass, TOOL.camera[0].center),
    ]
    return sum(9.81 * mass * (T @ [*com, 1])[2] for T, mass, com in parts)


def test_torque_at_rest_is_the_slope_of_the_weights_energy():
    step = 1e-5
    for q in np.random.default_rng(0).uniform(SAWYER.lower, SAWYER.upper, (5, 7)):
        slope = [(weight_energy(q + step * e) - weight_energy(q - step * e)) / (2 * step) for e in np.eye(7)]
        np.testing.assert_allclose(motions.torques(SAWYER, q, STILL, STILL)[0], slope, atol=1e-5)


def test_the_power_put_in_is_the_energy_gained():
    """Along a motion from rest to rest, what the motors put in less the rotors' share is what the weight gained."""
    path = np.linspace(SAWYER.neutral, np.add(SAWYER.neutral, [0.3, 0.2, -0.3, 0.2, 0.4, -0.3, 0.5]), 9)
    motion = motions.along_line(SAWYER, path, 0.3, 0.3)
    acceleration = np.gradient(motion.velocities, motion.times, axis=0)
    power = (motions.torques(SAWYER, motion.positions, motion.velocities, acceleration) * motion.velocities).sum(axis=1)
    gained = weight_energy(motion.positions[-1]) - weight_energy(motion.positions[0])
    assert np.trapezoid(power, motion.times) == pytest.approx(gained, rel=5e-3)


def test_a_spun_joint_feels_its_rotor_and_what_it_carries():
    about_the_vertical = motions.torques(SAWYER, SAWYER.neutral, STILL, np.eye(7)[0])[0, 0]
    assert SAWYER.rotor_inertia[0] + 1.0 < about_the_vertical < SAWYER.rotor_inertia[0] + 10.0


def test_a_motion_too_hard_for_a_motor_is_refused():
    times = np.linspace(0, 0.2, 21)
    rate = np.zeros((21, 7))
    rate[:, 6] = 12.0 * np.sin(np.pi * times / 0.2) ** 2
    wrist = JointTrajectory(times, SAWYER.neutral + np.cumsum(rate, axis=0) * 0.01, rate)
    with pytest.raises(StageFailure, match=r"of joint 6; allowed: <= 8\.1") as failure:
        motions.check_effort(SAWYER, wrist)
    assert failure.value.kind == "limits_exceeded"


@pytest.mark.parametrize("frequency", [2.0, 10.0, 30.0])
def test_the_amplitude_promised_is_within_the_motors_limits_and_near_them(frequency):
    """A shake at the promised amplitude needs at most all, and most of, the torque there is."""
    q = _kinematics.inverse(SAWYER, GRASP)[0]
    rates = shaking.joint_rates(SAWYER, q, [0, 1, 0], [frequency])
    amplitude = motions.shake_amplitude(SAWYER, q, rates, [frequency])[0]
    t = np.linspace(0, 1 / frequency, 400)
    omega = 2 * np.pi * frequency
    swing = amplitude * rates[0] * np.sin(omega * t)[:, None]
    moving = amplitude * omega * rates[0] * np.cos(omega * t)[:, None]
    share = np.abs(motions.torques(SAWYER, q + swing, moving, -(omega**2) * swing) / SAWYER.effort).max()
    assert share == pytest.approx(motions.USABLE, rel=0.2)


def test_the_planner_s_motions_are_within_the_motors_limits():
    planner = Planner(NOTHING, NOTHING)
    q = _kinematics.inverse(SAWYER, GRASP)[0]
    amplitude = planner.shake_limit(q, [0, 1, 0], [8.0])[0]
    shake = planner.swing(q, [0, 1, 0], whole_shake(amplitude, 8.0, 1.0), amplitude)
    for motion in (
        shake,
        planner.move(SAWYER.ready, q),
        motions.along_line(SAWYER, np.linspace(q, q + 0.02, 9), 0.02, 0.05),
    ):
        assert motions.effort_share(SAWYER, motion).max() <= motions.USABLE
