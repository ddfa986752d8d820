"""How long a moving camera is sharp, and how long an arm must stand for it, whenever its frames are taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from anther.core.errors import InputError
from anther.core.geometry import Box
from anther.robot.arm import views as sharpness
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.arm.views import Params, Views, capture_time, cylinder_points, plan_views
from evaluation.robustness.capture_path import through_views

REGION = Box(np.array([0.47, -0.25, -0.3]), np.array([0.97, 0.25, 0.35]))
POINTS = cylinder_points(REGION, 0.08)
CAMERA = Params()
HAND_EYE = TOOL.T_flange_cam


@pytest.fixture(scope="module")
def views() -> Views:
    return plan_views(REGION, [], Params(count=6, azimuth_step=30, widest=75.0, distances=(0.58,)))


def test_the_motion_through_all_views_rests_at_each_for_its_time(views: Views) -> None:
    motion, arrivals = through_views(views)
    assert motion.duration == pytest.approx(capture_time(views))
    curve = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
    for share in (0.0, 0.5, 1.0):
        np.testing.assert_allclose(curve(arrivals + share * views.dwell), views.joints, atol=1e-9)


def test_standing_times_leave_a_sharp_span_as_long_as_a_frame_and_no_longer(views: Views) -> None:
    motion, arrivals = through_views(views)
    curve = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
    for arrival, dwell in zip(arrivals[:-1], views.dwell, strict=False):
        t = np.arange(arrival - 0.1, arrival + dwell + 0.1, 5e-4)
        sharp = sharpness.is_sharp(SAWYER, curve(t), curve(t, 1), HAND_EYE, POINTS, CAMERA)
        edges = np.flatnonzero(~sharp)
        here = np.searchsorted(t, arrival + dwell / 2)
        span = t[edges[edges > here][0]] - t[edges[edges < here][-1]]
        assert span >= CAMERA.span - 1e-3
        assert dwell == 0 or span <= CAMERA.span + 4e-3


@pytest.mark.parametrize("worse", [{"exposure": 0.02}, {"frame_rate": 15.0}])
def test_a_worse_camera_or_clock_makes_the_arm_stand_longer(views: Views, worse: dict[str, float]) -> None:
    longer = sharpness.standing_times(SAWYER, views.motions, HAND_EYE, POINTS, replace(CAMERA, **worse))
    assert np.all(longer >= views.dwell - 1e-9)
    assert longer.sum() > views.dwell.sum()


def test_a_translation_moves_the_image_by_focal_length_over_distance() -> None:
    q = SAWYER.neutral
    T = SAWYER.forward(q) @ HAND_EYE
    ahead = (T @ np.array([[0, 0, 0.5, 1], [0, 0, 0.8, 1], [0, 0, -0.3, 1], [5, 0, 0.5, 1]]).T).T[:, :3]
    rates = np.linalg.pinv(SAWYER.jacobian(q)) @ np.r_[0.1 * T[:3, 0], 0, 0, 0]
    speed = sharpness.image_speed(SAWYER, q[None], rates[None], HAND_EYE, ahead, 640.0)
    assert speed[0] == pytest.approx(640 * 0.1 / 0.5, rel=1e-3)  # the nearest ahead; none behind or outside counts


def test_bad_numbers_are_refused() -> None:
    for wrong in ({"exposure": 0.0}, {"frame_rate": float("nan")}):
        with pytest.raises(InputError):
            Params(**wrong)
