"""COLMAP's own files: cameras, images and points3D, text or binary, and depth maps. V images, N points.

Written from https://colmap.github.io/format.html (output format), https://colmap.github.io/cameras.html (camera models)
and https://colmap.github.io/faq.html (depth maps). Lengths are model units; pixel centres lie at half-integers.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.errors import InputError, bad_input
from anther.files import read_lines, whole_file
from anther.geometry import Array, inverse, transform

MODELS = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12,
}  # fmt: skip
"""Camera model -> number of parameters, in the order of COLMAP's model ids (0, 1, ...)."""

_SAME_FOCAL = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
_LONGEST_NAME = 4096


@dataclass(frozen=True, slots=True)
class ColmapCamera:
    """One camera of a model.

    Attributes:
        model: one of `MODELS`.
        width, height: image size [px].
        params: the model's parameters, focal lengths first.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def pinhole(self) -> tuple[float, float, float, float]:
        """Return (fx, fy, cx, cy) [px], pixel centres at half-integers.

        Raises:
            InputError: the camera has lens distortion.
        """
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


@dataclass(frozen=True, slots=True, eq=False)
class ColmapImage:
    """One registered image.

    Attributes:
        name: its path below the image folder.
        camera: id of its camera.
        T_world_cam: (4, 4), translation in model units; OpenCV's camera frame.
    """

    name: str
    camera: int
    T_world_cam: Array


def read_cameras(folder: Path) -> dict[int, ColmapCamera]:
    """Return the cameras of a model folder (cameras.bin or cameras.txt) by id.

    Raises:
        InputError: missing, truncated, or of an unknown camera model.
    """
    path = _either(folder, "cameras")
    try:
        return dict(_cameras_binary(path.read_bytes()) if path.suffix == ".bin" else _cameras_text(path))
    except (struct.error, ValueError, IndexError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise _unreadable(path, error, "COLMAP cameras") from error


def read_images(folder: Path) -> list[ColmapImage]:
    """Return the registered images of a model folder (images.bin or images.txt), by name.

    Raises:
        InputError: missing or truncated.
    """
    path = _either(folder, "images")
    try:
        images = list(_images_binary(path.read_bytes()) if path.suffix == ".bin" else _images_text(path))
    except (struct.error, ValueError, IndexError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise _unreadable(path, error, "COLMAP images") from error
    return sorted(images, key=lambda image: image.name)


def read_points(folder: Path) -> tuple[Array, NDArray[np.uint8]]:
    """Return ((N, 3) points in model units, (N, 3) colours) of points3D.bin or points3D.txt.

    Raises:
        InputError: missing or truncated.
    """
    path = _either(folder, "points3D")
    try:
        rows = list(_points_binary(path.read_bytes()) if path.suffix == ".bin" else _points_text(path))
    except (struct.error, ValueError, IndexError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise _unreadable(path, error, "COLMAP points") from error
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return table[:, :3].copy(), table[:, 3:].astype(np.uint8)


def read_depth_map(path: Path) -> NDArray[np.float32]:
    """Return (H, W) z-depth in model units of a COLMAP .bin depth map: "width&height&channels&", then float32 rows.

    Raises:
        InputError: missing, or the file is no depth map of one channel or truncated.
    """
    data = whole_file(path).read_bytes()
    head = data[:64].split(b"&", 3)
    try:
        width, height, channels = (int(word) for word in head[:3])
        start = sum(len(word) + 1 for word in head[:3])
        if channels != 1 or min(width, height) < 1 or len(data) - start != 4 * width * height:
            raise ValueError(f"{width} x {height} x {channels} values announced, {len(data) - start} bytes there")
    except ValueError as error:
        raise _unreadable(path, error, "a COLMAP depth map (width&height&1&, float32)") from error
    return np.frombuffer(data, "<f4", offset=start).reshape(height, width)


def _either(folder: Path, name: str) -> Path:
    found = [folder / f"{name}{suffix}" for suffix in (".bin", ".txt") if (folder / f"{name}{suffix}").exists()]
    if not found:
        raise bad_input(
            str(folder),
            given=f"no {name}.bin or {name}.txt",
            allowed="a COLMAP model folder",
            do="Name sparse/0 or such.",
        )
    return found[0]


def _cameras_binary(data: bytes) -> Iterator[tuple[int, ColmapCamera]]:
    names, at = list(MODELS), 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        number, model, width, height = struct.unpack_from("<iiQQ", data, at)
        params = struct.unpack_from(f"<{MODELS[_known(names, model)]}d", data, at + 24)
        at += 24 + 8 * len(params)
        yield number, ColmapCamera(names[model], width, height, params)


def _known(names: list[str], model: int) -> str:
    if not 0 <= model < len(names):
        raise ValueError(f"camera model {model}")
    return names[model]


def _cameras_text(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    for line in _lines(path):
        number, model, width, height, *params = line.split()
        if len(params) != MODELS.get(model):
            raise ValueError(f"camera model {model} with {len(params)} parameters")
        yield int(number), ColmapCamera(model, int(width), int(height), tuple(float(p) for p in params))


def _images_binary(data: bytes) -> Iterator[ColmapImage]:
    at = 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        _, *pose, camera = struct.unpack_from("<i7di", data, at)
        end = data.index(b"\0", at + 64, at + 64 + _LONGEST_NAME)
        name = data[at + 64 : end].decode("utf-8")
        seen = struct.unpack_from("<Q", data, end + 1)[0]
        at = end + 9 + 24 * seen
        if at > len(data):
            raise ValueError("truncated")
        yield ColmapImage(name, camera, _pose(pose))


def _images_text(path: Path) -> Iterator[ColmapImage]:
    """Two lines an image; the second (its points) may be empty, so only comments are skipped."""
    lines = [line for line in read_lines(path) if not line.startswith("#")]
    for line in lines[::2]:
        if line.strip():
            _, *pose, camera, name = line.split(maxsplit=9)
            yield ColmapImage(name.strip(), int(camera), _pose([float(word) for word in pose]))


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


def _points_text(path: Path) -> Iterator[tuple[float, ...]]:
    for line in _lines(path):
        yield tuple(float(word) for word in line.split(maxsplit=7)[1:7])


def _lines(path: Path) -> Iterator[str]:
    for line in read_lines(path):
        if line.strip() and not line.startswith("#"):
            yield line


def _unreadable(path: Path, error: Exception, allowed: str) -> InputError:
    return bad_input(str(path), given=f"unreadable ({error})", allowed=allowed, do="Is it truncated?")
