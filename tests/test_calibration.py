from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_board import (
    CAMERA,
    T_BASE_BOARD,
    T_FLANGE_CAM,
    corners_of,
    errors,
    jitter,
    poses,
    render,
    seen_from,
    views_of,
)
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from anther.calibration import (
    BoardViews,
    CharucoBoard,
    Chessboard,
    HandEye,
    Params,
    board_views,
    calibrate,
    detect_board,
    estimate_intrinsics,
    largest_distortion,
    parse_board,
    undistorted,
)
from anther.calibration.closed_form import METHODS, Method, closed_form
from anther.calibration.motions import motion_warnings
from anther.calibration.pose_file import read_intrinsics, read_poses
from anther.calibration.refinement import Noise, Problem, _moved, refine, view_distances
from anther.errors import InputError
from anther.geometry import inverse, small_transform


@pytest.mark.parametrize("method", METHODS)
def test_perfect_poses_give_the_exact_transform(method: Method) -> None:
    flange, board = poses(8, np.random.default_rng(0))
    assert max(errors(closed_form(flange, board, method)[0])) < 1e-3
    views = views_of(board, np.random.default_rng(0), noise=0.0)
    result = calibrate(flange, views, CAMERA, Params(method=method))
    assert max(errors(result.T_flange_cam)) < 1e-4
    assert max(errors(result.T_base_board, T_BASE_BOARD)) < 1e-4
    assert result.pixel_residuals.max() < 1e-4
    assert result.used.all()


def test_twenty_noisy_views_meet_the_target() -> None:
    """Target: 20 poses, 0.2 px, exact robot: 0.06 deg and 0.6 mm; and better than every closed form."""
    refined, plain = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        flange, board = poses(20, rng)
        views = views_of(board, rng)
        result = calibrate(flange, views, CAMERA)
        refined.append(errors(result.T_flange_cam))
        plain.append([errors(closed_form(flange, views.T_cam_board, method)[0]) for method in METHODS])
        assert result.pixel_noise == pytest.approx(0.2, rel=0.15)
        assert result.arm_translation_error < 1e-4
    assert np.all(np.max(refined, axis=0) <= [0.06, 0.6])
    assert np.all(np.median(refined, axis=0) < 0.5 * np.median(plain, axis=0).min(axis=0))


def test_an_inexact_arm_is_noticed_and_allowed_for() -> None:
    """0.5 px and an arm that errs by 0.1 deg and 1 mm per axis: better than Tsai, far better than pixels alone."""
    refined, plain, pixels, arm, ratios = [], [], [], [], []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        flange, board = poses(20, rng)
        views = views_of(board, rng, 0.5)
        flange = jitter(flange, rng, 0.1, 0.001)
        result = calibrate(flange, views, CAMERA)
        arm.append([np.rad2deg(result.arm_rotation_error), 1e3 * result.arm_translation_error])
        refined.append(errors(result.T_flange_cam)[1])
        start = closed_form(flange, views.T_cam_board, "tsai")
        plain.append(errors(start[0])[1])
        problem = Problem.of(flange, views, CAMERA)
        exact_arm = refine(problem, *start, Noise(0.5, 1e-6, 1e-6), np.full(20, True))
        pixels.append(errors(exact_arm.T_flange_cam)[1])
        ratios.append(refined[-1] / (1e3 * result.translation_error))
    assert np.median(arm, axis=0) == pytest.approx([0.1, 1.0], rel=0.3)
    assert np.mean(refined) < np.mean(plain)
    assert np.mean(refined) < 0.5 * np.mean(pixels)
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 2.2  # the stated error, in its worst direction, is the error


@pytest.mark.parametrize("arm", [(0.0, 0.0), (0.1, 0.001)])
def test_outlying_views_are_left_out_and_named(arm: tuple[float, float]) -> None:
    rng = np.random.default_rng(3)
    flange, board = poses(20, rng)
    views = views_of(board, rng)
    flange = jitter(flange, rng, *arm)
    flange[[4, 11]] = flange[[11, 4]]  # two names mixed up
    flange[7] = flange[7] @ small_transform([0, 0, 0], [0.02, 0, 0])
    names = tuple(f"view_{i}.png" for i in range(20))
    result = calibrate(flange, views, CAMERA, images=names)
    assert set(np.flatnonzero(~result.used)) == {4, 7, 11}
    assert any("view_4.png, view_7.png, view_11.png" in note for note in result.notes)
    assert errors(result.T_flange_cam)[1] < (0.3 if arm[0] == 0 else 3)
    assert result.translation_residuals[7] > 0.015
    assert np.isnan(result.left_out_errors[~result.used]).all()
    assert np.isfinite(result.left_out_errors[result.used]).all()


