"""Views and clouds from COLMAP: a dense workspace becomes a `Capture`, a fused PLY or sparse points a `Cloud`.

COLMAP knows neither scale nor up: the user states them (`scale_and_up`). The world's origin stays the model's. Its own
files, cameras, images and points3D, text or binary, and depth maps, are read as https://colmap.github.io/format.html
(output format), cameras.html (camera models) and faq.html (depth maps): lengths are model units; pixel centres lie
at half-integers. V views, N points.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.core.checks import check_range
from anther.core.errors import bad_input
from anther.core.files import existing, named_file, read_lines, understood, whole_file
from anther.core.geometry import Array, Intrinsics, inverse, transform
from anther.core.opencv import cv2
from anther.perception.capture import PIXEL_CENTRE, Capture
from anther.perception.cloud import Cloud
from anther.perception.formats.clouds import RawPoints, checked_cloud, read_ply
from anther.perception.images import read_image

_ALLOWED = "x, y, z, -x, -y, -z, or three numbers such as 0.1,-0.9,0.3"


def scale_and_up(path: object, scale: float | None, up: str | None) -> tuple[float, Array]:
    """Return (scale [m per model unit], R_world_model (3, 3)) as the user states them.

    The rotation is the shortest that turns `up` to +z.

    Args:
        path: the file, for the message.
        scale: metres per model unit.
        up: the direction that points up in the model: an axis, e.g. "-y", or a vector "0.1,-0.9,0.3".

    Raises:
        InputError: one of them is missing, or is no positive number or no direction.
    """
    missing = " and ".join(name for name, value in (("scale", scale), ("up", up)) if value is None)
    if scale is None or up is None:
        raise bad_input(
            str(path),
            given=f"no {missing}",
            allowed=f"--scale (metres per model unit) and --up= ({_ALLOWED})",
            do="A structure-from-motion model has neither: measure a known length in it (real metres / model length), "
            "and check which way the plant grows (before any alignment it is often about -y).",
        )
    check_range("scale", scale, 1e-6, 1e6, "m per unit")
    direction = _direction(up)
    rotation = Rotation.align_vectors([[0.0, 0.0, 1.0]], [direction])[0]
    return scale, rotation.as_matrix()


def _direction(up: str) -> Array:
    found = re.fullmatch(r"([+-]?)([xyz])", up.strip().lower())
    if found:
        return np.eye(3)["xyz".index(found[2])] * (-1.0 if found[1] == "-" else 1.0)
    try:
        vector = np.array([float(word) for word in up.replace(",", " ").split()])
    except ValueError:
        vector = np.zeros(0)
    if vector.shape != (3,) or not np.isfinite(vector).all() or np.linalg.norm(vector) < 1e-9:
        raise bad_input("up", given=f"'{up}'", allowed=_ALLOWED, do="Name the direction in which the plant grows.")
    return vector / np.linalg.norm(vector)


DEPTH_MAPS = ("geometric", "photometric")
"""Kinds of depth map, the better first."""


def read_colmap_capture(folder: Path | str, scale: float | None = None, up: str | None = None) -> Capture:
    """Return the views of a COLMAP dense workspace, in metres with z up.

    The workspace is what `colmap image_undistorter` and `patch_match_stereo` leave: sparse/ (cameras, images),
    images/, stereo/depth_maps/NAME.geometric.bin. Images without depth map are left out.

    Args:
        folder: the workspace.
        scale: metres per model unit.
        up: the direction that points up in the model, e.g. "-y" or "0.1,-0.9,0.3".

    Raises:
        InputError: scale or up is missing; a file is missing or unreadable; several cameras, lens distortion, depth
            maps of another size than the camera; or no depth maps.
    """
    folder = existing(folder)
    scale, R_world_model = scale_and_up(folder, scale, up)
    model = _model_folder(folder)
    maps = {image.name: _depth_path(folder, image.name) for image in read_images(model)}
    images = [image for image in read_images(model) if maps[image.name] is not None]
    if not images:
        given, do = f"a depth map for none of {len(maps)} images", "Run `colmap patch_match_stereo`, or import the PLY."
        allowed = "NAME.geometric.bin or NAME.photometric.bin"
        raise bad_input(str(folder / "stereo/depth_maps"), given=given, allowed=allowed, do=do)
    intrinsics = _intrinsics(read_cameras(model), images)
    depth = np.stack([_depth(maps[image.name], intrinsics, scale) for image in images])
    rgb = [_colour(named_file(folder / "images", image.name), intrinsics) for image in images]
    return Capture(
        depth=depth,
        intrinsics=intrinsics,
        T_world_cam=_upright(np.stack([image.T_world_cam for image in images]), scale, R_world_model),
        rgb=np.stack(rgb),
    )


def without_depth(folder: Path | str) -> tuple[str, ...]:
    """Return the names of the workspace's images that have no depth map, which `read_colmap_capture` leaves out."""
    return tuple(
        i.name for i in read_images(_model_folder(existing(folder))) if _depth_path(Path(folder), i.name) is None
    )


