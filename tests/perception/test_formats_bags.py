"""Bags: what recorders of ROS 1, RealSense, ROS 2 and MCAP leave becomes the same views; what lacks is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_bags import START, BagMaker

from anther.cli.main import main
from anther.core.cameras import laid_over, straightened
from anther.core.errors import InputError, MissingExtra
from anther.core.geometry import Intrinsics, inverse, look_at, pose7, small_transform, transform_points
from anther.perception.capture import Capture
from anther.perception.formats import _bag_file
from anther.perception.formats._bag_messages import camera_of
from anther.perception.formats.bags import BagOptions, read_bag

CAMERA = Intrinsics(32, 24, 30.0, 31.0, 15.5, 11.25)
COLOR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
POSE = "/arm/camera_pose"
PERIOD = 0.1  # [s] between frames


def truth(views: int = 5) -> Capture:
    rng = np.random.default_rng(0)
    depth = np.round(rng.uniform(0.3, 1.2, (views, 24, 32)), 3).astype(np.float32)
    depth[:, :4] = 0
    poses = np.stack([look_at([np.cos(a), np.sin(a), 0.4], [0, 0, 0]) for a in np.linspace(0, 4, views)])
    return Capture(depth, CAMERA, poses, rng.integers(0, 256, (views, 24, 32, 3)).astype(np.uint8))


def images(maker: BagMaker, capture: Capture, late: float = 0.004) -> None:
    """Colour comes `late` after depth."""
    assert capture.rgb is not None
    for i, (depth, rgb) in enumerate(zip(capture.depth, capture.rgb, strict=True)):
        time = START + i * PERIOD
        maker.image(DEPTH, time, np.round(depth * 1000).astype(np.uint16), "16UC1")
        maker.image(COLOR, time + late, rgb, "rgb8")


def ros_bag(ros1: bool = True, capture: Capture | None = None) -> BagMaker:
    capture, maker = capture or truth(), BagMaker(ros1)
    maker.camera_info("/camera/color/camera_info", CAMERA)
    maker.camera_info("/camera/aligned_depth_to_color/camera_info", CAMERA)
    images(maker, capture)
    for i, T in enumerate(capture.T_world_cam):
        maker.pose(POSE, START + i * PERIOD - 0.003, T)
    return maker


def same(read: Capture, wanted: Capture, depth_tolerance: float = 1e-6) -> None:
    assert read.intrinsics == wanted.intrinsics
    np.testing.assert_allclose(read.T_world_cam, wanted.T_world_cam, atol=1e-9)
    np.testing.assert_allclose(read.depth, wanted.depth, atol=depth_tolerance)
    assert read.rgb is not None
    assert wanted.rgb is not None
    np.testing.assert_array_equal(read.rgb, wanted.rgb)


@pytest.mark.parametrize(("name", "ros1"), [("a.bag", True), ("a.mcap", True), ("a.mcap", False), ("folder", False)])
def test_every_container_gives_the_same_views(tmp_path: Path, name: str, ros1: bool) -> None:
    ros_bag(ros1).write(tmp_path / name)
    views = read_bag(tmp_path / name)
    same(views.capture, truth())
    np.testing.assert_allclose(views.stamps - START, np.arange(5) * PERIOD, atol=1e-5)
    assert views.notes == (f"{POSE} is taken for the poses of the camera's optical frame; else see --camera-in-pose",)


def test_depth_in_metres_and_other_colour_encodings(tmp_path: Path) -> None:
    capture = truth(3)
    assert capture.rgb is not None
    for encoding in ("bgr8", "rgba8", "bgra8", "png"):
        maker = BagMaker()
        maker.camera_info("/camera/color/camera_info", CAMERA)
        for i in range(3):
            time, rgb = START + i * PERIOD, capture.rgb[i]
            depth = np.where(capture.depth[i] == 0, np.nan, capture.depth[i]).astype(np.float32)
            maker.image(DEPTH, time, depth, "32FC1")
            maker.pose(POSE, time, capture.T_world_cam[i])
            solid = np.full((24, 32, 1), 255, np.uint8)
            if encoding == "png":
                data = cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()
                maker.compressed(COLOR + "/compressed", time, data)
            else:
                flipped = rgb if encoding.startswith("rgb") else rgb[..., ::-1]
                maker.image(COLOR, time, np.dstack([flipped, solid]) if "a" in encoding else flipped, encoding)
        maker.write(tmp_path / f"{encoding}.bag")
        same(read_bag(tmp_path / f"{encoding}.bag").capture, capture)


def test_poses_from_tf_with_a_hand_eye_link(tmp_path: Path) -> None:
    """base -> flange moves, flange -> camera_link -> camera are fixed; stamps of tf lie between the frames'."""
    capture, maker = truth(), BagMaker()
    link, optical = small_transform([0.1, 0.2, 0.3], [0.02, -0.01, 0.05]), small_transform([-1.2, 0.4, 0], [0, 0.01, 0])
    maker.camera_info("/camera/color/camera_info", CAMERA)
    maker.tf("/tf_static", START, [("flange", "camera_link", link), ("camera_link", "camera", optical)])
    for i, T in enumerate(capture.T_world_cam):
        flange = T @ inverse(link @ optical)
        maker.tf("/tf", START + i * PERIOD + 0.011, [("base", "flange", flange), ("base", "other", np.eye(4))])
    images(maker, capture)
    maker.write(tmp_path / "a.bag")
    same(read_bag(tmp_path / "a.bag").capture, capture)
    views = read_bag(tmp_path / "a.bag", BagOptions(world_frame="flange"))
    np.testing.assert_allclose(views.capture.T_world_cam, np.tile(link @ optical, (5, 1, 1)), atol=1e-9)
    with pytest.raises(InputError, match="no way from 'camera' up to 'map'"):
        read_bag(tmp_path / "a.bag", BagOptions(world_frame="map"))
    with pytest.raises(InputError, match=r"nearest pose 0\.011"):
        read_bag(tmp_path / "a.bag", BagOptions(tolerance=0.01))


