"""Bags of trackers and of compressed depth: whose pose is given, and how depth is packed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from made_bags import START, BagMaker
from test_formats_bags import CAMERA, COLOR, DEPTH, PERIOD, images, ros_bag, same, truth

from anther.core.cameras import straightening
from anther.core.errors import InputError
from anther.core.geometry import Intrinsics, inverse, pose7, small_transform
from anther.perception.formats.bags import BagOptions, read_bag

LINK, OPTICAL = small_transform([0.1, 0.2, 0.3], [0.02, -0.01, 0.05]), small_transform([-1.2, 0.4, 0], [0, 0.06, 0])
BODY = inverse(LINK @ OPTICAL)
"""T_cam_body: body -> link -> camera are fixed."""


def tracked(kind: str, *, moving_tf: bool) -> BagMaker:
    """A tracker's bag: a topic with the poses of its body, and tf with the fixed frames, perhaps moving ones."""
    capture, maker = truth(), BagMaker(ros1=False)
    maker.camera_info("/camera/color/camera_info", CAMERA)
    images(maker, capture)
    maker.tf("/tf_static", START, [("body", "link", LINK), ("link", "camera", OPTICAL)])
    for i, T in enumerate(capture.T_world_cam):
        time = START + i * PERIOD
        if kind == "pose":
            maker.pose("/tracker/pose", time, T @ BODY)
        else:
            maker.odometry("/tracker/odom", time, T @ BODY, kind)
        if moving_tf:
            maker.tf("/tf", time, [("map", "body", T @ BODY)])
    return maker


@pytest.mark.parametrize("kind", ["pose", "body", ""])
def test_tf_that_moves_the_camera_is_better_than_a_topic(tmp_path: Path, kind: str) -> None:
    tracked(kind, moving_tf=True).write(tmp_path / "a")
    views = read_bag(tmp_path / "a")
    same(views.capture, truth())
    assert any("is not used (--pose-topic)" in note for note in views.notes)


def test_the_poses_of_a_body_are_carried_to_the_camera(tmp_path: Path) -> None:
    tracked("body", moving_tf=False).write(tmp_path / "a")
    views = read_bag(tmp_path / "a")
    same(views.capture, truth())
    assert any("gives the poses of 'body'" in note for note in views.notes)
    tracked("stranger", moving_tf=False).write(tmp_path / "b")
    with pytest.raises(InputError, match="poses of 'stranger', a camera in 'camera'"):
        read_bag(tmp_path / "b")
    same(read_bag(tmp_path / "b", BagOptions(pose_frame="body")).capture, truth())
    offset = tuple(pose7(LINK @ OPTICAL).tolist())
    same(read_bag(tmp_path / "b", BagOptions(camera_in_pose=offset)).capture, truth())  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["pose", ""])
def test_a_pose_that_does_not_say_whose_it_is_is_refused_where_it_may_be_the_body(tmp_path: Path, kind: str) -> None:
    tracked(kind, moving_tf=False).write(tmp_path / "a")
    with pytest.raises(InputError, match=r"poses of an unnamed frame.*--pose-frame camera, or another of body, link"):
        read_bag(tmp_path / "a")
    same(read_bag(tmp_path / "a", BagOptions(pose_frame="body")).capture, truth())


def test_a_topic_that_is_named_is_taken(tmp_path: Path) -> None:
    """Also where tf would give it: the body's pose is the camera's only if that is said."""
    maker = tracked("body", moving_tf=True)
    maker.write(tmp_path / "a")
    same(read_bag(tmp_path / "a", BagOptions(pose_topic="/tracker/odom")).capture, truth())


def rvl(steps: np.ndarray) -> bytes:
    """The publication's encoder (Wilson 2017), in plain Python."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        while True:
            part, value = value & 7, value >> 3
            nibbles.append(part | (8 if value else 0))
            if not value:
                return

    flat, at, last = steps.ravel().astype(int).tolist(), 0, 0
    while at < len(flat):
        zeros = next((k for k, v in enumerate(flat[at:]) if v), len(flat) - at)
        at += zeros
        run = next((k for k, v in enumerate(flat[at:]) if not v), len(flat) - at)
        put(zeros)
        put(run)
        for value in flat[at : at + run]:
            delta, last = value - last, value
            put((delta << 1) ^ (delta >> 31))
        at += run
    nibbles += [0] * (-len(nibbles) % 8)
    words = [sum(n << (28 - 4 * k) for k, n in enumerate(nibbles[i : i + 8])) for i in range(0, len(nibbles), 8)]
    return np.array(steps.shape[::-1], "<u4").tobytes() + np.array(words, "<u4").tobytes()


def png(steps: np.ndarray) -> bytes:
    return cv2.imencode(".png", steps)[1].tobytes()


A, B = 10100.0, -1009.0
"""compressed_depth_image_transport's two numbers for depth to 10 m, its precision 100."""
PLAIN = np.zeros(12, np.uint8).tobytes()
PACKED = np.zeros(1, "<i4").tobytes() + np.array([A, B], "<f4").tobytes()


