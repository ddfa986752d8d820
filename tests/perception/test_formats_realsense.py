"""RealSense's own recordings: each SDK's dialect becomes the same views, and depth lies where the SDK lays it.

`recordings/` holds what SDKs 2.57.7 and 2.58.4 wrote of `made_realsense`; the installed SDK writes another meanwhile.
"""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path
from typing import Any

import cv2
import made_realsense
import numpy as np
import pytest
from made_bags import BagMaker
from made_realsense import COLOR, DEPTH, LENS, PERIOD, SHIFT, START, TURN, UNIT

from anther.cli.main import main
from anther.core.cameras import laid_over, straightened, straightening
from anther.core.errors import InputError
from anther.core.geometry import Array, Intrinsics, pose7, small_transform
from anther.perception.capture import Capture
from anther.perception.formats import _realsense_bag
from anther.perception.formats._bag_file import BagFile
from anther.perception.formats._bag_messages import colour_image
from anther.perception.formats.bags import BagOptions, BagViews, read_bag

KEPT = Path(__file__).parents[1] / "support" / "recordings"
DEPTH_CAMERA, COLOR_CAMERA = (
    Intrinsics(int(c["width"]), int(c["height"]), c["fx"], c["fy"], c["ppx"], c["ppy"]) for c in (DEPTH, COLOR)
)
T_COLOR_DEPTH = small_transform([0, 0, TURN], SHIFT)


@pytest.fixture(scope="session")
def rs() -> Any:
    try:
        return made_realsense.sdk()
    except ImportError as error:
        pytest.skip(f"pyrealsense2 cannot be imported ({error})")


