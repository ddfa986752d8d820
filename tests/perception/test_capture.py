from __future__ import annotations

import contextlib
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anther.cli.args.import_ import Args
from anther.cli.import_ import run
from anther.core.errors import InputError
from anther.core.geometry import Intrinsics, look_at
from anther.perception.capture import Capture, CaptureWriter, viewed_box

CAMERA = Intrinsics(32, 24, 30.0, 31.0, 15.5, 11.25)


def small_capture(views: int = 3, *, colour: bool = True, joints: bool = True) -> Capture:
    rng = np.random.default_rng(views)
    depth = rng.uniform(0.3, 1.2, (views, 24, 32)).astype(np.float32)
    depth[:, :4] = 0
    poses = [look_at([np.cos(a), np.sin(a), 0.4], [0, 0, 0]) for a in np.linspace(0, 4, views)]
    return Capture(
        depth=depth,
        intrinsics=CAMERA,
        T_world_cam=np.stack(poses),
        rgb=rng.integers(0, 256, (views, 24, 32, 3)).astype(np.uint8) if colour else None,
        joints=rng.normal(size=(views, 7)) if joints else None,
    )


@pytest.mark.parametrize(("colour", "joints"), [(True, True), (False, False)])
def test_selected_views_are_those_views_in_that_order(colour: bool, joints: bool) -> None:
    capture = small_capture(4, colour=colour, joints=joints)
    for views in ([2, 0], np.array([True, False, False, True])):
        some = capture.select(views)
        for name in ("depth", "T_world_cam", "rgb", "joints"):
            mine, theirs = getattr(capture, name), getattr(some, name)
            assert (mine is None) == (theirs is None)
            assert mine is None or np.array_equal(mine[views], theirs)


@pytest.mark.parametrize(("colour", "joints"), [(True, True), (False, False)])
def test_round_trip(tmp_path: Path, colour: bool, joints: bool) -> None:
    capture = small_capture(colour=colour, joints=joints)
    capture.save(tmp_path / "capture")
    again = Capture.load(tmp_path / "capture")
    assert again.intrinsics == capture.intrinsics
    np.testing.assert_allclose(again.T_world_cam, capture.T_world_cam, atol=1e-12)
    assert np.abs(again.depth - capture.depth).max() <= 0.51e-4
    assert np.array_equal(again.depth == 0, capture.depth == 0)
    for name in ("rgb", "joints"):
        mine, theirs = getattr(capture, name), getattr(again, name)
        assert (mine is None) == (theirs is None)
        assert mine is None or np.array_equal(mine, theirs)
    assert {p.name for p in tmp_path.iterdir()} == {"capture"}


def test_far_depth_is_kept_to_a_millimetre(tmp_path: Path) -> None:
    capture = small_capture(colour=False)
    far = Capture(capture.depth * 10, CAMERA, capture.T_world_cam)
    far.save(tmp_path / "far")
    assert np.abs(Capture.load(tmp_path / "far").depth - far.depth).max() <= 0.51e-3


def test_only_the_view_that_sees_far_is_coarse(tmp_path: Path) -> None:
    depth = small_capture().depth.copy()
    depth[1, 5, 5] = 20.0
    near = small_capture()
    Capture(depth, near.intrinsics, near.T_world_cam, near.rgb).save(tmp_path / "capture")
    error = np.abs(Capture.load(tmp_path / "capture").depth - depth).max(axis=(1, 2))
    assert (error[[0, 2]] <= 0.51e-4).all()
    assert 0.51e-4 < error[1] <= 0.51e-3


def test_a_capture_whose_views_do_not_all_come_leaves_nothing(tmp_path: Path) -> None:
    capture = small_capture()
    with CaptureWriter(tmp_path / "capture") as writer:
        writer.add(capture.view(0))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("told", [0, 1, 3])
def test_a_capture_is_written_whole_though_other_views_were_added(tmp_path: Path, told: int) -> None:
    """What takes views may leave one out afterwards, or tell of none."""
    capture = small_capture(2)
    with CaptureWriter(tmp_path / "capture") as writer:
        for _ in range(told):
            writer.add(capture.view(0)._replace(depth=np.ones_like(capture.depth[0]), rgb=None))
        writer.finish(capture)
    read = Capture.load(tmp_path / "capture")
    assert read.views == 2
    np.testing.assert_allclose(read.depth, capture.depth, atol=0.51e-4)


