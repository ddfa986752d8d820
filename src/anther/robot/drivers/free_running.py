"""A live camera: it runs freely in a thread of its own, is opened anew when it stops, and gives frames when asked.

What makes it a RealSense or a webcam is its `Source`.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from anther.core.checks import check_range
from anther.core.geometry import Intrinsics
from anther.robot.devices import DeviceError, Frame

STALLED = 0.5
"""A camera that gave no frame for so long has stopped [s]: 15 frames at 30 Hz."""
_COLD = "camera: it is still warming up"


@dataclass(frozen=True, slots=True)
class Shot:
    """A frame as a source hears of it.

    Attributes:
        time: when it was taken [s], on the robot's clock.
        number: the camera's count of the frames it took: a gap is a lost frame.
        images: gives rgb (H, W, 3) uint8 and depth (H, W) float32 [m], 0 = no reading; called before the next frame is
            waited for, and only if the frame is wanted. Raises DeviceError if they are damaged.
    """

    time: float
    number: int
    images: Callable[[], tuple[NDArray[Any], NDArray[Any]]]


class Source(Protocol):
    """What a kind of camera must do. All but `clock` is called by one thread at a time."""

    def clock(self) -> float:
        """Return the robot's clock [s]."""
        ...

    def open(self) -> Intrinsics:
        """Begin to take frames, and return the camera that all of them are of; also after `close`.

        Where it cannot (DeviceError), nothing is left open.
        """
        ...

    def next(self) -> Shot:
        """Wait for the next frame; DeviceError: none came in `STALLED`, or the camera is gone."""
        ...

    def close(self) -> None:
        """Let go of the camera; also of one that is gone, or not open."""
        ...


@dataclass(frozen=True, slots=True)
class Health:
    """How a camera does.

    Attributes:
        received: frames since it was first opened.
        lost: frames that it took in this time and that never came, or came damaged.
        stops: so often it stopped and was opened anew.
        rate: of the last hundred frames [Hz]; NaN before there are two.
        longest_gap: between two of these [s].
        fault: why it gives no frames now; "" if it does.
    """

    received: int
    lost: int
    stops: int
    rate: float
    longest_gap: float
    fault: str


def _silent() -> DeviceError:
    return DeviceError(f"camera: no frame in {STALLED:g} s. Check its cable, and that nobody else uses it.")


