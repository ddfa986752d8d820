"""Has the camera moved on the flange since it was calibrated? The same board, seen again from the same places. V views.

The arm goes to joints that it had in the calibration, so that what is wrong with its kinematics is wrong twice and
cancels. Board and camera are then as they were, or one of them has moved: a camera by the same way in the flange's
frame in every view, a board by the same way in the base frame. Each is fitted (`refinement.refine`); squared residuals
tell which it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from anther.calibration._hand_eye import HandEye
from anther.calibration._refinement import LEAST_PIXEL_NOISE, Noise, Problem, misfit, refine
from anther.calibration._views import BoardViews
from anther.checks import check_transform
from anther.geometry import Array, Intrinsics, inverse

Verdict = Literal["still", "camera", "board", "camera or board", "more"]
CAMERA, BOARD, BOTH = slice(0, 6), slice(6, 12), slice(0, 12)
CERTAIN = 4.0
"""A movement counts beyond so many standard deviations of a normal distribution: once in 16 000 mornings by chance."""
TRIFLE = float(np.deg2rad(0.1)), 0.5e-3
"""Less is not told, however certain [rad], [m]. A guess: a camera that warms up moves as much, and no grasp is lost."""
LIKELIER = 9.0
"""One explanation is preferred when its squared misfit is less by this [-]: it is then 90 times as likely."""


@dataclass(frozen=True, slots=True)
class Moved:
    """What moved between calibration and check.

    Attributes:
        verdict: "still"; what moved; "camera or board" where the views do not tell which; "more" where neither explains
            them alone.
        rotation, translation: by which the camera moved on the flange, if it was the camera (or both) [rad], [m].
        rotation_error, translation_error: their standard errors, in the worst direction [rad], [m].
        board_rotation, board_translation: by which the board's centre moved, if it was the board [rad], [m].
    """

    verdict: Verdict
    rotation: float
    translation: float
    rotation_error: float
    translation_error: float
    board_rotation: float
    board_translation: float


def camera_moved(
    found: HandEye,
    then: tuple[Array, Array],
    T_base_flange: Array,
    views: BoardViews,
    intrinsics: Intrinsics,
    centre: Array,
) -> Moved:
    """Return what moved since a calibration.

    Args:
        found: the calibration.
        then: T_base_flange and T_cam_board (V, 4, 4) of its views at the same places.
        T_base_flange: (V, 4, 4) today, V >= 3, the same to about a degree.
        views: V, of the board, today.
        intrinsics: of the camera.
        centre: (3,) of the board [m].

    Raises:
        InputError: another count of views, or views that determine nothing.
    """
    today = check_transform("T_base_flange", T_base_flange, len(views.images))
    flange_then, T_cam_board = (check_transform("views of the calibration", T, len(today)) for T in then)
    X, Z = found.T_flange_cam, found.T_base_board
    # The flange as the calibration has it from what the camera saw then: the arm's errors, and that view's, are in it.
    as_seen_then = Z @ inverse(T_cam_board) @ inverse(X)
    problem = Problem.of(today @ inverse(flange_then) @ as_seen_then, views, intrinsics)
    twice = np.sqrt(2) * np.array([found.pixel_noise, found.arm_rotation_error, found.arm_translation_error])
    noise = Noise(max(float(twice[0]), LEAST_PIXEL_NOISE), float(twice[1]), float(twice[2]))
    all_views = np.full(len(today), True)
    fits = {name: refine(problem, X, Z, noise, all_views, part) for name, part in _PARTS.items()}
    rest = {name: misfit(problem, fit.T_flange_cam, fit.T_base_board, noise) for name, fit in fits.items()}
    gain = misfit(problem, X, Z, noise) - np.array([rest["camera"], rest["board"]])
    camera, board = _way(X, fits["camera"].T_flange_cam), _way(Z, fits["board"].T_base_board, centre)
    verdict = _verdict(rest, gain, bool(np.all(np.array([camera, board]) < TRIFLE)))
    fit = fits["both" if verdict == "more" else "camera"]
    turn, shift = (float(np.sqrt(np.linalg.eigvalsh(fit.covariance[i : i + 3, i : i + 3])[-1])) for i in (0, 3))
    return Moved(verdict, *_way(X, fit.T_flange_cam), turn, shift, *board)


_PARTS: dict[str, slice] = {"camera": CAMERA, "board": BOARD, "both": BOTH}


def _verdict(rest: dict[str, float], gain: Array, trifling: bool) -> Verdict:
    limit = float(chi2.isf(2 * norm.sf(CERTAIN), 6))
    if trifling or gain.max() <= limit:
        return "still"
    if min(rest["camera"], rest["board"]) - rest["both"] > limit:
        return "more"
    if abs(rest["camera"] - rest["board"]) < LIKELIER:
        return "camera or board"
    return "camera" if rest["camera"] < rest["board"] else "board"


def _way(before: Array, after: Array, point: Array | None = None) -> tuple[float, float]:
    """Return angle [rad] and distance [m] between two poses, the distance of a (3,) point of the moving frame."""
    turn = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).magnitude()
    p = np.zeros(3) if point is None else point
    return float(turn), float(np.linalg.norm((after - before)[:3, :3] @ p + (after - before)[:3, 3]))
