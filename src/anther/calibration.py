"""Hand-eye calibration: board views and flange poses give where the camera sits on the flange. V views.

AX = XB by a closed-form solver (Tsai and Lenz 1989, as in paper row P1), then a nonlinear refinement of camera and
board pose together, which halves the translation error (facts: perception, hand-eye table), without outlying views.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from anther.checks import check_array, check_range, check_transform
from anther.errors import InputError, bad_input
from anther.files import read_npz, write_npz
from anther.geometry import Array, Intrinsics, inverse, small_transform, transform

SCHEMA = 1

Method = Literal["tsai", "park", "horaud", "daniilidis"]
_METHODS = {
    "tsai": cv2.CALIB_HAND_EYE_TSAI,
    "park": cv2.CALIB_HAND_EYE_PARK,
    "horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}  # Andreff is left out: its translation is unstable (facts: perception)


@dataclass(frozen=True, slots=True)
class Params:
    """How the hand-eye transform is found.

    Attributes:
        method: closed-form solver of the first estimate.
        refine: whether to refine it by least squares.
        rotation_sigma, translation_sigma: error of one view, arm and board detection together [rad], [m]; their
            ratio weighs rotations against translations.
        outlier: views whose residual exceeds this many robust standard deviations are left out.
        least_turn: the flange must turn about two different axes by at least this [rad].
    """

    method: Method = "tsai"
    refine: bool = True
    rotation_sigma: float = float(np.deg2rad(0.1))
    translation_sigma: float = 0.001
    outlier: float = 4.0
    least_turn: float = float(np.deg2rad(5))

    def __post_init__(self) -> None:
        if self.method not in _METHODS:
            raise bad_input(
                "hand-eye method", given=self.method, allowed=", ".join(_METHODS), do="Choose one of these."
            )
        check_range("rotation sigma", self.rotation_sigma, 1e-6, 1, "rad")
        check_range("translation sigma", self.translation_sigma, 1e-6, 1, "m")
        check_range("outlier threshold", self.outlier, 1, 100)


@dataclass(frozen=True, slots=True, eq=False)
class HandEye:
    """Where the camera sits on the flange, and how well the views agree with it.

    Attributes:
        T_flange_cam: (4, 4).
        T_base_board: (4, 4) where the board stood.
        rotation_residuals: (V,) angle between the board seen in each view and the board's common pose [rad].
        translation_residuals: (V,) distance between them [m].
        used: (V,) whether the view took part; the others are outliers.
        method: what was done.
        notes: what the user should know.
    """

    T_flange_cam: Array
    T_base_board: Array
    rotation_residuals: Array
    translation_residuals: Array
    used: NDArray[Any]
    method: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.used)
        for name in ("T_flange_cam", "T_base_board"):
            object.__setattr__(self, name, check_transform(name, getattr(self, name)))
        for name in ("rotation_residuals", "translation_residuals"):
            object.__setattr__(self, name, check_array(name, getattr(self, name), (n,)))
        object.__setattr__(self, "used", check_array("used views", self.used, (n,), dtype="bool"))

    def save(self, path: Path | str) -> None:
        """Write an .npz."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        write_npz(path, "hand-eye", SCHEMA, **arrays, method=self.method, notes=json.dumps(self.notes))

    @classmethod
    def load(cls, path: Path | str) -> HandEye:
        """Read what `save` wrote.

        Raises:
            InputError: the file is missing, truncated or holds something else.
        """
        stored = read_npz(path, "hand-eye", SCHEMA)
        arrays = {name: stored[name] for name in _ARRAYS}
        return cls(**arrays, method=str(stored["method"]), notes=tuple(json.loads(str(stored["notes"]))))


_ARRAYS = ("T_flange_cam", "T_base_board", "rotation_residuals", "translation_residuals", "used")


