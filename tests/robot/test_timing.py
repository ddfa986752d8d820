"""Timed straight motions: within every limit, on the line, and no slower than they must be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from anther.robot.arm import motions
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import JointTrajectory

JOINTS = st.integers(0, 10_000).map(
    lambda seed: np.random.default_rng(seed).uniform(SAWYER.lower, SAWYER.upper, (2, 7))
)


@given(ends=JOINTS, share=st.floats(0.1, 1.0), flange=st.floats(0.2, 1.5))
def test_a_straight_motion_keeps_the_limits_between_its_samples_too(ends, share: float, flange: float) -> None:
    motion = motions.straight(SAWYER, *ends, share, share, flange)
    np.testing.assert_allclose(motion.positions[[0, -1]], ends, atol=1e-12)
    np.testing.assert_allclose(motion.velocities[[0, -1]], 0, atol=1e-12)
    along = (motion.positions - ends[0]) @ (ends[1] - ends[0]) / np.sum((ends[1] - ends[0]) ** 2)
    np.testing.assert_allclose(motion.positions, ends[0] + along[:, None] * (ends[1] - ends[0]), atol=1e-9)
    assert np.all(np.diff(along) >= 0)
    curve = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
    t = np.linspace(0, motion.duration, 2000)
    assert np.abs(curve(t, 1) / SAWYER.velocity).max() <= 1.01 * share
    assert np.abs(curve(t, 2) / SAWYER.acceleration).max() <= 1.02 * share
    assert motions.flange_speed(SAWYER, motion) <= 1.01 * flange


def test_a_straight_motion_of_one_joint_takes_the_least_time() -> None:
    """Up, along and down at the joint's own limits: far / v + v / a."""
    way = np.array([0, 0, 0, 0, 0, 0, 1.5])
    v, a = SAWYER.velocity[6], SAWYER.acceleration[6]
    there = motions.straight(SAWYER, SAWYER.neutral, SAWYER.neutral + way, 0.5, 0.5, 10.0)
    assert there.duration == pytest.approx(1.5 / (0.5 * v) + v / a, rel=0.01)
    short = motions.straight(SAWYER, SAWYER.neutral, SAWYER.neutral + 0.1 * way, 0.5, 0.5, 10.0)
    assert short.duration == pytest.approx(2 * np.sqrt(0.15 / (0.5 * a)), rel=0.01)


def test_only_where_the_flange_is_too_fast_does_a_straight_motion_slow_down() -> None:
    way = np.array([1.8, -1.0, 0, 1.5, 0, 0, 0])
    free, held = (
        motions.straight(SAWYER, SAWYER.neutral, SAWYER.neutral + way, 0.9, 0.7, limit) for limit in (10.0, 0.8)
    )
    evenly = motions.slow_down(SAWYER, free, 0.8)
    assert motions.flange_speed(SAWYER, free) > 0.95
    assert free.duration < held.duration < evenly.duration


def test_a_motion_too_strong_for_the_motors_is_slowed_until_they_bear_it() -> None:
    stretched, lifted = np.array([0, 0.6, 0, 0.1, 0, 0.1, 0]), np.array([0, 0.1, 0, 0.1, 0, 0.1, 0])
    motion = motions.straight(SAWYER, stretched, lifted, 1.0, 1.0, 10.0)
    hasty = JointTrajectory(motion.times / 1.1, motion.positions, 1.1 * motion.velocities)
    assert motions.effort_share(SAWYER, hasty).max() > motions.USABLE
    calm = motions.limit_effort(SAWYER, hasty)
    assert motions.effort_share(SAWYER, calm).max() <= motions.USABLE
    assert hasty.duration < calm.duration <= 1.2 * hasty.duration
