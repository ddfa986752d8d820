"""librealsense's own messages in its recordings: streams, cameras, extrinsics, units, times.

Up to SDK 2.57 they are ROS 1 bags with a float32, the depth unit, behind every Image. From 2.58 on they are one rosbag2
SQLite file (.db3): cameras, extrinsics and options are texts `key=value;key=value`, and a header's stamp is the time
since the recording began. Read off files that SDKs 2.54.1 to 2.59.1 wrote (docs/reports/machines.md).
"""

from __future__ import annotations

import struct
from types import SimpleNamespace

import numpy as np

from anther.core.errors import bad_input
from anther.core.geometry import Array, transform

_STREAM_END = "/image/data"
_ZSTD = b"\x28\xb5\x2f\xfd"  # RFC 8878


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
    return zstd.ZstdDecompressor().decompress(data, max_length=1 << 28)


def camera_info(topic: str, text: str) -> SimpleNamespace:
    """Return a camera's text with the names of sensor_msgs/CameraInfo."""
    fields = _fields(text)
    K = np.zeros(9)
    K[[0, 2, 4, 5, 8]] = [*(_numbers(topic, fields, name, 1)[0] for name in ("fx", "ppx", "fy", "ppy")), 1.0]
    size = [int(_numbers(topic, fields, name, 1)[0]) for name in ("width", "height")]
    return SimpleNamespace(
        width=size[0],
        height=size[1],
        k=K,
        d=_numbers(topic, fields, "coeffs", 5),
        distortion_model=fields.get("model", ""),
        header=SimpleNamespace(frame_id=""),
    )


def extrinsics(topic: str, text: str) -> Array:
    """Return T_stream_reference (4, 4): its rotation is written column by column, as rs2_extrinsics holds it."""
    fields = _fields(text)
    return transform(_numbers(topic, fields, "rotation", 9).reshape(3, 3).T, _numbers(topic, fields, "translation", 3))


def frame_time(topic: str, text: str) -> float:
    """Return when a frame was taken [s], on the clock of its timestamp_domain."""
    return 1e-3 * float(_numbers(topic, _fields(text), "timestamp", 1)[0])


def number(topic: str, text: str) -> float:
    """Return an option's value."""
    return float(_numbers(topic, {"value": text}, "value", 1)[0])


def _length(message: bytes, at: int) -> int:
    return struct.unpack_from("<I", message, at)[0]


def _fields(text: str) -> dict[str, str]:
    return dict(part.split("=", 1) for part in text.strip().strip(";").split(";") if "=" in part)


def _numbers(topic: str, fields: dict[str, str], name: str, count: int) -> Array:
    try:
        values = np.array([float(word) for word in fields[name].split(",")])
    except (KeyError, ValueError):
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        given, allowed = f"{name}={fields.get(name, '')}", f"{count} finite number{'s' if count > 1 else ''}"
        raise bad_input(topic, given=given, allowed=allowed, do="Record it again.")
    return values
