"""COLMAP: models and depth maps written here after its documentation come back as views; what it lacks is asked for."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from anther.cli.main import main
from anther.core.errors import InputError
from anther.core.geometry import Intrinsics, inverse, look_at, transform_points
from anther.perception.capture import Capture
from anther.perception.cloud import Cloud
from anther.perception.formats.colmap import (
    MODELS,
    read_cameras,
    read_colmap_capture,
    read_colmap_cloud,
    read_depth_map,
    read_images,
    read_points,
    scale_and_up,
)

CAMERA = Intrinsics(32, 24, 30.0, 31.0, 15.5, 11.25)
SCALE = 0.25
UP = "-y"
TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # model to world: -y becomes z, x stays
NAMES = ["b 2.png", "a/1.png", "c.png"]
Params = tuple[float, ...]


def views() -> Capture:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.3, 1.2, (3, 24, 32)).astype(np.float32)
    depth[:, :4] = 0
    poses = np.stack([look_at([np.cos(a), np.sin(a), 0.4], [0, 0, 0.1]) for a in (0.0, 2.0, 4.0)])
    return Capture(depth, CAMERA, poses, rng.integers(0, 256, (3, 24, 32, 3)).astype(np.uint8))


def model_poses(capture: Capture) -> np.ndarray:
    """(V, 7) qw qx qy qz tx ty tz of the cameras, world to camera, in the model's frame and units."""
    rows = []
    for T in capture.T_world_cam:
        model = T.copy()
        model[:3, :3] = TURN.T @ T[:3, :3]
        model[:3, 3] = TURN.T @ T[:3, 3] / SCALE
        back = inverse(model)
        rows.append([*np.roll(Rotation.from_matrix(back[:3, :3]).as_quat(), 1), *back[:3, 3]])
    return np.array(rows)


def write_workspace(
    folder: Path, *, binary: bool, model: str = "PINHOLE", params: Params = (30.0, 31.0, 16.0, 11.75)
) -> Capture:
    capture = views()
    sparse = folder / "sparse"
    sparse.mkdir(parents=True)
    (write_binary if binary else write_text)(sparse, model_poses(capture), model, params)
    for name, depth, rgb in zip(NAMES, capture.depth, capture.rgb if capture.rgb is not None else (), strict=True):
        image, depths = folder / "images" / name, folder / "stereo/depth_maps" / f"{name}.geometric.bin"
        for path in (image, depths):
            path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(image), rgb[..., ::-1])
        depths.write_bytes(b"32&24&1&" + (depth / np.float32(SCALE)).astype("<f4").tobytes())
    return capture


def write_text(folder: Path, poses: np.ndarray, model: str, params: Params) -> None:
    (folder / "cameras.txt").write_text(
        f"# Camera list\n# Number of cameras: 1\n7 {model} 32 24 {' '.join(map(repr, params))}\n"
    )
    rows = [
        f"{5 + i} {' '.join(map(repr, map(float, pose)))} 7 {name}\n{'1.5 2.5 -1 3 4 12' if i else ''}"
        for i, (pose, name) in enumerate(zip(poses, NAMES, strict=True))
    ]
    (folder / "images.txt").write_text("# Image list\n#   POINTS2D[]\n" + "\n".join(rows) + "\n")
    (folder / "points3D.txt").write_text("# 3D point list\n12 0.1 0.2 0.3 10 20 30 0.5 5 0 6 1\n13 1 2 3 1 2 3 0.5\n")


def write_binary(folder: Path, poses: np.ndarray, model: str, params: Params) -> None:
    number = list(MODELS).index(model)
    (folder / "cameras.bin").write_bytes(struct.pack(f"<QiiQQ{len(params)}d", 1, 7, number, 32, 24, *params))
    body = struct.pack("<Q", len(NAMES))
    for i, (pose, name) in enumerate(zip(poses, NAMES, strict=True)):
        body += struct.pack("<i7di", 5 + i, *pose, 7) + name.encode() + b"\0" + struct.pack("<Q", i)
        body += struct.pack("<ddq", 1.5, 2.5, -1) * i
    (folder / "images.bin").write_bytes(body)
    points = struct.pack("<Q", 2) + struct.pack("<Q3d3BdQ4i", 12, 0.1, 0.2, 0.3, 10, 20, 30, 0.5, 2, 5, 0, 6, 1)
    (folder / "points3D.bin").write_bytes(points + struct.pack("<Q3d3BdQ", 13, 1, 2, 3, 1, 2, 3, 0.5, 0))


