from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from anther.calibration import CharucoBoard, HandEye, Params, calibrate, detect_board
from anther.errors import InputError
from anther.geometry import Array, Intrinsics, inverse, look_at, small_transform

T_FLANGE_CAM = small_transform([0.1, -0.2, 1.5], [0.03, -0.06, 0.05])
T_BASE_BOARD = small_transform([3.1, 0.02, 0.01], [0.7, 0.1, -0.2])  # it lies face up: OpenCV's board z points down
BOARD_CENTRE = T_BASE_BOARD @ [0.105, 0.075, 0, 1]
CAMERA = Intrinsics(1280, 720, 640.0, 640.0, 639.5, 359.5)


def poses(count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Flange poses that look at the board from above, and what the camera then sees of it."""
    flange = []
    for _ in range(count):
        eye = BOARD_CENTRE[:3] + np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.35, 0.5)])
        aim = BOARD_CENTRE[:3] + np.array([*rng.uniform(-0.04, 0.04, 2), 0])
        roll = small_transform([0, 0, rng.uniform(-1, 1)], [0, 0, 0])
        flange.append(look_at(eye, aim, up=(0.1, 1, 0)) @ roll @ inverse(T_FLANGE_CAM))
    flange = np.stack(flange)
    return flange, inverse(flange @ T_FLANGE_CAM) @ T_BASE_BOARD


def jitter(T: Array, rng: np.random.Generator, degrees: float, shift: float) -> Array:
    return np.stack(
        [M @ small_transform(np.deg2rad(degrees) * rng.normal(size=3), shift * rng.normal(size=3)) for M in T]
    )


def errors(found: Array, true: Array = T_FLANGE_CAM) -> tuple[float, float]:
    """Rotation [deg] and translation [m] error."""
    gap = inverse(true) @ found
    return float(np.rad2deg(np.linalg.norm(Rotation.from_matrix(gap[:3, :3]).as_rotvec()))), float(
        np.linalg.norm(gap[:3, 3])
    )


@pytest.mark.parametrize("method", ["tsai", "park", "horaud", "daniilidis"])
def test_perfect_poses_give_the_exact_transform(method: str) -> None:
    flange, board = poses(8, np.random.default_rng(0))
    result = calibrate(flange, board, Params(method=method))  # type: ignore[arg-type]
    assert max(errors(result.T_flange_cam)) < 1e-6
    assert max(errors(result.T_base_board, T_BASE_BOARD)) < 1e-6
    assert result.translation_residuals.max() < 1e-7
    assert result.used.all()


def test_noisy_poses_stay_within_the_measured_accuracy() -> None:
    """Facts, perception, hand-eye table: 20 poses, 0.2 px, perfect robot: 0.06 deg and 0.6 mm."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(10):
        flange, board = poses(20, rng)
        found.append(errors(calibrate(flange, jitter(board, rng, 0.06, 0.0003)).T_flange_cam))
    rotation, translation = np.median(found, axis=0)
    assert rotation <= 0.06
    assert translation <= 0.0006


def test_refinement_beats_the_closed_form() -> None:
    rng = np.random.default_rng(2)
    plain, refined = [], []
    for _ in range(12):
        flange, board = poses(15, rng)
        seen = jitter(board, rng, 0.1, 0.0005)
        plain.append(errors(calibrate(flange, seen, Params(refine=False)).T_flange_cam)[1])
        refined.append(errors(calibrate(flange, seen).T_flange_cam)[1])
    assert np.mean(refined) < np.mean(plain)


def test_outlying_views_are_left_out_and_named() -> None:
    rng = np.random.default_rng(3)
    flange, board = poses(20, rng)
    seen = jitter(board, rng, 0.05, 0.0003)
    seen[[4, 11]] = seen[[4, 11]] @ small_transform([0, 0.05, 0], [0.03, 0, 0.01])
    result = calibrate(flange, seen)
    assert set(np.flatnonzero(~result.used)) == {4, 11}
    assert "4, 11" in result.notes[0]
    assert errors(result.T_flange_cam)[1] < 0.001
    assert result.translation_residuals[4] > 0.02


def test_turning_about_one_axis_is_refused() -> None:
    flange = np.stack([small_transform([0, 0, a], [0.1 * a, 0, 0.3]) for a in np.linspace(0, 2, 8)])
    with pytest.raises(InputError, match="one axis only"):
        calibrate(flange, inverse(flange @ T_FLANGE_CAM) @ T_BASE_BOARD)


def test_pure_translation_is_refused() -> None:
    flange = np.stack([small_transform([0, 0, 0], [0.1 * a, 0, 0.3]) for a in range(5)])
    with pytest.raises(InputError, match="turn"):
        calibrate(flange, inverse(flange @ T_FLANGE_CAM) @ T_BASE_BOARD)


def test_two_views_are_refused() -> None:
    flange, board = poses(2, np.random.default_rng(0))
    with pytest.raises(InputError, match="3 or more"):
        calibrate(flange, board)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(["count", "nan", "scale", "shape"]), st.integers(0, 3))
