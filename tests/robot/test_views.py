"""Viewpoints: reachable, free, looking at the plant from where they say, in a motion without gaps."""

from __future__ import annotations

import numpy as np
import pytest

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Box
from anther.robot.arm._collision import CollisionWorld
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.arm.views import Params, capture_time, cylinder_points, plan_views, reachable_views
from anther.sim.simulated_cell import PRESETS, USUAL_DISTANCE, layout

REGION = Box(np.array([0.47, -0.25, -0.3]), np.array([0.97, 0.25, 0.35]))
BENCH = Box(np.array([0.4, -0.4, -0.6]), np.array([1.1, 0.4, -0.47]))
COARSE = Params(count=10, azimuth_step=30, distances=(0.6, 0.52))


@pytest.fixture(scope="module")
def views():
    return plan_views(REGION, [BENCH], COARSE)


def test_views_look_at_the_plant_from_their_azimuth_and_elevation(views):
    eye, forward = views.T_world_cam[:, :3, 3], views.T_world_cam[:, :3, 2]
    away = np.linalg.norm((eye - [0.72, 0, 0])[:, :2], axis=1)
    on_axis = eye + forward * (away / np.linalg.norm(forward[:, :2], axis=1))[:, None]
    np.testing.assert_allclose(on_axis[:, :2], np.broadcast_to([0.72, 0], (len(eye), 2)), atol=1e-5)
    assert np.all((on_axis[:, 2] > REGION.lower[2]) & (on_axis[:, 2] < REGION.upper[2]))
    np.testing.assert_allclose(np.rad2deg(np.arcsin(-forward[:, 2])), views.elevation, atol=1e-4)
    azimuth = np.rad2deg(np.arctan2(-eye[:, 1], 0.72 - eye[:, 0]))
    np.testing.assert_allclose((azimuth - views.azimuth + 180) % 360 - 180, 0, atol=1e-3)
    assert np.all(np.linalg.norm(eye - on_axis, axis=1) > 0.48)


def test_views_are_spread_wide(views):
    assert len(views.joints) == 10
    assert np.ptp(views.azimuth) >= 180
    assert len(set(zip(views.azimuth, views.elevation, strict=True))) == 10


def test_motions_lead_from_view_to_view_without_touching_the_region(views):
    world = CollisionWorld(SAWYER, cylinder_points(REGION), np.zeros((0, 3)), [BENCH])
    here = SAWYER.ready
    for motion, q in zip(views.motions, views.joints, strict=True):
        np.testing.assert_allclose(motion.positions[[0, -1]], [here, q], atol=1e-6)
        assert all(world.free(x) for x in motion.positions[::10])
        here = q


def test_camera_pose_follows_from_joints(views):
    np.testing.assert_allclose(views.T_world_cam, SAWYER.forward(views.joints) @ TOOL.T_flange_cam, atol=1e-12)


def test_capture_time_counts_motion_and_stops(views):
    assert capture_time(views) == pytest.approx(sum(m.duration for m in views.motions) + views.dwell.sum())


def test_order_is_shorter_than_a_random_one(views):
    def length(order):
        q = np.array([SAWYER.ready, *views.joints[order]])
        return np.abs(np.diff(q, axis=0) / SAWYER.velocity).max(axis=1).sum()

    rng = np.random.default_rng(0)
    assert length(np.arange(10)) < min(length(rng.permutation(10)) for _ in range(50))


def test_a_plant_out_of_reach_says_so():
    shift = np.array([1.5, 0, 0])
    far = Box(REGION.lower + shift, REGION.upper + shift)
    with pytest.raises(StageFailure, match="Move the plant") as failure:
        plan_views(far, [], COARSE)
    assert failure.value.kind == "unreachable"


def test_starting_within_the_region_is_refused():
    with pytest.raises(StageFailure) as failure:
        plan_views(REGION, [], COARSE, start=[0, 0.3, 0, 0.3, 0, 0, 0])
    assert failure.value.kind == "collision"


def test_bad_parameters_are_refused():
    with pytest.raises(InputError, match="views"):
        Params(count=0)
    with pytest.raises(InputError, match="nearest view"):
        Params(distances=(0.65, 58.0, 0.01))


def test_cylinder_points_lie_on_the_cylinder():
    points = cylinder_points(REGION)
    radius = np.linalg.norm(points[:, :2] - [0.72, 0], axis=1)
    on_wall, on_top = np.abs(radius - 0.25) < 1e-9, np.abs(points[:, 2] - 0.35) < 1e-9
    assert np.all(on_wall | on_top)
    assert REGION.contains(points - [0, 0, 1e-9]).mean() > 0.9


def test_chosen_viewpoints_are_visited(views):
    points = reachable_views(REGION, [BENCH], COARSE)
    chosen = [3, 0, 8, 5]
    visited = points.visit(chosen)
    grid = list(zip(points.azimuth, points.elevation, strict=True))
    order = [grid.index(view) for view in zip(visited.azimuth, visited.elevation, strict=True)]
    assert sorted(order) == sorted(chosen)
    np.testing.assert_allclose(visited.T_world_cam[:, :3, 2], points.T_world_cam[order, :3, 2], atol=1e-4)


def test_views_spread_over_all_that_can_be_reached(views):
    points = reachable_views(REGION, [BENCH], COARSE)
    assert set(zip(views.azimuth, views.elevation, strict=True)) == {
        (points.azimuth[i], points.elevation[i]) for i in points.spread(10)
    }


def test_views_stay_within_the_widest_azimuth():
    narrow = Params(count=6, azimuth_step=30, distances=(0.6, 0.52), widest=45.0)
    assert np.abs(plan_views(REGION, [BENCH], narrow).azimuth).max() <= 45


def test_the_fast_preset_takes_ten_views_in_a_short_time():
    place = layout(USUAL_DISTANCE)
    views = plan_views(place.region, place.solids, PRESETS["fast"])
    assert len(views.joints) == 10
    assert np.abs(views.azimuth).max() <= 75
    assert capture_time(views) < 10  # docs/reports/views.md
