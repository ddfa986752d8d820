"""Images and cameras as bags hold them: decoding, undistortion. H x W pixels.

What librealsense's own recordings say in words of their own: streams, cameras, extrinsics, units, times.

Up to SDK 2.57 they are ROS 1 bags with a float32, the depth unit, behind every Image. From 2.58 on they are one rosbag2
SQLite file (.db3): cameras, extrinsics and options are texts `key=value;key=value`, and a header's stamp is the time
since the recording began. Read off files that SDKs 2.54.1 to 2.59.1 wrote (docs/reports/cameras.md).
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import bad_input
from anther.formats.alignment import Maps, straightened, straightening
from anther.geometry import Array, Intrinsics, transform
from anther.images import is_intact

_STREAM_END = "/image/data"
_ZSTD = b"\x28\xb5\x2f\xfd"  # RFC 8878
_LARGEST = 1 << 28


def stream_of(image: str) -> str:
    """Return the stream's folder of an image topic, "/device_0/sensor_0/Depth_0"; "" if no such recorder wrote it."""
    stream, found, codec = image.partition(_STREAM_END)
    return stream if image.startswith("/device_") and found and codec in ("", "/compressed", "/compressedDepth") else ""


def units_of(image: str) -> str:
    """Return the topic with the depth unit of an image's sensor; "" if no such recorder wrote it."""
    stream = stream_of(image)
    return stream and stream.rpartition("/")[0] + "/option/Depth_Units/value"


def shared_extrinsics(topics: set[str], color: str, depth: str) -> tuple[str, str]:
    """Return the transforms of two image topics from one reference stream to theirs; two "" where they share none.

    Streams that are joined carry the same last name: /tf/0, /tf/1 (.bag), /tf/ref_1 (.db3).
    """
    streams = stream_of(color) + "/tf/", stream_of(depth) + "/tf/"
    ends = [{t.removeprefix(stream) for t in topics if t.startswith(stream)} for stream in streams]
    shared = sorted(ends[0] & ends[1])
    return (streams[0] + shared[0], streams[1] + shared[0]) if shared else ("", "")


def without_unit(topic: str, message: bytes) -> bytes:
    """Return a ROS 1 message; a recorder's sensor_msgs/Image without the float32 behind its pixels."""
    if not topic.endswith(_STREAM_END) or not stream_of(topic):
        return message
    try:
        at = 12  # seq, stamp
        at += 4 + _length(message, at) + 8  # frame_id; height, width
        at += 4 + _length(message, at) + 5  # encoding; is_bigendian, step
        end = at + 4 + _length(message, at)
    except struct.error:
        return message
    return message[:end] if len(message) == end + 4 else message


def unpacked(data: bytes) -> bytes:
    """Return what was packed with Zstandard, as SDK 2.58 packs every message; anything else as it is."""
    if not data.startswith(_ZSTD):
        return data
    try:
        from compression import zstd  # type: ignore[import-not-found]  # noqa: PLC0415  # Python 3.14
    except ImportError:
        from backports import zstd  # noqa: PLC0415  # rosbags brings it
    return zstd.ZstdDecompressor().decompress(data, max_length=_LARGEST)


def camera_info(topic: str, text: str) -> SimpleNamespace:
    """Return what a camera's text says with the names of sensor_msgs/CameraInfo."""
    said = _said(text)
    K = np.zeros(9)
    K[[0, 2, 4, 5, 8]] = [*(_numbers(topic, said, name, 1)[0] for name in ("fx", "ppx", "fy", "ppy")), 1.0]
    size = [int(_numbers(topic, said, name, 1)[0]) for name in ("width", "height")]
    return SimpleNamespace(
        width=size[0],
        height=size[1],
        k=K,
        d=_numbers(topic, said, "coeffs", 5),
        distortion_model=said.get("model", ""),
        header=SimpleNamespace(frame_id=""),
    )


def extrinsics(topic: str, text: str) -> Array:
    """Return T_stream_reference (4, 4): its rotation is written column by column, as rs2_extrinsics holds it."""
    said = _said(text)
    return transform(_numbers(topic, said, "rotation", 9).reshape(3, 3).T, _numbers(topic, said, "translation", 3))


def frame_time(topic: str, text: str) -> float:
    """Return when a frame was taken [s], on the clock of its timestamp_domain."""
    return 1e-3 * float(_numbers(topic, _said(text), "timestamp", 1)[0])


def number(topic: str, text: str) -> float:
    """Return an option's value."""
    return float(_numbers(topic, {"value": text}, "value", 1)[0])


def _length(message: bytes, at: int) -> int:
    return struct.unpack_from("<I", message, at)[0]


def _said(text: str) -> dict[str, str]:
    return dict(part.split("=", 1) for part in text.strip().strip(";").split(";") if "=" in part)


def _numbers(topic: str, said: dict[str, str], name: str, count: int) -> Array:
    try:
        values = np.array([float(word) for word in said[name].split(",")])
    except (KeyError, ValueError):
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        given, allowed = f"{name}={said.get(name, '')}", f"{count} finite number{'s' if count > 1 else ''}"
        raise bad_input(topic, given=given, allowed=allowed, do="Record it anew.")
    return values


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