def test_poses_of_the_flange_with_a_calibration(tmp_path: Path) -> None:
    capture, maker = truth(), BagMaker()
    T_flange_cam = small_transform([0.3, -0.2, 0.1], [0.03, 0.04, 0.05])
    maker.camera_info("/camera/color/camera_info", CAMERA)
    images(maker, capture)
    for i, T in enumerate(capture.T_world_cam):
        maker.pose(POSE, START + i * PERIOD, T @ inverse(T_flange_cam))
    maker.write(tmp_path / "a.bag")
    options = BagOptions(camera_in_pose=tuple(pose7(T_flange_cam).tolist()))  # type: ignore[arg-type]
    again = read_bag(tmp_path / "a.bag", options).capture
    same(again, capture)
    assert len(again.T_world_cam) == len(capture.T_world_cam)


def realsense_bag(
    tmp_path: Path, *, aligned: bool = False, D: tuple[float, ...] = (0.0,) * 5
) -> tuple[BagMaker, Intrinsics, np.ndarray]:
    """A librealsense recording of a wall 0.5 m in front of the depth camera, with its own topics, no poses."""
    depth_camera = CAMERA if aligned else Intrinsics(32, 24, 20.0, 20.0, 15.5, 11.5)
    T_color_depth = np.eye(4) if aligned else small_transform([0, 0, 0], [0.0125, 0, 0])
    maker = BagMaker()
    maker.camera_info("/device_0/sensor_1/Color_0/info/camera_info", CAMERA, "0", D=D)
    maker.camera_info("/device_0/sensor_0/Depth_0/info/camera_info", depth_camera, "0")
    maker.transform("/device_0/sensor_0/Depth_0/tf/0", START, np.eye(4))
    maker.transform("/device_0/sensor_1/Color_0/tf/0", START, T_color_depth)
    maker.add("/device_0/sensor_0/option/Depth_Units/value", "std_msgs/msg/Float32", START, data=1e-4)
    for i in range(3):
        time = START + i * PERIOD
        maker.image("/device_0/sensor_0/Depth_0/image/data", time, np.full((24, 32), 5000, np.uint16), "mono16", "0")
        maker.image("/device_0/sensor_1/Color_0/image/data", time, np.full((24, 32, 3), 9 + i, np.uint8), "rgb8", "0")
        maker.image("/device_0/sensor_0/Infrared_1/image/data", time, np.zeros((24, 32), np.uint8), "mono8", "0")
    rows = [[START + i * PERIOD, *pose7(look_at([1, 0.1 * i, 0.4], [0, 0, 0]))] for i in range(3)]
    np.savetxt(tmp_path / "poses.txt", rows, fmt="%.9f", header="time x y z qx qy qz qw")
    return maker, depth_camera, T_color_depth


