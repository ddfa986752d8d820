"""From where to look at a board next, so that the views determine the hand-eye transform. C candidates, V views.

Errors go with 1 / turn and with 1 / sin of the angle between rotation axes, and grow with the camera's distance (Tsai
and Lenz 1989, section VI): candidates are near, tilted to all sides and rolled, and the next view is the one least like
those that were taken.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from anther.geometry import (
    Array,
    Intrinsics,
    inverse,
    look_at,
    transform,
    transform_points,
)

TILT, ROLL = float(np.deg2rad(40)), float(np.deg2rad(60))
"""Most from the board's normal, and about the optical axis from the first view [rad]; docs/calibration.md: 20 to 40
degrees between views."""
NEAREST, FARTHEST = 0.25, 1.7
"""The camera is no nearer [m], nor so near that the board would fill more than `FILLED` of the image's lesser side; and
no farther than so many times that."""
FILLED, MARGIN = 0.8, 0.04
"""Shares of the image: see above; and the frame that the board keeps out of, where lenses are worst [-]."""
COUNT = 256
CAREFUL = float(np.deg2rad(12))
"""While the camera's place is not known the camera circles the board by so little that it stays in view [rad]."""
LIKE = float(np.deg2rad(30)), 0.25, 0.3
"""Views that differ by one of these count as equally far apart: turn [rad], place of the board in the image [of its
width], distance [its logarithm]. A choice."""


def candidates(T_board_cam_first: Array, centre: Array, intrinsics: Intrinsics, *, known: bool) -> Array:
    """Return T_board_cam (C, 4, 4) of cameras that see the whole board.

    Args:
        T_board_cam_first: (4, 4) of the first view; upright is as it was there.
        centre: (3,) of the board [m]; the board reaches as far on its other side.
        intrinsics: of the camera.
        known: whether the camera's place on the flange is known well enough for large motions. If not: small turns of
            the first view about the board.
    """
    if not known:
        turns = Rotation.from_rotvec(CAREFUL * np.concatenate([np.eye(3), -np.eye(3)])).as_matrix()
        about = np.stack([transform(R, centre - R @ centre) for R in turns])
        return about @ T_board_cam_first
    side = np.sign(T_board_cam_first[2, 3]) or -1.0
    near = max(
        NEAREST, np.linalg.norm(centre) * 2 * intrinsics.fx / (FILLED * min(intrinsics.width, intrinsics.height))
    )
    draws = qmc.Halton(6, scramble=False).random(COUNT + 1)[1:]
    poses = np.stack([_pose(draw, T_board_cam_first, centre, side, float(near), intrinsics) for draw in draws])
    return poses[sees_board(poses, centre, intrinsics)]


def sees_board(T_board_cam: Array, centre: Array, intrinsics: Intrinsics) -> NDArray[np.bool_]:
    """Return (C,) whether each of (C, 4, 4) cameras sees all of the board, within the image's `MARGIN`."""
    size = np.array([intrinsics.width, intrinsics.height])
    corners = centre + centre * np.array([[-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]])
    pixels = np.stack([intrinsics.project(transform_points(inverse(T), corners)) for T in T_board_cam])
    inside = (pixels > MARGIN * size) & (pixels < (1 - MARGIN) * size)  # NaN, behind the camera, is not inside
    return np.asarray(inside.all(axis=(1, 2)))


def differences(T_board_cam: Array, others: Array, centre: Array, intrinsics: Intrinsics) -> Array:
    """Return (C, V) how unlike the views from (C, 4, 4) and (V, 4, 4) are [-], see `LIKE`."""
    turn = Rotation.from_matrix(
        np.einsum("cji,vjk->cvik", T_board_cam[:, :3, :3], others[:, :3, :3]).reshape(-1, 3, 3)
    ).magnitude()
    (place, far), (place_other, far_other) = (_place(T, centre, intrinsics) for T in (T_board_cam, others))
    shift = np.linalg.norm(place[:, None] - place_other[None], axis=2)
    nearer = far[:, None] - far_other[None]
    return np.sqrt((turn.reshape(shift.shape) / LIKE[0]) ** 2 + (shift / LIKE[1]) ** 2 + (nearer / LIKE[2]) ** 2)


def least_alike(T_board_cam: Array, taken: Array, centre: Array, intrinsics: Intrinsics) -> NDArray[np.intp]:
    """Return the numbers (C,) of the candidates (C, 4, 4), first the one least like all of the (V, 4, 4) taken."""
    nearest = differences(T_board_cam, taken, centre, intrinsics).min(axis=1)
    return np.argsort(-nearest, kind="stable")


def spread(T_board_cam: Array, count: int, first: int, centre: Array, intrinsics: Intrinsics) -> list[int]:
    """Return up to `count` of the views (V, 4, 4), `first` and then always the one least like those before."""
    chosen = [first]
    while len(chosen) < min(count, len(T_board_cam)):
        chosen.append(int(least_alike(T_board_cam, T_board_cam[chosen], centre, intrinsics)[0]))
    return chosen


def _pose(draw: Array, first: Array, centre: Array, side: float, near: float, intrinsics: Intrinsics) -> Array:
    """Return T_board_cam (4, 4) of six numbers from 0 to 1."""
    tilt, azimuth, roll = draw[:3] * [TILT, 2 * np.pi, 2 * ROLL] - [0, 0, ROLL]
    ray = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), side * np.cos(tilt)])
    distance = near * FARTHEST ** draw[3]
    size = np.array([intrinsics.width, intrinsics.height])
    reach = intrinsics.fx * np.linalg.norm(centre[:2]) / distance
    room = np.maximum(size * (0.5 - MARGIN) - reach, 0)  # that the board has around it in the image [px]
    right, down = np.arctan2((2 * draw[4:] - 1) * room, intrinsics.fx)
    pose = look_at(centre + distance * ray, centre, up=-first[:3, 1])
    turns = Rotation.from_euler("z", roll) * Rotation.from_euler("xy", [down, -right])
    return pose @ transform(turns.as_matrix(), np.zeros(3))


def _place(T_board_cam: Array, centre: Array, intrinsics: Intrinsics) -> tuple[Array, Array]:
    """Return where (V, 4, 4) cameras see the board's centre (V, 2) [of the width], and log its distance (V,)."""
    seen = np.stack([transform_points(inverse(T), centre[None])[0] for T in T_board_cam])
    depth = np.maximum(np.abs(seen[:, 2]), 1e-3)
    return seen[:, :2] / depth[:, None] * intrinsics.fx / intrinsics.width, np.log(np.linalg.norm(seen, axis=1))