@pytest.mark.parametrize("binary", [True, False])
def test_workspace_round_trip(tmp_path: Path, binary: bool) -> None:
    truth = write_workspace(tmp_path, binary=binary)
    read = read_colmap_capture(tmp_path, SCALE, UP)
    order = np.argsort(NAMES)
    assert read.intrinsics == CAMERA
    np.testing.assert_allclose(read.T_world_cam, truth.T_world_cam[order], atol=1e-9)
    np.testing.assert_allclose(read.depth, truth.depth[order], rtol=1e-6)
    assert read.rgb is not None
    assert truth.rgb is not None
    np.testing.assert_array_equal(read.rgb, truth.rgb[order])


@pytest.mark.parametrize("binary", [True, False])
def test_points_of_a_model(tmp_path: Path, binary: bool) -> None:
    write_workspace(tmp_path, binary=binary)
    points, colors = read_points(tmp_path / "sparse")
    np.testing.assert_allclose(points, [[0.1, 0.2, 0.3], [1, 2, 3]])
    np.testing.assert_array_equal(colors, [[10, 20, 30], [1, 2, 3]])


def test_views_without_depth_map_are_left_out_and_photometric_ones_do(tmp_path: Path) -> None:
    write_workspace(tmp_path, binary=True)
    maps = tmp_path / "stereo/depth_maps"
    (maps / "c.png.geometric.bin").unlink()
    (maps / "b 2.png.geometric.bin").rename(maps / "b 2.png.photometric.bin")
    assert read_colmap_capture(tmp_path, SCALE, UP).views == 2


def test_depth_below_zero_or_not_finite_is_no_reading(tmp_path: Path) -> None:
    write_workspace(tmp_path, binary=True)
    depth = np.array([-1, np.nan, np.inf, 2], np.float32).repeat(24 * 8)
    (tmp_path / "stereo/depth_maps/c.png.geometric.bin").write_bytes(b"32&24&1&" + depth.tobytes())
    read = read_colmap_capture(tmp_path, SCALE, UP).depth[2].ravel()
    np.testing.assert_allclose(read, np.array([0, 0, 0, 0.5]).repeat(24 * 8))


@pytest.mark.parametrize(("up", "axis"), [("x", [1, 0, 0]), ("-y", [0, -1, 0]), ("+z", [0, 0, 1]), ("-z", [0, 0, -1])])
def test_up_becomes_z_and_stays_a_rotation(up: str, axis: list[float]) -> None:
    scale, R = scale_and_up("m", 2.0, up)
    assert scale == 2.0
    np.testing.assert_allclose(R @ axis, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)