def test_realsense_depth_is_laid_over_colour(tmp_path: Path) -> None:
    maker, depth_camera, T_color_depth = realsense_bag(tmp_path)
    maker.write(tmp_path / "a.bag")
    views = read_bag(tmp_path / "a.bag", BagOptions(poses=tmp_path / "poses.txt"))
    corners = np.array([[-0.5, -0.5], [31.5, 23.5]])
    rays = (corners - [depth_camera.cx, depth_camera.cy]) / [depth_camera.fx, depth_camera.fy]
    seen = CAMERA.project(transform_points(T_color_depth, np.column_stack([rays, [1, 1]]) * 0.5))
    u, v = np.meshgrid(np.arange(32), np.arange(24))
    inside = (u > seen[0, 0]) & (u < seen[1, 0]) & (v > seen[0, 1]) & (v < seen[1, 1])
    assert inside.mean() > 0.9
    for depth in views.capture.depth:
        np.testing.assert_allclose(depth, np.where(inside, 0.5, 0), atol=1e-6)
    assert views.capture.intrinsics == CAMERA
    np.testing.assert_allclose(views.capture.T_world_cam[2], look_at([1, 0.2, 0.4], [0, 0, 0]), atol=1e-6)


def test_no_depth_is_laid_where_a_lens_leaves_no_colour(tmp_path: Path) -> None:
    """Where a pincushion's image is straight, its rim is black: points there would be black ones."""
    realsense_bag(tmp_path, D=(0.3, 0, 0, 0, 0))[0].write(tmp_path / "a.bag")
    capture = read_bag(tmp_path / "a.bag", BagOptions(poses=tmp_path / "poses.txt")).capture
    assert capture.rgb is not None
    black = (capture.rgb < 4).all(axis=-1)
    assert black.mean() > 0.05
    assert not capture.depth[black].any()
    assert (capture.depth[~black] > 0).mean() > 0.9


def test_realsense_without_poses_says_how_to_give_them(tmp_path: Path) -> None:
    realsense_bag(tmp_path, aligned=True)[0].write(tmp_path / "a.bag")
    with pytest.raises(InputError, match="--poses FILE"):
        read_bag(tmp_path / "a.bag")
    same_depth = read_bag(tmp_path / "a.bag", BagOptions(poses=tmp_path / "poses.txt")).capture.depth
    np.testing.assert_allclose(same_depth, 0.5)


