"""Kinect depth frames with known poses (millimetres) -> a capture folder (metres)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import tyro

from anther.core.checks import check_array
from anther.core.errors import bad_input
from anther.core.files import existing, named_file, read_object, understood
from anther.core.geometry import Intrinsics
from anther.perception.capture import Capture, check_views
from anther.perception.images import read_image

_MM = 1e-3  # [m]


@dataclass(frozen=True)
class Args:
    """Attributes: what to convert, and where to."""

    source: Annotated[Path, tyro.conf.Positional]
    """Folder with poses.json (intrinsics, depth_scale_mm, frames with file and T_world_cam [mm]) and 16-bit PNGs."""
    out: Annotated[Path, tyro.conf.Positional]
    """Capture folder to write."""


def run(args: Args) -> None:
    """Convert, in metres; the world's z axis stays the turntable's, which is the plant's up axis."""
    capture = read_kinect(args.source)
    capture.save(args.out)
    size = f"{capture.intrinsics.width} x {capture.intrinsics.height} px"
    print(f"{args.out}: {capture.views} views of {size}, depth only")


def read_kinect(folder: Path) -> Capture:
    """Return the capture in a Kinect folder; see `Args`."""
    meta = read_object(existing(folder) / "poses.json")
    wanted = "intrinsics {width, height, fx, fy, cx, cy} and frames [{file, T_world_cam}]"
    with understood(folder / "poses.json", wanted, "Compare with docs/capture.md."):
        values = {key: meta["intrinsics"][key] for key in ("width", "height", "fx", "fy", "cx", "cy")}
        scale = float(meta.get("depth_scale_mm", 1.0)) * _MM
        poses = np.array([check_array("T_world_cam", frame["T_world_cam"], (4, 4)) for frame in meta["frames"]])
        poses[:, :3, 3] *= _MM
        size = check_views(len(poses), camera := Intrinsics(**values))
        depth = np.stack([_depth(named_file(folder, str(frame["file"])), scale, size) for frame in meta["frames"]])
    return Capture(depth=depth, intrinsics=camera, T_world_cam=poses)


def _depth(path: Path, scale: float, size: tuple[int, int]) -> Any:
    image = read_image(path, cv2.IMREAD_UNCHANGED, size)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise bad_input(str(path), given="no 16-bit depth image", allowed="one channel, 16 bits", do="Is it truncated?")
    return (image * np.float64(scale)).astype(np.float32)
