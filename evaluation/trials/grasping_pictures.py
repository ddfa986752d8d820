"""The pictures of `grasping.py`: each grasp as the wrist camera saw its place, and sheets of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from anther.core import Array, inverse, transform_points
from anther.core.files import replacing
from anther.perception import Capture
from anther.pollination import Grasp
from anther.robot.arm.gripper_shape import GripperShape
from anther.robot.arm.sawyer import TOOL

TILE = 150  # px
AROUND = 0.13  # m shown to either side of the grasp
SEEN = 0.02  # m, the depth image must show something this near the grasp for the view to count as showing it
GOOD, BAD = (60, 170, 90), (215, 60, 50)


def portrait(capture: Capture, grasp: Grasp | None, path: Path) -> None:
    """Write the picture of a grasp, with the open pads and the fingers behind them; without one, a whole view."""
    assert capture.rgb is not None
    if grasp is None:
        whole = capture.rgb[len(capture.rgb) // 2]
        side = whole.shape[0]
        left = (whole.shape[1] - side) // 2
        _write(path, cv2.resize(whole[:, left : left + side], (TILE, TILE), interpolation=cv2.INTER_AREA))
        return
    view = best_view(capture, grasp)
    camera = capture.intrinsics
    T_cam_world = inverse(capture.T_world_cam[view])
    x, y, z = transform_points(T_cam_world, grasp.point[None])[0]
    half = camera.fx * AROUND / z
    at = camera.project(np.array([[x, y, z]]))[0]
    scale = TILE / (2 * half)
    warp = np.array([[scale, 0, -scale * (at[0] - half)], [0, scale, -scale * (at[1] - half)]])
    tile = cv2.warpAffine(np.asarray(capture.rgb[view]), warp, (TILE, TILE), flags=cv2.INTER_AREA)
    for box in finger_boxes():
        corners = camera.project(transform_points(T_cam_world @ grasp.T_world_flange, box))
        outline = cv2.convexHull(np.round(corners @ warp[:, :2].T + warp[:, 2]).astype(np.int32))
        cv2.polylines(tile, [outline], isClosed=True, color=(255, 215, 0), thickness=1, lineType=cv2.LINE_AA)
    _write(path, tile)


def finger_boxes() -> list[Array]:
    """Return the eight corners (8, 3) of each open pad in the flange's frame [m]."""
    gripper = GripperShape()
    inner, deep = TOOL.stroke / 2, gripper.pad[1] / 2
    spans = [(inner, inner + gripper.finger[0]), (-inner - gripper.finger[0], -inner)]
    across, along = gripper.pad[0] / 2, (gripper.depth - deep, gripper.depth + deep)
    return [np.array([(x, y, z) for x in (-across, across) for y in ys for z in along]) for ys in spans]


def best_view(capture: Capture, grasp: Grasp) -> int:
    """Return the view that looks most nearly along the approach, of those that show the grasped place if any do."""
    T_cam_world = np.stack([inverse(T) for T in capture.T_world_cam])
    p = T_cam_world[:, :3, :3] @ grasp.point + T_cam_world[:, :3, 3]
    pixel = np.round(capture.intrinsics.project(p)).astype(int)
    size = np.array([capture.intrinsics.width, capture.intrinsics.height])
    inside = np.all((pixel >= 0) & (pixel < size), axis=1)
    column, row = np.clip(pixel, 0, size - 1).T
    depth = capture.depth[np.arange(len(p)), row, column]
    shown = inside & (np.abs(depth - p[:, 2]) < SEEN)
    facing = capture.T_world_cam[:, :3, 2] @ grasp.approach
    return int(np.argmax(facing + 2.0 * inside + 4.0 * shown))


def sheet(pictures: Sequence[tuple[Path, str, bool]], columns: int, path: Path) -> None:
    """Write tiles in rows, each with a frame and words below it; the picture may be missing.

    Args:
        pictures: (picture, words, success) of each.
        columns: tiles a row.
        path: of the PNG, of 96 colours so that it stays small.
    """
    tiles = [_labelled(*picture) for picture in pictures]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        Image.fromarray(np.vstack(rows)).quantize(96, dither=Image.Dither.NONE).save(
            temporary, format="PNG", optimize=True
        )


def _labelled(picture: Path, words: str, success: bool) -> NDArray[Any]:
    image = cv2.imread(str(picture))
    tile = np.full((TILE, TILE, 3), 128, np.uint8) if image is None else image[..., ::-1].copy()
    cv2.rectangle(tile, (0, 0), (TILE - 1, TILE - 1), GOOD if success else BAD, 3)
    strip = np.full((16, TILE, 3), 255, np.uint8)
    cv2.putText(strip, words, (3, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.33, GOOD if success else BAD, 1, cv2.LINE_AA)
    return np.pad(np.vstack([tile, strip]), ((1, 1), (2, 2), (0, 0)), constant_values=255)


def _write(path: Path, image: NDArray[Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        cv2.imwrite(str(temporary), np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 9])