def test_the_nearer_surface_wins_and_footprints_leave_no_holes() -> None:
    """Depth from a coarse camera onto a fine one: a bar before a wall hides it, and every pixel is filled."""
    of, onto = Intrinsics(40, 30, 30, 30, 19.5, 14.5), Intrinsics(160, 120, 117, 117, 79.5, 59.5)
    depth = np.full((30, 40), 1.0, np.float32)
    depth[:, 18:22] = 0.5
    out = laid_over(depth, of, onto, small_transform([0, 0, 0], [0.02, 0, 0]))
    inner = out[10:-10, 15:-15]
    assert set(np.unique(inner)) <= {0.0, 0.5, 1.0}
    left = onto.project(np.array([[(17.5 - 19.5) / 30 * 0.5 + 0.02, 0, 0.5]]))[0, 0]
    right = onto.project(np.array([[(21.5 - 19.5) / 30 * 0.5 + 0.02, 0, 0.5]]))[0, 0]
    columns = np.arange(160)
    bar = (columns > left) & (columns < right)
    assert np.all(out[20:-20, bar] == 0.5)
    assert np.all(out[20:-20, 20:60][:, columns[20:60] < left - 10] == 1.0)
    assert np.all(laid_over(np.zeros_like(depth), of, onto, np.eye(4)) == 0)


@pytest.mark.parametrize("model", ["plumb_bob", "Inverse Brown Conrady"])
def test_lens_distortion_is_taken_out(model: str) -> None:
    """A dot drawn where the lens puts it lies, straightened, where the pinhole does."""
    camera, D = Intrinsics(320, 240, 280, 282, 160, 119), np.array([-0.12, 0.05, 0.001, -0.002, 0.0])
    maker = BagMaker()
    maker.camera_info("/info", camera, model=model, D=D)
    straight = np.array([[60.0, 50.0], [250.0, 180.0], [160.0, 119.0]])
    rays = np.column_stack([(straight - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(3)])
    bent = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, D)[0].reshape(-1, 2)
    u, v = np.meshgrid(np.arange(320), np.arange(240))
    spots = sum(np.exp(-((u - x) ** 2 + (v - y) ** 2) / 8) for x, y in bent)
    maps = camera_of("/info", maker.messages[0][3]).maps
    image = straightened(np.asarray(spots, np.float32), maps, nearest=False)
    assert np.abs(bent[:2] - straight[:2]).max() > 1.5
    for x, y in straight:
        near = (np.abs(u - x) < 8) & (np.abs(v - y) < 8)
        centre = [float((image * w)[near].sum() / image[near].sum()) for w in (u, v)]
        np.testing.assert_allclose(centre, [x, y], atol=0.1)


def test_frames_without_partner_are_left_out_and_views_are_spread(tmp_path: Path) -> None:
    capture = truth(12)
    maker = ros_bag(capture=capture)
    maker.messages = [m for m in maker.messages if not (m[0] == POSE and m[2] < START + 1.9 * PERIOD)]
    maker.write(tmp_path / "a.bag")
    views = read_bag(tmp_path / "a.bag", BagOptions(views=4))
    assert "2 of 12 depth frames" in views.notes[0]
    assert "4 of 10" in views.notes[1]
    np.testing.assert_allclose(views.capture.T_world_cam, capture.T_world_cam[[2, 5, 8, 11]], atol=1e-9)


def without(*topics: str) -> Callable[[BagMaker], None]:
    def spoil(maker: BagMaker) -> None:
        maker.messages = [m for m in maker.messages if m[0] not in topics]

    return spoil


def second_colour(maker: BagMaker) -> None:
    maker.image("/other/color/image_raw", START, np.zeros((2, 2, 3), np.uint8), "rgb8")


def second_pose(maker: BagMaker) -> None:
    maker.pose("/other_pose", START, np.eye(4))


def odd_encoding(maker: BagMaker) -> None:
    for topic, _, _, message in maker.messages:
        if topic == COLOR:
            message.encoding = "bayer_rggb8"


def other_frame(maker: BagMaker) -> None:
    for topic, _, _, message in maker.messages:
        if topic == "/camera/aligned_depth_to_color/camera_info":
            message.header.frame_id = "elsewhere"


def late_colour(maker: BagMaker) -> None:
    without(COLOR)(maker)
    maker.image(COLOR, START + 60, np.zeros((24, 32, 3), np.uint8), "rgb8")


