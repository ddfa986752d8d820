"""Where the camera sits on the flange (AX = XB): closed forms, what odd views do not spoil, and how far to trust it.

V views. The honest error of a calibration is how well each view is predicted from all the others, for every method.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.calibration._refinement import Fit, Noise, Problem, refine
from anther.checks import check_array, check_transform
from anther.errors import InputError, bad_input
from anther.files import read_object, understood, write_json
from anther.geometry import Array, Intrinsics, inverse, transform

KIND, SCHEMA = "hand-eye", 2


class MethodError(NamedTuple):
    """How well one method did.

    Attributes:
        name: "tsai", "park", "horaud", "daniilidis", or "result".
        rotation_apart, translation_apart: by how much its T_flange_cam differs from the result's [rad], [m].
        pixel_rms: RMS distance of the corners of the used views [px].
        left_out_pixel, left_out_rotation, left_out_translation: RMS over views, each predicted from all others
            [px], [rad], [m]; NaN with three views.
    """

    name: str
    rotation_apart: float
    translation_apart: float
    pixel_rms: float
    left_out_pixel: float
    left_out_rotation: float
    left_out_translation: float


@dataclass(frozen=True, slots=True, eq=False)
class HandEye:
    """Where the camera sits on the flange, and how well the views agree with it.

    Attributes:
        T_flange_cam: (4, 4).
        T_base_board: (4, 4) where the board stood.
        intrinsics: of the camera.
        distortion: (5,) of the lens, k1, k2, p1, p2, k3 as in OpenCV; 0 where there is none.
        images: (V) names of the views.
        used: (V,) whether the view took part; the others are outliers.
        pixel_residuals: (V,) RMS distance between the corners seen and expected [px].
        rotation_residuals: (V,) angle between the board seen in each view alone and the board's common pose [rad].
        translation_residuals: (V,) distance between their centres [m].
        left_out_errors: (V, 3) the same three, each view predicted from all others; NaN for outliers.
        rotation_error, translation_error: standard error of T_flange_cam in its worst direction [rad], [m].
        pixel_noise: standard deviation of a corner's pixel coordinate [px].
        arm_rotation_error, arm_translation_error: standard deviation of the arm's pose errors, as they look from
            the views [rad], [m] per axis.
        methods: the closed forms beside the result.
        method: what was done.
        notes: what the user should know.
    """

    T_flange_cam: Array
    T_base_board: Array
    intrinsics: Intrinsics
    distortion: Array
    images: tuple[str, ...]
    used: NDArray[Any]
    pixel_residuals: Array
    rotation_residuals: Array
    translation_residuals: Array
    left_out_errors: Array
    rotation_error: float
    translation_error: float
    pixel_noise: float
    arm_rotation_error: float
    arm_translation_error: float
    methods: tuple[MethodError, ...]
    method: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.images)
        for name in ("T_flange_cam", "T_base_board"):
            object.__setattr__(self, name, check_transform(name, getattr(self, name)))
        for name in ("pixel_residuals", "rotation_residuals", "translation_residuals"):
            object.__setattr__(self, name, check_array(name, getattr(self, name), (n,)))
        left_out = check_array("left_out_errors", self.left_out_errors, (n, 3), finite=False)
        object.__setattr__(self, "left_out_errors", left_out)
        object.__setattr__(self, "distortion", check_array("distortion", self.distortion, (5,)))
        object.__setattr__(self, "used", check_array("used views", self.used, (n,), dtype="bool"))

    def board_in_camera(self, T_base_flange: Array) -> Array:
        """Return T_cam_board (V, 4, 4) as the calibration has it for (V, 4, 4) flange poses."""
        return inverse(T_base_flange @ self.T_flange_cam) @ self.T_base_board

    def save(self, path: Path | str) -> None:
        """Write a JSON file (docs/calibration.md)."""
        values = {name: getattr(self, name) for name in self.__slots__}
        values |= {"intrinsics": asdict(self.intrinsics), "methods": [row._asdict() for row in self.methods]}
        write_json(path, {"kind": KIND, "schema": SCHEMA, **values})

    @classmethod
    def load(cls, path: Path | str) -> HandEye:
        """Read what `save` wrote.

        Raises:
            InputError: the file is missing, truncated or holds something else.
        """
        stored = read_object(path)
        if (stored.get("kind"), stored.get("schema")) != (KIND, SCHEMA):
            raise bad_input(
                str(path),
                given="something else, or another schema number",
                allowed=f"a calibration written by anther calibrate, schema {SCHEMA}",
                do="Calibrate again.",
            )
        with understood(path, "a whole file", "Restore it."):
            values = {name: stored[name] for name in cls.__slots__}
            values["intrinsics"] = Intrinsics(**values["intrinsics"])
            values["methods"] = tuple(MethodError(**_with_nan(row)) for row in values["methods"])
            values["images"], values["notes"] = tuple(values["images"]), tuple(values["notes"])
            values["left_out_errors"] = np.array(values["left_out_errors"], dtype=np.float64).reshape(-1, 3)
            return cls(**values)


def _with_nan(row: dict[str, Any]) -> dict[str, Any]:
    return {name: float("nan") if value is None else value for name, value in row.items()}


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
