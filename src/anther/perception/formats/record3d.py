"""Recordings of Record3D on a phone (.r3d) -> a `Capture`. V views, H x W pixels.

The file is a zip with `metadata` (JSON: w, h of the cameras' matrix, dw, dh of depth, K column by column,
perFrameIntrinsicCoeffs fx fy cx cy, poses qx qy qz qw x y z) and, for each frame, `rgbd/N.jpg`, `N.depth` (float32
[m]) and `N.conf` (uint8: 0 low, 1 medium, 2 high), packed with LZFSE (the extra `anther[phones]`) or zlib. Poses are
ARKit's: camera to world, OpenGL axes, y up, metres. Read off public readers of it; no recording of a phone was tested.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_array
from anther.core.errors import AntherError, MissingExtra, bad_input
from anther.core.files import LARGEST, understood, whole_file
from anther.core.geometry import Array, Intrinsics, transform_from_pose7
from anther.core.opencv import cv2
from anther.perception.capture import Capture
from anther.perception.images import is_intact
from anther.perception.transforms import OPENGL_TO_OPENCV, PIXEL_CENTRE, brought_to_one, check_views, same_shape

INSTALL = "pip install 'anther[phones]'"
_ZLIB, _LZFSE = b"\x78", b"bvx"


def read_record3d(path: Path | str, views: int = 30) -> tuple[Capture, tuple[str, ...]]:
    """Return at most `views` views, evenly spread over the recording, and notes; the world has z up.

    Raises:
        MissingExtra: depth is packed with LZFSE and lzfse is not installed.
        InputError: no .r3d, damaged, or without poses or depth.
    """
    path = whole_file(path)
    allowed = "a recording of Record3D with depth and poses"
    with understood(path, allowed, "Export it again as .r3d."):
        try:
            with zipfile.ZipFile(path) as archive:
                return _views(str(path), archive, json.loads(archive.read("metadata")), views)
        except AntherError:
            raise
        except (zipfile.BadZipFile, zlib.error, OSError) as error:
            raise ValueError(str(error)) from error


def _views(path: str, archive: zipfile.ZipFile, meta: dict[str, Any], views: int) -> tuple[Capture, tuple[str, ...]]:
    names = set(archive.namelist())
    frames = [i for i in range(len(meta["poses"])) if f"rgbd/{i}.depth" in names]
    if not frames:
        given = f"depth of none of {len(meta['poses'])} frames"
        raise bad_input(path, given=given, allowed="rgbd/N.depth", do="Export it as .r3d, with depth.")
    notes = (
        [f"{len(meta['poses']) - len(frames)} frames without depth left out"]
        if len(frames) < len(meta["poses"])
        else []
    )
    if len(frames) > views:
        notes.append(f"{views} of {len(frames)} frames taken, evenly spread (--views)")
        frames = [frames[k] for k in np.round(np.linspace(0, len(frames) - 1, views)).astype(int)]
    size = int(meta["dw"]), int(meta["dh"])
    cameras = [_camera(meta, frame) for frame in frames]
    check_views(len(frames), cameras[0])
    if not same_shape(size, (cameras[0].width, cameras[0].height)):
        given = f"depth of {size[0]} x {size[1]} px, a camera of {cameras[0].width} x {cameras[0].height} px"
        raise bad_input(path, given=given, allowed="both of one shape", do="Export it again.")
    depth = np.stack([_depth(path, archive, frame, size) for frame in frames])
    sure = np.stack([_sure(path, archive, frame, size, names) for frame in frames])
    seen = depth > 0
    if not sure[seen].all():
        notes.append(f"{1 - sure[seen].mean():.0%} of the depth is of low confidence and left out")
    depth[~sure] = 0
    rgb = np.stack([_colour(path, archive, frame, size) for frame in frames])
    camera = brought_to_one(cameras, depth, rgb)
    poses = np.stack([_pose(path, meta, frame) for frame in frames])
    T_z_up_arkit = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return Capture(depth, camera, T_z_up_arkit @ poses @ OPENGL_TO_OPENCV, rgb), tuple(notes)


def _camera(meta: dict[str, Any], frame: int) -> Intrinsics:
    """Return a frame's own camera, else the one of all."""
    K = check_array("K", meta["K"], (9,))
    fx, fy, cx, cy = K[0], K[4], *((K[6], K[7]) if K[6] else (K[2], K[5]))
    own = meta.get("perFrameIntrinsicCoeffs") or []
    if frame < len(own):
        fx, fy, cx, cy = check_array("perFrameIntrinsicCoeffs", own[frame], (4,))
    size = int(meta["w"]), int(meta["h"])
    return Intrinsics(*size, float(fx), float(fy), float(cx) - PIXEL_CENTRE, float(cy) - PIXEL_CENTRE)


def _pose(path: str, meta: dict[str, Any], frame: int) -> Array:
    numbers = check_array(f"{path}: pose {frame}", meta["poses"][frame], (7,))
    return transform_from_pose7([*numbers[4:], *numbers[:4]])


def _depth(path: str, archive: zipfile.ZipFile, frame: int, size: tuple[int, int]) -> NDArray[np.float32]:
    depth = _unpacked(path, archive.read(f"rgbd/{frame}.depth"), np.dtype("<f4"), size)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0)).astype(np.float32)


def _sure(path: str, archive: zipfile.ZipFile, frame: int, size: tuple[int, int], names: set[str]) -> NDArray[np.bool_]:
    name = f"rgbd/{frame}.conf"
    if name not in names:
        return np.ones(size[::-1], dtype=bool)
    return _unpacked(path, archive.read(name), np.dtype(np.uint8), size) > 0  # ARKit: 0 is low


def _unpacked(path: str, data: bytes, kind: np.dtype[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return (H, W) numbers that are packed with LZFSE or zlib, or not at all."""
    count = size[0] * size[1] * kind.itemsize
    if not 0 < count <= LARGEST:
        raise bad_input(path, given=f"depth of {size[0]} x {size[1]} px", allowed="its size", do="Export it again.")
    if data.startswith(_LZFSE):
        data = _lzfse(path, data)
    elif len(data) != count and data.startswith(_ZLIB):
        data = zlib.decompressobj().decompress(data, count + 1)
    if len(data) != count:
        given = f"{len(data)} bytes for {size[0]} x {size[1]} px of {kind.itemsize}"
        raise bad_input(path, given=given, allowed="a whole image", do="Export it again.")
    return np.frombuffer(data, kind).reshape(size[::-1])


def _lzfse(path: str, data: bytes) -> bytes:
    try:
        import lzfse  # noqa: PLC0415
    except ImportError as error:
        raise MissingExtra(
            f"{path}: its depth is packed with LZFSE. Install what unpacks it with: {INSTALL}"
        ) from error
    try:
        return lzfse.decompress(data)
    except lzfse.error as error:
        raise ValueError(str(error)) from error


def _colour(path: str, archive: zipfile.ZipFile, frame: int, size: tuple[int, int]) -> NDArray[np.uint8]:
    data = archive.read(f"rgbd/{frame}.jpg")
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if is_intact(data) else None
    if image is None or not same_shape(size, (image.shape[1], image.shape[0])):
        given = f"rgbd/{frame}.jpg that is " + (
            "damaged" if image is None else f"{image.shape[1]} x {image.shape[0]} px"
        )
        raise bad_input(path, given=given, allowed=f"an image of the shape of depth, {size}", do="Export it again.")
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)[..., ::-1], np.uint8)
