"""Images -> the board's corners in them -> the camera's intrinsics, if they are not known -> the board's poses.

Do the flange's motions determine the hand-eye transform? What the user should change where they hardly do.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError, bad_input
from anther.core.geometry import Array, Intrinsics, small_transform, transform_points
from anther.core.opencv import cv2
from anther.robot.calibration._inputs import LEAST_CORNERS, Board, explain_missing_board

CELLS = (8, 6)
"""Columns and rows of the grid in which covered cells are counted."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardCorners:
    """The board's corners in those images that show enough of it. V views with n corners each.

    Attributes:
        images: (V,) numbers of these images.
        points: V arrays (n, 3), the corners in the board frame [m].
        pixels: V arrays (n, 2), where they are seen [px].
    """

    images: NDArray[Any]
    points: tuple[Array, ...]
    pixels: tuple[Array, ...]

    def __len__(self) -> int:
        return len(self.images)


@dataclass(frozen=True, slots=True, eq=False)
class BoardViews:
    """The board in those images that show enough of it, seen by a camera whose intrinsics are known.

    Attributes:
        corners: in an image without distortion.
        T_cam_board: (V, 4, 4).
        reprojection: (V,) RMS distance between the corners seen and those of this pose [px].
    """

    corners: BoardCorners
    T_cam_board: Array
    reprojection: Array

    @property
    def images(self) -> NDArray[Any]:
        """(V,) numbers of the images."""
        return self.corners.images


def find_corners(images: Iterable[NDArray[Any]], board: Board) -> BoardCorners:
    """Return the board's corners in each image that shows `LEAST_CORNERS` of them or more, not all in one line.

    Args:
        images: (H, W) or (H, W, 3) uint8.
        board: what was printed; measure its squares.

    Raises:
        InputError: no image shows the board.
    """
    numbers, points, pixels, count, last = [], [], [], 0, np.zeros((1, 1), np.uint8)
    for number, image in enumerate(images):
        known, seen = board.find(image)
        count, last = count + 1, image
        if len(known) >= LEAST_CORNERS and np.linalg.matrix_rank(known[:, :2] - known[0, :2], tol=1e-9) == 2:
            numbers.append(number)
            points.append(known)
            pixels.append(seen)
    if not numbers:
        raise bad_input(
            "calibration images",
            given=f"{count} images, none with {LEAST_CORNERS} corners of the board",
            allowed=f"a {board}",
            do=explain_missing_board(last if last.ndim == 2 else cv2.cvtColor(last, cv2.COLOR_BGR2GRAY), board),
        )
    return BoardCorners(np.array(numbers), tuple(points), tuple(pixels))


def estimate_intrinsics(corners: BoardCorners, width: int, height: int) -> tuple[Intrinsics, Array]:
    """Return the camera's intrinsics and its distortion (5,), k1, k2, p1, p2, k3, from views of a flat board.

    Zhang's method (Zhang 2000) as in `cv2.calibrateCamera`. Distortion (k1, k2, p1, p2; k3 stays 0) is kept only where
    it pays for its four numbers by Schwarz's criterion (Schwarz 1978); otherwise it is zero.

    Raises:
        InputError: fewer than three views, or views that do not determine the intrinsics.
    """
    if len(corners) < 3:
        raise bad_input(
            "intrinsics",
            given=f"{len(corners)} views of the board",
            allowed="3 or more",
            do="Take 15 to 20 views, tilted, all over the image.",
        )
    flat = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    plain, bent = (_calibrate_camera(corners, (width, height), flags) for flags in (flat, cv2.CALIB_FIX_K3))
    count = 2 * sum(len(seen) for seen in corners.pixels)
    pays = 2 * count * np.log(max(plain[0], 1e-9) / max(bent[0], 1e-9)) > 4 * np.log(count)
    _, K, distortion = bent if pays else plain
    if not np.isfinite(K).all():
        raise InputError("intrinsics: the views do not determine them. Tilt the board by 20 to 40 deg between views.")
    intrinsics = Intrinsics(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    return intrinsics, distortion.ravel()[:5]


def _calibrate_camera(corners: BoardCorners, size: tuple[int, int], flags: int) -> tuple[float, Array, Array]:
    known = [points.astype(np.float32) for points in corners.points]
    seen = [pixels.astype(np.float32) for pixels in corners.pixels]
    try:
        rms, K, distortion, _, _ = cv2.calibrateCamera(known, seen, size, np.eye(3), np.zeros(5), flags=flags)
    except cv2.error as error:
        raise InputError(f"intrinsics: the views do not determine them ({error.err}). Take more, tilted.") from error
    return rms, np.asarray(K, dtype=np.float64), np.asarray(distortion, dtype=np.float64)


def undistort(corners: BoardCorners, intrinsics: Intrinsics, distortion: Array) -> BoardCorners:
    """Return the corners where a camera of these intrinsics without distortion would see them.

    Args:
        corners: as seen through the lens.
        intrinsics: of the camera.
        distortion: of the lens in OpenCV's order, 5, 8, 12 or 14 numbers.

    Raises:
        InputError: the polynomials cannot be undone at a corner: they are no lens's that took these images.
    """
    if not np.any(distortion):
        return corners
    K, settled = intrinsics.matrix, (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 200, 1e-10)
    pixels = []
    for seen in corners.pixels:
        rays = cv2.undistortPointsIter(seen.reshape(-1, 1, 2), K, distortion, np.eye(3), np.eye(3), settled)
        rays = np.asarray(rays, dtype=np.float64).reshape(-1, 2)
        back, _ = cv2.projectPoints(np.c_[rays, np.ones(len(rays))], np.zeros(3), np.zeros(3), K, distortion)
        off = float(np.abs(back.reshape(-1, 2) - seen).max())
        if not off < 0.05:  # corners are found to 0.1
            do = "Are these the numbers of this lens, at this image size?"
            given, allowed = f"a lens that cannot be undone ({off:.3g} px off)", "within 0.05 px"
            raise bad_input("distortion", given=given, allowed=allowed, do=do)
        pixels.append(rays @ np.diag([K[0, 0], K[1, 1]]) + K[:2, 2])
    return BoardCorners(corners.images, corners.points, tuple(pixels))


def largest_distortion(intrinsics: Intrinsics, distortion: Array) -> float:
    """Return how far the lens moves a pixel on the image's border [px]."""
    across, down = np.linspace(0, intrinsics.width - 1, 33), np.linspace(0, intrinsics.height - 1, 19)
    u, v = (grid.ravel() for grid in np.meshgrid(across, down))
    straight = np.stack([u, v], axis=1)
    rays = np.stack([(u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy, np.ones_like(u)], axis=1)
    bent, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), intrinsics.matrix, distortion)
    return float(np.linalg.norm(bent.reshape(-1, 2) - straight, axis=1).max())


