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

import numpy as np
from numpy.typing import NDArray

from anther.core.cameras import Maps, straightening
from anther.core.checks import check_array
from anther.core.compiling import numba
from anther.core.errors import bad_input
from anther.core.files import read_lines, understood
from anther.core.geometry import Array, Intrinsics, inverse, transform_from_pose7
from anther.core.opencv import cv2
from anther.perception.formats._realsense_bag import unpacked
from anther.perception.images import is_intact

_MILLIMETRES = {"16UC1", "mono16"}
_PNG = b"\x89PNG"
_ZSTD_FORMAT = re.compile(r"(\w+); zstd; (\d+)x(\d+) step=(\d+)")


class BagCamera(NamedTuple):
    """The pinhole camera of a CameraInfo without its lens, the optical frame's name, and the lens's maps, if any."""

    intrinsics: Intrinsics
    frame: str
    maps: Maps | None


def camera_of(topic: str, info: Any, *, rectified: bool = False) -> BagCamera:
    """Return the camera of a sensor_msgs/CameraInfo (ROS 1 or 2).

    Of images that are already `rectified` the projection P describes the camera, and lens distortion is removed.
    """
    K = np.array(check_array(f"{topic} K", info.K if hasattr(info, "K") else info.k, (9,)))
    D = np.array(check_array(f"{topic} D", info.D if hasattr(info, "D") else info.d, (None,)))
    P = np.asarray(getattr(info, "P", getattr(info, "p", np.zeros(12))), dtype=np.float64)
    if rectified and P.shape == (12,) and P[0] > 0:
        K, D = P.reshape(3, 4)[:, :3].ravel(), np.zeros(0)
    if K[1]:
        raise bad_input(f"{topic} K", given=f"skew {K[1]:g} px", allowed="0", do="Record rectified images.")
    intrinsics = _cropped(Intrinsics(int(info.width), int(info.height), K[0], K[4], K[2], K[5]), info)
    maps = straightening(topic, intrinsics, D, str(info.distortion_model))
    return BagCamera(intrinsics, str(info.header.frame_id), maps)


def _cropped(camera: Intrinsics, info: Any) -> Intrinsics:
    """Return the camera of the images, where a CameraInfo is of the whole sensor and states binning and a region."""
    x, y = (max(1, int(getattr(info, f"binning_{axis}", 0))) for axis in "xy")
    roi = getattr(info, "roi", None)
    region = (0, 0, 0, 0) if roi is None else (roi.x_offset, roi.y_offset, roi.width, roi.height)
    left, top, width, height = (int(n) for n in region)
    size = (width or camera.width) // x, (height or camera.height) // y
    cx, cy = (camera.cx - left + 0.5) / x - 0.5, (camera.cy - top + 0.5) / y - 0.5
    return Intrinsics(*size, camera.fx / x, camera.fy / y, cx, cy)


def check_size(topic: str, image: NDArray[Any], camera: Intrinsics) -> None:
    """Refuse an image (H, W, ...) of another size than its camera's."""
    if image.shape[:2] != (camera.height, camera.width):
        given = (
            f"images of {image.shape[1]} x {image.shape[0]} px, a camera info of {camera.width} x {camera.height} px"
        )
        do = "Record the camera info of this stream, or set its binning and region."
        raise bad_input(topic, given=given, allowed="both of one size", do=do)