def calibrate(T_base_flange: Any, T_cam_board: Any, params: Params | None = None) -> HandEye:
    """Return the hand-eye transform from views of a board that stands still.

    Args:
        T_base_flange: (V, 4, 4) flange poses, V >= 3.
        T_cam_board: (V, 4, 4) board poses seen from them (`detect_board`).
        params: see `Params`.

    Raises:
        InputError: fewer than three views, or motions that do not determine the transform.
    """
    params = params or Params()
    flange = check_transform("T_base_flange", T_base_flange, len(T_base_flange))
    board = check_transform("T_cam_board", T_cam_board, len(flange))
    _check_motions(flange, params)
    estimate, placed = _solve(flange, board, params, loss="cauchy")
    used = _inliers(flange, board, estimate, placed, params)
    notes: tuple[str, ...] = ()
    if not used.all():
        _check_motions(flange[used], params)
        notes = (f"left out as outliers: views {', '.join(map(str, np.flatnonzero(~used)))}",)
    estimate, placed = _solve(flange[used], board[used], params, loss="linear")
    turn, shift = _residuals(flange, board, estimate, placed)
    return HandEye(
        estimate,
        placed,
        np.linalg.norm(turn, axis=1),
        np.linalg.norm(shift, axis=1),
        used,
        f"{params.method}{' + nonlinear refinement' if params.refine else ''}, {int(used.sum())} of {len(used)} views",
        notes,
    )


def _check_motions(flange: Array, params: Params) -> None:
    """Refuse motions about one axis only: they leave the camera's position along that axis open (Tsai, Lenz 1989)."""
    if len(flange) < 3:
        raise bad_input(
            "hand-eye calibration", given=f"{len(flange)} usable views", allowed="3 or more", do="Take 15 to 20 views."
        )
    pairs = [(i, j) for i in range(len(flange)) for j in range(i)]
    relative = np.stack([flange[i, :3, :3].T @ flange[j, :3, :3] for i, j in pairs])
    turns = Rotation.from_matrix(relative).as_rotvec()
    turns /= np.maximum(1.0, np.linalg.norm(turns, axis=1, keepdims=True))
    axis = np.linalg.svd(turns, full_matrices=False)[2][0]
    beside = float(np.linalg.norm(turns - np.outer(turns @ axis, axis), axis=1).max())
    if beside < params.least_turn:
        raise bad_input(
            "hand-eye calibration",
            given=f"motions that turn about one axis only ({np.rad2deg(beside):.1f} deg about any other)",
            allowed=f"turns of {np.rad2deg(params.least_turn):.0f} deg or more about two axes",
            do="Tilt the camera about several axes, 20 to 40 deg between views.",
        )


def _solve(flange: Array, board: Array, params: Params, loss: str) -> tuple[Array, Array]:
    """Return T_flange_cam and T_base_board: closed form, then least squares over both, 12 numbers."""
    R, t = cv2.calibrateHandEye(
        R_gripper2base=list(flange[:, :3, :3]),
        t_gripper2base=list(flange[:, :3, 3]),
        R_target2cam=list(board[:, :3, :3]),
        t_target2cam=list(board[:, :3, 3]),
        method=_METHODS[params.method],
    )
    if not (np.isfinite(R).all() and np.isfinite(t).all()):
        raise InputError(
            "hand-eye calibration: the closed-form solver found nothing; do the poses belong to the views?"
        )
    estimate = transform(_nearest_rotation(np.asarray(R, dtype=np.float64)), np.asarray(t).ravel())
    placed = _middle(flange @ estimate @ board)
    if not params.refine:
        return estimate, placed

    def misfit(x: Array) -> Array:
        turn, shift = _residuals(
            flange, board, estimate @ small_transform(x[:3], x[3:6]), placed @ small_transform(x[6:9], x[9:])
        )
        return np.concatenate([turn / params.rotation_sigma, shift / params.translation_sigma], axis=1).ravel()

    x = least_squares(misfit, np.zeros(12), loss=loss, x_scale=np.tile(np.repeat([0.01, 0.01], 3), 2)).x
    return estimate @ small_transform(x[:3], x[3:6]), placed @ small_transform(x[6:9], x[9:])


def _residuals(flange: Array, board: Array, T_flange_cam: Array, T_base_board: Array) -> tuple[Array, Array]:
    """Return per view the rotation vector [rad] and shift [m] between the predicted and the seen board."""
    predicted = inverse(flange @ T_flange_cam) @ T_base_board
    turn = Rotation.from_matrix(np.swapaxes(predicted[:, :3, :3], 1, 2) @ board[:, :3, :3]).as_rotvec()
    return turn, board[:, :3, 3] - predicted[:, :3, 3]


