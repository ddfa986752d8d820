"""Where the camera sits on the flange (AX = XB): closed forms, what odd views do not spoil, and how far to trust it.

V views. The honest error of a calibration is how well each view is predicted from all the others, for every method.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from anther.core.checks import check_transform
from anther.core.choices import HandEyeMethod as Method
from anther.core.errors import InputError, bad_input
from anther.core.files import read_object, understood, write_json
from anther.core.geometry import Array, Intrinsics, inverse, transform
from anther.core.opencv import cv2
from anther.core.records import Range, Record, Shape, decode, encode
from anther.robot.calibration._intrinsics import LENS_SIZES
from anther.robot.calibration._refinement import LEAST_PIXEL_NOISE, Noise, Problem, misfit, refine
from anther.robot.calibration._views import BoardViews

KIND, KIND_BESIDE, SCHEMA = "hand-eye", "eye-to-hand", 2


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
class HandEye(Record):
    """Where the camera sits on the flange, and how well the views agree with it.

    Attributes:
        T_flange_cam: (4, 4).
        T_base_board: (4, 4) where the board stood.
        intrinsics: of the camera.
        distortion: of the lens in OpenCV's order, (5,), (8,), (12,) or (14,): k1, k2, p1, p2, k3, k4, k5, k6, ...; 0
            where there is none.
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

    CALLED = "calibration"
    T_flange_cam: Annotated[Array, Shape(4, 4, rigid=True)]
    T_base_board: Annotated[Array, Shape(4, 4, rigid=True)]
    intrinsics: Intrinsics
    distortion: Annotated[Array, Shape(None)]
    images: tuple[str, ...]
    used: Annotated[NDArray[np.bool_], Shape("V")]
    pixel_residuals: Annotated[Array, Shape("V"), Range(unit="px")]
    rotation_residuals: Annotated[Array, Shape("V"), Range(unit="rad")]
    translation_residuals: Annotated[Array, Shape("V"), Range(unit="m")]
    left_out_errors: Annotated[Array, Shape("V", 3, missing=True)]
    rotation_error: Annotated[float, Range(unit="rad")]
    translation_error: Annotated[float, Range(unit="m")]
    pixel_noise: Annotated[float, Range(unit="px")]
    arm_rotation_error: Annotated[float, Range(unit="rad")]
    arm_translation_error: Annotated[float, Range(unit="m")]
    methods: tuple[MethodError, ...]
    method: str
    notes: tuple[str, ...] = ()

    def _check(self) -> None:
        if len(self.distortion) not in LENS_SIZES:
            given, allowed = f"{len(self.distortion)} numbers", f"one of {', '.join(map(str, LENS_SIZES))}"
            raise bad_input("distortion", given=given, allowed=allowed, do="Give them in OpenCV's order.")
        if len(self.images) != len(self.used):
            given, allowed = f"{len(self.used)} views", f"{len(self.images)}, one an image"
            raise bad_input("used views", given=given, allowed=allowed, do="Calibrate again.")

    def board_in_camera(self, T_base_flange: Array) -> Array:
        """Return T_cam_board (V, 4, 4) as the calibration has it for (V, 4, 4) flange poses."""
        return inverse(T_base_flange @ self.T_flange_cam) @ self.T_base_board

    def save(self, path: Path | str) -> None:
        """Write a JSON file (docs/calibration.md)."""
        _save(path, KIND, self, {})

    @classmethod
    def load(cls, path: Path | str) -> HandEye:
        """Read what `save` wrote.

        Raises:
            InputError: the file is missing, truncated or holds something else.
        """
        return _load(path, KIND, {})


@dataclass(frozen=True, slots=True, eq=False)
class EyeToHand:
    """Where a camera beside the robot stands, and how well the views of a board on the flange agree with it.

    Attributes:
        exchanged: the calibration with base and flange exchanged: its T_flange_cam is T_base_cam, its T_base_board
            T_flange_board; all else is as it says.
    """

    exchanged: HandEye

    @property
    def T_base_cam(self) -> Array:
        """(4, 4): T_world_cam, because the world is the arm's base."""
        return self.exchanged.T_flange_cam

    @property
    def T_flange_board(self) -> Array:
        """(4, 4)."""
        return self.exchanged.T_base_board

    def save(self, path: Path | str) -> None:
        """Write a JSON file (docs/calibration.md)."""
        _save(path, KIND_BESIDE, self.exchanged, _EXCHANGED)

    @classmethod
    def load(cls, path: Path | str) -> EyeToHand:
        """Read what `save` wrote.

        Raises:
            InputError: the file is missing, truncated or holds something else.
        """
        return cls(_load(path, KIND_BESIDE, _EXCHANGED))


_EXCHANGED = {"T_flange_cam": "T_base_cam", "T_base_board": "T_flange_board"}


def _save(path: Path | str, kind: str, found: HandEye, names: dict[str, str]) -> None:
    values = {names.get(name, name): value for name, value in encode(found).items()}
    write_json(path, {"kind": kind, "schema": SCHEMA, **values})


def _load(path: Path | str, kind: str, names: dict[str, str]) -> HandEye:
    stored = read_object(path)
    if (stored.get("kind"), stored.get("schema")) != (kind, SCHEMA):
        other = stored.get("kind") in (KIND, KIND_BESIDE) and stored.get("kind") != kind
        raise bad_input(
            str(path),
            given=f"a calibration of kind '{stored['kind']}'" if other else "something else, or another schema number",
            allowed=f"a calibration written by anther calibrate, kind '{kind}', schema {SCHEMA}",
            do="'hand-eye': a camera on the flange; 'eye-to-hand': beside the robot." if other else "Calibrate again.",
        )
    with understood(path, "a whole file", "Restore it."):
        return decode({name: stored[names.get(name, name)] for name in HandEye.__slots__}, HandEye)


