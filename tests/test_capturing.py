"""Pictures taken on the way: sharp, at known poses, whenever the camera happens to take its frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fake_robot import FakeArm, FakeGripper
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from anther.arm import sawyer, sharpness
from anther.arm.capturing import take_views, through_views
from anther.arm.views import SEEN, Params, Views, capture_time, cylinder_points, plan_views
from anther.devices import DeviceError, Frame, Robot
from anther.errors import InputError, StageFailure
from anther.geometry import Box, Intrinsics, inverse

REGION = Box(np.array([0.47, -0.25, -0.3]), np.array([0.97, 0.25, 0.35]))
POINTS = cylinder_points(REGION, SEEN)
CAMERA = sharpness.Params()
HAND_EYE = sawyer.T_FLANGE_CAM


@pytest.fixture(scope="module")
def views() -> Views:
    return plan_views(REGION, [], Params(count=6, azimuth_step=30, widest=75.0, distances=(0.58,)))


class FreeCamera:
    """Takes a frame every `period` [s] from `phase` on; `read` gives the next one. Every `lose`-th reading is lost."""

    intrinsics = Intrinsics(4, 3, 4.0, 4.0, 1.5, 1.0)

    def __init__(self, arm: FakeArm, period: float, phase: float, lose: int = 0) -> None:
        self.arm, self.period, self.phase, self.lose, self.read_ = arm, period, phase, lose, 0

    def read(self) -> Frame:
        self.read_ += 1
        if self.lose and self.read_ % self.lose == 0:
            raise DeviceError("lost")
        taken = self.phase + self.period * np.ceil((self.arm.clock - self.phase) / self.period)
        return Frame(float(taken), np.zeros((3, 4, 3), np.uint8), np.full((3, 4), 0.6, np.float32))

    def start(self, rate: float) -> None:
        raise NotImplementedError

    def recorded(self, since: float) -> list[Frame]:
        raise NotImplementedError

    def stop(self) -> list[Frame]:
        raise NotImplementedError


def robot(period: float, phase: float, lose: int = 0) -> Robot:
    arm = FakeArm(sawyer.READY)
    return Robot(arm, FakeGripper(), FreeCamera(arm, period, phase, lose))


@given(phase=st.floats(0, 1 / 30))
def test_whenever_the_camera_takes_its_frames_every_picture_is_sharp_and_where_it_says(
    views: Views, phase: float
) -> None:
    capture = take_views(robot(1 / 30, phase), views, HAND_EYE, POINTS, CAMERA)
    assert capture.views == len(views.joints)
    assert capture.joints is not None
    apart = inverse(views.T_world_cam) @ capture.T_world_cam
    assert np.linalg.norm(apart[:, :3, 3], axis=1).max() < 0.005
    np.testing.assert_allclose(capture.T_world_cam, sawyer.forward(capture.joints) @ HAND_EYE, atol=1e-12)


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
        sharp = sharpness.is_sharp(sawyer.SAWYER, curve(t), curve(t, 1), HAND_EYE, POINTS, CAMERA)
        edges = np.flatnonzero(~sharp)
        here = np.searchsorted(t, arrival + dwell / 2)
        span = t[edges[edges > here][0]] - t[edges[edges < here][-1]]
        assert span >= CAMERA.span - 1e-3
        assert dwell == 0 or span <= CAMERA.span + 4e-3


@pytest.mark.parametrize("worse", [{"exposure": 0.02}, {"blur": 0.1}, {"frame_rate": 15.0}, {"jitter": 0.01}])
def test_a_worse_camera_or_clock_makes_the_arm_stand_longer(views: Views, worse: dict[str, float]) -> None:
    longer = sharpness.standing_times(sawyer.SAWYER, views.motions, HAND_EYE, POINTS, replace(CAMERA, **worse))
    assert np.all(longer >= views.dwell - 1e-9)
    assert longer.sum() > views.dwell.sum()


def test_a_translation_moves_the_image_by_focal_length_over_distance() -> None:
    q = sawyer.NEUTRAL
    T = sawyer.forward(q) @ HAND_EYE
    ahead = (T @ np.array([[0, 0, 0.5, 1], [0, 0, 0.8, 1], [0, 0, -0.3, 1], [5, 0, 0.5, 1]]).T).T[:, :3]
    rates = np.linalg.pinv(sawyer.jacobian(q)) @ np.r_[0.1 * T[:3, 0], 0, 0, 0]
    speed = sharpness.image_speed(sawyer.SAWYER, q[None], rates[None], HAND_EYE, ahead, 640.0)
    assert speed[0] == pytest.approx(640 * 0.1 / 0.5, rel=1e-3)  # the nearest ahead; none behind or outside counts


def test_a_camera_too_slow_for_the_plan_gives_no_capture_or_only_sharp_views(views: Views) -> None:
    kept = []
    for phase in np.linspace(0, 0.4, 5):
        try:
            kept.append(take_views(robot(0.5, phase), views, HAND_EYE, POINTS, CAMERA).views)
        except StageFailure:
            kept.append(0)
    assert max(kept) < len(views.joints)


def test_pictures_too_blurred_for_any_use_end_as_a_device_fault(views: Views) -> None:
    dark = replace(CAMERA, exposure=0.5, blur=0.01)  # the views were planned for another
    with pytest.raises(StageFailure, match="sharp") as failure:
        take_views(robot(1 / 30, 0.0), views, HAND_EYE, POINTS, dark)
    assert failure.value.kind == "device_fault"


def test_a_lost_frame_is_the_caller_s_to_hear_of(views: Views) -> None:
    with pytest.raises(DeviceError, match="lost"):
        take_views(robot(1 / 30, 0.0, lose=3), views, HAND_EYE, POINTS, CAMERA)


def test_bad_numbers_are_refused() -> None:
    for wrong in ({"exposure": 0.0}, {"frame_rate": float("nan")}, {"blur": -1.0}):
        with pytest.raises(InputError):
            sharpness.Params(**wrong)
