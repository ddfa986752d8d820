"""nerfstudio's transforms.json and the images it names, as one pinhole camera's views. V views, H x W pixels.

Each frame may have intrinsics of its own, as phones write them, and depth may be coarser than colour.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_array, check_range, check_transform
from anther.core.errors import InputError, bad_input
from anther.core.files import existing, named_file, read_json
from anther.core.geometry import Array, Intrinsics
from anther.core.opencv import cv2
from anther.perception.images import read_image

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""nerfstudio's camera frame (x right, y up, z backward) expressed in OpenCV's (x right, y down, z forward)."""
PIXEL_CENTRE = 0.5
"""nerfstudio puts pixel centres at half-integers (its `pixel_offset`); `Intrinsics` and OpenCV at integers [px]."""
LENS_MODELS = {
    "pinhole", "simple pinhole", "opencv", "full opencv", "simple radial", "radial", "plumb bob", "none", "perspective",
    "rational polynomial", "brown conrady", "modified brown conrady", "inverse brown conrady", "radtan", "brown",
}  # fmt: skip
"""How programs call OpenCV's polynomials, or no distortion."""
LENS_KEYS = re.compile(
    r"(?!.*model)([bkps]\d+|tau.*|skew|alpha(_c)?|xi|omega|.*fisheye.*|dist.*coeff.*|.*distort.*)", re.IGNORECASE
)
"""Names of what bends an image or slants its axes."""

_KEYS = ("fl_x", "fl_y", "cx", "cy", "w", "h")
_MODELS = ("camera_model", "distortion_model", "lens_model")
_UNIT = "depth_unit_scale_factor"
_UNITS = (_UNIT, "integer_depth_scale")
"""Metres per step of depth, as nerfstudio and instant-ngp call it."""
_OTHER_UNITS = re.compile(r"depth_?(scale|unit|factor).*|.*depth_(scale|unit|factor)", re.IGNORECASE)
_OTHER_AXES = re.compile(r".*(convention|coordinate_?(system|frame)).*", re.IGNORECASE)
_AXES = {"opengl", "nerfstudio", "blender", "nerf"}
"""How programs call the axes of the camera in transforms.json."""


class Transforms(NamedTuple):
    """What a folder holds: see `capture.Capture`."""

    depth: NDArray[np.float32]
    intrinsics: Intrinsics
    T_world_cam: Array
    rgb: NDArray[np.uint8] | None
    joints: NDArray[Any] | None


def read_transforms(path: Path | str) -> Transforms:
    """Read a transforms.json, or the one in a folder, and its images.

    Views whose intrinsics differ are brought to the median's where that moves a pixel at all; where depth is coarser
    than colour, colour is brought to its size.

    Raises:
        InputError: a file is missing, truncated or of the wrong size; poses or intrinsics are not usable; lens
            distortion.
    """
    path = existing(path)
    meta = read_json(path / "transforms.json" if path.is_dir() else path)
    folder = path if path.is_dir() else path.parent
    frames = _frames(meta)
    cameras = [_camera(i, meta, frame) for i, frame in enumerate(frames)]
    common = _common(cameras)
    poses = np.stack([_pose(i, frame) for i, frame in enumerate(frames)])
    joints = [frame.get("joints") for frame in frames]
    size = _depth_size(folder, frames, common)
    depth = _depth(folder, meta, frames, size)
    rgb = _colour(folder, frames, (common.width, common.height), size)
    common = brought_to_one(cameras, depth, rgb)
    held = None if any(j is None for j in joints) else check_array("joints of the frames", joints, (len(joints), None))
    return Transforms(depth, common, poses @ OPENGL_TO_OPENCV, rgb, held)


def _refused(given: str, allowed: str, do: str) -> InputError:
    return bad_input("transforms.json", given=given, allowed=allowed, do=do)