def test_many_outliers_do_not_mislead() -> None:
    rng = np.random.default_rng(8)
    flange, board = poses(20, rng)
    views = views_of(board, rng)
    wrong = [0, 3, 5, 8, 12, 15, 18, 19]
    flange[wrong] = jitter(flange[wrong], rng, 5, 0.05)
    result = calibrate(flange, views, CAMERA)
    assert set(np.flatnonzero(~result.used)) == set(wrong)
    assert "more than a third" in " ".join(result.notes)
    assert errors(result.T_flange_cam)[1] < 0.6


def test_good_views_are_kept() -> None:
    """Three calibrations of 20 good views: at a limit of 4 standard deviations hardly one view is lost."""
    lost = 0
    for seed in range(3):
        rng = np.random.default_rng(100 + seed)
        flange, board = poses(20, rng)
        lost += int((~calibrate(jitter(flange, rng, 0.05, 0.0005), views_of(board, rng), CAMERA).used).sum())
    assert lost <= 1


def test_the_left_out_error_is_larger_than_the_fitted_one_and_prefers_the_refinement() -> None:
    rng = np.random.default_rng(4)
    flange, board = poses(12, rng)
    result = calibrate(flange, views_of(board, rng), CAMERA)
    rows = {row.name: row for row in result.methods}
    assert set(rows) == {*METHODS, "result"}
    assert rows["result"].left_out_pixel > rows["result"].pixel_rms
    assert rows["result"].left_out_pixel < min(rows[method].left_out_pixel for method in METHODS)
    assert rows["tsai"].translation_apart == pytest.approx(
        np.linalg.norm(
            closed_form(flange, views_of(board, np.random.default_rng(4)).T_cam_board, "tsai")[0][:3, 3]
            - result.T_flange_cam[:3, 3]
        ),
        abs=2e-3,
    )


def test_left_out_views_are_predicted_without_themselves() -> None:
    rng = np.random.default_rng(5)
    flange, board = poses(8, rng)
    views = views_of(board, rng)
    result = calibrate(flange, views, CAMERA)
    rest = np.arange(8) != 2
    some = BoardViews(views.corners.pick(rest), views.T_cam_board[rest], views.reprojection[rest])
    without = calibrate(flange[rest], some, CAMERA)
    problem = Problem.of(flange, views, CAMERA)
    expected = problem.pixel_rms(without.T_flange_cam, without.T_base_board)[2]
    assert result.left_out_errors[2, 0] == pytest.approx(expected, rel=0.1)


def test_derivatives_are_those_of_the_residuals() -> None:
    rng = np.random.default_rng(6)
    flange, board = poses(3, rng)
    problem = Problem.of(flange, views_of(board, rng, 1.0), CAMERA)
    X, Z = T_FLANGE_CAM @ small_transform([0.01, 0.02, 0], [0, 0.001, 0]), T_BASE_BOARD

    def cost(x: np.ndarray) -> float:
        return float(np.sum(problem.residuals(_moved(X, x[:6]), _moved(Z, x[6:])) ** 2))

    slope = approx_fprime(np.zeros(12), cost, 1e-8)
    assert -2 * problem.sums(X, Z).Fr.sum(axis=0) == pytest.approx(slope, rel=1e-3, abs=1e-3 * np.abs(slope).max())


def test_distances_of_good_views_follow_their_law() -> None:
    """Mahalanobis distances of true poses are chi-square distributed with 6 degrees of freedom."""
    rng = np.random.default_rng(7)
    flange, board = poses(60, rng)
    noise = Noise(0.2, np.deg2rad(0.1), 0.001)
    problem = Problem.of(jitter(flange, rng, 0.1, 0.001), views_of(board, rng), CAMERA)
    fit = refine(problem, T_FLANGE_CAM, T_BASE_BOARD, noise, np.full(60, True))
    assert np.mean(view_distances(problem, fit, noise, np.full(60, 0.2)) ** 2) == pytest.approx(6, rel=0.25)


# Motions


def about(axes: list[list[float]], degrees: float, count: int = 12) -> np.ndarray:
    """Flange poses over the board, turned by up to so many degrees about these axes of the flange in turn."""
    start = poses(1, np.random.default_rng(0))[0][0]
    turns = np.deg2rad(degrees) * np.linspace(-0.5, 0.5, count)
    shifts = 0.03 * np.random.default_rng(1).uniform(-1, 1, (count, 3))
    return np.stack(
        [start @ small_transform(np.array(axes[k % len(axes)]) * turns[k], shifts[k]) for k in range(count)]
    )


def test_turning_about_one_axis_is_refused() -> None:
    flange = about([[0, 0, 1]], 60)
    with pytest.raises(InputError, match="one axis only"):
        calibrate(flange, views_of(seen_from(flange), np.random.default_rng(0)), CAMERA)


def test_pure_translation_is_refused() -> None:
    flange = about([[0, 0, 1]], 0)
    with pytest.raises(InputError, match="degenerate motions"):
        calibrate(flange, views_of(seen_from(flange), np.random.default_rng(0)), CAMERA)


