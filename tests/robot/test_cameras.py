"""Live cameras: what they show, when it was taken, what is lost, and what happens when one stops and comes back."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import made_realsense
import numpy as np
import pytest
from live_cameras import RATE, WEBCAM, Bench, FakeWebcam, realsense, running, webcam
from made_realsense import COLOR, DEPTH, LENS, SHIFT, TURN, UNIT

from anther.core.cameras import laid_over, straightened, straightening
from anther.core.errors import InputError, MissingExtra
from anther.core.geometry import Intrinsics, small_transform
from anther.robot.devices import DeviceError, Frame
from anther.robot.drivers import free_running
from anther.robot.drivers import realsense as driver
from anther.robot.drivers.free_running import FreeRunningCamera
from anther.robot.drivers.realsense import RealSense, load_sdk, open_realsense, open_recording
from anther.robot.drivers.uvc import Uvc, open_uvc

DEPTH_CAMERA, COLOR_CAMERA = (
    Intrinsics(int(c["width"]), int(c["height"]), c["fx"], c["fy"], c["ppx"], c["ppy"]) for c in (DEPTH, COLOR)
)


@pytest.fixture(scope="session")
def rs() -> Any:
    try:
        return load_sdk()
    except MissingExtra as error:
        pytest.skip(str(error))


@pytest.fixture
def bench(rs: Any) -> Iterator[Bench]:
    with running(Bench()) as bench:
        yield bench


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cameras are tried again soon; on a busy machine they have longer to answer."""
    monkeypatch.setattr(FreeRunningCamera, "_again", 0.1)
    for module in (free_running, driver):
        monkeypatch.setattr(module, "STALLED", 1.5)


