"""Depth laid over colour, and images freed of their lens: what recordings and live cameras need alike. H x W pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.compiling import compiled
from anther.core.errors import bad_input
from anther.core.geometry import Array, Intrinsics
from anther.core.opencv import cv2

_BROWN = {
    "", "none", "plumb_bob", "rational_polynomial", "brown conrady", "modified brown conrady", "inverse brown conrady",
}  # fmt: skip
_FISHEYE = {"equidistant", "fisheye", "kannala brandt4"}
"""OpenCV's fisheye: what is seen at an angle a lies at f (a + k1 a^3 + k2 a^5 + ...), also where k1 to k4 are 0."""

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]
"""(H, W) column and row of the distorted image for every pixel of the straight one."""


def straightening(
    what: str, camera: Intrinsics, D: Array, model: str, straight: Intrinsics | None = None
) -> Maps | None:
    """Return where each pixel of an image without lens distortion lies in the one with it; None if all stay.

    Distortion is Brown's (OpenCV's plumb_bob, rational_polynomial). librealsense's "Inverse Brown Conrady" is the same
    polynomial, straight to distorted: `rs2_project_point_to_pixel` of SDK 2.54 to 2.59 agrees with OpenCV's within
    1e-3 px, and 2.59 records it as plumb_bob. ROS's equidistant, librealsense's Kannala Brandt4, is OpenCV's fisheye.

    Args:
        what: for messages.
        camera: the pinhole camera.
        D: coefficients in OpenCV's order.
        model: its name, in ROS's or librealsense's words.
        straight: the camera of the image without distortion, perhaps larger; None: the same.

    Raises:
        InputError: an unknown distortion model.
    """
    name, D, onto = model.strip().lower(), np.trim_zeros(D, "b"), straight or camera
    size = onto.width, onto.height
    sizes = (5, 8, 12, 14)  # how many coefficients OpenCV's polynomials have
    if name not in _BROWN | _FISHEYE or len(D) > (4 if name in _FISHEYE else sizes[-1]):
        raise bad_input(
            what,
            given=f"distortion model '{model}' with {len(D)} coefficients",
            allowed="plumb_bob, rational_polynomial, (Modified, Inverse) Brown Conrady, equidistant",
            do="Record rectified images.",
        )
    if name in _FISHEYE:
        D = np.r_[D, np.zeros(4 - len(D))]
        maps = cv2.fisheye.initUndistortRectifyMap(camera.matrix, D, np.eye(3), onto.matrix, size, cv2.CV_32FC1)
    elif len(D) or onto != camera:
        D = np.r_[D, np.zeros(next(n for n in sizes if n >= len(D)) - len(D))]
        maps = cv2.initUndistortRectifyMap(camera.matrix, D, np.eye(3), onto.matrix, size, cv2.CV_32FC1)
    else:
        return None
    return np.asarray(maps[0], np.float32), np.asarray(maps[1], np.float32)


def straightened(image: NDArray[Any], maps: Maps | None, *, nearest: bool) -> NDArray[Any]:
    """Return the image freed of its lens; `nearest` for depth, which must not be mixed across edges."""
    if maps is None:
        return image
    return cv2.remap(image, *maps, cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR)


def is_shown(maps: Maps, camera: Intrinsics) -> NDArray[np.bool_]:
    """Return (H, W) whether pixels of the straight image lie within the distorted one, which is of `camera`'s size."""
    halves = camera.width / 2, camera.height / 2
    return np.logical_and(*(np.abs(at + 0.5 - half) <= half for at, half in zip(maps, halves, strict=True)))


def laid_over(depth: NDArray[np.float32], of: Intrinsics, onto: Intrinsics, T_onto_of: Array) -> NDArray[np.float32]:
    """Return the depth image as another camera would see it: every pixel's footprint, the nearest one in front.

    Args:
        depth: (H, W) z-depth [m] of camera `of`.
        of: the depth camera.
        onto: the colour camera.
        T_onto_of: (4, 4) depth-camera to colour-camera coordinates.
    """
    square = np.abs(T_onto_of[:2, :2]) @ (0.5 / of.pinhole[:2])  # of a turned pixel at depth 1, half
    out = np.zeros((onto.height, onto.width), np.float32)
    _lay(
        np.ascontiguousarray(depth, np.float32),
        of.pinhole,
        onto.pinhole,
        np.ascontiguousarray(T_onto_of, np.float64),
        square * onto.pinhole[:2],
        out,
    )
    return out


@compiled
def _lay(depth: Any, of: Any, onto: Any, T: Any, half: Any, out: Any) -> None:
    # A point that comes nearer to the colour camera than this share of its depth is not drawn larger for it
    nearest = 0.25
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if not z > 0:
                continue
            x, y = (u - of[2]) / of[0] * z, (v - of[3]) / of[1] * z
            ahead = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            if ahead <= 0:
                continue
            across = onto[0] * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / ahead + onto[2]
            down = onto[1] * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / ahead + onto[3]
            larger = z / max(ahead, nearest * z)
            dx, dy = half[0] * larger, half[1] * larger
            # half-open, so that neighbours share no pixel
            left, right = max(np.ceil(across - dx - 1e-6), 0), min(np.floor(across + dx - 1e-6), out.shape[1] - 1)
            top, bottom = max(np.ceil(down - dy - 1e-6), 0), min(np.floor(down + dy - 1e-6), out.shape[0] - 1)
            for row in range(int(top), int(bottom) + 1):
                for column in range(int(left), int(right) + 1):
                    if out[row, column] == 0 or ahead < out[row, column]:
                        out[row, column] = ahead
