"""Joint torques: what rests on which joint, against energy, and what the planner makes of the motors' limits."""

from __future__ import annotations

import numpy as np
import pytest

from anther.core.errors import StageFailure
from anther.core.geometry import transform
from anther.robot.arm import _kinematics, motions, sawyer, shaking
from anther.robot.arm.planner import Planner
from anther.robot.devices import JointTrajectory
from anther.robot.swing import whole_shake

STILL = np.zeros(7)
NOTHING = np.zeros((0, 3))
GRASP = transform(np.array([[0, 0, 1.0], [0, -1, 0], [1, 0, 0]]), [0.6, 0.0, -0.1])


def weight_energy(q):
    """The height of all mass, times its weight [J], by forward kinematics alone."""
    poses = sawyer.link_poses(q)
    parts = [
        *((poses[i], link.mass, link.com) for i, link in enumerate(sawyer.SAWYER.links)),
        (
            poses[0],
            sawyer.SAWYER.riders[0][1].mass,
            np.add(sawyer.SAWYER.riders[0][1].xyz, sawyer.SAWYER.riders[0][1].com),
        ),
        (poses[7], sawyer.TOOL.mass, sawyer.TOOL.com),
        (poses[7], sawyer.TOOL.camera_mass, sawyer.TOOL.camera[0].center),
    ]
    return sum(9.81 * mass * (T @ [*com, 1])[2] for T, mass, com in parts)


def test_torque_at_rest_is_the_slope_of_the_weights_energy():
    step = 1e-5
    for q in np.random.default_rng(0).uniform(sawyer.LOWER, sawyer.UPPER, (5, 7)):
        slope = [(weight_energy(q + step * e) - weight_energy(q - step * e)) / (2 * step) for e in np.eye(7)]
        np.testing.assert_allclose(motions.torques(sawyer.SAWYER, q, STILL, STILL)[0], slope, atol=1e-5)


def test_the_power_put_in_is_the_energy_gained():
    """Along a motion from rest to rest, what the motors put in less the rotors' share is what the weight gained."""
    path = np.linspace(sawyer.NEUTRAL, np.add(sawyer.NEUTRAL, [0.3, 0.2, -0.3, 0.2, 0.4, -0.3, 0.5]), 9)
    motion = motions.along_line(sawyer.SAWYER, path, 0.3, 0.3)
    acceleration = np.gradient(motion.velocities, motion.times, axis=0)
    power = (motions.torques(sawyer.SAWYER, motion.positions, motion.velocities, acceleration) * motion.velocities).sum(
        axis=1
    )
    gained = weight_energy(motion.positions[-1]) - weight_energy(motion.positions[0])
    assert np.trapezoid(power, motion.times) == pytest.approx(gained, rel=5e-3)


def test_a_spun_joint_feels_its_rotor_and_what_it_carries():
    about_the_vertical = motions.torques(sawyer.SAWYER, sawyer.NEUTRAL, STILL, np.eye(7)[0])[0, 0]
    assert sawyer.SAWYER.rotor_inertia[0] + 1.0 < about_the_vertical < sawyer.SAWYER.rotor_inertia[0] + 10.0


def test_a_motion_too_hard_for_a_motor_is_refused():
    times = np.linspace(0, 0.2, 21)
    rate = np.zeros((21, 7))
    rate[:, 6] = 12.0 * np.sin(np.pi * times / 0.2) ** 2
    wrist = JointTrajectory(times, sawyer.NEUTRAL + np.cumsum(rate, axis=0) * 0.01, rate)
    with pytest.raises(StageFailure, match=r"of joint 6; allowed: <= 8\.1") as failure:
        motions.check_effort(sawyer.SAWYER, wrist)
    assert failure.value.kind == "limits_exceeded"


@pytest.mark.parametrize("frequency", [2.0, 10.0, 30.0])
def test_the_amplitude_promised_is_within_the_motors_limits_and_near_them(frequency):
    """A shake at the promised amplitude needs at most all, and most of, the torque there is."""
    q = _kinematics.inverse(sawyer.SAWYER, GRASP)[0]
    rates = shaking.joint_rates(sawyer.SAWYER, q, [0, 1, 0], [frequency])
    amplitude = motions.shake_amplitude(sawyer.SAWYER, q, rates, [frequency])[0]
    t = np.linspace(0, 1 / frequency, 400)
    omega = 2 * np.pi * frequency
    swing = amplitude * rates[0] * np.sin(omega * t)[:, None]
    moving = amplitude * omega * rates[0] * np.cos(omega * t)[:, None]
    share = np.abs(motions.torques(sawyer.SAWYER, q + swing, moving, -(omega**2) * swing) / sawyer.SAWYER.effort).max()
    assert share == pytest.approx(motions.USABLE, rel=0.2)


def test_the_planner_s_motions_are_within_the_motors_limits():
    planner = Planner(NOTHING, NOTHING)
    q = _kinematics.inverse(sawyer.SAWYER, GRASP)[0]
    amplitude = planner.shake_limit(q, [0, 1, 0], [8.0])[0]
    shake = planner.swing(q, [0, 1, 0], whole_shake(amplitude, 8.0, 1.0), amplitude)
    for motion in (
        shake,
        planner.move(sawyer.READY, q),
        motions.along_line(sawyer.SAWYER, np.linspace(q, q + 0.02, 9), 0.02, 0.05),
    ):
        assert motions.effort_share(sawyer.SAWYER, motion).max() <= motions.USABLE