def test_poses_are_written_in_nerfstudios_camera_frame(tmp_path: Path) -> None:
    capture = small_capture()
    capture.save(tmp_path / "c")
    meta = json.loads((tmp_path / "c" / "transforms.json").read_text())
    matrix = np.array(meta["frames"][0]["transform_matrix"])
    np.testing.assert_allclose(matrix[:3, 2], -capture.T_world_cam[0, :3, 2])  # it looks along -z
    np.testing.assert_allclose(matrix[:3, 0], capture.T_world_cam[0, :3, 0])
    assert meta["cx"] == CAMERA.cx + 0.5


def test_saving_replaces_a_capture_and_nothing_else(tmp_path: Path) -> None:
    small_capture(4).save(tmp_path / "c")
    small_capture(2).save(tmp_path / "c")
    assert Capture.load(tmp_path / "c").views == 2
    assert len(list((tmp_path / "c" / "depth").iterdir())) == 2
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match="not a capture"):
        small_capture().save(tmp_path / "mine")
    assert (tmp_path / "mine" / "letter.txt").read_text() == "dear"


def edit(folder: Path, change: dict[str, object]) -> None:
    path = folder / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))


def edit_frame(folder: Path, change: dict[str, object], frame: int = 1) -> None:
    frames = json.loads((folder / "transforms.json").read_text())["frames"]
    frames[frame] |= change
    edit(folder, {"frames": frames})


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-30])


def flip_byte(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))


