"""Capture: the RGB-D views of one plant, and the folder that holds them. Dimensions: V views, H x W pixels.

The folder is nerfstudio's: `transforms.json` with PNG images (docs/capture.md).
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_array, check_range, check_transform
from anther.core.errors import InputError, bad_input
from anther.core.files import written
from anther.core.geometry import Array, Box, Intrinsics
from anther.core.opencv import cv2
from anther.perception.transforms import OPENGL_TO_OPENCV, PIXEL_CENTRE, check_views, in_threads, read_transforms

__all__ = [
    "OPENGL_TO_OPENCV",
    "PIXEL_CENTRE",
    "Capture",
    "CaptureWriter",
    "Keep",
    "View",
    "check_views",
    "in_threads",
    "no_keep",
    "viewed_box",
]


class View(NamedTuple):
    """One RGB-D view, which does not change.

    Attributes:
        depth: (H, W) float32 [m]; 0 means no reading.
        rgb: (H, W, 3) uint8, or None.
        intrinsics: of the camera.
        T_world_cam: (4, 4) its pose as the robot believes it.
    """

    depth: NDArray[Any]
    rgb: NDArray[Any] | None
    intrinsics: Intrinsics
    T_world_cam: Array


Keep = Callable[[View], None]
"""Hears of each view as it is taken. It does not wait."""


def no_keep(view: View) -> None:
    """Let a view go: a `Keep`."""


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """RGB-D views of one plant with their camera poses, depth aligned to colour.

    Attributes:
        depth: (V, H, W) float32, z-depth [m]; 0 means no reading.
        intrinsics: of every view.
        T_world_cam: (V, 4, 4) camera poses as the robot believes them.
        rgb: (V, H, W, 3) uint8, or None for a depth-only sensor.
        joints: (V, J) arm joint angles [rad] of each view, or None.
    """

    depth: NDArray[Any]
    intrinsics: Intrinsics
    T_world_cam: Array
    rgb: NDArray[Any] | None = None
    joints: NDArray[Any] | None = None

    def __post_init__(self) -> None:
        views, size = len(self.depth), (self.intrinsics.height, self.intrinsics.width)
        if views == 0:
            raise bad_input("capture", given="no views", allowed="at least one view", do="Add frames.")
        depth = check_array("depth", self.depth, (views, *size), dtype="float32")
        if depth.min() < 0:
            raise bad_input("depth", given=f"{depth.min():g} m", allowed=">= 0 m", do="0 means no reading.")
        object.__setattr__(self, "depth", depth)
        object.__setattr__(self, "T_world_cam", check_transform("T_world_cam", self.T_world_cam, views))
        _check_scale(depth, self.T_world_cam)
        if self.rgb is not None:
            object.__setattr__(self, "rgb", check_array("rgb", self.rgb, (views, *size, 3), dtype="uint8"))
        if self.joints is not None:
            object.__setattr__(self, "joints", check_array("joints", self.joints, (views, None)))

    @property
    def views(self) -> int:
        """Number of views V."""
        return len(self.depth)

    def view(self, number: int) -> View:
        """Return one of the views."""
        rgb = None if self.rgb is None else self.rgb[number]
        return View(self.depth[number], rgb, self.intrinsics, self.T_world_cam[number])

    def select(self, views: NDArray[Any] | list[int]) -> Capture:
        """Return the capture with these views only (indices or a mask), in the order given."""
        rgb, joints = (None if rows is None else rows[views] for rows in (self.rgb, self.joints))
        return Capture(self.depth[views], self.intrinsics, self.T_world_cam[views], rgb, joints)

    def save(self, folder: Path | str) -> None:
        """Write the capture folder (docs/capture.md), all of it or nothing.

        See `CaptureWriter`.

        Raises:
            InputError: `folder` exists and is something else than a capture, it cannot be written, or depth exceeds
                65 m.
        """
        with CaptureWriter(folder) as writer:
            writer.finish(self)

    @classmethod
    def load(cls, folder: Path | str) -> Capture:
        """Read a capture folder: `transforms.json` in nerfstudio's convention and its images (docs/capture.md).

        Raises:
            InputError: a file is missing, truncated or of the wrong size; poses or intrinsics are not usable;
                the scale is implausible.
        """
        read = read_transforms(folder)
        _check_apart(read.T_world_cam)
        return cls(read.depth, read.intrinsics, read.T_world_cam, read.rgb, read.joints)


class CaptureWriter:
    """Writes a capture folder view by view, beside what takes the views; all of it or nothing. Use it in a `with`.

    An existing capture there is replaced. Depth is rounded to 0.1 mm, in a view beyond 6.5 m to 1 mm.

    Raises:
        InputError: `folder` exists and is something else than a capture, it cannot be written, or depth exceeds 65 m.
    """

    def __init__(self, folder: Path | str) -> None:
        self._folder = Path(folder)
        self._temporary: Path | None = None
        self._pool, self._units = ThreadPoolExecutor(2), list[Future[float]]()

    def __enter__(self) -> CaptureWriter:
        return self

    def __exit__(self, *reason: object) -> None:
        self._pool.shutdown(cancel_futures=True)
        self._clear()

    def add(self, view: View) -> None:
        """Begin to write the next view."""
        if self._temporary is None:
            self._temporary = self._prepared()
        self._units.append(self._pool.submit(_write_view, self._temporary / "new", len(self._units), view))

    def finish(self, capture: Capture) -> None:
        """Write what is known of the views, and put the folder where it belongs.

        Unless just its views were added, one by one, they are written now.
        """
        if len(self._units) != capture.views:
            wait(self._units)
            self._clear()
            for number in range(capture.views):
                self.add(capture.view(number))
        assert self._temporary is not None, "a capture has views"
        with written(self._folder, _FOLDER):
            new = self._temporary / "new"
            _write_transforms(capture, [unit.result() for unit in self._units], new / "transforms.json")
            if self._folder.exists():
                self._folder.replace(self._temporary / "old")
            new.replace(self._folder)

    def _clear(self) -> None:
        if self._temporary is not None:
            shutil.rmtree(self._temporary, ignore_errors=True)
        self._temporary, self._units = None, []

    def _prepared(self) -> Path:
        with written(self._folder, _FOLDER):
            _check_replaceable(self._folder)
            self._folder.parent.mkdir(parents=True, exist_ok=True)
            temporary = Path(tempfile.mkdtemp(prefix=f".{self._folder.name}-", dir=self._folder.parent))
            (temporary / "new" / "depth").mkdir(parents=True)
            return temporary


_FOLDER = "a folder that can be written"


def _check_replaceable(folder: Path) -> None:
    other = folder.exists() and not (folder / "transforms.json").exists()
    if other and (folder.is_file() or any(folder.iterdir())):
        raise bad_input(
            str(folder), given="something that is not a capture", allowed="a new folder", do="Choose another name."
        )


def _check_scale(depth: NDArray[Any], T_world_cam: Array) -> None:
    """Refuse metres mistaken for millimetres, or the other way round, in depth or poses."""
    nearest, farthest, widest = 0.02, 20.0, 50.0  # median of the readings and distance of a camera [m]; guesses
    readings = depth[:: max(1, len(depth) // 5), ::8, ::8]
    if np.any(readings > 0):
        middle = float(np.median(readings[readings > 0]))
        if not nearest <= middle <= farthest:
            raise bad_input(
                "depth",
                given=f"a median of {middle:g} m",
                allowed=f"{nearest:g} to {farthest:g} m",
                do="Is it in metres? In a folder, depth_unit_scale_factor says metres per step: 0.001 for millimetres.",
            )
    away = np.linalg.norm(T_world_cam[:, :3, 3], axis=1)
    if away.max() > widest:
        raise bad_input(
            "T_world_cam",
            given=f"a camera {away.max():g} m from the world's origin (view {away.argmax()})",
            allowed=f"at most {widest:g} m",
            do="Are the poses in metres?",
        )


def _check_apart(poses: Array) -> None:
    """Refuse views that were all taken from one and the same place, which say nothing about depth."""
    if len(poses) > 1 and np.abs(poses - poses[0]).max() < 1e-6:
        raise bad_input(
            "transforms.json",
            given=f"{len(poses)} views with one and the same pose",
            allowed="a pose of its own for every view",
            do="Was the arm's pose read only once, or the camera not moved? Write each view's own pose.",
        )


def viewed_box(capture: Capture) -> Box:
    """Return a box around the point where the optical axes meet, reaching towards the cameras but not to them.

    Half its width is 0.5, half its height 0.8 of the cameras' median distance from that point. Where the axes are
    nearly parallel (one view, a straight pass) the median depth at the image centre replaces the point.
    """
    origins, axes = capture.T_world_cam[:, :3, 3], capture.T_world_cam[:, :3, 2]
    normals = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    centre, _, _, spread = np.linalg.lstsq(normals.sum(axis=0), np.einsum("vij,vj->i", normals, origins), rcond=None)
    if spread[-1] < 0.05 * capture.views:
        h, w = capture.intrinsics.height // 4, capture.intrinsics.width // 4
        middle = capture.depth[:, h : 3 * h + 1, w : 3 * w + 1]
        ranges = [float(np.median(d[d > 0])) if np.any(d > 0) else 1.0 for d in middle]
        centre = np.mean(origins + axes * np.array(ranges)[:, None], axis=0)
    distance = float(np.median(np.linalg.norm(origins - centre, axis=1)))
    half = np.maximum(distance, 1e-3) * np.array([0.5, 0.5, 0.8])
    return Box(centre - half, centre + half)


def _write_view(folder: Path, number: int, view: View) -> float:
    """Write the images of a view, and return the step of its depth [m]: up to 6.5 m tenths of a millimetre."""
    furthest, steps = float(view.depth.max()), 2**16 - 1
    check_range("greatest depth", furthest, 0, 1e-3 * steps, "m")
    unit = 1e-4 if furthest <= 1e-4 * steps else 1e-3
    _write_png(folder / f"depth/{number:04d}.png", np.round(view.depth.astype(np.float64) / unit).astype(np.uint16))
    if view.rgb is not None:
        (folder / "rgb").mkdir(exist_ok=True)
        _write_png(folder / f"rgb/{number:04d}.png", view.rgb[..., ::-1])
    return unit


def _write_transforms(capture: Capture, units: list[float], path: Path) -> None:
    camera = capture.intrinsics
    meta = {
        "camera_model": "PINHOLE",
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + PIXEL_CENTRE,
        "cy": camera.cy + PIXEL_CENTRE,
        "w": camera.width,
        "h": camera.height,
        "depth_unit_scale_factor": min(units),
        "frames": [_frame(capture, view, unit, min(units)) for view, unit in enumerate(units)],
    }
    path.write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")


def _write_png(path: Path, image: NDArray[Any]) -> None:
    # beside zlib's quickest level: less than half the time and a tenth smaller, since sensors' noise never repeats
    quick = [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY, cv2.IMWRITE_PNG_FILTER]
    ok, data = cv2.imencode(".png", image, [*quick, cv2.IMWRITE_PNG_FILTER_SUB])
    if not ok:
        raise InputError(f"{path}: the image of shape {image.shape} could not be encoded as PNG.")
    path.write_bytes(data.tobytes())


def _frame(capture: Capture, view: int, unit: float, usual: float) -> dict[str, Any]:
    frame: dict[str, Any] = {"depth_file_path": f"depth/{view:04d}.png"}
    if unit != usual:
        frame["depth_unit_scale_factor"] = unit
    if capture.rgb is not None:
        frame["file_path"] = f"rgb/{view:04d}.png"
    if capture.joints is not None:
        frame["joints"] = capture.joints[view].tolist()
    return frame | {"transform_matrix": (capture.T_world_cam[view] @ OPENGL_TO_OPENCV).tolist()}