def read_colmap_cloud(path: Path | str, scale: float | None = None, up: str | None = None) -> Cloud:
    """Return a fused PLY, or a model folder's sparse points, as a cloud in metres with z up.

    Args:
        path: a .ply (`colmap stereo_fusion`), or a folder with points3D.bin or .txt.
        scale: metres per model unit.
        up: the direction that points up in the model.

    Raises:
        InputError: scale or up is missing, the file is unreadable, has too few points, or a size no plant has.
    """
    path = existing(path)
    scale, R_world_model = scale_and_up(path, scale, up)
    raw = RawPoints(*read_points(_model_folder(path))) if path.is_dir() else read_ply(path)
    cloud = checked_cloud(path, RawPoints(raw.points @ R_world_model.T * scale, raw.colors), f"scale {scale:g}")
    return replace(cloud, notes=(*cloud.notes, *raw.notes))


def _model_folder(folder: Path) -> Path:
    for candidate in (folder, folder / "sparse", folder / "sparse/0"):
        if any((candidate / f"cameras{suffix}").exists() for suffix in (".bin", ".txt")):
            return candidate
    raise bad_input(
        str(folder),
        given="no cameras.bin or cameras.txt in it, in sparse or in sparse/0",
        allowed="a COLMAP workspace or model folder",
        do="Name the folder that holds sparse/.",
    )


def _depth_path(folder: Path, name: str) -> Path | None:
    paths = (named_file(folder / "stereo/depth_maps", f"{name}.{kind}.bin") for kind in DEPTH_MAPS)
    return next((path for path in paths if path.exists()), None)


def _intrinsics(cameras: dict[int, ColmapCamera], images: list[ColmapImage]) -> Intrinsics:
    lost = [image for image in images if image.camera not in cameras]
    if lost:
        raise bad_input(
            "COLMAP images",
            given=f"camera {lost[0].camera} of {lost[0].name}",
            allowed=f"ids {sorted(cameras)}",
            do="Are cameras and images of one model?",
        )
    used = [cameras[number] for number in sorted({image.camera for image in images})]
    first = used[0].pinhole()
    for other in used[1:]:
        same_size = (other.width, other.height) == (used[0].width, used[0].height)
        if not same_size or not np.allclose(other.pinhole(), first, rtol=1e-6, atol=0):
            raise bad_input(
                "COLMAP cameras",
                given=f"{len(used)} different cameras",
                allowed="one camera for all views",
                do="Reconstruct with `--ImageReader.single_camera 1`, or import each camera's views on their own.",
            )
    fx, fy, cx, cy = first
    return Intrinsics(used[0].width, used[0].height, fx, fy, cx - PIXEL_CENTRE, cy - PIXEL_CENTRE)


