"""Sawyer's kinematics against published and independently derived values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from anther.robot.arm.gripper_shape import GripperShape
from anther.robot.arm.sawyer import SAWYER, TOOL

PI = np.pi
# Standard DH: offset of theta, d, a, alpha; then Rz(-100 deg) (facts: sawyer 2).
DH = [
    (0, 0.317, 0.081, -PI / 2),
    (PI / 2, 0.1925, 0, PI / 2),
    (0, 0.400, 0, -PI / 2),
    (0, -0.1685, 0, PI / 2),
    (0, 0.400, 0, -PI / 2),
    (0, 0.1363, 0, PI / 2),
    (0, 0.1345, 0, 0),
]


def dh_forward(q):
    T = np.eye(4)
    for angle, (offset, d, a, alpha) in zip(q, DH, strict=True):
        c, s, ca, sa = np.cos(angle + offset), np.sin(angle + offset), np.cos(alpha), np.sin(alpha)
        T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
    T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec([0, 0, np.deg2rad(-100)]).as_matrix()
    return T


def random_joints(count, seed=0):
    return np.random.default_rng(seed).uniform(SAWYER.lower, SAWYER.upper, (count, 7))


@pytest.mark.parametrize(
    ("q", "position"),
    [(np.zeros(7), (1.0155, 0.1603, 0.3170)), (SAWYER.neutral, (0.4496, 0.1603, 0.21575))],
)
def test_published_flange_positions(q, position):
    np.testing.assert_allclose(SAWYER.forward(q)[:3, 3], position, atol=6e-5)  # printed with four or five decimals


def test_tool_points_down_at_neutral():
    np.testing.assert_allclose(
        SAWYER.forward(SAWYER.neutral)[:3, 2], [0, 0, -1], atol=1e-3
    )  # neutral is rounded to 0.01 rad


def test_forward_equals_denavit_hartenberg():
    for q in random_joints(50):
        np.testing.assert_allclose(SAWYER.forward(q), dh_forward(q), atol=1e-9)


def test_forward_of_a_stack_equals_one_by_one():
    q = random_joints(6).reshape(2, 3, 7)
    stacked = SAWYER.forward(q)
    assert stacked.shape == (2, 3, 4, 4)
    np.testing.assert_allclose(stacked[1, 2], SAWYER.forward(q[1, 2]), atol=1e-14)


def test_jacobian_is_the_derivative_of_forward():
    step = 1e-6
    for q in random_joints(5, seed=1):
        J = SAWYER.jacobian(q)
        for i in range(7):
            dq = step * np.eye(7)[i]
            plus, minus = SAWYER.forward(q + dq), SAWYER.forward(q - dq)
            twist = Rotation.from_matrix(plus[:3, :3] @ minus[:3, :3].T).as_rotvec() / (2 * step)
            np.testing.assert_allclose(J[:3, i], (plus[:3, 3] - minus[:3, 3]) / (2 * step), atol=1e-8)
            np.testing.assert_allclose(J[3:, i], twist, atol=1e-8)


def test_reach_matches_the_facts():
    q = random_joints(20_000, seed=2)
    reach = np.linalg.norm(SAWYER.forward(q)[:, :3, 3] - [0, 0, 0.317], axis=1).max()
    assert 1.10 < reach < 1.1301


def test_inertias_are_physical():
    for link in SAWYER.links:
        xx, yy, zz, xy, xz, yz = link.inertia
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert moments[0] > 0
        assert moments[0] + moments[1] > moments[2]


def test_limits_enclose_neutral():
    assert np.all((SAWYER.lower < SAWYER.neutral) & (SAWYER.neutral < SAWYER.upper))


def test_fingers_close_along_y_and_touch_at_zero_opening():
    left, right = TOOL.fingers(0.0)
    assert left.center[1] - left.half[1] == pytest.approx(0)
    assert right.center[1] + right.half[1] == pytest.approx(0)
    assert left.center[2] + left.half[2] == pytest.approx(TOOL.tip)


def test_camera_does_not_see_the_gripper():
    """Every corner of gripper and open fingers is outside the D455's 87 x 58 degree view."""
    solids = (TOOL.body, *TOOL.fingers(TOOL.stroke))
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = np.concatenate([np.array(s.center) + signs * s.half for s in solids])
    in_camera = (corners - TOOL.T_flange_cam[:3, 3]) @ TOOL.T_flange_cam[:3, :3]
    x, y, z = np.abs(in_camera[:, 0]), np.abs(in_camera[:, 1]), in_camera[:, 2]
    seen = (z > 0) & (x < z * np.tan(np.deg2rad(43.5))) & (y < z * np.tan(np.deg2rad(32.5)))
    assert not seen.any()


def test_grasp_planning_assumes_the_same_gripper():
    """Stages do not import the arm, so grasp planning has the gripper's numbers as defaults: they must not drift."""
    gripper = GripperShape()
    assert gripper.depth == pytest.approx(TOOL.T_flange_grasp[2, 3])
    assert gripper.pad == (TOOL.pad[0], TOOL.pad[2])
    boxes = {tuple(np.round(box, 6)) for box in gripper.boxes(0.0)}
    solids = (TOOL.body, *TOOL.camera, *TOOL.fingers(TOOL.stroke))
    assert {tuple(np.round(np.r_[np.subtract(s.center, s.half), np.add(s.center, s.half)], 6)) for s in solids} <= boxes
