"""What bags hold, decoded: images, cameras, and where the camera was, from a topic, tf or a trajectory file.

H x W pixels, T times.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import bad_input
from anther.files import read_lines, understood
from anther.formats._realsense_bag import unpacked
from anther.formats.alignment import Maps, straightening
from anther.geometry import Array, Intrinsics, inverse, transform_from_pose7
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


class BagCamera(NamedTuple):
    """The pinhole camera of a CameraInfo without its lens, the optical frame's name, and the lens's maps, if any."""

    intrinsics: Intrinsics
    frame: str
    maps: Maps | None


def camera_of(topic: str, info: Any) -> BagCamera:
    """Return the camera of a sensor_msgs/CameraInfo (ROS 1 or 2)."""
    K = np.array(check_array(f"{topic} K", info.K if hasattr(info, "K") else info.k, (9,)))
    D = np.array(check_array(f"{topic} D", info.D if hasattr(info, "D") else info.d, (None,)))
    intrinsics = Intrinsics(int(info.width), int(info.height), K[0], K[4], K[2], K[5])
    maps = straightening(topic, intrinsics, D, str(info.distortion_model))
    return BagCamera(intrinsics, str(info.header.frame_id), maps)


def colour_image(topic: str, message: Any) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of a sensor_msgs/Image or CompressedImage."""
    if hasattr(message, "format") and "; zstd; " in message.format:
        message = _raw(topic, message)
    if hasattr(message, "format"):
        data = np.asarray(message.data, np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if is_intact(bytes(data)) else None
        if image is None:
            raise bad_input(topic, given=f"damaged {message.format}", allowed="JPEG or PNG", do="Record it anew.")
        return np.asarray(image[..., ::-1], dtype=np.uint8)
    if message.encoding not in _COLORS:
        allowed, do = ", ".join(_COLORS), "Name another colour topic."
        raise bad_input(topic, given=f"encoding {message.encoding}", allowed=allowed, do=do)
    channels, conversion = _COLORS[message.encoding]
    pixels = _pixels(topic, message, np.dtype(np.uint8), channels)
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), dtype=np.uint8)


def depth_image(topic: str, message: Any, unit: float) -> NDArray[np.float32]:
    """Return (H, W) z-depth [m], 0 where there is none: 16UC1, mono16 or a compressedDepth PNG in steps of `unit` [m],
    or 32FC1 in metres (REP 118)."""
    encoding = getattr(message, "encoding", getattr(message, "format", "?"))
    if encoding.startswith(_COMPRESSED_DEPTH):
        return _depth_png(topic, message).astype(np.float32) * np.float32(unit)
    if encoding in _MILLIMETRES:
        return _pixels(topic, message, np.dtype(np.uint16), 1).astype(np.float32) * np.float32(unit)
    if encoding == "32FC1":
        depth = _pixels(topic, message, np.dtype(np.float32), 1)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
    allowed = f"16UC1, mono16, 32FC1 or {_COMPRESSED_DEPTH} png"
    raise bad_input(topic, given=f"encoding {encoding}", allowed=allowed, do="Name another depth topic.")


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
        allowed = f"{height} rows of {row} bytes or more"
        raise bad_input(topic, given=f"{data.size} bytes", allowed=allowed, do="Record it anew.")
    rows = data[: height * step].reshape(height, step)[:, :row]
    order = kind.newbyteorder(">" if message.is_bigendian else "<")
    pixels = np.ascontiguousarray(rows).view(order).astype(kind, copy=False)
    return pixels if channels == 1 else pixels.reshape(height, width, channels)


_ROWS = "time x y z qx qy qz qw"
Where = Callable[[float], tuple[Array, float]]
"""Time [s] -> (T_world_camera, how far off its stamp is [s])."""


class PoseSeries(NamedTuple):
    """Poses (T, 4, 4) in the order of their times (T,) [s]."""

    times: Array
    poses: Array

    def at(self, time: float) -> tuple[Array, float]:
        """Return (the pose nearest in time, how far off it is [s])."""
        k = nearest(self.times, time)
        return self.poses[k], abs(float(self.times[k]) - time)


