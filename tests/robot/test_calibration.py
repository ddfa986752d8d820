from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_board import (
    CAMERA,
    T_BASE_BOARD,
    T_FLANGE_CAM,
    errors,
    jitter,
    poses,
    seen_from,
    views_of,
)
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError
from anther.core.geometry import inverse, small_transform
from anther.robot.calibration import (
    BoardCorners,
    BoardViews,
    HandEye,
    Method,
    board_views,
    calibrate,
)
from anther.robot.calibration._hand_eye import METHODS, closed_form
from anther.robot.calibration._refinement import Noise, Problem, _adjust_intrinsics, _apply_step, refine, view_distances
from anther.robot.calibration._views import motion_warnings


@pytest.mark.parametrize("method", METHODS)
def test_perfect_poses_give_the_exact_transform(method: Method) -> None:
    flange, board = poses(8, np.random.default_rng(0))
    assert max(errors(closed_form(flange, board, method)[0])) < 1e-3
    views = views_of(board, np.random.default_rng(0), noise=0.0)
    result = calibrate(flange, views, CAMERA, method=method)
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
    seen, index = views.corners, np.arange(len(flange))[rest]
    corners = BoardCorners(seen.images[index], *(tuple(rows[i] for i in index) for rows in (seen.points, seen.pixels)))
    some = BoardViews(corners, views.T_cam_board[rest], views.reprojection[rest])
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
        return float(np.sum(problem.residuals(_apply_step(X, x[:6]), _apply_step(Z, x[6:])) ** 2))

    slope = approx_fprime(np.zeros(12), cost, 1e-8)
    assert -2 * problem.sums(X, Z).Fr.sum(axis=0) == pytest.approx(slope, rel=1e-3, abs=1e-3 * np.abs(slope).max())


def test_derivatives_after_the_intrinsics() -> None:
    rng = np.random.default_rng(6)
    flange, board = poses(3, rng)
    problem = Problem.of(flange, views_of(board, rng, 1.0), CAMERA, free_intrinsics=True)

    def cost(x: np.ndarray) -> float:
        return float(np.sum(problem.at(_adjust_intrinsics(CAMERA, x)).residuals(T_FLANGE_CAM, T_BASE_BOARD) ** 2))

    slope = approx_fprime(np.zeros(4), cost, 1e-8)
    found = -2 * problem.sums(T_FLANGE_CAM, T_BASE_BOARD).Fr.sum(axis=0)[12:]
    assert found == pytest.approx(slope, rel=1e-3, abs=1e-3 * np.abs(slope).max())


def test_free_intrinsics_are_found_with_the_camera() -> None:
    """From a start that is off by 10 px; the camera is placed nearly as well as with the true ones."""
    rng = np.random.default_rng(7)
    flange, board = poses(20, rng)
    corners = views_of(board, rng).corners
    start = replace(CAMERA, fx=645.0, fy=636.0, cx=645.0, cy=352.0)
    result = calibrate(flange, board_views(corners, start), start, free_intrinsics=True)
    camera, true = result.intrinsics, CAMERA
    assert [camera.fx, camera.fy, camera.cx, camera.cy] == pytest.approx([true.fx, true.fy, true.cx, true.cy], abs=0.6)
    rotation, translation = errors(result.T_flange_cam)
    assert rotation < min(0.06, 3 * np.rad2deg(result.rotation_error))
    assert translation < min(0.6, 3e3 * result.translation_error)


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


@settings(max_examples=20)
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
    flange, board = poses(8, np.random.default_rng(0))
    with pytest.raises(InputError, match="tsai, park"):
        calibrate(flange, views_of(board, np.random.default_rng(0)), CAMERA, method="andreff")  # type: ignore[arg-type]


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
