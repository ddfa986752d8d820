"""Hand-eye calibration: board views and flange poses give where the camera sits on the flange. V views.

AX = XB by a closed-form solver (Tsai and Lenz 1989, as in paper row P1) on the views that agree, then a nonlinear
refinement of camera and board pose together on reprojection errors, without outlying views.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from anther.core.checks import check_transform
from anther.core.choices import HandEyeMethod as Method
from anther.core.errors import InputError, bad_input
from anther.core.geometry import Array, Intrinsics, inverse, pose7, transform_from_pose7
from anther.robot.calibration._hand_eye import (
    AGREED,
    CERTAIN,
    METHODS,
    ODD,
    EyeToHand,
    HandEye,
    MethodError,
    Moved,
    closed_form,
    disagreement,
    find_movement,
    predict_board,
    robust_estimate,
)  # fmt: skip
from anther.robot.calibration._inputs import (
    Board,
    CharucoBoard,
    Chessboard,
    explain_missing_board,
    parse_board,
    read_poses,
)  # fmt: skip
from anther.robot.calibration._intrinsics import check_size, read_intrinsics
from anther.robot.calibration._refinement import (
    Fit,
    Noise,
    Problem,
    estimate_noise,
    pixel_noise,
    refine,
    view_distances,
)
from anther.robot.calibration._views import (
    CELLS,
    BoardCorners,
    BoardViews,
    board_views,
    check_motions,
    estimate_intrinsics,
    find_corners,
    flange_motions,
    image_coverage,
    largest_distortion,
    motion_warnings,
    undistort,
)  # fmt: skip

__all__ = [
    "CELLS",
    "Board",
    "BoardCorners",
    "BoardViews",
    "CharucoBoard",
    "Chessboard",
    "EyeToHand",
    "HandEye",
    "Method",
    "MethodError",
    "Moved",
    "board_views",
    "calibrate",
    "calibrate_eye_to_hand",
    "check_size",
    "estimate_intrinsics",
    "explain_missing_board",
    "find_corners",
    "find_movement",
    "flange_motions",
    "image_coverage",
    "largest_distortion",
    "parse_board",
    "read_intrinsics",
    "read_poses",
    "undistort",
]  # fmt: skip

ARM_ERRORS = float(np.deg2rad(0.1)), 0.001
"""Of rotation [rad] and translation [m] in one view, per axis; of few views they are not estimated."""
LOOSE = 0.002
"""Standard error of the camera's place from which on the views are called too poor, and how far a board of another size
than was said may move it [m]."""


def calibrate(
    T_base_flange: Any,
    views: BoardViews,
    intrinsics: Intrinsics,
    *,
    method: Method = "tsai",
    free_intrinsics: bool = False,
    images: tuple[str, ...] | None = None,
    distortion: Array | None = None,
) -> HandEye:
    """Return the hand-eye transform from views of a board that stands still.

    Args:
        T_base_flange: (V, 4, 4) flange poses of the views, V >= 3.
        views: of the board from them (`board_views`).
        intrinsics: of the camera.
        method: closed-form solver of the first estimate.
        free_intrinsics: whether focal lengths and principal point are sought too, from where they are given: for
            `estimate_intrinsics`, which does not know how the camera moved.
        images: names of the views, for messages and the result; by default their numbers.
        distortion: of the lens, already taken out of `views`; only recorded.

    Raises:
        InputError: fewer than three views, motions that do not determine the transform, or poses that do not belong
            to the images; an unknown method.
    """
    flange = check_transform("T_base_flange", T_base_flange, len(views.images))
    return _calibrate(flange, views, intrinsics, method, free_intrinsics, images, distortion)


def calibrate_eye_to_hand(
    T_base_flange: Any,
    views: BoardViews,
    intrinsics: Intrinsics,
    *,
    method: Method = "tsai",
    free_intrinsics: bool = False,
    images: tuple[str, ...] | None = None,
    distortion: Array | None = None,
) -> EyeToHand:
    """Return where a camera beside the robot stands, from views of a board that is fixed to the flange.

    T_base_flange^-1 takes the place of T_base_flange: the equation is then that of `calibrate`, which tells of the
    arguments and errors.
    """
    flange = check_transform("T_base_flange", T_base_flange, len(views.images))
    return EyeToHand(
        _calibrate(inverse(flange), views, intrinsics, method, free_intrinsics, images, distortion, eye_to_hand=True)
    )


def _calibrate(
    flange: Array,
    views: BoardViews,
    intrinsics: Intrinsics,
    method: Method,
    free_intrinsics: bool,
    images: tuple[str, ...] | None,
    distortion: Array | None,
    *,
    eye_to_hand: bool = False,
) -> HandEye:
    """Return the calibration; with `eye_to_hand` of T_flange_base (V, 4, 4), base and flange exchanged."""
    if method not in METHODS:
        raise bad_input("hand-eye method", given=method, allowed=", ".join(METHODS), do="Choose one of these.")
    board = check_transform("T_cam_board", views.T_cam_board, len(views.images))
    names = images or tuple(str(number) for number in views.images)
    check_motions(flange)
    centre = np.concatenate(views.corners.points).mean(axis=0)
    X, Z, misfit = robust_estimate(flange, board, centre, ARM_ERRORS, method)
    _refuse_strangers(flange, board, centre, (X, Z, misfit), eye_to_hand)
    used = misfit <= 5 * max(float(np.median(misfit)), 1.0)
    problem = Problem.of(flange, views, intrinsics, free_intrinsics, eye_to_hand)
    fit, noise, used = _without_outliers(problem, X, Z, used, pixel_noise(views))
    problem, board = problem.at(fit.intrinsics), board_views(views.corners, fit.intrinsics).T_cam_board
    turn, shift = disagreement(predict_board(flange, fit.T_flange_cam, fit.T_base_board), board, centre)
    left_out = _left_out_errors(problem, board, centre, fit, noise, used)
    spread = np.sqrt([np.linalg.eigvalsh(fit.covariance[i : i + 3, i : i + 3])[-1] for i in (0, 3)])
    return HandEye(
        T_flange_cam=fit.T_flange_cam,
        T_base_board=fit.T_base_board,
        intrinsics=fit.intrinsics,
        distortion=np.zeros(5) if distortion is None else distortion,
        images=names,
        used=used,
        pixel_residuals=problem.pixel_rms(fit.T_flange_cam, fit.T_base_board),
        rotation_residuals=turn,
        translation_residuals=shift,
        left_out_errors=left_out,
        rotation_error=float(spread[0]),
        translation_error=float(spread[1]),
        pixel_noise=noise.pixel,
        arm_rotation_error=noise.rotation,
        arm_translation_error=noise.translation,
        methods=_compare(problem, board, centre, fit, noise, used, left_out),
        method=f"{method} + nonlinear refinement",
        notes=(
            *_notes(flange, used, names, float(spread[1])),
            *_place_notes(fit, eye_to_hand),
            *_size_notes(problem, fit, noise, used),
        ),
    )


def _without_outliers(
    problem: Problem, X: Array, Z: Array, used: NDArray[Any], own_noise: Array
) -> tuple[Fit, Noise, NDArray[Any]]:
    """Refine, estimate the noise and judge all views by it, until the same views stay."""
    flange = problem.T_base_flange
    noise = Noise(float(np.median(own_noise)), *ARM_ERRORS)
    limit = float(np.sqrt(chi2.isf(2 * norm.sf(4.0), 6)))  # as likely as four standard deviations of a normal one
    rounds = 0
    while True:
        check_motions(flange[used])
        fit, noise = _refined(problem, X, Z, noise, used)
        distances = view_distances(problem, fit, noise, own_noise)
        scale = max(float(np.median(distances[used])) / np.sqrt(chi2.median(6)), 1.0)
        kept, rounds = distances <= limit * scale, rounds + 1
        if np.array_equal(kept, used) or rounds == 8:  # the outliers stay what they are
            return fit, noise, used
        used, X, Z, problem = kept, fit.T_flange_cam, fit.T_base_board, problem.at(fit.intrinsics)


def _refined(problem: Problem, X: Array, Z: Array, noise: Noise, used: NDArray[Any]) -> tuple[Fit, Noise]:
    """Return the refined fit, and with six views or more the noise that they tell."""
    fit = refine(problem, X, Z, noise, used)
    if used.sum() < 6:
        return fit, noise
    noise = estimate_noise(problem, fit, noise.pixel, used)
    return refine(problem, fit.T_flange_cam, fit.T_base_board, noise, used), noise


def _notes(flange: Array, used: NDArray[Any], names: tuple[str, ...], spread: float) -> tuple[str, ...]:
    notes = list(motion_warnings(flange[used]))
    if not used.all():
        left = ", ".join(name for name, kept in zip(names, used, strict=True) if not kept)
        notes.append(f"left out as outliers: views {left}")
    if (~used).sum() > len(used) / 3:
        notes.append("more than a third of the views are outliers: check that poses and images belong together")
    if spread > LOOSE:
        notes.append(f"the views leave the camera's place open by {1e3 * spread:.1f} mm: take more, tilted more")
    return tuple(notes)


def _place_notes(fit: Fit, eye_to_hand: bool) -> tuple[str, ...]:
    """Return a note where poses T_flange_base of the other place of the camera would give the same equation."""
    camera, board = (float(np.linalg.norm(T[:3, 3])) for T in (fit.T_flange_cam, fit.T_base_board))
    if eye_to_hand == (camera > board):
        return ()
    on, off = ("base", "flange") if eye_to_hand else ("flange", "base")
    return (
        f"the camera would be {camera:.2f} m from the {on}, and the board {board:.2f} m from the {off}: are the poses "
        f"T_flange_base, of a camera {'on the flange' if eye_to_hand else 'beside the robot (--eye-to-hand)'}?",
    )


def _size_notes(problem: Problem, fit: Fit, noise: Noise, used: NDArray[Any]) -> tuple[str, ...]:
    """Return a note where the arm's motion says that the board is of another size than was said.

    The arm's translations are in metres, the board's in what its squares were said to be.
    """
    try:
        found, _ = _refined(replace(problem, free_scale=True), fit.T_flange_cam, fit.T_base_board, noise, used)
    except InputError:
        return ()  # these views do not tell
    away = float(np.linalg.norm(found.T_flange_cam[:3, 3] - fit.T_flange_cam[:3, 3]))
    sure = abs(np.log(found.scale)) > CERTAIN * np.sqrt(found.covariance[-1, -1])
    if not sure or away < LOOSE:
        return ()
    edges = np.diff(np.unique(np.round(problem.points[:, 0], 6)))  # [m]: corners are a square apart
    said = 1e3 * float(edges.min())
    share, way = 100 * abs(found.scale - 1), "smaller" if found.scale < 1 else "larger"
    return (
        f"the arm's motion says that the board is {share:.1f} % {way} than said: squares of {said * found.scale:.2f} "
        f"mm, not {said:g}; the camera's place would move by {1e3 * away:.1f} mm, which the stated error does not "
        "hold. Measure the squares and correct --board. (If they are right, the focal length is wrong, or the poses' "
        "unit.)",
    )


def _refuse_strangers(
    flange: Array, board: Array, centre: Array, found: tuple[Array, Array, Array], eye_to_hand: bool
) -> None:
    """Refuse poses that no hand-eye transform explains, and say which mix-up of conventions would explain them."""
    X, Z, misfit = found
    score, hopeless = _half(misfit), _hopeless(flange, board, centre, X, Z)
    if score < AGREED:
        return
    first = np.stack([pose7(T) for T in (inverse(flange) if eye_to_hand else flange)])[:, [0, 1, 2, 4, 5, 6, 3]]
    wxyz = np.stack([transform_from_pose7(p) for p in first])
    advice = {
        "": inverse(flange),
        "Their quaternions look like w x y z: write x y z w.": inverse(wxyz) if eye_to_hand else wxyz,
    }
    best, best_score = "Check that image names, poses and units (m, quaternion x y z w) belong together.", score / ODD
    for text, other in advice.items():
        X_other, Z_other, misfit = robust_estimate(other, board, centre, ARM_ERRORS, "park")
        if _half(misfit) < best_score and not _hopeless(other, board, centre, X_other, Z_other):
            best, best_score = text or _explain_inverse(X_other, Z_other, eye_to_hand), _half(misfit)
    if not hopeless and best_score == score / ODD:
        return
    turn, shift = disagreement(predict_board(flange, X, Z), board, centre)
    fixed, moving = ("camera", "board") if eye_to_hand else ("board", "camera")
    raise bad_input(
        "flange poses",
        given=f"poses from which half of the views disagree about the board ({_half(np.rad2deg(turn)):.0f} deg, "
        f"{_half(1e3 * shift):.0f} mm)",
        allowed=f"T_base_flange of a flange with the {moving} on it, the {fixed} standing still",
        do=best,
    )


def _explain_inverse(X: Array, Z: Array, eye_to_hand: bool) -> str:
    """Return what to do about poses that fit once inverted.

    Poses T_flange_base of a camera on the flange look exactly like poses T_base_flange of a board on the flange; but
    what is on the flange is nearer to it than what stands beside the robot is to the base.
    """
    beside = np.linalg.norm(X[:3, 3]) > np.linalg.norm(Z[:3, 3])
    if eye_to_hand and not beside:
        return "They look like those of a camera on the flange, the board standing still: leave out --eye-to-hand."
    if beside and not eye_to_hand:
        return (
            "They look like those of a camera beside the robot (eye-to-hand), the board on the flange: give "
            "--eye-to-hand, which tells T_base_cam. (If the camera is on the flange, they are T_flange_base: "
            "invert them.)"
        )
    return "They look like T_flange_base: invert them."


def _half(values: Array) -> float:
    return float(np.median(values))


def _hopeless(flange: Array, board: Array, centre: Array, X: Array, Z: Array) -> bool:
    turn, shift = disagreement(predict_board(flange, X, Z), board, centre)
    # the poses do not belong to the images
    return bool(_half(turn) > np.deg2rad(4) or _half(shift) > 0.04)  # [rad], [m]


def _left_out_errors(
    problem: Problem,
    T_cam_board: Array,
    centre: Array,
    fit: Fit,
    noise: Noise,
    used: NDArray[Any],
    method: Method | None = None,
) -> Array:
    """Return (V, 3): how far off each view is [px], [rad], [m] from what the other used views predict.

    NaN for outliers, and for all where only three views are left.

    Args:
        problem: all views.
        T_cam_board: (V, 4, 4) the board seen in each view alone.
        centre: (3,) of the board [m], where distances are measured.
        fit: to all used views, where each refinement starts.
        noise: of corners and arm.
        used: (V,) views that are not outliers.
        method: a closed form; None: the refinement.

    Raises:
        InputError: a solution without one of the views is not possible.
    """
    out = np.full((len(used), 3), np.nan)
    for view in np.flatnonzero(used) if used.sum() > 3 else ():
        others = used & (np.arange(len(used)) != view)
        if method is None:
            X, Z, camera = refine(problem, fit.T_flange_cam, fit.T_base_board, noise, others)[:3]
        else:
            (X, Z), camera = closed_form(problem.T_base_flange[others], T_cam_board[others], method), fit.intrinsics
        turn, shift = disagreement(predict_board(problem.T_base_flange, X, Z), T_cam_board, centre)
        out[view] = problem.at(camera).pixel_rms(X, Z)[view], turn[view], shift[view]
    return out


def _compare(
    problem: Problem, T_cam_board: Array, centre: Array, fit: Fit, noise: Noise, used: NDArray[Any], left_out: Array
) -> tuple[MethodError, ...]:
    """Return how the closed forms differ from the result, and how well each predicts a view it has not seen.

    The last row is the result itself, whose errors are `left_out` (V, 3). A solver that finds nothing has no row.
    """
    rows, problem = [], problem.at(fit.intrinsics)
    for method in METHODS:
        try:
            X, Z = closed_form(problem.T_base_flange[used], T_cam_board[used], method)
            errors = _left_out_errors(problem, T_cam_board, centre, fit, noise, used, method)
        except InputError:
            continue
        turn, shift = disagreement(X[None], fit.T_flange_cam[None], np.zeros(3))
        rows.append(MethodError(method, float(turn[0]), float(shift[0]), *_rms(problem, X, Z, used, errors)))
    X, Z = fit.T_flange_cam, fit.T_base_board
    return (*rows, MethodError("result", 0.0, 0.0, *_rms(problem, X, Z, used, left_out)))


def _rms(problem: Problem, X: Array, Z: Array, used: NDArray[Any], errors: Array) -> tuple[float, float, float, float]:
    """Return the RMS over the used views of the reprojection error and of the three errors of a view left out."""
    columns = np.column_stack([problem.pixel_rms(X, Z), errors])[used]
    pixel, left_pixel, turn, shift = (float(rms) for rms in np.sqrt(np.mean(columns**2, axis=0)))
    return pixel, left_pixel, turn, shift
