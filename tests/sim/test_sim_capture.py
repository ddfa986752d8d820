"""Simulated captures: what the planner gets differs from the truth as much as stated, and by nothing else."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from grown_plants import grown
from scipy.spatial.transform import Rotation
from straight_plant import BASE, straight_plant, with_blade

from anther.core.errors import InputError
from anther.core.geometry import Array, inverse, look_at, small_transform, transform
from anther.robot.arm.views import Views
from anther.sim.capture import (
    CameraErrors,
    DepthNoise,
    capture_from_poses,
    capture_views,
    noisy_rgb,
    orbit_poses,
    perturbed_hand_eye,
)
from anther.sim.plant import Organ, SimPlant
from anther.sim.render import Scene, d455
from anther.sim.simulated_cell import in_wind
from anther.sim.sway import swaying
from anther.sim.truth import Truth

CAMERA = d455(256, 144)
TARGET = (0.72, 0.0, -0.1)
SHARP = DepthNoise(
    subpixel=0, quantum=0, fattening=0, thin=0, edge_dropped=0, edge_flying=0, stereo_shadow=False, max_range=50
)
NONE = CameraErrors(
    pose_rotation=0, pose_translation=0, depth=SHARP, exposure=0, white_balance=0, read_noise=0, shot_noise=0, blur=0
)
T_FLANGE_CAM = small_transform([0.1, 0.0, -0.4], [0.03, 0.0, 0.05])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.of_plant(grown("pepper", 0))


def forward(q: Array) -> Array:
    """A made-up arm whose flange circles the plant with the first joint."""
    eye = np.array(TARGET) + 0.8 * np.array([-np.cos(q[0]), -np.sin(q[0]), 0.3])
    return look_at(eye, TARGET) @ inverse(T_FLANGE_CAM)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_without_errors_the_capture_is_the_truth(scene: Scene) -> None:
    capture, truth = capture_from_poses(scene, orbit_poses(2, TARGET, 0.8), rng=rng(), intrinsics=CAMERA, errors=NONE)
    np.testing.assert_allclose(capture.T_world_cam, truth.T_world_cam, atol=1e-12)
    np.testing.assert_allclose(capture.depth, truth.depth, rtol=1e-5)
    assert set(np.unique(truth.organ)) >= {Organ.STEM, Organ.LEAF, Organ.POT, Organ.BENCH}


def test_pose_errors_have_the_stated_size(scene: Scene) -> None:
    tiny = d455(16, 9)
    _, truth = capture_from_poses(scene, np.tile(np.eye(4), (400, 1, 1)), rng=rng(), intrinsics=tiny)
    assert truth.T_world_cam[:, :3, 3].std(axis=0) == pytest.approx(0.0015, rel=0.15)
    turns = Rotation.from_matrix(truth.T_world_cam[:, :3, :3]).as_rotvec()
    assert np.degrees(turns.std(axis=0)) == pytest.approx(0.2, rel=0.15)


def test_the_planner_believes_forward_kinematics_and_calibration(scene: Scene) -> None:
    joints = np.linspace(-0.5, 0.5, 3)[:, None] * np.ones(7)
    believed = perturbed_hand_eye(T_FLANGE_CAM, rng(1))
    capture, truth = capture_views(scene, joints, forward, T_FLANGE_CAM, believed, rng=rng(), intrinsics=CAMERA)
    for q, T in zip(joints, capture.T_world_cam, strict=True):
        np.testing.assert_allclose(T, forward(q) @ believed, atol=1e-12)
    np.testing.assert_array_equal(capture.joints, joints)
    offset = np.linalg.norm((capture.T_world_cam - truth.T_world_cam)[:, :3, 3], axis=1)
    assert np.all(offset < 0.01)
    assert np.all(offset > 1e-5)


def test_without_arm_error_the_true_camera_is_forward_times_hand_eye(scene: Scene) -> None:
    joints = np.array([[0.2] * 7])
    _, truth = capture_views(scene, joints, forward, T_FLANGE_CAM, np.eye(4), rng=rng(), intrinsics=CAMERA, errors=NONE)
    np.testing.assert_allclose(truth.T_world_cam[0], forward(joints[0]) @ T_FLANGE_CAM, atol=1e-12)


def test_same_seed_same_capture(scene: Scene) -> None:
    poses = orbit_poses(3, TARGET, 0.8)
    a, _ = capture_from_poses(scene, poses, rng=rng(7), intrinsics=CAMERA)
    b, _ = capture_from_poses(scene, poses, rng=rng(7), intrinsics=CAMERA)
    c, _ = capture_from_poses(scene, poses, rng=rng(8), intrinsics=CAMERA)
    np.testing.assert_array_equal(a.depth, b.depth)
    np.testing.assert_array_equal(a.rgb, b.rgb)
    assert np.any(a.depth != c.depth)


def test_progress_counts_every_view(scene: Scene) -> None:
    calls: list[tuple[int, int]] = []
    poses = orbit_poses(3, TARGET, 0.8)
    capture_from_poses(scene, poses, rng=rng(), intrinsics=CAMERA, progress=lambda done, n: calls.append((done, n)))
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_hand_eye_error_has_the_stated_size() -> None:
    for seed in range(5):
        error = inverse(T_FLANGE_CAM) @ perturbed_hand_eye(T_FLANGE_CAM, rng(seed))
        assert np.degrees(Rotation.from_matrix(error[:3, :3]).magnitude()) == pytest.approx(0.2, rel=1e-6)
        assert np.linalg.norm(error[:3, 3]) == pytest.approx(0.001)


def test_orbit_looks_at_its_target_from_the_stated_distance() -> None:
    poses = orbit_poses(7, TARGET, 0.7, (90, 270), (0.0, 30.0))
    to_target = np.array(TARGET) - poses[:, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(to_target, axis=1), 0.7)
    np.testing.assert_allclose(poses[:, :3, 2], to_target / 0.7, atol=1e-12)
    azimuth = np.degrees(np.arctan2(-to_target[:, 1], -to_target[:, 0])) % 360
    assert azimuth.min() == pytest.approx(90)
    assert azimuth.max() == pytest.approx(270)


def test_colour_noise_grows_with_brightness_and_keeps_the_mean() -> None:
    errors = CameraErrors(exposure=0, white_balance=0, read_noise=1.5, shot_noise=0.03)
    spread = []
    for grey in (20, 200):
        image = noisy_rgb(np.full((200, 200, 3), grey, dtype=np.uint8), rng(), errors).astype(float)
        assert image.mean() == pytest.approx(grey, abs=0.2)
        spread.append(image.std())
    np.testing.assert_allclose(spread, np.sqrt(1.5**2 + 0.03 * np.array([20, 200])), rtol=0.05)


def test_bad_joints_and_transforms_are_refused(scene: Scene) -> None:
    with pytest.raises(InputError, match="joints"):
        capture_views(scene, np.zeros(7), forward, np.eye(4), np.eye(4), rng=rng())
    with pytest.raises(InputError, match="rigid"):
        capture_views(scene, np.zeros((2, 7)), forward, 2 * np.eye(4), np.eye(4), rng=rng())
    with pytest.raises(InputError, match="pose rotation"):
        CameraErrors(pose_rotation=0.2 * 57)
    with pytest.raises(InputError, match="number of views"):
        orbit_poses(0, TARGET)


def test_identity_flange_is_a_plain_camera() -> None:
    T = transform(np.eye(3), [0, 0, 0])
    np.testing.assert_array_equal(perturbed_hand_eye(T, rng(), rotation=0.0, translation=0.0), T)


@pytest.fixture(scope="module")
def leafy() -> SimPlant:
    """A stem whose one blade, all there is to see, feels the wind."""
    plant = with_blade(straight_plant(), BASE + np.array([0.03, 0.13, 0.4]), [1.0, 0.1, 0.2], segment=23)
    return replace(plant, drag_area=np.full(len(plant.start), 1e-4))


def tour(count: int) -> Views:
    """Views of which all that counts here is how long they take: 0.3 s each."""
    motions = [SimpleNamespace(duration=0.1)] * count
    return cast(Views, SimpleNamespace(joints=np.zeros((count, 7)), motions=motions, dwell=np.full(count, 0.2)))


def test_without_wind_all_views_find_the_plant_where_it_grew(leafy: SimPlant) -> None:
    still = Scene.of_plant(leafy)
    assert in_wind(leafy, still, tour(3), Truth(wind=0.0)) is still


def test_in_wind_each_view_finds_the_plant_where_it_has_swayed_to_by_then(leafy: SimPlant) -> None:
    still, count = Scene.of_plant(leafy), 3
    sight = in_wind(leafy, still, tour(count), Truth(wind=0.8))
    assert callable(sight)
    blown = [sight(view).vertices for view in range(count)]
    own = len(leafy.vertices)
    for vertices, T in zip(blown, swaying(leafy, 0.8, [0.0, 0.45, 0.9]), strict=True):
        assert vertices[:own] == pytest.approx(leafy.posed_vertices(T))
        assert np.array_equal(vertices[own:], still.vertices[own:])  # bench and pot stand still
    for one, other in ((0, 1), (1, 2), (0, 2)):
        assert np.linalg.norm((blown[one] - blown[other])[:own], axis=1).max() > 3e-4


def test_each_view_sees_the_scene_that_it_finds(scene: Scene) -> None:
    joints = np.array([[-0.3] * 7, [0.4] * 7])
    aside = scene.moved(np.add(scene.vertices, [0, 0.05, 0]))
    taken = [
        capture_views(sight, joints, forward, T_FLANGE_CAM, T_FLANGE_CAM, rng=rng(), intrinsics=CAMERA, errors=NONE)
        for sight in (scene, aside, lambda view: (scene, aside)[view])
    ]
    still, moved, mixed = (truth.depth for _, truth in taken)
    assert not np.array_equal(still[1], moved[1])
    np.testing.assert_array_equal(mixed, [still[0], moved[1]])
    np.testing.assert_array_equal(taken[2][0].depth[1], taken[1][0].depth[1])