def _depth(path: Path | None, intrinsics: Intrinsics, scale: float) -> NDArray[np.float32]:
    assert path is not None
    depth = read_depth_map(path)
    if depth.shape != (intrinsics.height, intrinsics.width):
        raise bad_input(
            str(path),
            given=f"{depth.shape[1]} x {depth.shape[0]} px",
            allowed=f"{intrinsics.width} x {intrinsics.height} px, the camera's size",
            do="Undistort with --max_image_size N and match with the same --PatchMatchStereo.max_image_size.",
        )
    return np.where(np.isfinite(depth) & (depth > 0), depth * np.float32(scale), np.float32(0))


def _colour(path: Path, intrinsics: Intrinsics) -> NDArray[Any]:
    image = read_image(path, cv2.IMREAD_COLOR, (intrinsics.width, intrinsics.height))
    return image[..., ::-1]


def _upright(poses: Array, scale: float, R_world_model: Array) -> Array:
    out = poses.copy()
    out[:, :3, :3] = R_world_model @ poses[:, :3, :3]
    out[:, :3, 3] = scale * poses[:, :3, 3] @ R_world_model.T
    return out


MODELS = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12,
}  # fmt: skip
"""Camera model -> number of parameters, in the order of COLMAP's model ids (0, 1, ...)."""

_SAME_FOCAL = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
_SAID = re.compile(r"# Number of (?:cameras|images|points): (\d+)")
_CUT = "Is it truncated?"

T = TypeVar("T")


class ColmapCamera(NamedTuple):
    """One camera, of one of `MODELS`, with the model's parameters, focal lengths first; size in pixels."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def pinhole(self) -> tuple[float, float, float, float]:
        """Return (fx, fy, cx, cy) [px], pixel centres at half-integers; lens distortion is refused."""
        same = self.model in _SAME_FOCAL
        fx, fy = (self.params[0], self.params[0]) if same else self.params[:2]
        cx, cy, *bend = self.params[1 if same else 2 :]
        if any(bend) or "FISHEYE" in self.model or self.model == "FOV":
            raise bad_input(
                "COLMAP camera",
                given=f"{self.model} with distortion {bend}",
                allowed="PINHOLE, SIMPLE_PINHOLE, or no distortion",
                do="Run `colmap image_undistorter` and import its folder.",
            )
        return fx, fy, cx, cy


class ColmapImage(NamedTuple):
    """One registered image: its path below the image folder, its camera's id, its pose (4, 4) in model units."""

    name: str
    camera: int
    T_world_cam: Array


def read_cameras(folder: Path) -> dict[int, ColmapCamera]:
    """Return the cameras of a model folder (cameras.bin or cameras.txt) by id."""
    return dict(_rows(folder, "cameras", _cameras_binary, _cameras_text))


def read_images(folder: Path) -> list[ColmapImage]:
    """Return the registered images of a model folder (images.bin or images.txt), by name."""
    return sorted(_rows(folder, "images", _images_binary, _images_text), key=lambda image: image.name)


def read_points(folder: Path) -> tuple[Array, NDArray[np.uint8]]:
    """Return ((N, 3) points in model units, (N, 3) colours) of points3D.bin or points3D.txt."""
    table = np.array(_rows(folder, "points3D", _points_binary, _points_text), dtype=np.float64).reshape(-1, 6)
    return table[:, :3].copy(), table[:, 3:].astype(np.uint8)


def read_depth_map(path: Path) -> NDArray[np.float32]:
    """Return (H, W) z-depth in model units of a .bin depth map: "width&height&channels&", then float32 rows."""
    data = whole_file(path).read_bytes()
    head = data[:64].split(b"&", 3)
    with understood(path, "a COLMAP depth map (width&height&1&, float32)", _CUT):
        width, height, channels = (int(word) for word in head[:3])
        start = sum(len(word) + 1 for word in head[:3])
        if channels != 1 or min(width, height) < 1 or len(data) - start != 4 * width * height:
            raise ValueError(f"{width} x {height} x {channels} values announced, {len(data) - start} bytes there")
    return np.frombuffer(data, "<f4", offset=start).reshape(height, width)


