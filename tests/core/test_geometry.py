"""Rigid transforms form a group; the pinhole camera and back-projection are inverse to each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError
from anther.core.geometry import (
    Box,
    Intrinsics,
    inverse,
    look_at,
    occupied_cells,
    pose7,
    small_transform,
    transform,
    transform_from_pose7,
    transform_points,
)

numbers = st.floats(-3, 3)
transforms = st.builds(
    small_transform, arrays(float, 3, elements=numbers), arrays(float, 3, elements=st.floats(-10, 10))
)
CAMERA = Intrinsics(width=64, height=48, fx=60, fy=62, cx=31.5, cy=23.5)


@given(transforms, transforms, transforms)
def test_transforms_form_a_group(A, B, C) -> None:
    assert np.allclose((A @ B) @ C, A @ (B @ C))
    assert np.allclose(A @ inverse(A), np.eye(4), atol=1e-12)
    assert np.allclose(inverse(A @ B), inverse(B) @ inverse(A), atol=1e-12)


@given(transforms)
def test_pose7_round_trip(T) -> None:
    pose = pose7(T)
    assert pose[6] >= 0
    assert np.allclose(transform_from_pose7(pose), T, atol=1e-9)


def test_inverse_of_a_stack_is_the_stack_of_inverses() -> None:
    T = np.stack([small_transform([0.1, 0.2, i], [1, 2, i]) for i in range(4)])
    assert np.allclose(inverse(T), np.linalg.inv(T))


@given(transforms, arrays(float, (5, 3), elements=numbers))
def test_transform_points_matches_the_matrix(T, points) -> None:
    homogeneous = np.c_[points, np.ones(5)] @ T.T
    assert np.allclose(transform_points(T, points), homogeneous[:, :3])


def test_look_at_sees_the_target_in_the_middle_and_up_is_up() -> None:
    T = look_at([1, 2, 0.5], [0, 0, 0.3])
    target = transform_points(inverse(T), [[0, 0, 0.3], [0, 0, 0.5]])
    assert np.allclose(target[0, :2], 0, atol=1e-12)
    assert target[0, 2] > 0
    assert target[1, 1] < 0  # y points down in an optical frame
    assert np.isclose(np.linalg.det(T[:3, :3]), 1)


def test_project_inverts_back_project() -> None:
    depth = np.random.default_rng(0).uniform(0.4, 2, (48, 64))
    depth[::7] = 0
    points = CAMERA.back_project(depth)
    v, u = np.nonzero(depth)
    assert np.allclose(CAMERA.project(points), np.stack([u, v], axis=1))
    assert np.allclose(CAMERA.rays()[v, u] * depth[v, u, None], points)


def test_points_behind_the_camera_do_not_project() -> None:
    assert np.isnan(CAMERA.project([[0, 0, -1.0]])).all()


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.zeros(6), r"shape \(6,\).*allowed: shape \(7\)"),
        ([0, 0, 0, 0, 0, 0, 2], "norm 2"),
        ([0, 0, 0, np.nan, 0, 0, 1], "1 NaN"),
        ("pose", "str"),
    ],
)
def test_bad_poses_are_refused(bad, message) -> None:
    with pytest.raises(InputError, match=message):
        transform_from_pose7(bad)


def test_a_mirror_is_not_a_rigid_transform() -> None:
    with pytest.raises(InputError, match="not a rigid transform"):
        pose7(transform(np.diag([1, 1, -1.0]), [0, 0, 0]))
    with pytest.raises(InputError, match="not a rigid transform"):
        pose7(transform(1000 * Rotation.random(random_state=0).as_matrix(), [0, 0, 0]))


@given(st.integers(-5, 0))
def test_intrinsics_refuse_empty_images(width) -> None:
    with pytest.raises(InputError, match="image width"):
        Intrinsics(width=width, height=10, fx=10, fy=10, cx=0, cy=0)


def test_box_knows_its_inside() -> None:
    box = Box(np.zeros(3), np.ones(3))
    assert box.contains([[0.5, 0.5, 0.5], [0.5, 0.5, 1.5]]).tolist() == [True, False]
    with pytest.raises(InputError, match="Swap"):
        Box(np.ones(3), np.zeros(3))


@given(arrays(float, st.tuples(st.integers(1, 40), st.just(3)), elements=numbers))
def test_occupied_cells_hold_every_point_and_are_sorted(points) -> None:
    assert np.array_equal(occupied_cells(points, 0.5), np.unique(np.floor(points / 0.5), axis=0))
