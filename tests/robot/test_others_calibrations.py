"""Boards, lenses and poses as other people's programs and printers make them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_board import (
    CAMERA,
    CORNERS,
    T_BASE_BOARD,
    T_FLANGE_CAM,
    corners_of,
    errors,
    jitter,
    poses,
    render,
    views_of,
)

from anther.core.errors import InputError
from anther.core.geometry import Array, inverse, small_transform
from anther.robot.calibration import (
    BoardCorners,
    CharucoBoard,
    EyeToHand,
    HandEye,
    board_views,
    calibrate,
    calibrate_eye_to_hand,
    find_corners,
    read_intrinsics,
    undistort,
)

RATIONAL = np.array([0.9, 0.05, 3e-4, -4e-4, 0.001, 1.25, 0.2, 0.01])
PLAIN = {"width": 1280, "height": 720, "fx": 640.0, "fy": 640.0, "cx": 639.5, "cy": 359.5}


def through(lens: Array, T_cam_board: Array) -> BoardCorners:
    """The corners as a camera with this lens sees them."""
    straight = corners_of(T_cam_board, np.random.default_rng(0), 0.0)
    bent = []
    for pixels in straight.pixels:
        rays = np.c_[(pixels - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy], np.ones(len(pixels))]
        bent.append(cv2.projectPoints(rays, np.zeros(3), np.zeros(3), CAMERA.matrix, lens)[0].reshape(-1, 2))
    return BoardCorners(straight.images, straight.points, tuple(bent))


@pytest.mark.parametrize(
    "stated",
    [
        dict(zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), RATIONAL.tolist(), strict=True)),
        {"distortion": RATIONAL.tolist()},
        {"distortion_model": "rational_polynomial", "D": RATIONAL.tolist()},
        {"camera_model": "FULL_OPENCV", "distortion_coefficients": {"rows": 1, "data": RATIONAL.tolist()}},
    ],
)
def test_all_numbers_of_a_lens_are_used(tmp_path: Path, stated: dict[str, object]) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(PLAIN | stated))
    intrinsics, lens = read_intrinsics(path)
    flange, board = poses(10, np.random.default_rng(0))
    straight = undistort(through(RATIONAL, board), intrinsics, lens)
    found = calibrate(flange, board_views(straight, intrinsics), intrinsics, distortion=lens)
    assert max(errors(found.T_flange_cam)) < 0.02
    found.save(tmp_path / "calibration.json")
    np.testing.assert_array_equal(HandEye.load(tmp_path / "calibration.json").distortion, RATIONAL)
    np.testing.assert_array_equal(read_intrinsics(tmp_path / "calibration.json")[1], RATIONAL)


@pytest.mark.parametrize(
    "stated",
    [
        {"camera_model": "OPENCV_FISHEYE", "k1": 0.1},
        {"distortion_model": "equidistant", "D": [0.1, 0, 0, 0]},
        {"distortion_model": "equidistant", "D": [0.0, 0, 0, 0]},
        {"distortion_params": [0.1, 0, 0, 0]},
        {"radial_distortion": [0.1]},
        {"k7": 0.01},
        {"skew": 0.3},
        {"is_fisheye": True},
        {"distortion": [0.1] * 15},
        {"k1": 0.1, "distortion": [0.2, 0, 0, 0]},
    ],
)
def test_a_lens_that_is_not_understood_is_refused(tmp_path: Path, stated: dict[str, object]) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(PLAIN | stated))
    with pytest.raises(InputError, match=r"camera\.json"):
        read_intrinsics(path)


def test_a_lens_that_cannot_be_undone_is_refused() -> None:
    _, board = poses(4, np.random.default_rng(0))
    with pytest.raises(InputError, match="cannot be undone"):
        undistort(through(np.zeros(5), board), CAMERA, np.array([-3.0, 0, 0, 0, 0]))


def test_the_pixel_centres_of_a_transforms_json_are_half_integers(tmp_path: Path) -> None:
    path = tmp_path / "transforms.json"
    camera = {"w": 1280, "h": 720, "fl_x": 640.0, "fl_y": 640.0, "cx": 640.0, "cy": 360.0}
    path.write_text(json.dumps(camera | {"frames": []}))
    assert read_intrinsics(path)[0] == CAMERA
    path.write_text(json.dumps({"frames": [camera, camera]}), encoding="utf-8-sig")  # as Windows' editors write it
    assert read_intrinsics(path)[0] == CAMERA
    path.write_text(json.dumps({"frames": [camera, camera | {"fl_x": 641.0}]}))
    with pytest.raises(InputError, match="other intrinsics in each frame"):
        read_intrinsics(path)


@pytest.mark.parametrize(("size", "word"), [(0.97, "smaller"), (1.015, "larger")])
def test_a_board_of_another_size_is_noticed(size: float, word: str) -> None:
    rng = np.random.default_rng(1)
    flange, board = poses(15, rng)
    seen = corners_of(board, rng, 0.2)
    said = BoardCorners(seen.images, tuple(p / size for p in seen.points), seen.pixels)
    found = calibrate(jitter(flange, rng, 0.02, 0.0002), board_views(said, CAMERA), CAMERA)
    told = [re.search(r"([0-9.]+) % (\w+) than said: squares of ([0-9.]+) mm", note) for note in found.notes]
    share, way, square = next(m for m in told if m).groups()
    assert way == word
    assert float(share) == pytest.approx(100 * abs(size - 1), abs=0.2)
    assert float(square) == pytest.approx(30.0, abs=0.05)  # as they are


def test_a_board_of_the_size_that_was_said_is_not_doubted() -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        flange, board = poses(12, rng)
        found = calibrate(jitter(flange, rng, 0.1, 0.001), views_of(board, rng, 0.4), CAMERA)
        assert not any("than said" in note for note in found.notes)


T_BASE_CAM = small_transform([-2.0, 0.3, 0.2], [0.9, -0.5, 0.4])
T_FLANGE_BOARD = small_transform([0.2, -0.1, 0.4], [-0.1, -0.07, 0.06])


def beside(count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Flange poses that hold a board before a camera beside the robot, and what it then sees."""
    centre = CORNERS.mean(axis=0)
    board = np.stack(
        [
            small_transform(rng.uniform(-0.5, 0.5, 3), [*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.35, 0.5)])
            @ small_transform([0, 0, 0], -centre)
            for _ in range(count)
        ]
    )
    return T_BASE_CAM @ board @ inverse(T_FLANGE_BOARD), board