SKEWED = [[1, 0.2, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
FAR = [[1, 0, 0, 600.0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
NOT_A_NUMBER = [[1, 0, 0, float("nan")], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]

FAULTS = {
    "no transforms.json": (lambda f: (f / "transforms.json").unlink(), "no such file"),
    "not JSON": (lambda f: (f / "transforms.json").write_text("{"), "not JSON"),
    "no frames": (lambda f: edit(f, {"frames": []}), "non-empty list 'frames'"),
    "depth missing": (lambda f: (f / "depth/0001.png").unlink(), "no such file"),
    "depth truncated": (lambda f: truncate(f / "depth/0001.png"), "truncated"),
    "depth damaged": (lambda f: flip_byte(f / "depth/0001.png"), "truncated or damaged"),
    "colour truncated": (lambda f: truncate(f / "rgb/0002.png"), "truncated"),
    "depth of 8 bits": (
        lambda f: cv2.imwrite(str(f / "depth/0000.png"), np.zeros((24, 32), np.uint8)),
        "one channel of 16 bits",
    ),
    "another size": (
        lambda f: cv2.imwrite(str(f / "rgb/0000.png"), np.zeros((24, 30, 3), np.uint8)),
        "30 x 24 px; allowed: 32 x 24",
    ),
    "mixed intrinsics": (lambda f: edit_frame(f, {"fl_x": 99.0}), "one camera for all views"),
    "distorted": (lambda f: edit(f, {"k1": 0.1}), "Undistort"),
    "no focal length": (lambda f: edit(f, {"fl_x": None}), "finite number"),
    "no pose": (lambda f: edit_frame(f, {"transform_matrix": [1, 2]}), "shape"),
    "NaN in a pose": (lambda f: edit_frame(f, {"transform_matrix": NOT_A_NUMBER}), "NaN"),
    "skewed pose": (lambda f: edit_frame(f, {"transform_matrix": SKEWED}), "frame 1.*rigid"),
    "pose in millimetres": (lambda f: edit_frame(f, {"transform_matrix": FAR}), "600 m"),
    "depth in metres": (lambda f: edit(f, {"depth_unit_scale_factor": 1.0}), "depth_unit_scale_factor"),
    "some without colour": (lambda f: edit_frame(f, {"file_path": None}), "for every frame or for none"),
    "odd joints": (lambda f: edit_frame(f, {"joints": [1, 2]}), "joints"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_bad_folders_get_one_clear_message(tmp_path: Path, fault: str) -> None:
    small_capture().save(tmp_path / "c")
    spoil, message = FAULTS[fault]
    spoil(tmp_path / "c")
    with pytest.raises(InputError, match=message):
        Capture.load(tmp_path / "c")


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures") / "c"
    small_capture(2).save(folder)
    return folder


anything = st.one_of(
    st.none(), st.booleans(), st.floats(), st.integers(-(10**9), 10**9), st.text(max_size=5),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)  # fmt: skip


@settings(max_examples=60)
@given(
    key=st.sampled_from(["fl_x", "w", "cy", "depth_unit_scale_factor", "k2", "frames"]),
    frame_key=st.sampled_from([None, "transform_matrix", "depth_file_path", "file_path", "joints", "fl_y"]),
    value=anything,
)
def test_any_value_in_transforms_json_loads_or_is_refused(
    saved: Path, key: str, frame_key: str | None, value: object
) -> None:
    path = saved / "transforms.json"
    good = path.read_text()
    meta = json.loads(good)
    if frame_key is None:
        meta[key] = value
    else:
        meta["frames"][1][frame_key] = value
    path.write_text(json.dumps(meta))
    try:
        with contextlib.suppress(InputError):
            assert Capture.load(saved).views == 2
    finally:
        path.write_text(good)


def test_slightly_rounded_rotations_are_repaired(tmp_path: Path) -> None:
    capture = small_capture()
    capture.save(tmp_path / "c")
    meta = json.loads((tmp_path / "c/transforms.json").read_text())
    for frame in meta["frames"]:
        frame["transform_matrix"] = np.round(frame["transform_matrix"], 4).tolist()
    edit(tmp_path / "c", meta)
    np.testing.assert_allclose(Capture.load(tmp_path / "c").T_world_cam, capture.T_world_cam, atol=2e-4)


def test_viewed_box_surrounds_what_the_cameras_look_at() -> None:
    target = np.array([0.7, -0.1, 0.2])
    poses = np.stack([look_at(target + np.array([np.cos(a), np.sin(a), 0.3]), target) for a in (0, 1, 2)])
    capture = Capture(np.full((3, 24, 32), 1.0), CAMERA, poses)
    box = viewed_box(capture)
    np.testing.assert_allclose((box.lower + box.upper) / 2, target, atol=1e-9)
    assert not box.contains(poses[:, :3, 3]).any()


def test_viewed_box_of_one_view_lies_at_the_depth_it_sees() -> None:
    capture = Capture(np.full((1, 24, 32), 0.8), CAMERA, look_at([0, 0, 0.5], [1, 0, 0.5])[None])
    box = viewed_box(capture)
    np.testing.assert_allclose((box.lower + box.upper) / 2, [0.8, 0, 0.5], atol=1e-6)


def test_a_kinect_import_keeps_scale_and_poses(data: Path, tmp_path: Path) -> None:
    source = data / "captures" / "sorghum_kinect"
    run(Args(source, tmp_path / "sorghum"))
    capture = Capture.load(tmp_path / "sorghum")
    meta = json.loads((source / "poses.json").read_text())
    assert capture.views == len(meta["frames"]) == 12
    assert capture.rgb is None
    raw = cv2.imread(str(source / meta["frames"][3]["file"]), cv2.IMREAD_UNCHANGED)
    assert raw is not None
    assert np.abs(capture.depth[3] - raw / 1000).max() < 1e-3
    mm = np.array(meta["frames"][3]["T_world_cam"])
    np.testing.assert_allclose(capture.T_world_cam[3, :3, 3], mm[:3, 3] / 1000, atol=1e-6)
    box = viewed_box(capture)
    assert box.contains([0, 0, 0])  # the turntable's axis


def test_a_kinect_import_says_what_is_missing(tmp_path: Path) -> None:
    (tmp_path / "poses.json").write_text('{"intrinsics": {}, "frames": []}')
    with pytest.raises(InputError, match="intrinsics"):
        run(Args(tmp_path, tmp_path / "out"))
    assert not (tmp_path / "out").exists()