def image_coverage(pixels: Array, intrinsics: Intrinsics) -> float:
    """Return the share of the cells of an 8 x 6 grid over the image that hold a corner, of (N, 2) pixels."""
    size = np.array([intrinsics.width, intrinsics.height])
    cells = np.clip((pixels / size * CELLS).astype(int), 0, np.array(CELLS) - 1)
    return len(np.unique(cells, axis=0)) / (CELLS[0] * CELLS[1])


def board_views(corners: BoardCorners, intrinsics: Intrinsics) -> BoardViews:
    """Return the board's pose in each view.

    Of the two poses that a flat board has (Collins and Bartoli 2014, OpenCV's IPPE) the better one, refined by least
    squares.
    """
    poses, errors = [], []
    for points, pixels in zip(corners.points, corners.pixels, strict=True):
        _, turns, shifts, _ = cv2.solvePnPGeneric(points, pixels, intrinsics.matrix, None, flags=cv2.SOLVEPNP_IPPE)
        turn, shift = cv2.solvePnPRefineLM(points, pixels, intrinsics.matrix, None, turns[0], shifts[0])
        T = small_transform(turn.ravel(), shift.ravel())
        away = intrinsics.project(transform_points(T, points)) - pixels
        poses.append(T)
        errors.append(float(np.sqrt(np.mean(np.sum(away**2, axis=1)))))
    return BoardViews(corners, np.stack(poses), np.array(errors))


class Motions(NamedTuple):
    """How the flange turned between views.

    Attributes:
        turns: (V (V-1) / 2, 3) rotation vectors from each view to each other, in the flange frame [rad].
        largest: the largest angle [rad].
        second: the largest turn about an axis across the main one [rad], at most 1.
    """

    turns: Array
    largest: float
    second: float


def flange_motions(T_base_flange: Array) -> Motions:
    """Return how the flange turned between (V, 4, 4) poses."""
    later, earlier = np.tril_indices(len(T_base_flange), -1)
    R = T_base_flange[:, :3, :3]
    turns = Rotation.from_matrix(np.swapaxes(R[later], 1, 2) @ R[earlier]).as_rotvec()
    angles = np.linalg.norm(turns, axis=1)
    bounded = turns / np.maximum(1.0, angles)[:, None]
    axis = np.linalg.svd(bounded, full_matrices=False)[2][0]
    second = np.linalg.norm(bounded - np.outer(bounded @ axis, axis), axis=1)
    return Motions(turns, float(angles.max()), float(second.max()))


def check_motions(T_base_flange: Array) -> None:
    """Refuse motions about one axis only: they leave the camera's position along that axis open (Tsai, Lenz 1989).

    Args:
        T_base_flange: (V, 4, 4).

    Raises:
        InputError: fewer than three views, or turns about one axis only.
    """
    count = len(T_base_flange)
    if count < 3:
        raise bad_input(
            "hand-eye calibration", given=f"{count} usable views", allowed="3 or more", do="Take 15 to 20 views."
        )
    least_turn = float(np.deg2rad(3))  # about each of two different axes
    second = flange_motions(T_base_flange).second
    if second < least_turn:
        raise bad_input(
            "hand-eye calibration",
            given=f"degenerate motions, that turn about one axis only ({np.rad2deg(second):.1f} deg about any other)",
            allowed=f"turns of {np.rad2deg(least_turn):.0f} deg or more about two axes",
            do="Tilt the flange about several axes, 20 to 40 deg between views.",
        )


def motion_warnings(T_base_flange: Array) -> tuple[str, ...]:
    """Return what is poor about the motions between (V, 4, 4) flange poses, one sentence each."""
    motions, notes = flange_motions(T_base_flange), []
    if len(T_base_flange) < 10:
        notes.append(f"only {len(T_base_flange)} views: take 15 to 20, errors go with 1 / sqrt(views)")
    if motions.largest < np.deg2rad(20):  # errors go with 1 / turn (Tsai and Lenz 1989, section VI)
        notes.append(
            f"too little rotation: at most {np.rad2deg(motions.largest):.0f} deg between views, errors go with "
            f"1 / rotation; tilt the flange by 20 to 40 deg"
        )
    elif motions.second < np.deg2rad(15):
        notes.append(
            f"rotation axes nearly parallel: at most {np.rad2deg(motions.second):.0f} deg about any axis across the "
            f"main one, along which the camera's place is poorly known; turn about two axes"
        )
    return tuple(notes)
