"""Drivers of a hand's inertial sensor: a RealSense of the SDK's `software_device`, and a topic of ROS 2."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import made_realsense
import numpy as np
import pytest
from fake_ros2 import FakeNode

from anther.core.errors import MissingExtra
from anther.core.geometry import transform
from anther.robot.devices import DeviceError, Imu
from anther.robot.drivers.realsense import load_sdk
from anther.robot.drivers.realsense_imu import RealSenseImu
from anther.robot.drivers.ros2_imu import Ros2Imu
from anther.robot.imu_testing import IMU_CHECKS, ImuRig, check_imu_readings

RATES = {"accel": 250, "gyro": 400}
PLACE = (-0.0055, 0.0051, 0.0117)
"""Of the sensor in the frame of the depth lens [m]."""
TONE = 6.0
"""Hz, of what is read: the accelerometer's x, the gyroscope's y."""


@pytest.fixture(scope="module")
def rs() -> Any:
    try:
        return load_sdk()
    except MissingExtra as error:
        pytest.skip(str(error))


class MovedCamera:
    """A software RealSense whose inertial sensor reads a swing until it is told to stop; `silent`: it reads nothing."""

    def __init__(self, rs: Any, *, kinds: tuple[str, ...] = ("accel", "gyro"), late: float = 0.0) -> None:
        self.rs, self.camera, self.silent, self._late = rs, made_realsense.SoftwareCamera(rs), False, late
        self.swing = 1.0
        self._sensor, self._profiles = self.camera.device.add_sensor("Motion Module"), dict[str, Any]()
        for number, kind in enumerate(kinds):
            for slow in (2, 1):  # the slower profile comes first
                stream = rs.motion_stream()
                stream.type, stream.fmt = getattr(rs.stream, kind), rs.format.motion_xyz32f
                stream.index, stream.uid, stream.fps = 0, 20 + 2 * number + slow, RATES[kind] // slow
                profile = self._sensor.add_motion_stream(stream)
                between = rs.extrinsics()
                between.rotation, between.translation = [1.0, 0, 0, 0, 1, 0, 0, 0, 1], list(PLACE)
                profile.register_extrinsics_to(self.camera.profiles[0], between)
            self._profiles[kind] = profile
        self._on = True
        self._threads = [threading.Thread(target=self._run, args=(kind,), daemon=True) for kind in kinds]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        self._on = False
        for thread in self._threads:
            thread.join()

    def _run(self, kind: str) -> None:
        number = 0
        while self._on:
            time.sleep(1 / RATES[kind])
            number += 1
            if self.silent:
                continue
            now, data = time.time(), self.rs.vector()
            swung = self.swing * float(np.sin(2 * np.pi * TONE * now))
            data.x, data.y, data.z = (swung, -9.81, 0.0) if kind == "accel" else (0.0, swung, 0.0)
            frame = self.rs.software_motion_frame()
            frame.data, frame.timestamp, frame.frame_number = data, 1e3 * (now + self._late), number
            frame.domain = self.rs.timestamp_domain.global_time
            frame.profile = self._profiles[kind].as_motion_stream_profile()
            with suppress(RuntimeError):  # while it is closed
                self._sensor.on_motion_frame(frame)


@contextmanager
def moved(rs: Any, **how: Any) -> Iterator[MovedCamera]:
    camera = MovedCamera(rs, **how)
    try:
        yield camera
    finally:
        camera.stop()


def is_imu(sensor: Imu) -> Imu:
    """Take what is one, for the type checker."""
    return sensor


def test_a_realsense_s_accelerometer_and_gyroscope_come_together_on_the_robot_s_clock(rs: Any) -> None:
    clock = lambda: time.monotonic() + 1000  # noqa: E731
    with moved(rs) as camera, closing(RealSenseImu(clock=clock, devices=lambda: [camera.camera.device])) as sensor:
        imu, begin = is_imu(sensor), clock()
        imu.start()
        assert not len(imu.recorded(clock() + 1).times)
        time.sleep(0.6)
        told, now = imu.recorded(begin), clock()
        imu.stop()
        assert not len(imu.recorded(begin).times)
    assert begin - 0.01 <= told.times[0]
    assert told.times[-1] <= now
    assert np.all(np.diff(told.times) > 0)
    assert len(told.times) > 0.3 * RATES["accel"] * 0.6, "at the fastest rate, on a busy machine"
    lag = time.time() - clock()
    swung = np.sin(2 * np.pi * TONE * (told.times + lag))
    assert np.abs(told.acceleration[:, 0] - swung).max() < 0.1
    assert told.acceleration[:, 1] == pytest.approx(-9.81)
    assert np.median(np.abs(told.rate[:, 1] - swung)) < 0.05, "the gyroscope's are of the accelerometer's times"


def test_where_the_sensor_is_the_camera_says(rs: Any) -> None:
    between = transform(np.eye(3), PLACE)
    c, s = np.cos(made_realsense.TURN), np.sin(made_realsense.TURN)
    colour = transform(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), made_realsense.SHIFT)
    with moved(rs) as camera, closing(RealSenseImu(devices=lambda: [camera.camera.device])) as sensor:
        assert pytest.approx(colour @ between, abs=1e-6) == sensor.T_cam_imu


def test_a_realsense_without_the_sensor_is_told_from_one_that_is_silent(
    rs: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RealSenseImu, "_patience", 0.3)
    for kinds in ((), ("accel",)):
        with moved(rs, kinds=kinds) as camera, pytest.raises(DeviceError, match="has no inertial sensor"):
            RealSenseImu(devices=lambda camera=camera: [camera.camera.device])
    with moved(rs) as camera:
        camera.silent = True
        with pytest.raises(DeviceError, match="nothing within"):
            RealSenseImu(devices=lambda: [camera.camera.device])
        camera.silent = False
        RealSenseImu(devices=lambda: [camera.camera.device]).close()
    with pytest.raises(DeviceError, match="none is connected"):
        RealSenseImu(devices=list)


def message(
    stamp: float, *, force: tuple[float, ...] = (0.1, 0.2, 9.8), rate: tuple[float, ...] = (1.0, 2.0, 3.0)
) -> Any:
    """Return a sensor_msgs/Imu."""
    named = [dict(zip("xyz", values, strict=True)) for values in (force, rate)]
    header = SimpleNamespace(stamp=SimpleNamespace(sec=int(stamp), nanosec=round(1e9 * (stamp % 1))))
    return SimpleNamespace(
        header=header, linear_acceleration=SimpleNamespace(**named[0]), angular_velocity=SimpleNamespace(**named[1])
    )


class ToldNode(FakeNode):
    """A node whose topic tells one message as soon as it is subscribed."""

    def subscribe(self, topic: str, kind: str, hear: Callable[[Any], None]) -> None:
        super().subscribe(topic, kind, hear)
        hear(message(500.0))


def test_a_topic_s_readings_are_put_in_order_on_the_robot_s_clock() -> None:
    """The robot's clock is behind by 490 s; messages come 1 to 9 ms after their stamps."""
    node, now = ToldNode(), [10.0]
    imu = Ros2Imu(node, "/hand/imu", clock=lambda: now[0])  # type: ignore[arg-type]
    is_imu(imu).start()
    hear = node.hears["/hand/imu"]
    for number in range(1, 100):
        now[0] = 10.0 + 0.005 * number + 0.001 * (1 + number % 9)
        hear(message(500.0 + 0.005 * number, force=(float(number), 0.0, 9.81)))
    told = imu.recorded(10.1)
    assert told.times == pytest.approx(10.0 + 0.005 * told.acceleration[:, 0], abs=0.0011)
    assert told.times[0] == pytest.approx(10.1, abs=0.006)
    assert told.rate[-1] == pytest.approx([1.0, 2.0, 3.0])
    count = len(told.times)
    for wrong in (message(500.2), message(500.6, force=(float("nan"), 0.0, 0.0))):
        hear(wrong)
    assert len(imu.recorded(10.1).times) == count, "an old one and one without numbers are passed over"
    imu.stop()
    assert not len(imu.recorded(0.0).times)


