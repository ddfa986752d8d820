"""Cameras that run without a sensor: a RealSense of the SDK's `software_device`, and a webcam that is no webcam."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import cv2
import numpy as np
from made_realsense import SoftwareCamera

from anther.core.geometry import Intrinsics
from anther.robot.drivers.free_running import FreeRunningCamera
from anther.robot.drivers.realsense import RealSense, load_sdk
from anther.robot.drivers.uvc import Uvc

RATE = 30.0  # [Hz]
WEBCAM = Intrinsics(40, 30, 35.0, 35.0, 19.5, 14.5)


class Bench:
    """A software RealSense that takes frames at 30 Hz until it is told to stop.

    Attributes: camera; plugged, whether it is found and delivers; skipped, numbers of frames that are lost on the way;
    domain, lag: of its stamps [s]; sensor_lag: from the middle of the exposure to the stamp [s].
    """

    def __init__(self, *, domain: str = "global_time", lag: float = 0.0) -> None:
        self.rs = load_sdk()
        self.camera = SoftwareCamera(self.rs)
        self.plugged, self.skipped, self.domain, self.lag, self.sensor_lag = True, set[int](), domain, lag, 0.0
        self.number, self._on = 0, True
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def found(self) -> list[Any]:
        return [self.camera.device] if self.plugged else []

    def stop(self) -> None:
        self._on = False
        self._thread.join()

    def _run(self) -> None:
        value = self.rs.frame_metadata_value
        while self._on:
            time.sleep(1 / RATE)
            self.number += 1
            if not self.plugged or self.number in self.skipped:
                continue
            for sensor in self.camera.sensors:
                sensor.set_metadata(value.frame_timestamp, round(1e6 * self.number / RATE))
                sensor.set_metadata(value.sensor_timestamp, round(1e6 * (self.number / RATE - self.sensor_lag)))
            with suppress(RuntimeError):  # while it is closed
                self.camera.show(self.number, time.time() - self.lag - 0.002, domain=self.domain)


class FakeWebcam:
    """What cv2.VideoCapture is to `Uvc`.

    Attributes: rate [Hz]; limit, after so many frames it gives none; opens, so often it was opened; size [px]; stamped,
    whether it stamps as V4L2 does; damaged, numbers of frames that cannot be decoded; skipped, that never come.
    """

    def __init__(self, *, rate: float = RATE, size: tuple[int, int] = (40, 30), stamped: bool = False) -> None:
        self.rate, self.size, self.stamped, self.limit, self.opens = rate, size, stamped, 10**9, 0
        self.damaged, self.skipped = set[int](), set[int]()
        self.number, self.asked, self.there = 0, dict[int, float](), True

    def __call__(self, source: int | str) -> FakeWebcam:
        self.opens += 1
        return self

    def isOpened(self) -> bool:
        return self.there

    def set(self, name: int, value: float) -> bool:
        self.asked[name] = value
        return True

    def get(self, name: int) -> float:
        told = {cv2.CAP_PROP_FRAME_WIDTH: self.size[0], cv2.CAP_PROP_FRAME_HEIGHT: self.size[1]}
        stamp = 1e3 * (time.monotonic() - 0.02) if self.stamped else 0.0
        return {**told, cv2.CAP_PROP_FPS: self.rate, cv2.CAP_PROP_POS_MSEC: stamp}[name]

    def grab(self) -> bool:
        self.number += 1
        while self.number in self.skipped:
            self.number += 1
            time.sleep(1 / self.rate)
        time.sleep(1 / self.rate)
        return self.there and self.number <= self.limit

    def retrieve(self) -> tuple[bool, Any]:
        if self.number in self.damaged:
            return False, None
        return True, np.full((self.size[1], self.size[0], 3), (1, 2, self.number % 256), np.uint8)

    def release(self) -> None:
        pass


@contextmanager
def running(bench: Bench) -> Iterator[Bench]:
    try:
        yield bench
    finally:
        bench.stop()


def realsense(bench: Bench, warm_up: int = 2, **options: Any) -> FreeRunningCamera:
    return FreeRunningCamera(RealSense(devices=bench.found, **options), warm_up)


def webcam(fake: FakeWebcam, warm_up: int = 2, **options: Any) -> FreeRunningCamera:
    return FreeRunningCamera(Uvc(0, WEBCAM, rate=fake.rate, opener=fake, **options), warm_up)