@pytest.mark.parametrize(
    ("form", "topic", "pack", "metres"),
    [
        ("16UC1; compressedDepth", "compressedDepth", lambda s: PLAIN + png(s), False),
        ("16UC1; compressedDepth png", "compressedDepth", lambda s: PLAIN + png(s), False),
        ("16UC1; compressedDepth rvl", "compressedDepth", lambda s: PLAIN + rvl(s), False),
        ("16UC1; png compressed ", "compressed", png, False), ("mono16; png compressed", "compressed", png, False),
        ("png", "compressed", png, False),
        ("32FC1; compressedDepth", "compressedDepth", lambda s: PACKED + png(s), True),
        ("32FC1; compressedDepth png", "compressedDepth", lambda s: PACKED + png(s), True),
        ("32FC1; compressedDepth rvl", "compressedDepth", lambda s: PACKED + rvl(s), True),
    ],
)  # fmt: skip
def test_packed_depth(tmp_path: Path, form: str, topic: str, pack, metres: bool) -> None:
    wanted, maker = truth(), ros_bag(False)
    maker.messages = [m for m in maker.messages if m[0] != DEPTH]
    for i, depth in enumerate(wanted.depth):
        with np.errstate(divide="ignore"):
            steps = np.where(depth > 0, A / depth + B if metres else 1000 * depth, 0)
        data = pack(np.round(steps).astype(np.uint16))
        maker.compressed(f"{DEPTH}/{topic}", START + i * PERIOD, data, form)
    maker.write(tmp_path / "a")
    same(read_bag(tmp_path / "a").capture, wanted, 1e-4 if metres else 1e-6)


@pytest.mark.parametrize(
    ("form", "data"),
    [
        ("32FC1; compressedDepth", png(np.ones((24, 32), np.uint16))), ("16UC1; jpeg compressed", b"\xff\xd8\xff\xd9"),
        ("32FC1; compressedDepth rvl", PACKED + rvl(np.ones((24, 32), np.uint16))[:-4]),
        ("bgr8; png compressed", png(np.ones((24, 32), np.uint16))),
        ("16UC1; compressedDepth rvl", PLAIN + np.array([2**31, 2**31], "<u4").tobytes()),
    ],
)  # fmt: skip
def test_packed_depth_that_is_damaged_or_unknown_is_refused(tmp_path: Path, form: str, data: bytes) -> None:
    maker = ros_bag(False)
    maker.messages = [m for m in maker.messages if m[0] != DEPTH]
    for i in range(5):
        maker.compressed(f"{DEPTH}/compressed", START + i * PERIOD, data, form)
    maker.write(tmp_path / "a")
    with pytest.raises(InputError, match="aligned_depth_to_color"):
        read_bag(tmp_path / "a")


def test_rectified_images_have_no_lens_left_and_the_projection_as_camera(tmp_path: Path) -> None:
    capture, maker = truth(), BagMaker()
    rectified = "/camera/color/image_rect_color"
    maker.camera_info("/camera/color/camera_info", CAMERA, D=(0.3, 0, 0, 0, 0))
    info = maker.messages[-1][3]
    info.K = info.K * 1.1
    info.P[:] = np.c_[CAMERA.matrix, np.zeros(3)].ravel()
    images(maker, capture)
    maker.messages = [(rectified if m[0] == COLOR else m[0], *m[1:]) for m in maker.messages]
    for i, T in enumerate(capture.T_world_cam):
        maker.pose("/pose", START + i * PERIOD, T)
    maker.write(tmp_path / "a.bag")
    same(read_bag(tmp_path / "a.bag").capture, capture)


def with_info(change: Callable[[Any], None], **lens: Any) -> BagMaker:
    maker = ros_bag(False)
    maker.messages = [m for m in maker.messages if m[0] != "/camera/color/camera_info"]
    maker.camera_info("/camera/color/camera_info", CAMERA, **lens)
    change(maker.messages[-1][3])
    return maker


