"""Capture folders as phones, Windows and other people's programs write them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from anther.core.errors import InputError
from anther.core.geometry import Intrinsics, inverse, look_at
from anther.perception.capture import Capture

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
BALL = 0.15


def views_of_a_ball(count: int = 5) -> Capture:
    """A ball of 0.15 m at the origin before nothing, its colour that of the point that is seen."""
    depth, rgb, poses = [], [], []
    for angle in np.linspace(0, 4, count):
        T = look_at([0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.2], [0, 0, 0])
        rays = CAMERA.rays().reshape(-1, 3)
        centre = inverse(T)[:3, 3]
        b, a = rays @ centre, (rays**2).sum(axis=1)
        inside = b**2 - a * (centre @ centre - BALL**2)
        z = np.where(inside > 0, (b - np.sqrt(np.maximum(inside, 0))) / a, 0)
        depth.append(z.reshape(48, 64))
        points = rays * z[:, None] @ T[:3, :3].T + T[:3, 3]
        rgb.append(np.where(z[:, None] > 0, 128 + 600 * points, 0).reshape(48, 64, 3))
        poses.append(T)
    return Capture(np.float32(depth), CAMERA, np.stack(poses), np.clip(rgb, 0, 255).astype(np.uint8))


def changed(folder: Path, **values: Any) -> None:
    path = folder / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def each_frame(folder: Path, change: Any) -> None:
    meta = json.loads((folder / "transforms.json").read_text())
    changed(folder, frames=[frame | change(i, frame) for i, frame in enumerate(meta["frames"])])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    views_of_a_ball().save(tmp_path / "c")
    return tmp_path / "c"


def test_backslashes_marks_and_the_other_case(folder: Path) -> None:
    before = Capture.load(folder)
    each_frame(folder, lambda i, f: {key: f[key].replace("/", "\\") for key in ("file_path", "depth_file_path")})
    each_frame(folder, lambda i, f: {"file_path": f["file_path"].replace(".png", ".PNG")})
    path = folder / "transforms.json"
    path.write_text(path.read_text(), encoding="utf-8-sig")
    after = Capture.load(folder)
    np.testing.assert_array_equal(after.rgb, before.rgb)
    path.write_text(path.read_text(encoding="utf-8-sig"), encoding="utf-16")
    np.testing.assert_array_equal(Capture.load(folder).depth, before.depth)


def test_intrinsics_in_each_frame(folder: Path) -> None:
    own = {
        key: json.loads((folder / "transforms.json").read_text())[key] for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")
    }
    meta = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps({k: v for k, v in meta.items() if k not in own}))
    each_frame(folder, lambda i, f: own | {"fl_x": 60 + 0.01 * i, "fl_y": 60 + 0.01 * i})
    loaded = Capture.load(folder)
    assert loaded.intrinsics.fx == pytest.approx(60.02)
    np.testing.assert_allclose(loaded.depth, views_of_a_ball().depth, atol=1e-4)  # no pixel has moved


def test_a_view_of_another_focal_length_is_brought_to_the_others(folder: Path) -> None:
    """A camera that focuses: in view 2 all is 5 % larger."""
    straight = Capture.load(folder)
    grow = np.array([[1.05, 0, -0.05 * CAMERA.cx], [0, 1.05, -0.05 * CAMERA.cy]])
    for name, how in (("depth", cv2.INTER_NEAREST), ("rgb", cv2.INTER_LINEAR)):
        path = str(folder / name / "0002.png")
        image = cv2.imread(path, cv2.IMREAD_UNCHANGED)
        assert image is not None
        cv2.imwrite(path, cv2.warpAffine(image, grow, (64, 48), flags=how))
    each_frame(folder, lambda i, f: {"fl_x": 63.0, "fl_y": 63.0} if i == 2 else {})
    loaded = Capture.load(folder)
    assert loaded.intrinsics == straight.intrinsics
    both = (loaded.depth[2] > 0) & (straight.depth[2] > 0)
    assert both.sum() > 0.97 * (straight.depth[2] > 0).sum()
    assert np.median(np.abs(loaded.depth[2] - straight.depth[2])[both]) < 1e-3
    assert loaded.rgb is not None
    assert straight.rgb is not None
    assert np.median(np.abs(loaded.rgb[2].astype(int) - straight.rgb[2])[both]) <= 4
    each_frame(folder, lambda i, f: {"fl_x": 90.0} if i == 2 else {})
    with pytest.raises(InputError, match="one camera for all views"):
        Capture.load(folder)


@pytest.mark.parametrize("stated", ["colour", "depth"])
def test_small_depth_beside_large_colour(folder: Path, stated: str) -> None:
    small = Capture.load(folder)
    assert small.rgb is not None
    for view, image in enumerate(small.rgb):
        large = cv2.resize(image[..., ::-1], (256, 192), interpolation=cv2.INTER_NEAREST)
        cv2.imwrite(str(folder / f"rgb/{view:04d}.png"), large)
    if stated == "colour":
        changed(folder, w=256, h=192, fl_x=240.0, fl_y=240.0, cx=128.0, cy=96.0)
    loaded = Capture.load(folder)
    assert loaded.intrinsics == CAMERA
    np.testing.assert_array_equal(loaded.depth, small.depth)
    np.testing.assert_array_equal(loaded.rgb, small.rgb)


def test_another_shape_of_depth_is_refused(folder: Path) -> None:
    cv2.imwrite(str(folder / "depth/0000.png"), np.full((24, 30), 500, np.uint16))
    with pytest.raises(InputError, match="30 x 24 px; allowed: 64 x 48"):
        Capture.load(folder)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"camera_model": "OPENCV_FISHEYE"}, "camera_model OPENCV_FISHEYE"), ({"k5": 0.1}, "k5"),
        ({"is_fisheye": True}, "is_fisheye"), ({"distortion": [0.1, 0, 0, 0]}, "distortion"),
        ({"applied_scale": 0.4}, "poses that are not in metres"),
    ],
)  # fmt: skip
def test_what_would_bend_or_scale_the_views_is_refused(folder: Path, change: dict[str, Any], words: str) -> None:
    changed(folder, **change)
    with pytest.raises(InputError, match=words):
        Capture.load(folder)


def test_a_unit_of_its_own_in_a_frame_is_used(folder: Path) -> None:
    before = Capture.load(folder)
    each_frame(folder, lambda i, f: {"depth_unit_scale_factor": 2e-4} if i == 1 else {})
    np.testing.assert_allclose(Capture.load(folder).depth[1], 2 * before.depth[1])