@pytest.fixture(scope="session")
def written(rs: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that the installed SDK has just made."""
    path = tmp_path_factory.mktemp("sdk") / "now.db3"
    made_realsense.record(rs, path)
    return path


@pytest.fixture(params=["realsense_2.57.7.bag", "realsense_2.58.4.db3", "now"])
def recording(request: pytest.FixtureRequest) -> Path:
    return request.getfixturevalue("written") if request.param == "now" else KEPT / request.param


def poses(folder: Path) -> Path:
    rows = [[START + i * PERIOD, *pose7(small_transform([0, 0, 0.1 * i], [i, 0, 0]))] for i in range(3)]
    np.savetxt(folder / "poses.txt", rows, fmt="%.9f")
    return folder / "poses.txt"


def read(path: Path, folder: Path) -> BagViews:
    return read_bag(path, BagOptions(poses=poses(folder)))


def within_a_pixel(a: Array, b: Array, tolerance: float = 3e-3) -> float:
    """The share of a's pixels, without its two outermost rings, whose value b has there or next to it."""
    found = np.zeros(a.shape, bool)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            found |= np.abs(np.roll(b, (dv, du), (0, 1)) - a) < tolerance
    return float(found[2:-2, 2:-2].mean())


def test_every_sdk_s_recording_gives_the_same_views(recording: Path, tmp_path: Path) -> None:
    views = read(recording, tmp_path)
    np.testing.assert_allclose(views.stamps, START + PERIOD * np.arange(3), atol=1e-4)
    np.testing.assert_allclose(views.capture.T_world_cam[2], small_transform([0, 0, 0.2], [2, 0, 0]), atol=1e-6)
    assert views.capture.intrinsics == COLOR_CAMERA
    assert views.notes == ()
    assert views.capture.rgb is not None
    maps = straightening("lens", COLOR_CAMERA, np.array(LENS), "plumb_bob")
    for i, (depth, rgb) in enumerate(zip(views.capture.depth, views.capture.rgb, strict=True)):
        steps = made_realsense.depth_steps(i) * np.float32(UNIT)
        wanted = laid_over(steps, DEPTH_CAMERA, COLOR_CAMERA, T_COLOR_DEPTH)
        assert np.mean(np.abs(depth - wanted) < 1e-5) > 0.999  # .db3 rounds extrinsics to 1e-6
        np.testing.assert_array_equal(rgb, straightened(made_realsense.colours(i), maps, nearest=False))
        identity = laid_over(steps, DEPTH_CAMERA, COLOR_CAMERA, np.eye(4))
        board = [np.argwhere((image > 0) & (image < 0.4))[:, 1].mean() for image in (depth, identity)]
        assert board[0] - board[1] > 8  # 3 cm at 0.3 m: 9.5 px if it were not for the turn


def test_depth_lies_within_a_pixel_of_the_sdk_s_own_align(recording: Path, rs: Any, tmp_path: Path) -> None:
    """The SDK's align leaves the lens out: what it gives lies on the straight image, as ours does."""
    ours, theirs = read(recording, tmp_path).capture.depth, made_realsense.aligned_by_sdk(rs, recording)
    assert len(theirs) >= 2
    for number, depth in theirs.items():
        assert within_a_pixel(ours[number], depth) == 1
        assert within_a_pixel(depth, ours[number]) == 1


def test_a_lens_bends_as_the_sdk_says(rs: Any) -> None:
    """Where the SDK projects a point through the lens, there our map looks for it."""
    intrinsics = rs.intrinsics()
    for name, value in COLOR.items():
        setattr(intrinsics, name, value)
    for model in ("inverse_brown_conrady", "brown_conrady", "modified_brown_conrady"):
        intrinsics.model, intrinsics.coeffs = getattr(rs.distortion, model), list(LENS)
        maps = straightening("lens", COLOR_CAMERA, np.array(LENS), model.replace("_", " "))
        assert maps is not None
        for u, v in ((5, 4), (90, 10), (46, 36), (20, 70)):
            ray = [(u - COLOR_CAMERA.cx) / COLOR_CAMERA.fx, (v - COLOR_CAMERA.cy) / COLOR_CAMERA.fy, 1.0]
            bent = rs.rs2_project_point_to_pixel(intrinsics, ray)
            np.testing.assert_allclose([maps[0][v, u], maps[1][v, u]], bent, atol=0.05)
    assert abs(maps[0][4, 5] - 5) > 1.5


def test_streams_that_nothing_joins_are_refused(rs: Any, tmp_path: Path) -> None:
    made_realsense.record(rs, tmp_path / "apart.db3", joined=False)
    with pytest.raises(InputError, match="no fixed transform between them"):
        read(tmp_path / "apart.db3", tmp_path)


def bag_with(folder: Path, depth_tf: str, color_tf: str) -> Path:
    """A recording in the words of SDK <= 2.57, with extrinsics under the names given."""
    maker = BagMaker()
    maker.camera_info("/device_0/sensor_0/Depth_0/info/camera_info", DEPTH_CAMERA, "")
    maker.camera_info("/device_0/sensor_1/Color_0/info/camera_info", COLOR_CAMERA, "")
    maker.add("/device_0/sensor_0/option/Depth_Units/value", "std_msgs/msg/Float32", START, data=UNIT)
    for topic, T in (
        (f"sensor_0/Depth_0/tf/{depth_tf}", np.eye(4)),
        (f"sensor_1/Color_0/tf/{color_tf}", T_COLOR_DEPTH),
    ):
        if not topic.endswith("/"):
            maker.transform(f"/device_0/{topic}", START, T)
    for i in range(3):
        time = START + i * PERIOD
        steps, rgb = made_realsense.depth_steps(i), made_realsense.colours(i)
        maker.image("/device_0/sensor_0/Depth_0/image/data", time, steps, "mono16", "0")
        maker.image("/device_0/sensor_1/Color_0/image/data", time, rgb, "rgb8", "0")
    maker.write(folder / "a.bag")
    return folder / "a.bag"


@pytest.mark.parametrize("name", ["0", "1", "2"])
def test_extrinsics_are_found_under_any_number(tmp_path: Path, name: str) -> None:
    depth = read(bag_with(tmp_path, name, name), tmp_path).capture.depth[0]
    steps = made_realsense.depth_steps(0) * np.float32(UNIT)
    np.testing.assert_allclose(depth, laid_over(steps, DEPTH_CAMERA, COLOR_CAMERA, T_COLOR_DEPTH), atol=1e-5)


@pytest.mark.parametrize(("depth_tf", "color_tf"), [("0", "1"), ("", "0"), ("0", ""), ("", "")])
def test_extrinsics_that_do_not_meet_are_refused(tmp_path: Path, depth_tf: str, color_tf: str) -> None:
    with pytest.raises(InputError, match=r"sensor_0/Depth_0/tf/N and the colour's"):
        read(bag_with(tmp_path, depth_tf, color_tf), tmp_path)


@pytest.mark.parametrize(
    ("form", "channels", "pixel", "rgb"),
    [
        ("bgr8", 3, (10, 20, 30), (30, 20, 10)), ("bgra8", 4, (10, 20, 30, 255), (30, 20, 10)),
        ("rgba8", 4, (10, 20, 30, 255), (10, 20, 30)), ("y8", 1, (77,), (77, 77, 77)),
        ("yuyv", 2, (128, 128), (130, 130, 130)), ("uyvy", 2, (128, 128), (130, 130, 130)),
    ],
)  # fmt: skip
def test_the_installed_sdk_s_colours(
    rs: Any, tmp_path: Path, form: str, channels: int, pixel: tuple[int, ...], rgb: tuple[int, ...]
) -> None:
    """Grey with luma 128 of BT.601's 16..235 is (128 - 16) * 255 / 219."""
    device, stream = rs.software_device(), rs.video_stream()
    stream.type, stream.fmt, stream.uid, stream.bpp, stream.fps = (
        rs.stream.color,
        getattr(rs.format, form),
        2,
        channels,
        30,
    )
    stream.width, stream.height, stream.intrinsics = 8, 6, rs.intrinsics()
    sensor = device.add_sensor("RGB Camera")
    profile = sensor.add_video_stream(stream)
    recorder = rs.recorder(str(tmp_path / "a.db3"), device)
    recorded = recorder.query_sensors()[0]
    recorded.open(recorded.get_stream_profiles()[0])
    recorded.start(rs.frame_queue(5))
    frame = rs.software_video_frame()
    frame.pixels = np.tile(np.array(pixel, np.uint8), (6, 8, 1)).reshape(6, -1)
    frame.bpp, frame.stride, frame.profile = channels, 8 * channels, profile.as_video_stream_profile()
    sensor.on_video_frame(frame)
    recorded.stop()
    recorded.close()
    del recorded, recorder
    with BagFile(tmp_path / "a.db3") as bag:
        topic = next(t for t in bag.topics if "image/data" in t)
        images = [colour_image(topic, bag.decode(m)) for m in bag.messages({topic})]
    np.testing.assert_array_equal(images, np.tile(np.array(rgb, np.uint8), (1, 6, 8, 1)))


def edited(folder: Path, *statements: str) -> Path:
    """The kept .db3 after some SQL."""
    path = folder / "edited.db3"
    shutil.copy(KEPT / "realsense_2.58.4.db3", path)
    with sqlite3.connect(path) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()
    return path


FAULTS = {
    "no extrinsics": ("update topics set name='/else' where name like '%Color_0/tf/%'", "no fixed transform"),
    "no unit": ("update topics set name='/else' where name like '%Depth_Units/value'", "no depth unit"),
    "no camera": ("update topics set name='/else' where name like '%Depth_0/camera_info'", "no camera info"),
    "a frame without its time": ("delete from messages where id = (select max(id) from messages)", "times of frames"),
    "a camera of no words": (
        "update messages set data=x'0001000001000000' where topic_id = (select id from topics where name like"
        " '%Color_0/camera_info')",
        "allowed",
    ),
    "a broken package": ("update messages set data=x'28b52ffd00' where length(data) > 300", "unreadable"),
    "no messages": ("delete from messages", "nothing on|some of both"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_a_recording_are_refused_in_words(tmp_path: Path, fault: str) -> None:
    statement, message = FAULTS[fault]
    with pytest.raises(InputError, match=message):
        read(edited(tmp_path, statement), tmp_path)


@pytest.mark.parametrize("name", ["realsense_2.57.7.bag", "realsense_2.58.4.db3"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9])
def test_truncated_recordings_are_refused_in_words(tmp_path: Path, name: str, share: float) -> None:
    content = (KEPT / name).read_bytes()
    path = tmp_path / f"cut{Path(name).suffix}"
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match="allowed"):
        read(path, tmp_path)


@pytest.mark.parametrize(
    "text", ["", "rotation=1,0;translation=0,0,0", "rotation=1,0,0,0,1,0,0,0,nan;translation=0,0,0"]
)
def test_extrinsics_of_no_sense_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="9 finite numbers"):
        _realsense_bag.extrinsics("/tf/ref_1", text)


def test_a_recording_has_no_poses_of_its_own(written: Path) -> None:
    """SDK 2.59 writes /tf_static between its streams: that is no pose of the camera in a world."""
    with pytest.raises(InputError, match="--poses FILE"):
        read_bag(written)


def test_depth_as_a_png_must_be_whole(written: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    shutil.copy(written, path)
    with sqlite3.connect(path) as connection:
        where = "where topic_id = (select id from topics where name like '%compressedDepth')"
        whole = connection.execute(f"select data from messages {where}").fetchone()[0]
        connection.execute(f"update messages set data=? {where}", (whole[:-20] + bytes(20),))
    connection.close()
    with pytest.raises(InputError, match="damaged 16UC1; compressedDepth"):
        read(path, tmp_path)


def test_import_command(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["import", str(recording), str(tmp_path / "capture"), "--poses", str(poses(tmp_path))]
    assert main(words) == 0
    assert "3 views of 96 x 72 px" in capsys.readouterr().out
    capture = Capture.load(tmp_path / "capture")
    assert capture.views == 3
    assert cv2.countNonZero(capture.depth[0]) > 0.8 * 96 * 72