def binned(info: Any) -> None:
    """The whole sensor is twice as fine."""
    info.binning_x = info.binning_y = 2
    info.width, info.height = 2 * info.width, 2 * info.height
    info.k = np.array([2, 1, 2, 1, 2, 2, 1, 1, 1]) * info.k + [0, 0, 0.5, 0, 0, 0.5, 0, 0, 0]


def cropped(info: Any) -> None:
    """The image begins at column 10, row 20 of the sensor."""
    roi, shift = info.roi, [0, 0, 10, 0, 0, 20, 0, 0, 0]
    roi.x_offset, roi.y_offset, roi.width, roi.height = 10, 20, info.width, info.height
    info.width, info.height, info.k = info.width + 40, info.height + 40, info.k + shift


@pytest.mark.parametrize("change", [binned, cropped])
def test_binning_and_the_region_of_a_camera_info_are_used(tmp_path: Path, change: Callable[[Any], None]) -> None:
    with_info(change).write(tmp_path / "a")
    views = read_bag(tmp_path / "a").capture
    same(views, truth())
    assert views.intrinsics == CAMERA


def skewed(info: Any) -> None:
    info.k[1] = 3.0


def finer(info: Any) -> None:
    info.width, info.height = 2 * info.width, 2 * info.height


@pytest.mark.parametrize(("change", "words"), [(skewed, "skew 3 px"), (finer, "camera info of 64 x 48 px")])
def test_a_camera_info_that_is_not_of_the_images_is_refused(tmp_path: Path, change: Any, words: str) -> None:
    with_info(change).write(tmp_path / "a")
    with pytest.raises(InputError, match=words):
        read_bag(tmp_path / "a")


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 5, 8, 12, 14])
def test_lenses_of_any_number_of_zeros_or_coefficients(tmp_path: Path, count: int) -> None:
    model = "plumb_bob" if count < 6 else "rational_polynomial"
    with_info(lambda info: None, model=model, D=(0.0,) * count).write(tmp_path / "a")
    same(read_bag(tmp_path / "a").capture, truth())
    if count:
        with_info(lambda info: None, model=model, D=(-0.05, *(0.0,) * (count - 1))).write(tmp_path / "b")
        assert read_bag(tmp_path / "b").capture.intrinsics == CAMERA


@pytest.mark.parametrize("k1", [0.0, 0.05])
def test_a_fisheye_lens_is_taken_out_also_where_its_coefficients_are_zero(k1: float) -> None:
    camera = Intrinsics(200, 160, 90.0, 90.0, 99.5, 79.5)
    maps = straightening("", camera, np.array([k1, 0, 0, 0, 0]), "equidistant")
    assert maps is not None
    across, down = (camera.rays()[..., k] for k in (0, 1))
    radius = np.hypot(across, down)
    angle = np.arctan(radius)
    grow = (angle + k1 * angle**3) / np.maximum(radius, 1e-12)
    np.testing.assert_allclose(maps[0], camera.cx + camera.fx * grow * across, atol=1e-2)
    np.testing.assert_allclose(maps[1], camera.cy + camera.fy * grow * down, atol=1e-2)
    with pytest.raises(InputError, match="5 coefficients"):
        straightening("", camera, np.array([0, 0, 0, 0, 0.1]), "equidistant")


def test_a_frame_of_two_parents_and_a_camera_that_stands_are_refused(tmp_path: Path) -> None:
    maker = ros_bag(False)
    maker.messages = [m for m in maker.messages if "pose" not in m[0]]
    for i, T in enumerate(truth().T_world_cam):
        maker.tf("/tf", START + i * PERIOD, [("world", "camera", T)])
    maker.write(tmp_path / "a")
    same(read_bag(tmp_path / "a").capture, truth())
    maker.tf("/tf", START, [("odom", "camera", np.eye(4))])
    maker.write(tmp_path / "b")
    with pytest.raises(InputError, match="'camera' has the parents odom and world"):
        read_bag(tmp_path / "b")
    maker.messages = [m for m in maker.messages if m[0] != "/tf"]
    maker.tf("/tf_static", START, [("world", "camera", np.eye(4))])
    maker.write(tmp_path / "c")
    with pytest.raises(InputError, match="one and the same pose"):
        read_bag(tmp_path / "c")
