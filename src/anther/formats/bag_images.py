"""Images and cameras as bags hold them: decoding, undistortion, and laying depth over colour. H x W pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import bad_input
from anther.geometry import Array, Intrinsics, transform_points

_COLORS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None), "bgr8": (3, cv2.COLOR_BGR2RGB), "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB), "mono8": (1, cv2.COLOR_GRAY2RGB), "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2), "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
}  # fmt: skip
_MILLIMETRES = {"16UC1", "mono16"}
_FORWARD = {"", "none", "plumb_bob", "rational_polynomial", "brown conrady"}
_INVERSE = {"inverse brown conrady"}


@dataclass(frozen=True, slots=True, eq=False)
class BagCamera:
    """A camera as its CameraInfo tells.

    Attributes:
        intrinsics: the pinhole camera without its distortion.
        frame: the optical frame's name.
        maps: (H, W) column and row of the distorted image for every pixel of the straight one, or None.
    """

    intrinsics: Intrinsics
    frame: str
    maps: tuple[NDArray[np.float32], NDArray[np.float32]] | None

    def straighten(self, image: NDArray[Any], *, nearest: bool) -> NDArray[Any]:
        """Return the image freed of lens distortion; `nearest` for depth, which must not be mixed across edges."""
        if self.maps is None:
            return image
        return cv2.remap(image, *self.maps, cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR)


def camera_of(topic: str, info: Any) -> BagCamera:
    """Return the camera of a sensor_msgs/CameraInfo (ROS 1 or 2).

    Distortion is Brown's (OpenCV's plumb_bob, rational_polynomial) or librealsense's "Inverse Brown Conrady", whose
    polynomial maps distorted to straight coordinates (librealsense, doc/projection.md).

    Raises:
        InputError: no usable camera matrix, or an unknown distortion model.
    """
    K = np.array(check_array(f"{topic} K", getattr(info, "K", None) if hasattr(info, "K") else info.k, (9,)))
    D = np.array(check_array(f"{topic} D", info.D if hasattr(info, "D") else info.d, (None,)))
    intrinsics = Intrinsics(int(info.width), int(info.height), K[0], K[4], K[2], K[5])
    maps = None if not D.any() else _maps(topic, intrinsics, D, str(info.distortion_model).strip().lower())
    return BagCamera(intrinsics, str(info.header.frame_id), maps)


def colour_image(topic: str, message: Any) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of a sensor_msgs/Image or CompressedImage.

    Raises:
        InputError: an unknown encoding or damaged data.
    """
    if hasattr(message, "format"):
        image = cv2.imdecode(np.asarray(message.data, np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise bad_input(topic, given=f"damaged {message.format}", allowed="JPEG or PNG", do="Record it anew.")
        return np.asarray(image[..., ::-1], dtype=np.uint8)
    if message.encoding not in _COLORS:
        raise bad_input(
            topic, given=f"encoding {message.encoding}", allowed=", ".join(_COLORS), do="Name another colour topic."
        )
    channels, conversion = _COLORS[message.encoding]
    pixels = _pixels(topic, message, np.dtype(np.uint8), channels)
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), dtype=np.uint8)


def depth_image(topic: str, message: Any, unit: float) -> NDArray[np.float32]:
    """Return (H, W) z-depth [m], 0 where there is none, of a sensor_msgs/Image.

    Args:
        topic: for messages.
        message: 16UC1 or mono16 in steps of `unit`, or 32FC1 in metres (REP 118).
        unit: of a 16-bit step [m].

    Raises:
        InputError: an unknown encoding.
    """
    encoding = getattr(message, "encoding", getattr(message, "format", "?"))
    if encoding in _MILLIMETRES:
        return _pixels(topic, message, np.dtype(np.uint16), 1).astype(np.float32) * np.float32(unit)
    if encoding == "32FC1":
        depth = _pixels(topic, message, np.dtype(np.float32), 1)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
    raise bad_input(
        topic, given=f"encoding {encoding}", allowed="16UC1, mono16 or 32FC1", do="Name another depth topic."
    )


def laid_over(depth: NDArray[np.float32], of: Intrinsics, onto: Intrinsics, T_onto_of: Array) -> NDArray[np.float32]:
    """Return the depth image as another camera would see it: every pixel's footprint, the nearest one in front.

    Args:
        depth: (H, W) z-depth [m] of camera `of`.
        of: the depth camera.
        onto: the colour camera.
        T_onto_of: (4, 4) depth-camera to colour-camera coordinates.
    """
    points = transform_points(T_onto_of, of.back_project(depth))
    points = points[points[:, 2] > 0]
    pixels = onto.project(points)
    half = 0.5 * np.array([onto.fx / of.fx, onto.fy / of.fy])
    low = np.ceil(pixels - half - 1e-6).astype(np.int64)
    high = np.floor(pixels + half - 1e-6).astype(np.int64)  # half-open, so that neighbours share no pixel
    out = np.full(onto.height * onto.width, np.inf, dtype=np.float32)
    for du in range(int(np.ceil(2 * half[0])) + 1):
        for dv in range(int(np.ceil(2 * half[1])) + 1):
            at = low + np.array([du, dv])
            inside = np.all((at <= high) & (at >= 0) & (at < (onto.width, onto.height)), axis=1)
            np.minimum.at(out, at[inside, 1] * onto.width + at[inside, 0], points[inside, 2].astype(np.float32))
    out[np.isinf(out)] = 0
    return out.reshape(onto.height, onto.width)


def _maps(topic: str, camera: Intrinsics, D: Array, model: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    size = (camera.width, camera.height)
    if model in _FORWARD:
        across, down = cv2.initUndistortRectifyMap(camera.matrix, D, np.eye(3), camera.matrix, size, cv2.CV_32FC1)
        return np.asarray(across, np.float32), np.asarray(down, np.float32)
    if model in _INVERSE:
        u, v = np.meshgrid(np.arange(size[0], dtype=np.float64), np.arange(size[1], dtype=np.float64))
        grid = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
        bent = cv2.undistortPoints(grid, camera.matrix, D, P=camera.matrix).reshape(size[1], size[0], 2)
        return bent[..., 0].astype(np.float32), bent[..., 1].astype(np.float32)
    raise bad_input(
        topic,
        given=f"distortion model '{model}'",
        allowed="plumb_bob, rational_polynomial or (Inverse) Brown Conrady",
        do="Record rectified images.",
    )


def _pixels(topic: str, message: Any, kind: np.dtype[Any], channels: int) -> NDArray[Any]:
    """Return (H, W) or (H, W, channels) from a raw image's padded rows."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * kind.itemsize
    data = np.asarray(message.data, np.uint8)
    if step < row or data.size < height * step:
        raise bad_input(
            topic, given=f"{data.size} bytes", allowed=f"{height} rows of {row} bytes or more", do="Record it anew."
        )
    rows = data[: height * step].reshape(height, step)[:, :row]
    order = kind.newbyteorder(">" if message.is_bigendian else "<")
    pixels = np.ascontiguousarray(rows).view(order).astype(kind, copy=False)
    return pixels if channels == 1 else pixels.reshape(height, width, channels)