class FreeRunningCamera:
    """A live camera, as a `devices.Camera`. Use it as a context manager, or close it.

    A camera that stops is closed and tried again every second, without anybody asking; until it is back, every
    call says at once why there are no frames.

    Args:
        source: the camera, not yet open.
        warm_up: so many frames are thrown away whenever it was opened: exposure and white balance settle.
            librealsense's own example takes 30 (examples/save-to-disk).

    Raises:
        DeviceError: it cannot be opened, or gives no frames.
    """

    _again = 1.0
    """Between two tries to open a camera that stopped [s]."""
    _most_bytes = 1e9
    """Of a recording no more than so much is kept, its end [bytes]: 351 frames of 848 x 480 px."""

    def __init__(self, source: Source, warm_up: int = 30) -> None:
        self._source, self._warm_up = source, warm_up
        self._news = threading.Condition()
        self._waiting = 0
        self._latest: Frame | None = None
        self._fault = _COLD
        self._recording: deque[Frame] | None = None
        self._period = self._due = 0.0
        self._times: deque[float] = deque(maxlen=100)  # rate and longest gap
        self._received = self._lost = self._stops = 0
        self._ended = threading.Event()
        self._intrinsics = source.open()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        self._wait_for(lambda: self._fault != _COLD, STALLED + warm_up)  # at 1 Hz or more
        if self._fault:
            self.close()
            raise DeviceError(self._fault)

    def __enter__(self) -> FreeRunningCamera:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def intrinsics(self) -> Intrinsics:
        """Of every frame."""
        return self._intrinsics

    @property
    def rates(self) -> tuple[float, ...]:
        """At which a recording may be begun [1/s]: the rate that frames really have, and whole parts of it."""
        self._wait_for(lambda: self._fault or len(self._times) > 1, STALLED)
        with self._news:
            self._refuse_if_stopped()
            if len(self._times) < 2:
                raise _silent()
            rate = 1 / float(np.median(np.diff(self._times)))
        return tuple(rate / n for n in (1, 2, 3, 4, 6))  # a recording has every such frame

    def read(self) -> Frame:
        """Return the first frame taken from now on."""
        asked = self._source.clock()
        with self._news:
            self._refuse_if_stopped()
            self._waiting += 1
        try:
            self._wait_for(lambda: self._fault or (self._latest is not None and self._latest.time >= asked), STALLED)
        finally:
            with self._news:
                self._waiting -= 1
        with self._news:
            self._refuse_if_stopped()
            if self._latest is None or self._latest.time < asked:
                raise _silent()
            return self._latest

    def start(self, rate: float) -> None:
        """Begin to record at `rate` frames per second [Hz], or as many as there are."""
        check_range("frame rate", rate, 0.1, 1000, "Hz")
        with self._news:
            self._refuse_if_stopped()
            bytes_each = 7 * self._intrinsics.width * self._intrinsics.height
            self._recording = deque(maxlen=max(int(self._most_bytes / bytes_each), 1))
            self._period, self._due = 1 / rate, -np.inf

    def recorded(self, since: float) -> list[Frame]:
        """Return the frames of the recording under way that were taken from `since` on [s], in order of time."""
        with self._news:
            if self._recording is None:
                raise DeviceError("camera: it records nothing. Start it first.")
            frames = [frame for frame in self._recording if frame.time >= since]
            if not frames:
                raise DeviceError(f"camera: no frame since {since:.2f} s. {self._fault}".rstrip())
            return frames

    def stop(self) -> list[Frame]:
        """End the recording and return its frames in order of time, of a long one the last; none if none was begun."""
        with self._news:
            recording, self._recording = self._recording, None
            if recording is not None and not recording:
                raise DeviceError(f"camera: all frames of the recording were lost. {self._fault}".rstrip())
            return list(recording or ())

    def health(self) -> Health:
        """Return how the camera does."""
        with self._news:
            gaps = np.diff(self._times)
            rate, longest = (1 / gaps.mean(), gaps.max()) if len(gaps) else (np.nan, np.nan)
            return Health(self._received, self._lost, self._stops, float(rate), float(longest), self._fault)

    def close(self) -> None:
        """Stop the camera and let go of it."""
        self._ended.set()
        self._thread.join(2 * STALLED + self._again)
        if not self._thread.is_alive():  # else it hangs in the camera's own library, and closes when that returns
            self._source.close()

    def _run(self) -> None:
        last, cold = None, self._warm_up
        while not self._ended.is_set():
            try:
                shot = self._source.next()
            except Exception as error:  # whatever a library raises, the camera is opened anew
                self._open_anew(error)
                last, cold = None, self._warm_up
                continue
            with self._news:
                self._received += 1
                self._lost += 0 if last is None else max(shot.number - last - 1, 0)
                self._times.append(shot.time)
            last, cold = shot.number, max(cold - 1, -1)
            if cold < 0:
                self._take(shot)

    def _take(self, shot: Shot) -> None:
        """Keep a frame if anybody wants it."""
        with self._news:
            due = self._recording is not None and shot.time >= self._due - 0.25 * self._period
            wanted = due or self._waiting > 0
        frame = None
        if wanted:
            with suppress(DeviceError):
                frame = Frame(shot.time, *shot.images())
        with self._news:
            self._lost += wanted and frame is None
            self._fault = ""
            self._latest = frame or self._latest
            in_order = self._recording is not None and (not self._recording or self._recording[-1].time < shot.time)
            if frame is not None and due and in_order and self._recording is not None:
                self._recording.append(frame)
                late = shot.time > self._due + self._period
                self._due = shot.time + self._period if late else self._due + self._period
            self._news.notify_all()

    def _open_anew(self, error: Exception) -> None:
        """Say what is wrong, and try until the camera is there again, the same as before."""
        self._tell(str(error))
        self._stops += 1
        while not self._ended.is_set():
            with suppress(Exception):
                self._source.close()
            if self._ended.wait(self._again):
                return
            try:
                intrinsics = self._source.open()
            except Exception as again:
                self._tell(str(again))
                continue
            if intrinsics == self._intrinsics:
                return
            self._tell(f"camera: it came back as another one ({intrinsics}). Start anew, with a new calibration.")

    def _tell(self, fault: str) -> None:
        with self._news:
            self._fault, self._latest = fault or "camera: unknown fault", None
            self._times.clear()
            self._news.notify_all()

    def _refuse_if_stopped(self) -> None:
        if self._fault:
            raise DeviceError(self._fault)

    def _wait_for(self, there: Callable[[], Any], seconds: float) -> None:
        with self._news:
            self._news.wait_for(there, seconds)
