"""How well each view is predicted from all others: the honest error of a calibration, for every method. V views."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.calibration.closed_form import METHODS, Method, closed_form, disagreement, predicted_board
from anther.calibration.hand_eye import MethodError
from anther.calibration.refinement import Fit, Noise, Problem, refine
from anther.errors import InputError
from anther.geometry import Array


def left_out_errors(
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
            X, Z, camera, _ = refine(problem, fit.T_flange_cam, fit.T_base_board, noise, others)
        else:
            (X, Z), camera = closed_form(problem.T_base_flange[others], T_cam_board[others], method), fit.intrinsics
        turn, shift = disagreement(predicted_board(problem.T_base_flange, X, Z), T_cam_board, centre)
        out[view] = problem.at(camera).pixel_rms(X, Z)[view], turn[view], shift[view]
    return out


def compare(
    problem: Problem, T_cam_board: Array, centre: Array, fit: Fit, noise: Noise, used: NDArray[Any], left_out: Array
) -> tuple[MethodError, ...]:
    """Return how the closed forms differ from the result, and how well each predicts a view it has not seen.

    The last row is the result itself, whose errors are `left_out` (V, 3). A solver that finds nothing has no row.
    """
    rows, problem = [], problem.at(fit.intrinsics)
    for method in METHODS:
        try:
            X, Z = closed_form(problem.T_base_flange[used], T_cam_board[used], method)
            errors = left_out_errors(problem, T_cam_board, centre, fit, noise, used, method)
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