def test_a_topic_that_says_nothing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Ros2Imu, "_patience", 0.1)
    with pytest.raises(DeviceError, match="on /hand/imu"):
        Ros2Imu(FakeNode(), "/hand/imu")  # type: ignore[arg-type]


@pytest.mark.parametrize("check", IMU_CHECKS, ids=lambda check: check.__name__)
def test_a_realsense_passes_the_kit(rs: Any, check: Callable[[ImuRig], None]) -> None:
    with moved(rs) as camera:
        camera.swing = 0.0
        connect = partial(RealSenseImu, devices=lambda: [camera.camera.device])
        check(ImuRig(connect, time.monotonic, time.sleep, rate=80.0))


class StillTopic(FakeNode):
    """A node on whose topic a sensor at rest tells 200 messages a second, in a time of its own."""

    now = 10.0

    def subscribe(self, topic: str, kind: str, hear: Callable[[Any], None]) -> None:
        super().subscribe(topic, kind, hear)
        self.sleep(0.01)

    def sleep(self, seconds: float) -> None:
        (hear,) = self.hears.values()
        for _ in range(round(200 * seconds)):
            self.now += 0.005
            hear(message(self.now + 490.0, force=(0.0, 0.1, 9.8), rate=self.rate))

    rate = (0.001, 0.0, 0.0)


def topic_rig(node: StillTopic) -> ImuRig:
    return ImuRig(
        lambda: Ros2Imu(node, clock=lambda: node.now),  # type: ignore[arg-type]
        lambda: node.now,
        node.sleep,
        rate=200.0,
    )


@pytest.mark.parametrize("check", IMU_CHECKS, ids=lambda check: check.__name__)
def test_a_topic_passes_the_kit(check: Callable[[ImuRig], None]) -> None:
    check(topic_rig(StillTopic()))


def test_the_kit_finds_a_gyroscope_in_degrees_and_a_sensor_that_reads_seldom() -> None:
    node = StillTopic()
    node.rate = (3.0, 0.0, 0.0)
    with pytest.raises(AssertionError, match="degrees"):
        check_imu_readings(topic_rig(node))
    with pytest.raises(AssertionError, match=r"100 readings in 0\.5 s"):
        check_imu_readings(replace(topic_rig(StillTopic()), rate=400.0))