def _frames(meta: Any) -> list[dict[str, Any]]:
    frames = meta.get("frames") if isinstance(meta, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(f, dict) for f in frames):
        raise _refused(
            given="no list of frames", allowed="an object with a non-empty list 'frames'", do="See docs/capture.md."
        )
    for key in ("transform_matrix", "depth_file_path"):
        lacking = [i for i, frame in enumerate(frames) if key not in frame]
        if lacking:
            raise _refused(
                given=f"frame {lacking[0]} without '{key}' ({len(lacking)} of {len(frames)} lack it)",
                allowed=f"every frame has '{key}'",
                do="Anther needs a depth image and a pose for every view.",
            )
    _check_meaning(meta, frames)
    for key in ("applied_scale", "scale"):
        if _number(key, meta.get(key, 1.0)) != 1.0:
            given, do = (
                f"{key} {meta[key]}: poses that are not in metres",
                "Divide their positions by it, and leave it out.",
            )
            raise _refused(given=given, allowed="poses in metres", do=do)
    return frames


def _check_meaning(meta: dict[str, Any], frames: list[dict[str, Any]]) -> None:
    """Refuse what would change depth or poses in a way that is not read."""
    stated = meta | {key: value for frame in frames for key, value in frame.items()}
    for key, value in stated.items():
        if key not in _UNITS and _OTHER_UNITS.fullmatch(key) and value not in (None, 1):
            do = f"Write metres per step as {_UNIT}: 0.001 for millimetres."
            raise _refused(given=f"{key} {value!r}", allowed=_UNIT, do=do)
        if _OTHER_AXES.fullmatch(key) and str(value).lower() not in _AXES:
            do = "Turn the poses (y and z of the camera the other way), and leave it out."
            raise _refused(given=f"{key} {value!r}", allowed="OpenGL's camera axes: x right, y up, z backward", do=do)
    applied = check_array("applied_transform", meta.get("applied_transform", np.eye(4)), (None, 4))
    if not np.allclose(np.linalg.norm(applied[:3, :3], axis=0), 1, atol=1e-3):
        do = "Take its scale out of the poses, and leave it out."
        raise _refused(given="an applied_transform with a scale", allowed="poses in metres", do=do)


def _camera(view: int, meta: dict[str, Any], frame: dict[str, Any]) -> Intrinsics:
    """Return the camera of a frame: what it states itself, else what all share."""
    stated = meta | {key: frame[key] for key in frame if key in (*_KEYS, *_MODELS) or LENS_KEYS.fullmatch(key)}
    bent = [k for k, value in stated.items() if LENS_KEYS.fullmatch(k) and is_bent(k, value)]
    models = {key: str(stated[key]) for key in _MODELS if stated.get(key)}
    bent += [f"{k} {m[:40]}" for k, m in models.items() if m.lower().replace("_", " ") not in LENS_MODELS]
    if bent:
        raise _refused(
            given=f"lens distortion ({', '.join(bent)})",
            allowed="a pinhole camera without distortion",
            do="Undistort the images first (ns-process-data or cv2.undistort), then set the coefficients to 0.",
        )
    values = {key: _number(key, stated.get(key)) for key in _KEYS}
    return Intrinsics(
        width=round(values["w"]),
        height=round(values["h"]),
        fx=values["fl_x"],
        fy=values["fl_y"],
        cx=values["cx"] - PIXEL_CENTRE,
        cy=values["cy"] - PIXEL_CENTRE,
    )


def is_bent(key: str, value: Any) -> bool:
    """Return whether an entry of a lens, a number, a truth value or a list of them, is not 0."""
    if isinstance(value, list):
        return any(is_bent(key, part) for part in value)
    return value if isinstance(value, bool) else value is not None and _number(key, value) != 0


