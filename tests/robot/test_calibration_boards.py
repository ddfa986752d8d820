"""Boards, corners, intrinsics, and the files a user writes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_board import CAMERA, corners_of, errors, poses, render
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError
from anther.core.geometry import small_transform
from anther.robot.calibration import (
    CharucoBoard,
    Chessboard,
    board_views,
    calibrate,
    estimate_intrinsics,
    find_corners,
    largest_distortion,
    parse_board,
    read_intrinsics,
    read_poses,
    undistort,
)


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("charuco:7x5:30mm:22mm", CharucoBoard(7, 5, 0.030, 0.022)),
        ("ChArUco:8X6:3cm:0.02m:dict_5x5_100:legacy", CharucoBoard(8, 6, 0.03, 0.02, "DICT_5X5_100", legacy=True)),
        ("chessboard:9x6:25mm", Chessboard(9, 6, 0.025)),
    ],
)
def test_boards_are_read(text: str, board: object) -> None:
    assert parse_board(text) == board


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "charuco:7x5:30mm:22mm"),
        ("charuco:7x5:30mm", "charuco:7x5:30mm:22mm"),
        ("chessboard:9x6:25mm:20mm", "chessboard:9x6:25mm"),
        ("aruco:7x5:30mm:22mm", "chessboard:9x6:25mm"),
        ("charuco:7:30mm:22mm", "COLUMNSxROWS"),
        ("charuco:7x5:30:22mm", "with its unit"),
        ("charuco:7x5:-30mm:22mm", "with its unit"),
        ("charuco:7x5:22mm:30mm", "marker"),
        ("charuco:7x5:30mm:22mm:DICT_NONE", "DICT_4X4_50"),
        ("charuco:12x10:30mm:22mm", "60 markers"),
        ("charuco:7x5:30mm:22mm:DICT_4X4_50:new", "legacy"),
        ("chessboard:1x6:25mm", "columns"),
        ("chessboard:9x7:25mm", "upside down"),
        ("chessboard:8x8:25mm", "upside down"),
        ("chessboard:9x6:25km", "with its unit"),
    ],
)
def test_impossible_boards_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_board(text)


@settings(max_examples=200)
@given(st.text(alphabet="charuochessboard:x0123456789.mc -", max_size=40))
def test_any_board_text_is_read_or_refused(text: str) -> None:
    try:
        outcome: object = parse_board(text)
    except InputError as error:
        outcome = str(error)
    assert isinstance(outcome, CharucoBoard | Chessboard) or "board" in str(outcome)


@pytest.mark.parametrize("board", [CharucoBoard(), Chessboard(6, 5, 0.03)], ids=["charuco", "chessboard"])
def test_corners_are_found_where_they_are(board: CharucoBoard | Chessboard) -> None:
    """Whichever way the board is turned, each corner keeps its place on it (or, a chessboard, all by one half turn)."""
    camera = replace(CAMERA, width=640, height=480, cx=319.5, cy=239.5)
    half = small_transform([0, 0, np.pi], 2 * board.centre)
    for turn in range(0, 360, 60):
        T = small_transform([0, 0, 0], [0.02, 0.01, 0.35]) @ small_transform([0.3, 0.4, 0], [0, 0, 0])
        T = T @ small_transform([0, 0, np.deg2rad(turn)], [0, 0, 0]) @ small_transform([0, 0, 0], -board.centre)
        known, seen = board.find(render(board, T, camera))
        assert len(known) >= 20
        places = T if isinstance(board, CharucoBoard) else T @ half
        expected = camera.project(known @ places[:3, :3].T + places[:3, 3])
        assert np.sqrt(np.mean(np.sum((seen - expected) ** 2, axis=1))) < 0.3


def test_rendered_charuco_views_calibrate_the_camera() -> None:
    rng = np.random.default_rng(5)
    board = CharucoBoard()
    flange, seen = poses(8, rng)
    images = [render(board, T) for T in seen]
    images.insert(3, np.full((720, 1280), 90, np.uint8))  # a view without the board
    views = board_views(find_corners(images, board), CAMERA)
    assert 3 not in views.images
    rest = np.array([i - (i > 3) for i in views.images])
    assert len(rest) >= 6
    assert views.reprojection.max() < 0.3
    rotation, translation = errors(calibrate(flange[rest], views, CAMERA).T_flange_cam)
    assert rotation < 0.06
    assert translation < 0.6


def test_images_without_a_board_are_refused() -> None:
    with pytest.raises(InputError, match="none with 8 corners"):
        find_corners([np.zeros((720, 1280), np.uint8)], CharucoBoard())


def test_intrinsics_are_estimated_and_distortion_only_where_there_is_some() -> None:
    rng = np.random.default_rng(9)
    flange, board = poses(20, rng)
    corners = corners_of(board, rng, 0.1)
    found, none = estimate_intrinsics(corners, 1280, 720)
    assert not none.any()
    assert [found.fx, found.fy] == pytest.approx([640, 640], rel=2e-3)
    assert [found.cx, found.cy] == pytest.approx([639.5, 359.5], abs=2)
    lens = np.array([-0.1, 0.03, 0.001, -0.0005, 0])
    rays = [np.column_stack([(p - [639.5, 359.5]) / 640, np.ones(len(p))]) for p in corners.pixels]
    bent = [cv2.projectPoints(r, np.zeros(3), np.zeros(3), CAMERA.matrix, lens)[0].reshape(-1, 2) for r in rays]
    bent_corners = replace(corners, pixels=tuple(bent))
    camera, distortion = estimate_intrinsics(bent_corners, 1280, 720)
    assert distortion[0] == pytest.approx(lens[0], abs=0.02)
    assert largest_distortion(CAMERA, lens) > 5
    straight = undistort(bent_corners, CAMERA, lens)
    assert max(np.abs(a - b).max() for a, b in zip(straight.pixels, corners.pixels, strict=True)) < 0.05
    result = calibrate(flange, board_views(undistort(bent_corners, camera, distortion), camera), camera)
    rotation, translation = errors(result.T_flange_cam)
    assert rotation < 0.2  # a principal point that is off by 1 px turns the camera by 0.09 deg
    assert translation < 1


def test_poses_are_read_in_every_format(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("# measured on Monday\nimage,qx,qy,qz,qw,x,y,z\na.png,0,0,0.6,0.8,1,2,3\n\nb.png,0,0,0,1,0,0,0\n")
    poses = read_poses(path)
    assert list(poses) == ["a.png", "b.png"]
    np.testing.assert_allclose(poses["a.png"][:3, 3], [1, 2, 3])
    np.testing.assert_allclose(poses["a.png"][:3, :3], Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix())
    path.write_text("image;x;y;z;qx;qy;qz;qw\na.png;1,0;2,0;3,0;0;0;0,6;0,8\n")
    np.testing.assert_array_equal(read_poses(path)["a.png"], poses["a.png"])
    path = tmp_path / "poses.json"
    path.write_text('{"a.png": [1, 2, 3, 0, 0, 0.6, 0.8]}')
    np.testing.assert_array_equal(read_poses(path)["a.png"], poses["a.png"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 320, "cy": 240, "k1": -0.1}', None),
        ('{"w": 640, "h": 480, "fl_x": 600, "fl_y": 600, "cx": 320, "cy": 240.5, "k1": -0.1, "frames": []}', None),
        ('{"intrinsics": {"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 320, "cy": 240}, '
         '"distortion": [-0.1, 0, 0, 0, 0]}', None),
        ("[]", "list"),
        ('{"width": 640}', "'height': got nothing"),
        ('{"width": 640, "height": 480, "fx": "600", "fy": 600, "cx": 320, "cy": 240}', "'fx': got '600'"),
        ('{"width": 640, "height": 480, "fx": 0, "fy": 600, "cx": 320, "cy": 240}', "focal length"),
    ],
)  # fmt: skip
def test_intrinsics_files(tmp_path: Path, text: str, message: str | None) -> None:
    path = tmp_path / "camera.json"
    path.write_text(text)
    if message is None:
        intrinsics, distortion = read_intrinsics(path)
        assert (intrinsics.width, intrinsics.fy, intrinsics.cy, distortion[0]) == (640, 600, 240, -0.1)
    else:
        with pytest.raises(InputError, match=message):
            read_intrinsics(path)