METHODS: tuple[Method, ...] = get_args(Method)
"""Tsai and Lenz 1989, Park and Martin 1994, Horaud and Dornaika 1995, Daniilidis 1999.

Andreff is left out: its translation is unstable (facts: perception)."""
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
            method=getattr(cv2, f"CALIB_HAND_EYE_{method.upper()}"),
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


def predict_board(T_base_flange: Array, T_flange_cam: Array, T_base_board: Array) -> Array:
    """Return T_cam_board (V, 4, 4) as the arm and the calibration have it."""
    return inverse(T_base_flange @ T_flange_cam) @ T_base_board


def disagreement(predicted: Array, observed: Array, centre: Array) -> tuple[Array, Array]:
    """Return by how much two (V, 4, 4) board poses differ: angle [rad], distance of the board's `centre` (3,) [m]."""
    turn = Rotation.from_matrix(np.swapaxes(predicted[:, :3, :3], 1, 2) @ observed[:, :3, :3]).magnitude()
    shift = (predicted[:, :3, :3] - observed[:, :3, :3]) @ centre + predicted[:, :3, 3] - observed[:, :3, 3]
    return turn, np.linalg.norm(shift, axis=1)


def robust_estimate(
    T_base_flange: Array, T_cam_board: Array, centre: Array, sigmas: tuple[float, float], method: Method
) -> tuple[Array, Array, Array]:
    """Return T_flange_cam, T_base_board and the misfit (V,) [-] of the subset of views that most views agree with.

    Least median of squares (Rousseeuw 1984): it stands up to nearly half of the views being wrong.

    Args:
        T_base_flange, T_cam_board: (V, 4, 4), V >= 3.
        centre: (3,) of the board [m], where distances are measured.
        sigmas: unit of angles [rad] and of distances [m].
        method: solver.

    Raises:
        InputError: no subset gives a solution.
    """
    count = len(T_base_flange)
    best, best_score = None, np.inf
    for views in _subsets(count, np.random.default_rng(0)):
        try:
            X, Z = closed_form(T_base_flange[views], T_cam_board[views], method)
        except InputError:
            continue
        turn, shift = disagreement(predict_board(T_base_flange, X, Z), T_cam_board, centre)
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
    size = min(4, count - 1)
    if size < 3:
        return [np.arange(count)]
    if count <= 8:
        some = [np.array(views) for views in combinations(range(count), size)]
    else:
        # with 4 of 10 views wrong, one of 150 subsets is all right with a certainty of 1 - 1e-9
        some = [rng.choice(count, size, replace=False) for _ in range(150)]
    return [np.arange(count), *some]


def _middle(T: Array) -> Array:
    """Return the median position with the mean rotation of (V, 4, 4) poses."""
    return transform(Rotation.from_matrix(T[:, :3, :3]).mean().as_matrix(), np.median(T[:, :3, 3], axis=0))


def _nearest_rotation(R: Array) -> Array:
    U, _, Vt = np.linalg.svd(R)
    return U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt


# Has the camera moved on the flange since it was calibrated? The arm goes to joints that it had in the calibration, so
# that what is wrong with its kinematics is wrong twice and cancels. Board and camera are then as they were, or one of
# them has moved: a camera by the same way in the flange's frame in every view, a board by the same way in the base
# frame. Each is fitted (`refine`); squared residuals tell which it was.
Verdict = Literal["still", "camera", "board", "camera or board", "more"]
CERTAIN = 4.0
"""A movement counts beyond so many standard deviations of a normal distribution: once in 16 000 mornings by chance."""


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


def find_movement(
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
    parts = {"camera": slice(0, 6), "board": slice(6, 12), "both": slice(0, 12)}
    fits = {name: refine(problem, X, Z, noise, all_views, part) for name, part in parts.items()}
    rest = {name: misfit(problem, fit.T_flange_cam, fit.T_base_board, noise) for name, fit in fits.items()}
    gain = misfit(problem, X, Z, noise) - np.array([rest["camera"], rest["board"]])
    camera, board = _way(X, fits["camera"].T_flange_cam), _way(Z, fits["board"].T_base_board, centre)
    # a guess: a camera that warms up moves as much, and no grasp is lost
    trifle = np.deg2rad(0.1), 0.5e-3  # [rad], [m]
    verdict = _verdict(rest, gain, bool(np.all(np.array([camera, board]) < trifle)))
    fit = fits["both" if verdict == "more" else "camera"]
    turn, shift = (float(np.sqrt(np.linalg.eigvalsh(fit.covariance[i : i + 3, i : i + 3])[-1])) for i in (0, 3))
    return Moved(verdict, *_way(X, fit.T_flange_cam), turn, shift, *board)


def _verdict(rest: dict[str, float], gain: Array, trifling: bool) -> Verdict:
    limit = float(chi2.isf(2 * norm.sf(CERTAIN), 6))
    if trifling or gain.max() <= limit:
        return "still"
    if min(rest["camera"], rest["board"]) - rest["both"] > limit:
        return "more"
    if abs(rest["camera"] - rest["board"]) < 9:  # squared misfits: else the one is 90 times as likely
        return "camera or board"
    return "camera" if rest["camera"] < rest["board"] else "board"


def _way(before: Array, after: Array, point: Array | None = None) -> tuple[float, float]:
    """Return angle [rad] and distance [m] between two poses, the distance of a (3,) point of the moving frame."""
    turn = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).magnitude()
    p = np.zeros(3) if point is None else point
    return float(turn), float(np.linalg.norm((after - before)[:3, :3] @ p + (after - before)[:3, 3]))