def _common(cameras: list[Intrinsics]) -> Intrinsics:
    """Return the camera that all views are brought to, of median focal lengths and centre.

    Raises:
        InputError: they are not one camera's.
    """
    if all(camera == cameras[0] for camera in cameras):
        return cameras[0]
    numbers = np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras])
    middle = np.median(numbers, axis=0)
    focal = np.abs(numbers[:, :2] / middle[:2] - 1).max(axis=1)
    sizes = [(c.width, c.height) != (cameras[0].width, cameras[0].height) for c in cameras]
    odd = int(np.argmax(sizes)) if any(sizes) else int(np.argmax(focal))
    alike = 0.1  # a camera that focuses changes its focal length by no more; a guess
    if any(sizes) or focal.max() > alike:
        raise _refused(
            given=f"frame {odd} with other intrinsics than the others (fl_x {cameras[odd].fx:g}, most {middle[0]:g})",
            allowed=f"one camera for all views, its focal length the same to {alike:.0%}",
            do="Save each camera's views as a capture of its own, or resample them to one camera.",
        )
    fx, fy, cx, cy = middle.tolist()
    return replace(cameras[0], fx=fx, fy=fy, cx=cx, cy=cy)


def brought_to_one(cameras: list[Intrinsics], depth: NDArray[np.float32], rgb: NDArray[np.uint8] | None) -> Intrinsics:
    """Resample views to one camera, in place, where that moves a pixel at all; return it.

    Args:
        cameras: of the V views, perhaps at another size than the images.
        depth: (V, H, W) [m].
        rgb: (V, H, W, 3), or None.

    Raises:
        InputError: they are not one camera's.
    """
    size = depth.shape[2], depth.shape[1]
    common = scaled(_common(cameras), size)
    for view, camera in enumerate(cameras):
        maps = _maps(common, scaled(camera, size))
        if maps is not None:
            depth[view] = cv2.remap(depth[view], *maps, cv2.INTER_NEAREST)
            if rgb is not None:
                rgb[view] = cv2.remap(rgb[view], *maps, cv2.INTER_LINEAR)
    return common


def _maps(common: Intrinsics, own: Intrinsics) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Return where each pixel of the common camera lies in a view of its own; None where all lie in the same pixel."""
    u, v = np.arange(common.width), np.arange(common.height)
    across = (u - common.cx) * (own.fx / common.fx) + own.cx
    down = (v - common.cy) * (own.fy / common.fy) + own.cy
    if max(np.abs(across - u).max(), np.abs(down - v).max()) < 0.5:
        return None
    maps = np.meshgrid(across.astype(np.float32), down.astype(np.float32))
    return maps[0], maps[1]


def scaled(camera: Intrinsics, size: tuple[int, int]) -> Intrinsics:
    """Return the camera of the same images at another size (width, height)."""
    x, y = size[0] / camera.width, size[1] / camera.height
    cx, cy = (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5
    return Intrinsics(*size, camera.fx * x, camera.fy * y, cx, cy) if (x, y) != (1, 1) else camera


def same_shape(small: tuple[int, int], large: tuple[int, int]) -> bool:
    """Return whether two sizes have the same ratio of sides, to a pixel of the smaller."""
    return abs(large[1] * small[0] / large[0] - small[1]) <= 1


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise bad_input(
            f"transforms.json '{key}'", given=repr(value), allowed="a finite number", do="See docs/capture.md."
        )
    return float(value)


def _pose(view: int, frame: dict[str, Any]) -> Array:
    """Return the (4, 4) camera-to-world matrix."""
    return without_rounding(f"frame {view} transform_matrix", frame["transform_matrix"])


def without_rounding(name: str, matrix: Any) -> Array:
    """Return a (4, 4) rigid transform, its rotation freed of the rounding of files (up to 1e-3).

    Raises:
        InputError: no rigid transform.
    """
    T = np.array(check_array(name, matrix, (4, 4)))
    U, _, Vt = np.linalg.svd(T[:3, :3])
    nearest = U @ Vt
    if np.abs(nearest - T[:3, :3]).max() < 1e-3:
        T[:3, :3] = nearest
    check_transform(name, T)
    return T


def _depth_size(folder: Path, frames: list[dict[str, Any]], camera: Intrinsics) -> tuple[int, int]:
    """Return (width, height) of the depth images [px]: the camera's, or smaller of the same shape."""
    stated = check_views(len(frames), camera)
    first = read_image(named_file(folder, str(frames[0]["depth_file_path"])), cv2.IMREAD_UNCHANGED)
    size = first.shape[1], first.shape[0]
    return size if size < stated and same_shape(size, stated) else stated


