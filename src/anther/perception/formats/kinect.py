"""Kinect depth frames with known poses (millimetres) as a capture (metres)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from anther.core.checks import check_array
from anther.core.errors import bad_input
from anther.core.files import existing, named_file, read_object, understood
from anther.core.geometry import Intrinsics
from anther.core.opencv import cv2
from anther.perception.capture import Capture, check_views
from anther.perception.images import read_image


def read_kinect(folder: Path) -> Capture:
    """Return the capture in a folder of 16-bit depth images and a poses.json, in metres.

    poses.json holds intrinsics, depth_scale_mm, and frames with file and T_world_cam [mm]. The world's z axis stays the
    turntable's, which is the plant's up axis.

    Raises:
        InputError: something is missing or misread.
    """
    meta = read_object(existing(folder) / "poses.json")
    wanted = "intrinsics {width, height, fx, fy, cx, cy} and frames [{file, T_world_cam}]"
    with understood(folder / "poses.json", wanted, "Compare with docs/capture.md."):
        values = {key: meta["intrinsics"][key] for key in ("width", "height", "fx", "fy", "cx", "cy")}
        scale = float(meta.get("depth_scale_mm", 1.0)) * 1e-3
        poses = np.array([check_array("T_world_cam", frame["T_world_cam"], (4, 4)) for frame in meta["frames"]])
        poses[:, :3, 3] *= 1e-3
        size = check_views(len(poses), camera := Intrinsics(**values))
        depth = np.stack([_depth(named_file(folder, str(frame["file"])), scale, size) for frame in meta["frames"]])
    return Capture(depth=depth, intrinsics=camera, T_world_cam=poses)


def _depth(path: Path, scale: float, size: tuple[int, int]) -> Any:
    image = read_image(path, cv2.IMREAD_UNCHANGED, size)
    if image.dtype != np.uint16 or image.ndim != 2:
        raise bad_input(str(path), given="no 16-bit depth image", allowed="one channel, 16 bits", do="Is it truncated?")
    return (image * np.float64(scale)).astype(np.float32)