def test_a_camera_beside_the_robot_is_found(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    flange, board = beside(15, rng)
    found = calibrate_eye_to_hand(jitter(flange, rng, 0.02, 0.0002), views_of(board, rng, 0.1), CAMERA)
    assert max(errors(found.T_base_cam, T_BASE_CAM)) < 0.5
    assert max(errors(found.T_flange_board, T_FLANGE_BOARD)) < 0.5
    path = tmp_path / "calibration.json"
    found.save(path)
    np.testing.assert_allclose(EyeToHand.load(path).T_base_cam, found.T_base_cam)
    with pytest.raises(InputError, match="'eye-to-hand': beside the robot"):
        HandEye.load(path)


def test_the_arm_errors_of_a_camera_beside_the_robot_are_the_flanges() -> None:
    """An arm that errs by 0.1 deg and 1 mm at the flange, not at the base, is told so."""
    rng, told = np.random.default_rng(2), []
    for _ in range(4):
        flange, board = beside(20, rng)
        noise = np.stack(
            [small_transform(np.deg2rad(0.1) * rng.normal(size=3), 0.001 * rng.normal(size=3)) for _ in flange]
        )
        found = calibrate_eye_to_hand(flange @ noise, views_of(board, rng, 0.1), CAMERA).exchanged
        told.append([np.rad2deg(found.arm_rotation_error), 1e3 * found.arm_translation_error])
    assert np.median(told, axis=0) == pytest.approx([0.1, 1.0], rel=0.4)


def test_the_other_place_of_the_camera_is_named() -> None:
    rng = np.random.default_rng(1)
    flange, board = beside(12, rng)
    views = views_of(board, rng)
    with pytest.raises(InputError, match="give --eye-to-hand"):
        calibrate(flange, views, CAMERA)
    flange, board = poses(12, rng)
    views = views_of(board, rng)
    with pytest.raises(InputError, match="leave out --eye-to-hand"):
        calibrate_eye_to_hand(flange, views, CAMERA)
    with pytest.raises(InputError, match="T_flange_base: invert them"):
        calibrate(inverse(flange), views, CAMERA)


def test_inverted_poses_of_the_other_place_are_doubted() -> None:
    """Both mistakes together give the equation of neither: only the distances tell."""
    rng = np.random.default_rng(1)
    flange, board = beside(12, rng)
    found = calibrate(inverse(flange), views_of(board, rng), CAMERA)
    assert any("from the flange" in note and "T_flange_base" in note for note in found.notes)
    flange, board = poses(12, rng)
    views = views_of(board, rng)
    assert any(
        "T_flange_base" in note for note in calibrate_eye_to_hand(inverse(flange), views, CAMERA).exchanged.notes
    )
    assert not any("T_flange_base" in note for note in calibrate(flange, views, CAMERA).notes)


@pytest.mark.parametrize(
    ("printed", "said", "words"),
    [
        (CharucoBoard(7, 6, legacy=True), CharucoBoard(7, 6), "append :legacy"),
        (CharucoBoard(7, 6), CharucoBoard(7, 6, legacy=True), "take :legacy off"),
        (CharucoBoard(7, 5), CharucoBoard(5, 7), "7x5 squares, not 5x7"),
    ],
)
def test_the_board_that_was_printed_is_named(printed: CharucoBoard, said: CharucoBoard, words: str) -> None:
    _, board = poses(1, np.random.default_rng(3))
    with pytest.raises(InputError, match=words):
        find_corners([render(printed, board[0])], said)


def test_the_made_arm_is_as_the_tests_need_it() -> None:
    """The camera on the flange is nearer to it than the board is to the base, and the other way round beside it."""
    assert np.linalg.norm(T_FLANGE_CAM[:3, 3]) < np.linalg.norm(T_BASE_BOARD[:3, 3])
    assert np.linalg.norm(T_BASE_CAM[:3, 3]) > np.linalg.norm(T_FLANGE_BOARD[:3, 3])
