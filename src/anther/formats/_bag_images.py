"""Images and cameras as bags hold them: decoding, undistortion. H x W pixels."""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import bad_input
from anther.formats._realsense_bag import unpacked
from anther.formats.alignment import Maps, straightened, straightening
from anther.geometry import Intrinsics
from anther.images import is_intact

_COLORS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None), "bgr8": (3, cv2.COLOR_BGR2RGB), "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB), "mono8": (1, cv2.COLOR_GRAY2RGB), "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2), "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "YUYV": (2, cv2.COLOR_YUV2RGB_YUY2), "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY), "UYVY": (2, cv2.COLOR_YUV2RGB_UYVY),
}  # fmt: skip
_MILLIMETRES = {"16UC1", "mono16"}
_COMPRESSED_DEPTH = "16UC1; compressedDepth"
_PNG = b"\x89PNG"
_ZSTD_FORMAT = re.compile(r"(\w+); zstd; (\d+)x(\d+) step=(\d+)")


@dataclass(frozen=True, slots=True, eq=False)
class BagCamera:
    """A camera as its CameraInfo tells.

    Attributes:
        intrinsics: the pinhole camera without its distortion.
        frame: the optical frame's name.
        maps: of its lens (`straightening`), or None.
    """

    intrinsics: Intrinsics
    frame: str
    maps: Maps | None

    def straighten(self, image: NDArray[Any], *, nearest: bool) -> NDArray[Any]:
        """Return the image freed of lens distortion; `nearest` for depth, which must not be mixed across edges."""
        return straightened(image, self.maps, nearest=nearest)


def camera_of(topic: str, info: Any) -> BagCamera:
    """Return the camera of a sensor_msgs/CameraInfo (ROS 1 or 2).

    Raises:
        InputError: no usable camera matrix, or an unknown distortion model.
    """
    K = np.array(check_array(f"{topic} K", getattr(info, "K", None) if hasattr(info, "K") else info.k, (9,)))
    D = np.array(check_array(f"{topic} D", info.D if hasattr(info, "D") else info.d, (None,)))
    intrinsics = Intrinsics(int(info.width), int(info.height), K[0], K[4], K[2], K[5])
    maps = straightening(topic, intrinsics, D, str(info.distortion_model))
    return BagCamera(intrinsics, str(info.header.frame_id), maps)


def colour_image(topic: str, message: Any) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of a sensor_msgs/Image or CompressedImage.

    Raises:
        InputError: an unknown encoding or damaged data.
    """
    if hasattr(message, "format") and "; zstd; " in message.format:
        message = _raw(topic, message)
    if hasattr(message, "format"):
        data = np.asarray(message.data, np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if is_intact(bytes(data)) else None
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
        message: 16UC1, mono16 or a compressedDepth PNG in steps of `unit`, or 32FC1 in metres (REP 118).
        unit: of a 16-bit step [m].

    Raises:
        InputError: an unknown encoding.
    """
    encoding = getattr(message, "encoding", getattr(message, "format", "?"))
    if encoding.startswith(_COMPRESSED_DEPTH):
        return _depth_png(topic, message).astype(np.float32) * np.float32(unit)
    if encoding in _MILLIMETRES:
        return _pixels(topic, message, np.dtype(np.uint16), 1).astype(np.float32) * np.float32(unit)
    if encoding == "32FC1":
        depth = _pixels(topic, message, np.dtype(np.float32), 1)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
    raise bad_input(
        topic,
        given=f"encoding {encoding}",
        allowed=f"16UC1, mono16, 32FC1 or {_COMPRESSED_DEPTH} png",
        do="Name another depth topic.",
    )


def _depth_png(topic: str, message: Any) -> NDArray[np.uint16]:
    """Return (H, W) of a compressedDepth image: a PNG behind a header that 16-bit depth does not need."""
    data = bytes(message.data)
    at = data.find(_PNG, 0, 64)
    whole = at >= 0 and is_intact(data[at:])
    image = cv2.imdecode(np.frombuffer(data[at:], np.uint8), cv2.IMREAD_UNCHANGED) if whole else None
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise bad_input(topic, given=f"damaged {message.format}", allowed="a 16-bit PNG", do="Record it anew.")
    return np.asarray(image, dtype=np.uint16)


def _raw(topic: str, message: Any) -> SimpleNamespace:
    """Return the raw image in librealsense's own compression, format "YUYV; zstd; 640x480 step=1280"."""
    said = _ZSTD_FORMAT.fullmatch(message.format)
    if said is None:
        raise bad_input(topic, given=f"format {message.format}", allowed="YUYV; zstd; WxH step=N", do="Record it anew.")
    width, height, step = (int(said[k]) for k in (2, 3, 4))
    return SimpleNamespace(
        encoding=said[1],
        width=width,
        height=height,
        step=step,
        is_bigendian=0,
        data=np.frombuffer(unpacked(bytes(message.data)), np.uint8),
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