def _rows(
    folder: Path, name: str, binary: Callable[[bytes], Iterator[T]], text: Callable[[list[str]], Iterator[T]]
) -> list[T]:
    """Return what one of a model's files holds, .bin or else .txt."""
    path = next((p for p in (folder / f"{name}.bin", folder / f"{name}.txt") if p.exists()), None)
    if path is None:
        given = f"no {name}.bin or {name}.txt"
        raise bad_input(str(folder), given=given, allowed="a COLMAP model folder", do="Name sparse/0 or such.")
    with understood(path, f"COLMAP's {name}", _CUT):
        if path.suffix == ".bin":
            return list(binary(path.read_bytes()))
        lines = read_lines(path)
        found = list(text([line for line in lines if not line.startswith("#")]))
        stated = [m for line in lines if (m := _SAID.match(line))]
        if stated and int(stated[0][1]) != len(found):
            raise ValueError(f"{len(found)} {name}, where its head states {stated[0][1]}")
        return found


def _cameras_binary(data: bytes) -> Iterator[tuple[int, ColmapCamera]]:
    names, at = dict(enumerate(MODELS)), 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        number, model, width, height = struct.unpack_from("<iiQQ", data, at)
        if model not in names:
            raise ValueError(f"camera model {model}")
        params = struct.unpack_from(f"<{MODELS[names[model]]}d", data, at + 24)
        at += 24 + 8 * len(params)
        yield number, ColmapCamera(names[model], width, height, params)


def _cameras_text(lines: list[str]) -> Iterator[tuple[int, ColmapCamera]]:
    for line in filter(str.strip, lines):
        number, model, width, height, *params = line.split()
        if len(params) != MODELS.get(model):
            raise ValueError(f"camera model {model} with {len(params)} parameters")
        yield int(number), ColmapCamera(model, int(width), int(height), tuple(float(p) for p in params))


def _images_binary(data: bytes) -> Iterator[ColmapImage]:
    at = 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        _, *pose, camera = struct.unpack_from("<i7di", data, at)
        end = data.index(b"\0", at + 64, at + 64 + 4096)  # PATH_MAX of Linux
        name = data[at + 64 : end].decode("utf-8")
        seen = struct.unpack_from("<Q", data, end + 1)[0]
        at = end + 9 + 24 * seen
        if at > len(data):
            raise ValueError("truncated")
        yield ColmapImage(name, camera, _pose(pose))


def _images_text(lines: list[str]) -> Iterator[ColmapImage]:
    """Two lines an image; the second, its points (three numbers each), may be empty or left out."""
    behind_image = False
    for line in lines:
        words = line.split()
        if behind_image and (not words or (len(words) % 3 == 0 and all(map(_is_number, words)))):
            behind_image = False
        elif words:
            _, *pose, camera, name = line.split(maxsplit=9)
            behind_image = True
            yield ColmapImage(name.strip(), int(camera), _pose([float(word) for word in pose]))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _pose(numbers: list[float]) -> Array:
    """Return T_world_cam of qw, qx, qy, qz and t, which map the world to the camera."""
    w, *xyz = numbers[:4]
    return inverse(transform(Rotation.from_quat([*xyz, w]).as_matrix(), numbers[4:7]))


def _points_binary(data: bytes) -> Iterator[tuple[float, ...]]:
    at = 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        _, x, y, z, r, g, b, _, track = struct.unpack_from("<Q3d3BdQ", data, at)
        at += 51 + 8 * track
        if at > len(data):
            raise ValueError("truncated")
        yield x, y, z, r, g, b


def _points_text(lines: list[str]) -> Iterator[tuple[float, ...]]:
    for line in filter(str.strip, lines):
        yield tuple(float(word) for word in line.split(maxsplit=7)[1:7])