@pytest.mark.parametrize(
    ("flange", "text"),
    [
        (about([[0, 0, 1], [0.2, 0, 0.98]], 50), "rotation axes nearly parallel"),
        (about([[0, 0, 1], [1, 0, 0]], 12), "too little rotation"),
        (about([[0, 0, 1], [1, 0, 0]], 60, count=6), "only 6 views"),
    ],
)
def test_poor_motions_are_warned_of(flange: np.ndarray, text: str) -> None:
    result = calibrate(flange, views_of(seen_from(flange), np.random.default_rng(0)), CAMERA)
    assert any(text in note for note in result.notes)
    good = calibrate(poses(12, np.random.default_rng(0))[0], *varied())
    assert not good.notes
    assert result.translation_error > good.translation_error


def varied() -> tuple[BoardViews, object]:
    return views_of(poses(12, np.random.default_rng(0))[1], np.random.default_rng(1)), CAMERA


def test_good_motions_are_not_warned_of() -> None:
    assert motion_warnings(poses(15, np.random.default_rng(0))[0]) == ()


def test_two_views_are_refused() -> None:
    flange, board = poses(2, np.random.default_rng(0))
    with pytest.raises(InputError, match="3 or more"):
        calibrate(flange, views_of(board, np.random.default_rng(0)), CAMERA)


def test_mixed_up_conventions_are_named() -> None:
    rng = np.random.default_rng(0)
    flange, board = poses(10, rng)
    views = views_of(board, rng)
    with pytest.raises(InputError, match="invert them"):
        calibrate(inverse(flange), views, CAMERA)
    quaternions = Rotation.from_matrix(flange[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    confused = np.array(flange)
    confused[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    with pytest.raises(InputError, match="w x y z"):
        calibrate(confused, views, CAMERA)
    with pytest.raises(InputError, match="belong together"):
        calibrate(flange[rng.permutation(10)], views, CAMERA)


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(["count", "nan", "scale", "shape"]), st.integers(0, 3))
def test_bad_poses_are_refused(fault: str, where: int) -> None:
    flange, board = (np.array(T) for T in poses(4, np.random.default_rng(0)))
    views = views_of(board, np.random.default_rng(0))
    if fault == "count":
        flange = flange[:where]
    elif fault == "nan":
        flange[where, 0, 3] = np.nan
    elif fault == "scale":
        flange[where, :3, :3] *= 1.5
    else:
        flange = flange[:, :3]
    with pytest.raises(InputError):
        calibrate(flange, views, CAMERA)


def test_unknown_method_is_refused() -> None:
    with pytest.raises(InputError, match="tsai, park"):
        Params(method="andreff")  # type: ignore[arg-type]


# Files


def test_round_trip(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    flange, board = poses(8, rng)
    flange[3] = flange[3] @ small_transform([0.1, 0, 0], [0, 0.03, 0])  # its errors are NaN, null in the file
    result = calibrate(flange, views_of(board, rng), CAMERA)
    result.save(tmp_path / "calibration.json")
    again = HandEye.load(tmp_path / "calibration.json")
    for name in result.__slots__:
        np.testing.assert_equal(getattr(again, name), getattr(result, name), err_msg=name)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"kind": "hand-eye", "schema": 1}', '{"kind": "hand-eye", "schema": 2}']
)
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "calibration.json").write_text(text)
    with pytest.raises(InputError, match=r"calibration\.json"):
        HandEye.load(tmp_path / "calibration.json")


# Boards and images


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


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet="charuochessboard:x0123456789.mc -", max_size=40))
def test_any_board_text_is_read_or_refused(text: str) -> None:
    try:
        parse_board(text)
    except InputError as error:
        if not str(error):
            raise


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
    views = detect_board(images, CAMERA, board)
    assert 3 not in views.images
    rest = np.array([i - (i > 3) for i in views.images])
    assert len(rest) >= 6
    assert views.reprojection.max() < 0.3
    rotation, translation = errors(calibrate(flange[rest], views, CAMERA).T_flange_cam)
    assert rotation < 0.06
    assert translation < 0.6


def test_images_without_a_board_are_refused() -> None:
    with pytest.raises(InputError, match="none with 8 corners"):
        detect_board([np.zeros((720, 1280), np.uint8)], CAMERA, CharucoBoard())


# Intrinsics


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
    straight = undistorted(bent_corners, CAMERA, lens)
    assert max(np.abs(a - b).max() for a, b in zip(straight.pixels, corners.pixels, strict=True)) < 0.05
    result = calibrate(flange, board_views(undistorted(bent_corners, camera, distortion), camera), camera)
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
        ('{"w": 640, "h": 480, "fl_x": 600, "fl_y": 600, "cx": 320, "cy": 240, "k1": -0.1, "frames": []}', None),
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