def _depth(
    folder: Path, meta: dict[str, Any], frames: list[dict[str, Any]], size: tuple[int, int]
) -> NDArray[np.float32]:
    depth = np.empty((len(frames), *size[::-1]), dtype=np.float32)
    units = [_unit(meta | frame) for frame in frames]

    def read(view: int) -> None:
        path = named_file(folder, str(frames[view]["depth_file_path"]))
        image = read_image(path, cv2.IMREAD_UNCHANGED, size)
        if image.dtype != np.uint16 or image.ndim != 2:
            raise bad_input(
                str(path),
                given=f"{image.dtype} image of shape {image.shape}",
                allowed="one channel of 16 bits",
                do="Save depth as 16-bit PNG; 8 bits are too coarse.",
            )
        np.multiply(image, np.float32(units[view]), out=depth[view])
        if frames[view].get("mask_path"):  # nerfstudio's: black is not looked at
            mask = read_image(named_file(folder, str(frames[view]["mask_path"])), cv2.IMREAD_GRAYSCALE)
            depth[view][cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST) == 0] = 0

    in_threads(read, range(len(frames)))
    return depth


def _unit(stated: dict[str, Any]) -> float:
    """Return metres per step of a frame's depth image."""
    given = {_number(key, stated[key]) for key in _UNITS if key in stated}
    if len(given) > 1:
        raise _refused(
            given=f"{' and '.join(_UNITS)} that differ", allowed="one of them", do="Leave the wrong one out."
        )
    return check_range(_UNIT, given.pop() if given else 1e-3, 1e-6, 1, "m")


def _colour(
    folder: Path, frames: list[dict[str, Any]], stated: tuple[int, int], size: tuple[int, int]
) -> NDArray[np.uint8] | None:
    """Return (V, H, W, 3) RGB of the size of the depth, to which finer images are brought."""
    named = [i for i, frame in enumerate(frames) if frame.get("file_path")]
    if not named:
        return None
    if len(named) < len(frames):
        raise _refused(
            given=f"'file_path' in {len(named)} of {len(frames)} frames",
            allowed="a colour image for every frame or for none",
            do="Add the missing images, or remove file_path everywhere for a depth-only capture.",
        )
    rgb = np.empty((len(frames), *size[::-1], 3), dtype=np.uint8)

    def read(view: int) -> None:
        path = named_file(folder, str(frames[view]["file_path"]))
        image = read_image(path, cv2.IMREAD_COLOR_RGB)
        own = image.shape[1], image.shape[0]
        if own != size and (own < size or not same_shape(size, own)):
            read_image(path, cv2.IMREAD_COLOR, stated)  # which refuses it
        rgb[view] = image if own == size else cv2.resize(image, size, interpolation=cv2.INTER_AREA)

    in_threads(read, range(len(frames)))
    return rgb


def check_views(views: int, camera: Intrinsics) -> tuple[int, int]:
    """Return (width, height) [px] if that many views of that size fit into memory.

    Raises:
        InputError: they are too many or too large.
    """
    pixels, most = views * camera.width * camera.height, 2**28  # some 300 views of a D455, 2 GB with colour; a guess
    if pixels > most:
        given = f"{views} views of {camera.width} x {camera.height} px"
        allowed = f"at most {most / 1e6:.0f} million pixels"
        raise bad_input("capture", given=given, allowed=allowed, do="Take fewer views, or shrink the images.")
    return camera.width, camera.height


def in_threads(work: Callable[[int], Any], items: Iterable[int]) -> list[Any]:
    """Return what `work` makes of all numbers, or raise its first error; in threads: OpenCV, numba drop the GIL."""
    with ThreadPoolExecutor(max_workers=min(8, os.cpu_count() or 1)) as pool:
        return list(pool.map(work, items))
