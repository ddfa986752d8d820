"""Any camera that OpenCV opens (UVC, a stream, a video file), without depth, for `free_running.FreeRunningCamera`."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.cameras import straightened, straightening
from anther.core.checks import check_array, check_range
from anther.core.errors import bad_input
from anther.core.geometry import Intrinsics
from anther.core.opencv import cv2
from anther.robot.devices import DeviceError
from anther.robot.drivers.free_running import FreeRunningCamera, Shot


def open_uvc(
    source: int | str,
    intrinsics: Intrinsics,
    *,
    rate: float = 30.0,
    lens: tuple[float, ...] = (),
    latency: float = 0.0,
    clock: Callable[[], float] = time.monotonic,
) -> FreeRunningCamera:
    """Return a camera, running and warmed up. Arguments and errors: see `Uvc`."""
    return FreeRunningCamera(Uvc(source, intrinsics, rate=rate, lens=lens, latency=latency, clock=clock))


class Uvc:
    """A camera without depth as a `free_running.Source`: its depth images say everywhere "no reading".

    UVC counts no frames: one is lost where the time between two is long enough for it at the rate that the camera says
    it has. A camera that halves its rate in the dark loses every other frame by this count.

    Args:
        source: number of a camera, a device ("/dev/video2"), an address, or a video file, which is played in its own
            time and then stops.
        intrinsics: of the camera without its lens distortion; they state the size that is asked for.
        rate: to ask for [Hz].
        lens: distortion coefficients in OpenCV's order; empty if it has none.
        latency: by which frames come after they were taken [s]: what exposure and cable take, unless the driver stamps
            frames itself (V4L2 does).
        clock: the robot's [s].
        opener: what behaves like cv2.VideoCapture; None: that.

    Raises:
        InputError: rate, lens or latency make no sense.
    """

    def __init__(
        self,
        source: int | str,
        intrinsics: Intrinsics,
        *,
        rate: float = 30.0,
        lens: tuple[float, ...] = (),
        latency: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
        opener: Callable[..., Any] | None = None,
    ) -> None:
        if len(lens) not in (0, 4, 5, 8, 12, 14):
            raise bad_input("lens", given=f"{len(lens)} numbers", allowed="0, 4, 5, 8, 12 or 14", do="OpenCV's order.")
        self._rate = check_range("frame rate", rate, 0.1, 1000, "Hz")
        self._latency = check_range("latency", latency, 0, 2, "s")
        self._source, self._clock, self._intrinsics = source, clock, intrinsics
        self._opener = opener or cv2.VideoCapture
        self._maps = straightening("lens", intrinsics, check_array("lens", lens, (len(lens),)), "plumb_bob")
        self._is_file = not isinstance(source, int) and Path(source).is_file()
        self._no_depth = np.zeros((intrinsics.height, intrinsics.width), np.float32)
        self._no_depth.flags.writeable = False
        self._capture: Any = None
        self._name = f"camera {source}"

    def clock(self) -> float:
        """Return the robot's clock [s]."""
        return self._clock()

    def open(self) -> Intrinsics:
        """Open the camera."""
        if self._is_file and self._capture is not None:
            raise DeviceError(f"{self._name}: the video is at its end. Open it again.")
        self._capture = self._opener(self._source)
        if not self._capture.isOpened():
            self.close()
            raise DeviceError(f"{self._name}: it cannot be opened. Is it plugged in, may you read it, is it in use?")
        wanted = (self._intrinsics.width, self._intrinsics.height)
        if not self._is_file:
            for name, value in zip(("FRAME_WIDTH", "FRAME_HEIGHT", "FPS"), (*wanted, self._rate), strict=True):
                self._capture.set(getattr(cv2, f"CAP_PROP_{name}"), value)
            self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        got = tuple(round(self._capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if got != wanted:
            self.close()
            raise DeviceError(
                f"{self._name}: got images of {got} px; its intrinsics are of {wanted}. Calibrate at its size."
            )
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self._period = 1 / rate if rate > 0 else 0.0
        self._begun, self._number, self._last = self._clock(), 0, -np.inf
        return self._intrinsics

    def next(self) -> Shot:
        """Wait for the next frame."""
        if not self._capture.grab():
            why = "the video is at its end" if self._is_file else "it gives no more frames. Check its cable"
            raise DeviceError(f"{self._name}: {why}.")
        taken = self._time()
        missed = round((taken - self._last) / self._period) - 1 if self._number and self._period else 0
        self._number, self._last = self._number + 1 + max(missed, 0), taken
        return Shot(taken, self._number, self._images)

    def close(self) -> None:
        """Let go of the camera."""
        if self._capture is not None:
            self._capture.release()

    def _time(self) -> float:
        """Return when the frame that was just grabbed was taken, on the robot's clock [s]."""
        position = 1e-3 * self._capture.get(cv2.CAP_PROP_POS_MSEC)
        if self._is_file:
            time.sleep(max(self._begun + position - self._clock(), 0))
            return self._begun + position
        arrival, age = self._clock(), time.monotonic() - position
        # V4L2 stamps with the monotonic clock; an older stamp than a second is not believed
        return arrival - (age if 0 <= age < 1 else self._latency)

    def _images(self) -> tuple[NDArray[Any], NDArray[Any]]:
        there, image = self._capture.retrieve()
        size = self._no_depth.shape
        if not there or image is None or image.shape != (*size, 3):
            raise DeviceError(f"{self._name}: a damaged frame.")
        return np.ascontiguousarray(straightened(image, self._maps, nearest=False)[..., ::-1]), self._no_depth