@given(st.lists(st.floats(-10, 10), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_any_vector_becomes_z(vector: list[float]) -> None:
    _, R = scale_and_up("m", 1.0, ",".join(map(str, vector)))
    np.testing.assert_allclose(R @ vector, [0, 0, np.linalg.norm(vector)], atol=1e-9)


@pytest.mark.parametrize(
    ("scale", "up", "message"),
    [
        (None, None, "no scale and up"),
        (1.0, None, "no up"),
        (None, "z", "no scale"),
        (0.0, "z", "scale"),
        (-1.0, "z", "scale"),
        (float("nan"), "z", "scale"),
        (1.0, "north", "north"),
        (1.0, "0,0,0", "0,0,0"),
        (1.0, "1,2", "1,2"),
        (1.0, "nan,0,1", "nan"),
    ],
)
def test_scale_and_up_must_be_told(tmp_path: Path, scale: float | None, up: str | None, message: str) -> None:
    write_workspace(tmp_path, binary=True)
    with pytest.raises(InputError, match=message):
        read_colmap_capture(tmp_path, scale, up)


def test_fused_ply_becomes_a_cloud(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    truth = Cloud(rng.uniform(0, 0.5, (300, 3)), colors=rng.integers(0, 256, (300, 3)).astype(np.uint8))
    Cloud(truth.points @ TURN / SCALE, colors=truth.colors).save(tmp_path / "fused.ply")
    read = read_colmap_cloud(tmp_path / "fused.ply", SCALE, UP)
    np.testing.assert_allclose(read.points, truth.points, atol=1e-9)
    assert read.colors is not None
    np.testing.assert_array_equal(read.colors, truth.colors)
    with pytest.raises(InputError, match="Wrong scale"):
        read_colmap_cloud(tmp_path / "fused.ply", 1000.0, UP)


def test_depth_and_poses_meet_in_the_world(tmp_path: Path) -> None:
    """The same plane seen by all cameras is one plane after import: scale, up and pixel centres fit together."""
    write_workspace(tmp_path, binary=True)
    capture, names = views(), sorted(NAMES)
    for name, T in zip(NAMES, capture.T_world_cam, strict=True):
        rays = CAMERA.rays() @ T[:3, :3].T
        depth = np.where(rays[..., 2] < -1e-3, -T[2, 3] / rays[..., 2], 0).astype(np.float32)  # the plane z = 0
        path = tmp_path / "stereo/depth_maps" / f"{name}.geometric.bin"
        path.write_bytes(b"32&24&1&" + (depth / np.float32(SCALE)).tobytes())
    read = read_colmap_capture(tmp_path, SCALE, UP)
    assert names == ["a/1.png", "b 2.png", "c.png"]
    for depth, T in zip(read.depth, read.T_world_cam, strict=True):
        heights = transform_points(T, read.intrinsics.back_project(depth))[:, 2]
        assert len(heights) > 100
        np.testing.assert_allclose(heights, 0, atol=1e-5)


def two_cameras(folder: Path) -> None:
    text = "7 PINHOLE 32 24 30 31 16 11.75\n8 PINHOLE 32 24 35 31 16 11.75\n"
    (folder / "sparse/cameras.txt").write_text(text)
    lines = (folder / "sparse/images.txt").read_text().replace(" 7 c.png", " 8 c.png")
    (folder / "sparse/images.txt").write_text(lines)


FAULTS = {
    "no model": (lambda f: (f / "sparse/cameras.txt").unlink(), "cameras.bin or cameras.txt"),
    "no images": (lambda f: (f / "sparse/images.txt").unlink(), "images.bin or images.txt"),
    "two cameras": (two_cameras, "single_camera"),
    "unknown camera": (lambda f: (f / "sparse/cameras.txt").write_text("1 PINHOLE 32 24 30 31 16 12\n"), "camera 7"),
    "unknown camera model": (lambda f: (f / "sparse/cameras.txt").write_text("7 WIDE 32 24 30\n"), "WIDE"),
    "cut image line": (lambda f: (f / "sparse/images.txt").write_text("1 1 0 0 0\n\n"), "unreadable"),
    "no depth maps": (lambda f: [p.unlink() for p in f.rglob("*.geometric.bin")], "patch_match_stereo"),
    "small depth map": (
        lambda f: (f / "stereo/depth_maps/c.png.geometric.bin").write_bytes(b"2&1&1&" + bytes(8)),
        "2 x 1 px; allowed: 32 x 24",
    ),
    "cut depth map": (
        lambda f: (f / "stereo/depth_maps/c.png.geometric.bin").write_bytes(b"32&24&1&" + bytes(80)),
        "80 bytes there",
    ),
    "no depth map": (lambda f: (f / "stereo/depth_maps/c.png.geometric.bin").write_bytes(b"PNG"), "unreadable"),
    "image missing": (lambda f: (f / "images/c.png").unlink(), "no such file"),
    "image of another size": (lambda f: cv2.imwrite(str(f / "images/c.png"), np.zeros((5, 5, 3))), "5 x 5 px"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_refused_in_words(tmp_path: Path, fault: str) -> None:
    write_workspace(tmp_path, binary=False)
    spoil, message = FAULTS[fault]
    spoil(tmp_path)
    with pytest.raises(InputError, match=message):
        read_colmap_capture(tmp_path, SCALE, UP)


@pytest.mark.parametrize(
    ("model", "params", "fine"),
    [
        ("SIMPLE_PINHOLE", (30.0, 16.0, 11.75), True),
        ("SIMPLE_RADIAL", (30.0, 16.0, 11.75, 0.0), True),
        ("OPENCV", (30.0, 31.0, 16.0, 11.75, 0.0, 0.0, 0.0, 0.0), True),
        ("SIMPLE_RADIAL", (30.0, 16.0, 11.75, 0.01), False),
        ("OPENCV", (30.0, 31.0, 16.0, 11.75, 0.0, 0.1, 0.0, 0.0), False),
        ("OPENCV_FISHEYE", (30.0, 31.0, 16.0, 11.75, 0.0, 0.0, 0.0, 0.0), False),
    ],
)
def test_lens_distortion_is_refused(tmp_path: Path, model: str, params: Params, fine: bool) -> None:
    write_workspace(tmp_path, binary=True, model=model, params=params)
    if fine:
        assert read_colmap_capture(tmp_path, SCALE, UP).intrinsics.fx == 30
    else:
        with pytest.raises(InputError, match="image_undistorter"):
            read_colmap_capture(tmp_path, SCALE, UP)


@settings(max_examples=40)
@given(
    name=st.sampled_from(["cameras", "images", "points3D", "depth"]),
    share=st.floats(0, 0.99),
    junk=st.binary(max_size=30),
)
def test_damaged_binary_files_never_end_in_a_traceback(tmp_path_factory, name: str, share: float, junk: bytes) -> None:
    folder = tmp_path_factory.mktemp("cut")
    write_workspace(folder, binary=True)
    path = folder / f"sparse/{name}.bin" if name != "depth" else folder / "stereo/depth_maps/c.png.geometric.bin"
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))] + junk)
    read = {
        "cameras": read_cameras,
        "images": read_images,
        "points3D": read_points,
        "depth": lambda _: read_depth_map(path),
    }
    try:
        outcome: object = read[name](folder / "sparse")
    except InputError as error:
        outcome = str(error)
    assert not isinstance(outcome, str) or path.name in outcome


def test_import_command(tmp_path: Path, capsys) -> None:
    truth = write_workspace(tmp_path / "dense", binary=True)
    words = ["import", str(tmp_path / "dense"), str(tmp_path / "capture"), "--overwrite"]
    assert main([*words, "--scale", str(SCALE), "--up=-y"]) == 0
    assert "3 views of 32 x 24 px" in capsys.readouterr().out
    again = Capture.load(tmp_path / "capture")
    np.testing.assert_allclose(again.T_world_cam, truth.T_world_cam[np.argsort(NAMES)], atol=1e-9)
    assert main(words) == 2
    assert "no scale and up" in capsys.readouterr().err


def test_import_command_writes_clouds(tmp_path: Path, capsys) -> None:
    points = np.random.default_rng(2).uniform(0, 1, (200, 3))
    Cloud(points).save(tmp_path / "fused.ply")
    words = ["import", str(tmp_path / "fused.ply"), str(tmp_path / "cloud.ply"), "--scale", "0.5", "--up", "z"]
    assert main(words) == 0
    np.testing.assert_allclose(Cloud.load(tmp_path / "cloud.ply").points, points * 0.5)
    assert main([*words[:2], str(tmp_path / "cloud"), *words[3:]]) == 2
    assert "name a .ply" in capsys.readouterr().err
    (tmp_path / "a.las").write_bytes(b"LASF")
    assert main(["import", str(tmp_path / "a.las"), str(tmp_path / "other.ply")]) == 2
    assert ".mcap" in capsys.readouterr().err


def test_empty_lines_may_be_left_out_of_a_text_model(tmp_path: Path) -> None:
    """And of images without points the second line is empty, which some programs do not write."""
    truth = write_workspace(tmp_path, binary=False)
    path = tmp_path / "sparse/images.txt"
    lines = path.read_text().splitlines()
    count = len(NAMES)
    for kept in ([line for line in lines if line.strip()], lines[:2] + [line for line in lines if "png" in line]):
        path.write_text("\n".join([*kept, ""]))
        read = read_colmap_capture(tmp_path, SCALE, UP)
        np.testing.assert_allclose(read.T_world_cam, truth.T_world_cam[np.argsort(NAMES)], atol=1e-9)
    path.write_text("\n".join([f"# Number of images: {count + 1}, mean observations per image: 2", *lines]))
    with pytest.raises(InputError, match=f"{count} images, where its head states {count + 1}"):
        read_colmap_capture(tmp_path, SCALE, UP)


def test_images_without_depth_map_are_named(tmp_path: Path, capsys) -> None:
    write_workspace(tmp_path / "dense", binary=False)
    (tmp_path / f"dense/stereo/depth_maps/{NAMES[1]}.geometric.bin").unlink()
    arguments = ["import", str(tmp_path / "dense"), str(tmp_path / "out"), "--scale", str(SCALE), f"--up={UP}"]
    assert main(arguments) == 0
    assert f"left out for want of a depth map: {NAMES[1]}" in capsys.readouterr().out