def until(true: Callable[[], Any], seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it never came to that"
        time.sleep(0.01)


def refused(camera: FreeRunningCamera) -> str:
    """What the camera says when it is asked for a frame; "" if it gives one."""
    try:
        camera.read()
    except DeviceError as error:
        return str(error)
    return ""


def shown(frame: Frame) -> int:
    """Which of the software camera's eight pictures a frame is."""
    return round(float(np.median(frame.rgb[..., 2])) / 10)


def test_a_realsense_gives_straight_colour_and_depth_laid_over_it(bench: Bench) -> None:
    with realsense(bench) as camera:
        frames = [camera.read() for _ in range(4)]
    assert camera.intrinsics == COLOR_CAMERA
    maps, T = straightening("", COLOR_CAMERA, np.array(LENS), "plumb_bob"), small_transform([0, 0, TURN], SHIFT)
    for frame in frames:
        k = shown(frame)
        np.testing.assert_array_equal(frame.rgb, straightened(made_realsense.colours(k), maps, nearest=False))
        steps = made_realsense.depth_steps(k) * np.float32(UNIT)
        wanted = laid_over(steps, DEPTH_CAMERA, COLOR_CAMERA, T)
        assert np.mean(np.abs(frame.depth - wanted) < 1e-5) > 0.999
    assert len({frame.time for frame in frames}) == 4


def test_both_streams_may_come_from_one_sensor(rs: Any) -> None:
    """As in a D405, whose colour comes from its stereo module."""
    with running(Bench()) as bench:
        bench.camera = made_realsense.SoftwareCamera(rs, one_sensor=True)
        with realsense(bench) as camera:
            frame = camera.read()
    assert {round(float(x), 3) for x in np.unique(frame.depth)} == {0.0, 0.298, 0.598}
    assert frame.rgb[..., 0].max() > 80


def test_a_camera_s_clock_may_begin_anew(rs: Any) -> None:
    with running(Bench(domain="hardware_clock", lag=50.0)) as bench, realsense(bench) as camera:
        camera.read()
        bench.lag = 5000.0
        for _ in range(3):
            asked = time.monotonic()
            assert asked <= camera.read().time <= time.monotonic()


@pytest.mark.parametrize("domain", ["global_time", "system_time", "hardware_clock"])
def test_frames_are_stamped_on_the_robot_s_clock(rs: Any, domain: str) -> None:
    """A hardware clock that began 50 s before ours, a robot's clock 1000 s after it."""
    lag = 50.0 if domain == "hardware_clock" else 0.0
    clock = lambda: time.monotonic() + 1000  # noqa: E731
    with running(Bench(domain=domain, lag=lag)) as bench, realsense(bench, warm_up=10, clock=clock) as camera:
        for _ in range(10):
            asked = clock()
            frame = camera.read()
            assert asked <= frame.time <= clock()


def test_a_stamp_is_moved_to_the_middle_of_the_exposure(bench: Bench) -> None:
    with realsense(bench) as camera:
        bench.sensor_lag = 0.0
        camera.start(RATE)
        time.sleep(0.3)
        plain = camera.stop()
        bench.sensor_lag = 0.04
        time.sleep(0.1)
        camera.start(RATE)
        time.sleep(0.3)
        moved = camera.stop()
    late = [f.time - time.monotonic() for f in (plain[-1], moved[-1])]
    gap = moved[0].time - plain[-1].time
    assert late[0] < late[1] < 0
    assert 0.0 < gap < 0.2
    told = {1: 5_012_000, 2: 5_000_000}
    frame = SimpleNamespace(supports_frame_metadata=lambda v: True, get_frame_metadata=lambda v: told[v])
    named = SimpleNamespace(frame_metadata_value=SimpleNamespace(frame_timestamp=1, sensor_timestamp=2))
    source = driver.Stamps(named, time.monotonic)
    assert source._since_exposure(frame) == pytest.approx(0.012)


def test_lost_frames_are_counted(bench: Bench) -> None:
    with realsense(bench) as camera:
        camera.read()
        before, first = camera.health(), bench.number + 3
        bench.skipped = set(range(first, first + 5))
        until(lambda: bench.number > first + 10)
        until(lambda: camera.health().received > before.received + 5)
        lost = camera.health().lost - before.lost
    assert lost >= 5
    assert lost <= bench.number - before.received


def test_an_unplugged_realsense_says_so_and_comes_back(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    # a busy computer asks late; the next try says something else
    monkeypatch.setattr(FreeRunningCamera, "_again", 3.0)
    with realsense(bench) as camera:
        camera.start(RATE)
        camera.read()
        bench.plugged = False
        until(lambda: "unplugged" in camera.health().fault)
        began = time.monotonic()
        with pytest.raises(DeviceError, match=r"unplugged.*Plug it in"):
            camera.read()
        with pytest.raises(DeviceError, match="unplugged"):
            camera.start(RATE)
        with pytest.raises(DeviceError, match=r"no frame since.*unplugged"):
            camera.recorded(time.monotonic())
        assert time.monotonic() - began < 0.2  # nobody waits for a camera that is known to be gone
        kept = len(camera.recorded(0))
        bench.plugged = True
        until(lambda: not refused(camera))
        assert camera.health().stops >= 1
        assert len(camera.stop()) > kept


def test_a_realsense_that_only_falls_silent_is_opened_anew(bench: Bench) -> None:
    with realsense(bench) as camera:
        bench.skipped = set(range(bench.number, bench.number + round(4 * RATE)))
        until(lambda: "no frame in 1.5 s, though it is connected" in camera.health().fault)
        until(lambda: not refused(camera))
        assert camera.health().stops >= 1


def test_another_camera_never_takes_its_place(bench: Bench) -> None:
    other = made_realsense.SoftwareCamera(bench.rs, serial="77")
    source = RealSense(devices=lambda: [*bench.found(), *([] if bench.plugged else [other.device])])
    with FreeRunningCamera(source, warm_up=2) as camera:
        bench.plugged = False
        until(lambda: "RealSense 0123: not connected; there are 77" in camera.health().fault)
        assert "there are 77" in refused(camera)
        bench.plugged = True
        until(lambda: not refused(camera))


def test_a_camera_that_came_back_changed_is_refused(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    with realsense(bench) as camera:
        bench.plugged = False
        until(lambda: camera.health().fault)
        monkeypatch.setitem(COLOR, "fx", 77.0)
        bench.camera = made_realsense.SoftwareCamera(bench.rs)
        bench.plugged = True
        until(lambda: "came back as another" in refused(camera))
        assert camera.intrinsics == COLOR_CAMERA, "what was promised of every frame stays"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"serial": "9"}, "RealSense 9: not connected; there are 0123"),
        ({"size": (1280, 720), "rate": 30}, r"\(1280, 720\) px at 30 Hz; it has \(64, 48\) at 30 on USB 3.2"),
        ({"preset": "High Accuracy"}, "preset 'High Accuracy'; it has none"),
    ],
)
def test_what_a_realsense_cannot_do_is_refused(bench: Bench, options: dict[str, Any], message: str) -> None:
    with pytest.raises(DeviceError, match=message):
        realsense(bench, **options)
    with realsense(bench) as camera:  # nothing was left open
        camera.read()


