"""Recordings of an Azure Kinect: points where the wall is, in its colour; what cannot be read says why."""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

import made_azure
import numpy as np
import pytest
from made_azure import BLUE, DEPTH, EDGE, NORMAL, OFFSET, RED, T_COLOUR_DEPTH, WIDE, element, poses, recording

from anther.cli.main import main
from anther.core.errors import InputError
from anther.perception import Capture
from anther.perception.formats.azure_kinect import read_azure_kinect
from anther.perception.formats.bags import BagOptions


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    poses(tmp_path / "poses.txt")
    return tmp_path


def views(folder: Path, **options: Any) -> tuple[Capture, tuple[str, ...]]:
    read = read_azure_kinect(folder / "a.mkv", BagOptions(poses=folder / "poses.txt", **options))
    return read.capture, read.notes


def points_of(capture: Capture, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) points of a view in the world, and the pixels (row, column) they are seen at."""
    camera, rows_columns = capture.intrinsics, np.nonzero(capture.depth[view])
    z = capture.depth[view][rows_columns].astype(float)
    rays = [(rows_columns[1] - camera.cx) / camera.fx, (rows_columns[0] - camera.cy) / camera.fy, np.ones(len(z))]
    T = capture.T_world_cam[view]
    return (np.stack(rays, axis=1) * z[:, None]) @ T[:3, :3].T + T[:3, 3], np.stack(rows_columns, axis=1)


def off_wall(points: np.ndarray) -> float:
    """Return the distance from the wall that 99 of 100 points keep, over that from the camera at about the origin."""
    return float(np.quantile(np.abs(points @ NORMAL - OFFSET) / np.linalg.norm(points, axis=1), 0.99))


PIXEL = 1 / 252
"""Of depth, over its distance. The wall is turned by 27 degrees: half a pixel aside is a quarter off it."""


@pytest.mark.parametrize("kind", [b"MJPG", b"NV12", b"YUY2", b"BGRA"])
def test_points_are_where_the_wall_is_and_of_its_colour(folder: Path, kind: bytes) -> None:
    recording(folder / "a.mkv", colour=kind)
    words = ["import", str(folder / "a.mkv"), str(folder / "c"), "--poses", str(folder / "poses.txt")]
    assert main(words) == 0
    capture = Capture.load(folder / "c")
    assert capture.views == 3
    assert capture.rgb is not None
    np.testing.assert_allclose(capture.T_world_cam, [made_azure.pose(i) for i in range(3)], atol=1e-6)
    for view in range(3):
        points, at = points_of(capture, view)
        assert len(points) > 0.5 * capture.depth[view].size, "most of what colour shows has depth"
        assert off_wall(points) < PIXEL / 2, "of a pixel that is not mixed and of one that is laid over"
        sure = np.abs(points[:, 0] - EDGE) > 5e-3
        red = points[:, 0] < EDGE
        seen = capture.rgb[view][at[:, 0], at[:, 1]].astype(int)
        assert (np.abs(seen - np.where(red[:, None], RED, BLUE)).max(axis=1) < 40)[sure].mean() > 0.995


def test_colour_is_brought_to_about_the_fineness_of_depth(folder: Path) -> None:
    recording(folder / "a.mkv")
    camera = views(folder)[0].intrinsics
    assert (camera.width, camera.height) == (640, 360), "602 px of focal length beside 252 px"
    assert camera.fx == pytest.approx(0.4709 * 640)
    assert camera.cx == pytest.approx(0.4968 * 640 - 0.5)
    assert camera.cy == pytest.approx(0.5109 * 480 - 60 - 0.5)


@pytest.mark.parametrize(("eye", "angle"), [(DEPTH, 36), (WIDE, 55)])
def test_without_colour_all_that_the_depth_camera_saw_is_kept(folder: Path, eye: Any, angle: float) -> None:
    """A pinhole of the same size and focal length would end at 32 and at 45 degrees."""
    recording(folder / "a.mkv", depth=eye, colour=None)
    capture, _ = views(folder, views=1)
    assert capture.rgb is None
    capture = Capture(capture.depth, capture.intrinsics, capture.T_world_cam @ T_COLOUR_DEPTH)
    points, at = points_of(capture, 0)
    assert off_wall(points) < PIXEL
    widest = np.degrees(np.arctan(np.abs(at[:, 1] - capture.intrinsics.cx) / capture.intrinsics.fx)).max()
    assert widest > angle


def test_a_lens_that_were_left_out_would_show(folder: Path) -> None:
    """The bound on the distance from the wall is worth something."""
    straight = json.loads(json.dumps(made_azure.calibration()))
    for camera in straight["CalibrationInformation"]["Cameras"]:
        camera["Intrinsics"]["ModelParameters"][4:] = [0.0] * 10
    recording(folder / "a.mkv", told=straight)
    assert off_wall(points_of(views(folder)[0], 0)[0]) > 2 * PIXEL


def test_the_first_devices_tell_colour_by_the_middle_of_the_sensor(folder: Path) -> None:
    told = made_azure.calibration()
    colour = told["CalibrationInformation"]["Cameras"][1]
    colour["SensorHeight"] = 2304
    lens = colour["Intrinsics"]["ModelParameters"]
    lens[1], lens[3] = (lens[1] - 0.125) / 0.75, lens[3] / 0.75
    recording(folder / "a.mkv")
    wanted = views(folder)[0]
    recording(folder / "a.mkv", told=told)
    np.testing.assert_allclose(views(folder)[0].depth, wanted.depth, atol=1e-6)


STRIP = element(0x6D80, element(0x6240, element(0x5034, element(0x4254, 3), element(0x4255, b"\0\0"))))
DEFLATE = element(0x6D80, element(0x6240, element(0x5034)))


@pytest.mark.parametrize(
    "changes",
    [{"depth_kind": b"YUY2"}, {"packing": (DEFLATE, zlib.compress)}, {"packing": (STRIP, lambda data: data[2:])}],
)
def test_other_ways_to_keep_the_same_depth(folder: Path, changes: dict[str, Any]) -> None:
    """Little-endian; packed by zlib; without the beginning that all frames share: the lens shows nothing there."""
    recording(folder / "a.mkv", frames=1, depth=WIDE)
    wanted = views(folder)[0]
    recording(folder / "a.mkv", frames=1, depth=WIDE, **changes)
    np.testing.assert_array_equal(views(folder)[0].depth, wanted.depth)


def test_what_is_stated_and_not_used_is_noted(folder: Path) -> None:
    recording(folder / "a.mkv", tags={"K4A_DEPTH_DELAY_NS": "-8000000", "K4A_START_OFFSET_NS": "200011000"})
    notes = "\n".join(views(folder)[1])
    assert "tracks not used: IMU" in notes
    assert "depth was taken -0.008 s after colour" in notes
    assert "begins at 0.200011 s of the camera's clock" in notes


def test_colour_that_is_too_late_is_left_out(folder: Path) -> None:
    recording(folder / "a.mkv")
    with pytest.raises(InputError, match=r"nearest colour 0\.008 s.*from the recording's beginning"):
        views(folder, tolerance=0.005)


def test_a_recorder_that_was_killed_loses_its_last_frame_only(folder: Path) -> None:
    recording(folder / "a.mkv", closed=False)
    data = (folder / "a.mkv").read_bytes()
    (folder / "a.mkv").write_bytes(data[:-10])
    capture, notes = views(folder, tolerance=0.02)
    assert capture.views == 2, "the last colour frame is not whole"
    assert any("stopped hard" in note for note in notes)


BAD: list[tuple[dict[str, Any], str]] = [
    ({"told": {}}, r"no attachment calibration.json"),
    ({"told": {"CalibrationInformation": {"Cameras": []}}}, r"calibration.json: got .*0 cameras D0"),
    ({"told": made_azure.calibration(lens={"ModelType": "CALIBRATION_LensDistortionModelTheta"})}, r"lens: got Theta"),
    (
        {"told": made_azure.calibration(lens={"ModelType": "CALIBRATION_LensDistortionModelRational6KT"})},
        r"lens: got Rational6KT, p1 8.1e-05",
    ),
    ({"told": made_azure.calibration(lens={"ModelParameters": [0.5] * 12})}, r"ModelParameters: got .*12"),
    ({"told": made_azure.calibration(lens={"ModelParameters": [0.5] * 14})}, r"distortion centre 0.5"),
    ({"told": made_azure.calibration(MetricRadius=100.0)}, r"MetricRadius: got 100"),
    ({"told": made_azure.calibration(SensorWidth=640)}, r"320 x 288 px of a sensor of 640 x 1024 px"),
    ({"depth": DEPTH._replace(size=(300, 200))}, r"DEPTH: got 300 x 200 px"),
    ({"depth": None}, r"got tracks COLOR, IMU; allowed: a DEPTH track.*depth-mode"),
    ({"depth": None, "colour": None}, r"got tracks IMU; allowed: a DEPTH track"),
    ({"frames": 0}, r"0 colour and 0 depth frames"),
    ({"depth_kind": b"FFV1"}, r"DEPTH: got V_MS/VFW/FOURCC FFV1; allowed: b16g"),
    ({"packing": (b"", lambda data: data[:-2])}, r"DEPTH: got 184318 bytes for 320 x 288 px"),
    ({"packing": (element(0x6D80, element(0x6240, element(0x5035))), bytes)}, r"track DEPTH is encrypted"),
]


@pytest.mark.parametrize(("changes", "message"), BAD, ids=[str(i) for i in range(len(BAD))])
def test_what_cannot_be_read_says_why(folder: Path, changes: dict[str, Any], message: str) -> None:
    recording(folder / "a.mkv", **{"frames": 1} | changes)
    with pytest.raises(InputError, match=message):
        views(folder)


@pytest.mark.parametrize("kept", [0, 3, 200, 100_000])
def test_a_file_that_was_cut_off_is_refused(folder: Path, kept: int) -> None:
    recording(folder / "a.mkv")
    whole = (folder / "a.mkv").read_bytes()
    (folder / "a.mkv").write_bytes(whole[:kept])
    with pytest.raises(InputError, match=r"cut off|no Matroska"):
        views(folder)
    (folder / "a.mkv").write_bytes(whole[:-1])
    with pytest.raises(InputError, match=rf"cut off at {len(whole) - 1} of {len(whole)} bytes"):
        views(folder)


def test_a_damaged_jpeg_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(made_azure, "colour_bytes", lambda *_: b"\xff\xd8 no jpeg")
    recording(folder / "a.mkv")
    with pytest.raises(InputError, match="COLOR: got a damaged JPEG"):
        views(folder)


def test_garbage_is_one_clear_error(folder: Path) -> None:
    """Any byte changed in the headers: read, or refused; never a traceback."""
    recording(folder / "a.mkv", frames=1)
    whole = (folder / "a.mkv").read_bytes()
    rng = np.random.default_rng(0)
    for at in rng.integers(4, 1200, 60):
        (folder / "b.mkv").write_bytes(whole[:at] + bytes([int(rng.integers(256))]) + whole[at + 1 :])
        try:
            read_azure_kinect(folder / "b.mkv", BagOptions(poses=folder / "poses.txt", views=1))
        except InputError as error:
            assert "b.mkv" in str(error)  # noqa: PT017


def test_poses_are_needed_and_options_of_bags_refused(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    recording(folder / "a.mkv")
    assert main(["import", str(folder / "a.mkv"), str(folder / "c")]) == 2
    assert "no poses: a recording holds none" in capfd.readouterr().err
    with pytest.raises(InputError, match="--depth-topic, --world-frame"):
        views(folder, depth_topic="a", world_frame="b")


def test_a_camera_that_stands_still_gives_one_view(folder: Path) -> None:
    recording(folder / "a.mkv")
    np.savetxt(folder / "poses.txt", [[0, 0.1, 0.2, 0.3, 0, 0, 0, 1]])
    capture, _ = views(folder, views=1)
    assert capture.T_world_cam[0, :3, 3] == pytest.approx([0.1, 0.2, 0.3])
    with pytest.raises(InputError, match="one and the same pose in all views"):
        views(folder, tolerance=1.0)
