"""Capture folders as phones, Windows and other people's programs write them."""

from __future__ import annotations

import json
import sys
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import lzfse
import numpy as np
import pytest
from PIL import Image

from anther.cli.main import main
from anther.core.errors import InputError, MissingExtra
from anther.core.geometry import Intrinsics, inverse, look_at, pose7
from anther.perception.capture import Capture
from anther.perception.formats.record3d import read_record3d

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


@pytest.mark.parametrize("keys", [{"distortion_params": [0.1, 0, 0, 0]}, {"radial_distortion": [0.1]}, {"b1": 0.4}])
def test_a_lens_by_any_name_is_refused(folder: Path, keys: dict[str, Any]) -> None:
    each_frame(folder, lambda i, f: keys)
    with pytest.raises(InputError, match=f"lens distortion .{next(iter(keys))}"):
        Capture.load(folder)
    each_frame(folder, lambda i, f: dict.fromkeys(keys, 0.0))
    assert Capture.load(folder).views == 5


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"depth_scale": 10_000}, "depth_scale 10000; allowed: depth_unit_scale_factor"),
        ({"integer_depth_scale": 0.002}, "that differ"), ({"camera_convention": "opencv"}, "OpenGL's camera axes"),
        ({"applied_transform": (0.1 * np.eye(3, 4)).tolist()}, "applied_transform with a scale"),
        ({"applied_transform": "none"}, "applied_transform"),
    ],
)  # fmt: skip
def test_what_would_change_depth_or_poses_is_refused(folder: Path, keys: dict[str, Any], words: str) -> None:
    changed(folder, **keys)
    with pytest.raises(InputError, match=words):
        Capture.load(folder)


@pytest.mark.parametrize(
    "other", ["C:\\Users\\me\\plant\\{}", "/home/me/plant/{}", "./{}", ".\\{}", "RGB\\{name}", "rgb/{stem}"]
)
def test_images_are_found_where_paths_are_of_another_machine(folder: Path, other: str) -> None:
    before = Capture.load(folder)
    each_frame(folder, lambda i, f: {"file_path": other.format(f["file_path"], name=f"{i:04d}.png", stem=f"{i:04d}")})
    np.testing.assert_array_equal(Capture.load(folder).rgb, before.rgb)


def test_a_mask_takes_depth_away(folder: Path) -> None:
    mask = np.full((96, 128), 255, np.uint8)
    mask[:, :64] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    before = Capture.load(folder).depth
    each_frame(folder, lambda i, f: {"mask_path": "mask.png"} if i == 1 else {})
    after = Capture.load(folder).depth
    np.testing.assert_array_equal(after[1], np.where(np.arange(64) < 32, 0, before[1]))
    np.testing.assert_array_equal(after[[0, 2, 3, 4]], before[[0, 2, 3, 4]])


def test_images_are_not_turned(folder: Path) -> None:
    """A phone's image says how it was held; intrinsics and depth are those of the sensor's pixels."""
    before = Capture.load(folder)
    for path in (folder / "rgb").iterdir():
        note = Image.Exif()
        note[0x112] = 3  # half a turn
        Image.open(path).save(path, exif=note)
    np.testing.assert_array_equal(Capture.load(folder).rgb, before.rgb)


def phone(path: Path, pack: Any, *, confidence: int = 2, **changes: Any) -> Capture:
    """A recording of Record3D as its app writes it: y up, colour four times as fine as depth."""
    views = views_of_a_ball()
    assert views.rgb is not None
    K = np.array([[240.0, 0, 128], [0, 240, 96], [0, 0, 1]])
    up = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    poses = [pose7(up @ T @ np.diag([1.0, -1, -1, 1])) for T in views.T_world_cam]
    meta = {
        "w": 256, "h": 192, "dw": 64, "dh": 48, "K": K.T.ravel().tolist(), "fps": 60,
        "poses": [[*p[3:], *p[:3]] for p in poses], "perFrameIntrinsicCoeffs": [[240.0, 240.0, 128.0, 96.0]] * 5,
    }  # fmt: skip
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", json.dumps(meta | changes))
        for i, (depth, rgb) in enumerate(zip(views.depth, views.rgb, strict=True)):
            large = cv2.resize(rgb[..., ::-1], (256, 192), interpolation=cv2.INTER_NEAREST)
            archive.writestr(f"rgbd/{i}.jpg", cv2.imencode(".jpg", large, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes())
            archive.writestr(f"rgbd/{i}.depth", pack(np.where(depth > 0, depth, np.nan).astype("<f4").tobytes()))
            archive.writestr(f"rgbd/{i}.conf", pack(np.full((48, 64), confidence, np.uint8).tobytes()))
    return views


@pytest.mark.parametrize("pack", [lzfse.compress, zlib.compress, bytes])
@pytest.mark.parametrize("changes", [{}, {"perFrameIntrinsicCoeffs": None}])
def test_a_recording_of_record3d(tmp_path: Path, pack: Any, changes: dict[str, Any]) -> None:
    wanted = phone(tmp_path / "a.r3d", pack, **changes)
    assert main(["import", str(tmp_path / "a.r3d"), str(tmp_path / "c")]) == 0
    read = Capture.load(tmp_path / "c")
    assert read.intrinsics.fx == pytest.approx(60)
    assert read.intrinsics.cx == pytest.approx(CAMERA.cx)
    np.testing.assert_allclose(read.T_world_cam, wanted.T_world_cam, atol=1e-6)
    np.testing.assert_allclose(read.depth, wanted.depth, atol=1e-4)
    assert read.rgb is not None
    assert wanted.rgb is not None
    assert np.abs(read.rgb.astype(int) - wanted.rgb).mean() < 2


def test_what_a_recording_of_record3d_lacks_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.r3d"
    phone(path, lzfse.compress, confidence=0)
    _, notes = read_record3d(path, views=3)
    assert "3 of 5 frames taken, evenly spread (--views)" in notes
    assert any("100% of the depth is of low confidence" in note for note in notes)
    for change, words in (({"poses": []}, "depth of none"), ({"dw": 60}, "whole image|one shape"), ({"K": [1]}, "K")):
        phone(path, lzfse.compress, **change)
        with pytest.raises(InputError, match=words):
            read_record3d(path)
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(InputError, match="a recording of Record3D"):
        read_record3d(path)


def test_lzfse_that_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    phone(tmp_path / "a.r3d", lzfse.compress)
    monkeypatch.setitem(sys.modules, "lzfse", None)
    with pytest.raises(MissingExtra, match=r"pip install 'anther\[phones\]'"):
        read_record3d(tmp_path / "a.r3d")