def colour_image(topic: str, message: Any) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of a sensor_msgs/Image or CompressedImage."""
    if hasattr(message, "format") and "; zstd; " in message.format:
        message = _raw(topic, message)
    if hasattr(message, "format"):
        data = np.asarray(message.data, np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR) if is_intact(bytes(data)) else None
        if image is None:
            raise bad_input(topic, given=f"damaged {message.format}", allowed="JPEG or PNG", do="Record it again.")
        return np.asarray(image[..., ::-1], dtype=np.uint8)
    encodings: dict[str, tuple[int, int | None]] = {  # channels, and how OpenCV makes RGB of them
        "rgb8": (3, None), "bgr8": (3, cv2.COLOR_BGR2RGB), "rgba8": (4, cv2.COLOR_RGBA2RGB),
        "bgra8": (4, cv2.COLOR_BGRA2RGB), "mono8": (1, cv2.COLOR_GRAY2RGB), "8UC1": (1, cv2.COLOR_GRAY2RGB),
        "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2), "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
        "YUYV": (2, cv2.COLOR_YUV2RGB_YUY2), "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY), "UYVY": (2, cv2.COLOR_YUV2RGB_UYVY),
    }  # fmt: skip
    if message.encoding not in encodings:
        allowed, do = ", ".join(encodings), "Name another colour topic."
        raise bad_input(topic, given=f"encoding {message.encoding}", allowed=allowed, do=do)
    channels, conversion = encodings[message.encoding]
    pixels = _pixels(topic, message, np.dtype(np.uint8), channels)
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), dtype=np.uint8)


def depth_image(topic: str, message: Any, unit: float) -> NDArray[np.float32]:
    """Return (H, W) z-depth [m], 0 where there is none.

    It is of 16 bits in steps of `unit` [m], or 32FC1 in metres (REP 118); raw, as a PNG, or as
    compressed_depth_image_transport packs it (PNG or RVL).
    """
    raw = message if hasattr(message, "encoding") else None
    encoding = str(message.format).partition(";")[0].strip() if raw is None else str(raw.encoding)
    if encoding in _MILLIMETRES or (encoding == "png" and raw is None):
        steps = _depth_steps(topic, message) if raw is None else _pixels(topic, raw, np.dtype(np.uint16), 1)
        return steps.astype(np.float32) * np.float32(unit)
    if encoding == "32FC1":
        depth = _depth_of_inverse(topic, message) if raw is None else _pixels(topic, raw, np.dtype(np.float32), 1)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0)).astype(np.float32)
    allowed = "16UC1, mono16 or 32FC1, raw, png or compressedDepth"
    given = f"encoding {getattr(message, 'format', encoding)}"
    raise bad_input(topic, given=given, allowed=allowed, do="Name another depth topic.")


def _depth_of_inverse(topic: str, message: Any) -> NDArray[np.float32]:
    """Return (H, W) depth [m] that was packed as steps v of its inverse: depth = a / (v - b); v = 0 is no reading."""
    steps, data = _depth_steps(topic, message), bytes(message.data)
    a, b = np.frombuffer(data[4:12], "<f4")  # compressed_depth_image_transport's header: an int32 and these
    if data.startswith(_PNG) or not np.isfinite([a, b]).all() or a <= 0:
        given, do = f"{message.format} without the numbers that it is packed by", "Record compressedDepth."
        raise bad_input(topic, given=given, allowed="compressedDepth of 32FC1", do=do)
    with np.errstate(divide="ignore"):
        return np.where(steps > 0, np.float32(a) / (steps.astype(np.float32) - np.float32(b)), np.float32(0))


def _depth_steps(topic: str, message: Any) -> NDArray[np.uint16]:
    """Return (H, W) of a packed depth image: a PNG of 16 bits, perhaps behind a header, or RVL."""
    data = bytes(message.data)
    if "rvl" in message.format.lower():
        return _unpacked_rvl(topic, data[12:])  # behind that header
    at = data.find(_PNG, 0, 64)
    whole = at >= 0 and is_intact(data[at:])
    image = cv2.imdecode(np.frombuffer(data[at:], np.uint8), cv2.IMREAD_UNCHANGED) if whole else None
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise bad_input(topic, given=f"damaged {message.format}", allowed="a 16-bit PNG", do="Record it again.")
    return np.asarray(image, dtype=np.uint16)


def _unpacked_rvl(topic: str, data: bytes) -> NDArray[np.uint16]:
    """Return (H, W) of width, height (uint32) and RVL (A. Wilson 2017): runs of zeros, and steps between others."""
    width, height = (int(n) for n in np.frombuffer(data[:8].ljust(8, b"\0"), "<u4"))
    words = np.frombuffer(data[8 : 8 + (len(data) - 8) // 4 * 4], "<u4")
    flat = _rvl(words, width * height) if 0 < width * height <= 32 * len(data) else np.zeros(0, np.uint16)
    if not len(flat):
        raise bad_input(topic, given="damaged RVL", allowed="a whole depth image", do="Record it again.")
    return flat.reshape(height, width)


@numba.njit(cache=True)
def _rvl(words: Any, count: int) -> Any:
    """Return (count,) depths; empty if the (n,) words of eight nibbles end before."""
    out = np.zeros(count, np.uint16)
    at, nibble, last, zeros, run = 0, 0, 0, True, 0
    while at < count or run:
        value, shift = 0, 0
        while True:
            if nibble >= 8 * len(words):
                return out[:0]
            four = (int(words[nibble // 8]) >> (28 - 4 * (nibble % 8))) & 15
            nibble += 1
            value |= (four & 7) << shift
            shift += 3
            if four < 8:
                break
        if run:
            last += -((value + 1) >> 1) if value & 1 else value >> 1
            out[at] = last & 0xFFFF
            at, run = at + 1, run - 1
        elif zeros:
            at, zeros = at + value, False
        else:
            run, zeros = value, True
        if at + run > count:
            return out[:0]
    return out


def _raw(topic: str, message: Any) -> SimpleNamespace:
    """Return the raw image in librealsense's own compression, format "YUYV; zstd; 640x480 step=1280"."""
    layout = _ZSTD_FORMAT.fullmatch(message.format)
    if layout is None:
        raise bad_input(
            topic, given=f"format {message.format}", allowed="YUYV; zstd; WxH step=N", do="Record it again."
        )
    width, height, step = (int(layout[k]) for k in (2, 3, 4))
    return SimpleNamespace(
        encoding=layout[1],
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
        raise bad_input(topic, given=f"{data.size} bytes", allowed=allowed, do="Record it again.")
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
    """The frames of tf: parents and transforms by time; `ambiguous` are those with several parents."""

    parent: dict[str, str] = field(default_factory=dict)
    static: dict[str, Array] = field(default_factory=dict)
    moving: dict[str, list[tuple[float, Array]]] = field(default_factory=dict)
    ambiguous: dict[str, set[str]] = field(default_factory=dict)

    def add(self, transforms: Iterable[Any], *, static: bool) -> None:
        """Add the geometry_msgs/TransformStamped of one tf message."""
        for one in transforms:
            child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
            if self.parent.setdefault(child, parent) != parent:
                self.ambiguous.setdefault(child, {self.parent[child]}).add(parent)
            T = pose_matrix(one.transform.translation, one.transform.rotation)
            if static:
                self.static[child] = T
            else:
                self.moving.setdefault(child, []).append((stamp_of(one.header), T))

    def moves(self, frame: str) -> bool:
        """Return whether a link above a frame moves."""
        frame = frame.lstrip("/")
        return frame in self.parent and any(name in self.moving for name in self._chain(frame, None))

    def lookup(self, frame: str, world: str | None) -> Where:
        """Return what gives a frame's pose in `world`, an ancestor of it (None: the root of its tree), and how far off
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
        """Return T_a_b where fixed transforms join them, else None."""
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
            if at in self.ambiguous:
                given, do = (
                    f"'{at}' has the parents {' and '.join(sorted(self.ambiguous[at]))}",
                    "Record one of them, or give poses.",
                )
                raise bad_input("tf", given=given, allowed="one parent for a frame", do=do)
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