def test_bad_poses_are_refused(fault: str, where: int) -> None:
    flange, board = (np.array(T) for T in poses(4, np.random.default_rng(0)))
    if fault == "count":
        board = board[:where]
    elif fault == "nan":
        board[where, 0, 3] = np.nan
    elif fault == "scale":
        flange[where, :3, :3] *= 1.5
    else:
        flange = flange[:, :3]
    with pytest.raises(InputError):
        calibrate(flange, board)


def test_unknown_method_is_refused() -> None:
    with pytest.raises(InputError, match="tsai, park"):
        Params(method="andreff")  # type: ignore[arg-type]


def test_round_trip(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    flange, board = poses(6, rng)
    result = calibrate(flange, jitter(board, rng, 0.05, 0.0003))
    result.save(tmp_path / "hand_eye.npz")
    again = HandEye.load(tmp_path / "hand_eye.npz")
    assert np.array_equal(again.T_flange_cam, result.T_flange_cam)
    assert np.array_equal(again.used, result.used)
    assert (again.method, again.notes) == (result.method, result.notes)


def render(board: CharucoBoard, T_cam_board: Array, pixels_per_square: int = 80) -> Array:
    """The image a pinhole camera has of the printed board on a grey table."""
    page = board.opencv().generateImage((board.columns * pixels_per_square, board.rows * pixels_per_square))
    scale = board.square / pixels_per_square
    to_board = np.array([[scale, 0, scale / 2], [0, scale, scale / 2], [0, 0, 1]])  # pixel centres
    homography = (
        CAMERA.matrix @ np.column_stack([T_cam_board[:3, 0], T_cam_board[:3, 1], T_cam_board[:3, 3]]) @ to_board
    )
    # Drawn four times as large and averaged, so that edges have grey levels.
    grow = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1.0]])
    size = (4 * CAMERA.width, 4 * CAMERA.height)
    large = cv2.warpPerspective(page, grow @ homography, size, borderMode=cv2.BORDER_CONSTANT, borderValue=128)
    return cv2.resize(large, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA)


def test_rendered_charuco_views_calibrate_the_camera() -> None:
    rng = np.random.default_rng(5)
    board = CharucoBoard()
    flange, seen = poses(8, rng)
    images = [render(board, T) for T in seen]
    images.insert(3, np.full((720, 1280), 90, np.uint8))  # a view without the board
    views = detect_board(images, CAMERA, board)
    assert 3 not in views.images
    rest = np.array([i - (i > 3) for i in views.images])
    assert len(rest) >= 6
    assert views.reprojection.max() < 0.3
    result = calibrate(flange[rest], views.T_cam_board)
    rotation, translation = errors(result.T_flange_cam)
    assert rotation < 0.06
    assert translation < 0.0006


def test_images_without_a_board_are_refused() -> None:
    with pytest.raises(InputError, match="none with 8 corners"):
        detect_board([np.zeros((720, 1280), np.uint8)], CAMERA, CharucoBoard())


def test_impossible_boards_are_refused() -> None:
    with pytest.raises(InputError, match="marker"):
        CharucoBoard(square=0.02, marker=0.03)
    with pytest.raises(InputError, match="DICT_4X4_50"):
        CharucoBoard(dictionary="DICT_NONE")
