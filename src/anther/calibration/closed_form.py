"""AX = XB in closed form: four solvers, and one estimate that wrong views do not spoil. V views."""

from __future__ import annotations

from itertools import combinations
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.errors import InputError
from anther.geometry import Array, inverse, transform

Method = Literal["tsai", "park", "horaud", "daniilidis"]
METHODS: dict[Method, int] = {
    "tsai": cv2.CALIB_HAND_EYE_TSAI,
    "park": cv2.CALIB_HAND_EYE_PARK,
    "horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
"""Tsai and Lenz 1989, Park and Martin 1994, Horaud and Dornaika 1995, Daniilidis 1999.

Andreff is left out: its translation is unstable (facts: perception)."""
SAMPLES = 150
"""Subsets of views that are tried [-]: with 4 of 10 views wrong, one is all right with a certainty of 1 - 1e-9."""
SAMPLE_VIEWS = 4
AGREED, ODD = 3.0, 4.0
"""Where the median misfit of all views is below the one, and none exceeds it by the other, no subset is tried [-]."""


def closed_form(T_base_flange: Array, T_cam_board: Array, method: Method) -> tuple[Array, Array]:
    """Return T_flange_cam and the median T_base_board of (V, 4, 4) flange and board poses.

    Raises:
        InputError: the solver found nothing.
    """
    flange, board = T_base_flange, T_cam_board
    # `method` by keyword: as a positional argument OpenCV ignores it without a word (opencv #28074).
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what it would print is raised below
    try:
        R, t = cv2.calibrateHandEye(
            R_gripper2base=list(flange[:, :3, :3]),
            t_gripper2base=list(flange[:, :3, 3]),
            R_target2cam=list(board[:, :3, :3]),
            t_target2cam=list(board[:, :3, 3]),
            method=METHODS[method],
        )
    except cv2.error:
        R = t = np.array(np.nan)
    finally:
        cv2.utils.logging.setLogLevel(level)
    if not (np.isfinite(R).all() and np.isfinite(t).all()):
        raise InputError(
            f"hand-eye calibration: {method} found nothing. Do the poses belong to the images, and do they turn?"
        )
    T_flange_cam = transform(_nearest_rotation(np.asarray(R, dtype=np.float64)), np.asarray(t).ravel())
    return T_flange_cam, _middle(flange @ T_flange_cam @ board)


def predicted_board(T_base_flange: Array, T_flange_cam: Array, T_base_board: Array) -> Array:
    """Return T_cam_board (V, 4, 4) as the arm and the calibration have it."""
    return inverse(T_base_flange @ T_flange_cam) @ T_base_board


def disagreement(predicted: Array, seen: Array, centre: Array) -> tuple[Array, Array]:
    """Return by how much two (V, 4, 4) board poses differ: angle [rad], distance of the board's `centre` (3,) [m]."""
    turn = Rotation.from_matrix(np.swapaxes(predicted[:, :3, :3], 1, 2) @ seen[:, :3, :3]).magnitude()
    shift = (predicted[:, :3, :3] - seen[:, :3, :3]) @ centre + predicted[:, :3, 3] - seen[:, :3, 3]
    return turn, np.linalg.norm(shift, axis=1)


def robust_estimate(
    T_base_flange: Array, T_cam_board: Array, centre: Array, sigmas: tuple[float, float], method: Method, seed: int = 0
) -> tuple[Array, Array, Array]:
    """Return T_flange_cam, T_base_board and the misfit (V,) [-] of the subset of views that most views agree with.

    Least median of squares (Rousseeuw 1984): it stands up to nearly half of the views being wrong.

    Args:
        T_base_flange, T_cam_board: (V, 4, 4), V >= 3.
        centre: (3,) of the board [m], where distances are measured.
        sigmas: unit of angles [rad] and of distances [m].
        method: solver.
        seed: of the draws.

    Raises:
        InputError: no subset gives a solution.
    """
    count = len(T_base_flange)
    best, best_score = None, np.inf
    for views in _subsets(count, np.random.default_rng(seed)):
        try:
            X, Z = closed_form(T_base_flange[views], T_cam_board[views], method)
        except InputError:
            continue
        turn, shift = disagreement(predicted_board(T_base_flange, X, Z), T_cam_board, centre)
        misfit = np.hypot(turn / sigmas[0], shift / sigmas[1])
        score = float(np.partition(misfit, count // 2)[count // 2])
        if score < best_score:
            best, best_score = (X, Z, misfit), score
        if len(views) == count and score < AGREED and misfit.max() < ODD * score:
            break  # all views agree
    if best is None:
        raise InputError("hand-eye calibration: no set of views has a solution. Do the poses belong to the images?")
    return best


def _subsets(count: int, rng: np.random.Generator) -> list[NDArray[Any]]:
    """Return all views, then subsets of them."""
    size = min(SAMPLE_VIEWS, count - 1)
    if size < 3:
        return [np.arange(count)]
    if count <= 8:
        some = [np.array(views) for views in combinations(range(count), size)]
    else:
        some = [rng.choice(count, size, replace=False) for _ in range(SAMPLES)]
    return [np.arange(count), *some]


def _middle(T: Array) -> Array:
    """Return the median position with the mean rotation of (V, 4, 4) poses."""
    return transform(Rotation.from_matrix(T[:, :3, :3]).mean().as_matrix(), np.median(T[:, :3, 3], axis=0))


def _nearest_rotation(R: Array) -> Array:
    U, _, Vt = np.linalg.svd(R)
    return U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