def test_none_or_several_connected(rs: Any) -> None:
    with pytest.raises(DeviceError, match="none is connected"):
        FreeRunningCamera(RealSense(devices=list))
    two = [made_realsense.SoftwareCamera(rs, serial=name).device for name in ("a", "b")]
    with pytest.raises(DeviceError, match=r"2 are connected.*: a, b"):
        FreeRunningCamera(RealSense(devices=lambda: two))
    with pytest.raises(DeviceError, match="none is connected"):
        open_realsense()


def test_streams_that_nothing_joins_are_refused(rs: Any) -> None:
    apart = made_realsense.SoftwareCamera(rs, joined=False)
    with pytest.raises(DeviceError, match="RealSense: "):
        FreeRunningCamera(RealSense(devices=lambda: [apart.device]))


def test_a_realsense_that_gives_nothing_is_refused(rs: Any) -> None:
    silent = made_realsense.SoftwareCamera(rs)
    with pytest.raises(DeviceError, match="no frame in"):
        FreeRunningCamera(RealSense(devices=lambda: [silent.device]))


def test_a_preset_is_chosen_by_its_name(rs: Any) -> None:
    """The SDK's software sensor has no presets: this one answers as a D400's depth sensor does."""
    names, chosen = ["Custom", "Default", "Hand", "High Accuracy"], dict[Any, float]()
    sensor = SimpleNamespace(
        supports=lambda option: option == rs.option.visual_preset,
        get_option_range=lambda option: SimpleNamespace(min=0.0, max=3.0, step=1.0),
        get_option_value_description=lambda option, value: names[int(value)],
        set_option=chosen.__setitem__,
    )
    source = RealSense(preset="high accuracy", devices=list)
    source._set_up(SimpleNamespace(query_sensors=lambda: [sensor]), (sensor, None))
    assert chosen == {rs.option.visual_preset: 3.0}


@pytest.mark.slow
def test_a_recording_is_played_as_a_camera(rs: Any, tmp_path: Path) -> None:
    made_realsense.record(rs, tmp_path / "a.db3", frames=120)  # 4 s: the reads of a busy machine come before the end
    camera = FreeRunningCamera(RealSense(devices=open_recording(str(tmp_path / "a.db3"))), warm_up=1)
    with camera:
        frames = [camera.read() for _ in range(5)]
        until(lambda: "no frame in" in refused(camera), 30)
    assert np.all(np.diff([f.time for f in frames]) > 0)
    assert camera.intrinsics == COLOR_CAMERA
    assert {round(float(x), 3) for f in frames for x in np.unique(f.depth)} == {0.0, 0.298, 0.598}


def test_a_missing_sdk_names_the_install_command(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("pyrealsense2", "libusb_package"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtra, match=r"pip install 'anther\[realsense\]'"):
        open_realsense()


def test_a_webcam_gives_rgb_without_depth() -> None:
    fake = FakeWebcam()
    with webcam(fake) as camera:
        asked = time.monotonic()
        frame = camera.read()
        assert asked <= frame.time <= time.monotonic()
    assert frame.rgb.shape == (30, 40, 3)
    assert tuple(frame.rgb[0, 0, 1:]) == (2, 1)  # OpenCV gives blue first
    assert not frame.depth.any()
    assert fake.asked[cv2.CAP_PROP_FRAME_WIDTH] == 40
    assert fake.asked[cv2.CAP_PROP_FPS] == RATE


def test_rate_and_losses_of_a_webcam_are_measured() -> None:
    fake = FakeWebcam(rate=40.0)
    fake.skipped = set(range(20, 26))
    with webcam(fake) as camera:
        until(lambda: camera.health().received >= 60)
        health = camera.health()
    assert 15 < health.rate < 41
    assert health.lost >= 5
    assert health.longest_gap > 5 / 40


def test_a_camera_offers_the_rate_that_it_has_and_whole_parts_of_it_not_what_it_was_asked_for() -> None:
    with FreeRunningCamera(Uvc(0, WEBCAM, rate=90.0, opener=FakeWebcam(rate=40.0)), 2) as camera:
        until(lambda: camera.health().received >= 20)
        first, *rest = camera.rates
        camera.start(rest[0])
        time.sleep(1.0)
        gaps = np.diff([f.time for f in camera.stop()])
    assert first == pytest.approx(40, rel=0.2)
    assert rest == pytest.approx([first / 2, first / 3, first / 4, first / 6])
    assert np.median(gaps) == pytest.approx(2 / first, rel=0.2)


def test_a_camera_that_has_stopped_offers_no_rate() -> None:
    fake = FakeWebcam()
    with webcam(fake) as camera:
        fake.there = False
        until(lambda: bool(camera.health().fault))
        with pytest.raises(DeviceError):
            _ = camera.rates


def test_a_recording_is_thinned_to_the_rate_asked_for() -> None:
    with webcam(FakeWebcam(rate=100.0)) as camera:
        camera.start(20.0)
        time.sleep(1.0)
        frames = camera.stop()
    gaps = np.diff([f.time for f in frames])
    assert 5 <= len(frames) <= 22
    assert gaps.mean() > 0.04


def test_of_a_long_recording_the_end_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FreeRunningCamera, "_most_bytes", 7 * 40 * 30 * 5)
    with webcam(FakeWebcam()) as camera:
        camera.start(RATE)
        until(lambda: camera.health().received > 20)
        last = camera.read().time
        frames = camera.stop()
    assert len(frames) == 5
    assert frames[-1].time >= last - 0.1