def _inliers(flange: Array, board: Array, estimate: Array, placed: Array, params: Params) -> NDArray[np.bool_]:
    turn, shift = _residuals(flange, board, estimate, placed)
    size = np.hypot(
        np.linalg.norm(turn, axis=1) / params.rotation_sigma, np.linalg.norm(shift, axis=1) / params.translation_sigma
    )
    return size <= params.outlier * max(float(np.median(size)), 1e-3)


def _middle(T: Array) -> Array:
    """Return the median position with the mean rotation of (V, 4, 4) poses."""
    return transform(Rotation.from_matrix(T[:, :3, :3]).mean().as_matrix(), np.median(T[:, :3, 3], axis=0))


def _nearest_rotation(R: Array) -> Array:
    U, _, Vt = np.linalg.svd(R)
    return U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt


@dataclass(frozen=True, slots=True)
class CharucoBoard:
    """A ChArUco board.

    Attributes:
        columns, rows: number of squares.
        square, marker: edge lengths [m], marker < square.
        dictionary: name of the ArUco dictionary.
    """

    columns: int = 7
    rows: int = 5
    square: float = 0.030
    marker: float = 0.022
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        check_range("board columns", self.columns, 3, 50)
        check_range("board rows", self.rows, 3, 50)
        check_range("board square", self.square, 0.002, 1, "m")
        check_range("board marker", self.marker, 0.001, self.square * 0.99, "m")
        if not hasattr(cv2.aruco, self.dictionary):
            raise bad_input(
                "board dictionary",
                given=self.dictionary,
                allowed="an OpenCV name such as DICT_4X4_50",
                do="Correct it.",
            )

    def opencv(self) -> Any:
        """Return OpenCV's board."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)


@dataclass(frozen=True, slots=True, eq=False)
class BoardViews:
    """The board in those images that show enough of it.

    Attributes:
        images: (V,) numbers of these images.
        T_cam_board: (V, 4, 4).
        reprojection: (V,) RMS distance between seen and projected corners [px].
    """

    images: NDArray[Any]
    T_cam_board: Array
    reprojection: Array


def detect_board(
    images: list[NDArray[Any]], intrinsics: Intrinsics, board: CharucoBoard, least_corners: int = 8
) -> BoardViews:
    """Return the pose of a ChArUco board in each image that shows at least `least_corners` of its corners.

    Args:
        images: (H, W) or (H, W, 3) uint8, without distortion.
        intrinsics: of the camera.
        board: what was printed; measure its squares.
        least_corners: fewer corners give no pose.

    Raises:
        InputError: no image shows the board.
    """
    detector = cv2.aruco.CharucoDetector(board.opencv())
    found: list[tuple[int, Array, float]] = []
    for number, image in enumerate(images):
        corners, ids, _, _ = detector.detectBoard(np.ascontiguousarray(image))
        if ids is None or len(ids) < least_corners:
            continue
        known, seen = board.opencv().matchImagePoints(corners, ids)
        ok, turn, shift = cv2.solvePnP(known, seen, intrinsics.matrix, None, flags=cv2.SOLVEPNP_ITERATIVE)
        if ok:
            T = small_transform(turn.ravel(), shift.ravel())
            projected = intrinsics.project(known.reshape(-1, 3) @ T[:3, :3].T + T[:3, 3])
            error = float(np.sqrt(np.mean(np.sum((projected - seen.reshape(-1, 2)) ** 2, axis=1))))
            found.append((number, T, error))
    if not found:
        raise bad_input(
            "calibration images",
            given=f"{len(images)} images, none with {least_corners} corners of the board",
            allowed=f"a ChArUco board of {board.columns} x {board.rows} squares, {board.dictionary}",
            do="Check the board's size and dictionary, focus and light.",
        )
    numbers, poses, errors = zip(*found, strict=True)
    return BoardViews(np.array(numbers), np.stack(poses), np.array(errors))