@dataclass(slots=True)
class FrameTree:
    """The frames of tf: parents and transforms by time."""

    parent: dict[str, str] = field(default_factory=dict)
    static: dict[str, Array] = field(default_factory=dict)
    moving: dict[str, list[tuple[float, Array]]] = field(default_factory=dict)

    def add(self, transforms: Iterable[Any], *, static: bool) -> None:
        """Add the geometry_msgs/TransformStamped of one tf message."""
        for one in transforms:
            child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
            self.parent[child] = parent
            T = pose_matrix(one.transform.translation, one.transform.rotation)
            if static:
                self.static[child] = T
            else:
                self.moving.setdefault(child, []).append((stamp_of(one.header), T))

    def lookup(self, frame: str, world: str | None) -> Where:
        """Return what tells a frame's pose in `world`, an ancestor of it (None: the root of its tree), and how far off
        the worst link's stamp is. Every moving link is taken at its stamp nearest to the time asked for; fixed links
        are always on time."""
        chain = self._chain(frame.lstrip("/"), None if world is None else world.lstrip("/"))
        links = {name: sorted_series(self.moving[name]) for name in chain if name in self.moving}

        def where(time: float) -> tuple[Array, float]:
            T, worst = np.eye(4), 0.0
            for name in chain:
                step, off = links[name].at(time) if name in links else (self.static[name], 0.0)
                T, worst = step @ T, max(worst, off)
            return T, worst

        return where

    def between(self, a: str, b: str) -> Array | None:
        """Return T_a_b where both hang together by fixed transforms, else None."""
        ways = [self._fixed_way(name.lstrip("/")) for name in (a, b)]
        shared = [name for name in ways[0] if name in ways[1]]
        return inverse(ways[0][shared[0]]) @ ways[1][shared[0]] if shared else None

    def _fixed_way(self, frame: str) -> dict[str, Array]:
        """Return ancestor -> T_ancestor_frame along fixed transforms, the frame itself first."""
        way, T = {frame: np.eye(4)}, np.eye(4)
        while frame in self.static and self.parent[frame] not in way:
            T = self.static[frame] @ T
            frame = self.parent[frame]
            way[frame] = T
        return way

    def _chain(self, frame: str, world: str | None) -> list[str]:
        chain, at = [], frame
        while at != world and at in self.parent and at not in chain:
            chain.append(at)
            at = self.parent[at]
        if not chain or (world is not None and at != world):
            raise bad_input(
                "tf",
                given=f"no way from '{frame}' up to '{world or 'a parent'}'",
                allowed=f"frames {sorted({*self.parent, *self.parent.values()})}",
                do="Name the frames with --camera-frame and --world-frame, or give a pose topic or file.",
            )
        return chain


def nearest(times: Array, time: float) -> int:
    """Return the index of the entry of sorted (T,) times that is nearest to a time."""
    right = int(np.clip(np.searchsorted(times, time), 1, max(len(times) - 1, 1)))
    left = right - 1
    return left if right >= len(times) or time - times[left] <= times[right] - time else right


def pose_matrix(position: Any, orientation: Any) -> Array:
    """Return the (4, 4) matrix of a ROS position and quaternion (x, y, z, w)."""
    p, q = position, orientation
    return transform_from_pose7([p.x, p.y, p.z, q.x, q.y, q.z, q.w])


def stamp_of(header: Any) -> float:
    """Return a ROS header's stamp [s]."""
    return header.stamp.sec + header.stamp.nanosec * 1e-9


def read_trajectory(path: Path | str) -> PoseSeries:
    """Return the poses of a text file: rows of time [s], x, y, z [m], qx, qy, qz, qw, in the TUM RGB-D format.

    Format: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats; camera to world.

    Raises:
        InputError: missing, no rows of eight numbers, or a quaternion that is not of unit length.
    """
    with understood(path, _ROWS, "Is it a trajectory?"):
        rows = np.loadtxt(read_lines(path), ndmin=2)
    if not rows.size:
        raise bad_input(str(path), given="no rows", allowed=f"rows of {_ROWS}", do="Is it truncated?")
    rows = check_array(f"{path} (rows of {_ROWS})", rows, (None, 8))
    return sorted_series([(float(row[0]), transform_from_pose7(row[1:])) for row in rows])


def sorted_series(stamped: list[tuple[float, Array]]) -> PoseSeries:
    """Return (time [s], pose) pairs in the order of time."""
    ordered = sorted(stamped, key=lambda pair: pair[0])
    return PoseSeries(np.array([t for t, _ in ordered]), np.stack([T for _, T in ordered]))