def test_a_webcam_s_latency_and_its_own_stamps() -> None:
    """V4L2 stamps this one 20 ms before it is grabbed; the other says nothing, and the latency is known."""
    for fake, options, late in ((FakeWebcam(stamped=True), {}, 0.02), (FakeWebcam(), {"latency": 0.1}, 0.1)):
        source = Uvc(0, WEBCAM, rate=RATE, opener=fake, **options)
        source.open()
        shot = source.next()
        assert time.monotonic() - shot.time == pytest.approx(late, abs=0.015)


def test_a_damaged_frame_is_lost_and_the_next_is_given() -> None:
    fake = FakeWebcam()
    with webcam(fake) as camera:
        fake.damaged = set(range(fake.number, fake.number + 4))
        assert camera.read().rgb[0, 0, 0] not in fake.damaged  # this webcam's red is the frame's number
        assert camera.health().lost >= 1


def test_a_webcam_that_stops_says_so_and_comes_back() -> None:
    fake = FakeWebcam()
    with webcam(fake) as camera:
        camera.start(RATE)
        camera.read()
        fake.there = False
        until(lambda: camera.health().fault)
        assert "Is it plugged in" in refused(camera) or "no more frames" in refused(camera)
        assert camera.stop()
        fake.there = True
        until(lambda: not refused(camera))
    assert fake.opens >= 2


def test_a_recording_of_which_all_is_lost() -> None:
    fake = FakeWebcam()
    with webcam(fake) as camera:
        fake.damaged = set(range(10**6))
        time.sleep(0.1)
        camera.start(RATE)
        time.sleep(0.2)
        with pytest.raises(DeviceError, match="all frames of the recording were lost"):
            camera.stop()
        with pytest.raises(DeviceError, match=r"no frame in 1\.5 s"):
            camera.read()
        assert camera.stop() == []
        with pytest.raises(DeviceError, match="records nothing"):
            camera.recorded(0)


def test_webcams_that_cannot_be_used_are_refused() -> None:
    gone = FakeWebcam()
    gone.there = False
    with pytest.raises(DeviceError, match="cannot be opened"):
        webcam(gone)
    with pytest.raises(DeviceError, match=r"images of \(64, 48\) px; its intrinsics are of \(40, 30\)"):
        webcam(FakeWebcam(size=(64, 48)))
    with pytest.raises(DeviceError, match="cannot be opened"):
        open_uvc("none.avi", WEBCAM)
    for wrong in ({"lens": (0.1,)}, {"rate": 0.0}, {"latency": -1.0}):
        with pytest.raises(InputError):
            Uvc(0, WEBCAM, **wrong)


def test_a_video_file_is_played_in_its_own_time(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    for k in range(25):
        writer.write(np.full((48, 64, 3), 8 * k, np.uint8))
    writer.release()
    camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    source, began = Uvc(str(tmp_path / "a.avi"), camera), time.monotonic()
    with FreeRunningCamera(source, warm_up=0) as live:
        live.start(25.0)
        until(lambda: "at its end" in live.health().fault)
        frames = live.stop()
        assert time.monotonic() - began > 0.9
        assert "at its end" in refused(live)
        time.sleep(0.3)
        assert live.health().received == 25
    np.testing.assert_allclose(np.diff([f.time for f in frames]), 0.04, atol=1e-6)
    levels = [float(f.rgb.mean()) for f in frames]
    assert levels == sorted(levels)
    assert len(frames) >= 23


def test_a_library_s_own_error_is_no_end(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = FakeWebcam()
    with webcam(fake) as camera:
        monkeypatch.setattr(fake, "grab", lambda: 1 / 0)
        until(lambda: "division" in refused(camera))
        monkeypatch.undo()
        until(lambda: not refused(camera))
        assert camera.health().stops >= 1