def odd_lens(maker: BagMaker) -> None:
    without("/camera/color/camera_info")(maker)
    maker.camera_info("/camera/color/camera_info", CAMERA, model="ftheta", D=(0.0,) * 4)


FAULTS = {
    "no colour": (without(COLOR), "0 topics with colour images"),
    "no depth": (without(DEPTH), "--depth-topic"),
    "no camera info": (without("/camera/color/camera_info"), "no camera info for"),
    "no poses": (without(POSE), "no poses"),
    "two colour topics": (second_colour, "2 topics with colour images"),
    "two pose topics": (second_pose, "--pose-topic"),
    "odd encoding": (odd_encoding, "bayer_rggb8; allowed: rgb8"),
    "depth not aligned": (other_frame, "align_depth"),
    "clocks differ": (late_colour, "nearest colour 59.6"),
    "odd lens": (odd_lens, "distortion model 'ftheta'"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_refused_in_words(tmp_path: Path, fault: str) -> None:
    spoil, message = FAULTS[fault]
    maker = ros_bag()
    spoil(maker)
    maker.write(tmp_path / "a.bag")
    with pytest.raises(InputError, match=message):
        read_bag(tmp_path / "a.bag")


def test_given_topics_are_used_and_checked(tmp_path: Path) -> None:
    maker = ros_bag()
    second_colour(maker)
    second_pose(maker)
    maker.write(tmp_path / "a.bag")
    same(read_bag(tmp_path / "a.bag", BagOptions(color_topic=COLOR, pose_topic=POSE)).capture, truth())
    for wrong in (BagOptions(color_topic="/none"), BagOptions(color_topic=COLOR, pose_topic="/none")):
        with pytest.raises(InputError, match="on /none"):
            read_bag(tmp_path / "a.bag", wrong)


@pytest.mark.parametrize(
    ("name", "share"),
    [(n, s) for n in ("a.bag", "a.mcap", "folder") for s in (0.0, 0.001, 0.3, 0.9)]
    + [("a.bag", 0.999), ("a.mcap", 0.999)],
)
def test_truncated_bags_are_refused_in_words(tmp_path: Path, name: str, share: float) -> None:
    ros_bag(name != "folder").write(tmp_path / name)
    path = tmp_path / name if name != "folder" else next(p for p in (tmp_path / name).iterdir() if p.suffix != ".yaml")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"allowed"):
        read_bag(tmp_path / name)


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_bag(tmp_path / "none.bag")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"metadata\.yaml"):
        read_bag(tmp_path / "empty")


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "no rows"), ("1 2 3\n", "shape"), ("a b\n", "unreadable"), ("0 0 0 0 0 0 0 2\n", "quaternion")],
)
@pytest.mark.filterwarnings("ignore:loadtxt")
def test_bad_trajectories_are_refused(tmp_path: Path, text: str, message: str) -> None:
    ros_bag().write(tmp_path / "a.bag")
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        read_bag(tmp_path / "a.bag", BagOptions(poses=tmp_path / "poses.txt"))


def test_a_missing_extra_names_the_install_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ros_bag().write(tmp_path / "a.bag")
    monkeypatch.setitem(__import__("sys").modules, "mcap", None)
    with pytest.raises(MissingExtra, match=r"pip install 'anther\[bags\]'"):
        read_bag(tmp_path / "a.bag")
    assert _bag_file.INSTALL == "pip install 'anther[bags]'"


def test_import_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ros_bag(ros1=False).write(tmp_path / "a.mcap")
    words = ["import", str(tmp_path / "a.mcap"), str(tmp_path / "capture"), "--overwrite"]
    assert main([*words, "--views", "3"]) == 0
    assert "note: 3 of 5 matched views" in capsys.readouterr().out
    same(Capture.load(tmp_path / "capture"), truth().select([0, 2, 4]))
    assert main([*words, "--tolerance", "0.001"]) == 2
    assert "Raise --tolerance" in capsys.readouterr().err
