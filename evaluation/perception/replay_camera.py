"""A camera that replays a capture folder, so that everything after the sensor can be run again without one."""

from __future__ import annotations

from anther.core import InputError, Intrinsics
from anther.perception import Capture
from anther.robot import DeviceError, Frame


class ReplayCamera:
    """Give the views of a capture one after another, as a `devices.Camera`.

    Args:
        capture: recorded views, with colour.
        period: time between two views on the replayed clock [s].

    Raises:
        InputError: the capture has no colour.
    """

    def __init__(self, capture: Capture, period: float = 1 / 30) -> None:
        if capture.rgb is None:
            raise InputError("replay: got a capture without colour; allowed: RGB-D. Replay needs both images.")
        self._capture = capture
        self._rgb = capture.rgb
        self._period = period
        self._next = 0
        self._recording: int | None = None

    @property
    def intrinsics(self) -> Intrinsics:
        """Of every frame."""
        return self._capture.intrinsics

    @property
    def rates(self) -> tuple[float, ...]:
        """At which a recording may be begun [1/s]."""
        return (1 / self._period,)

    def read(self) -> Frame:
        """Return the next view.

        Raises:
            DeviceError: all views have been given.
        """
        if self._next >= self._capture.views:
            raise DeviceError(f"replay: all {self._capture.views} views have been read. Open the capture again.")
        frame = self._frame(self._next)
        self._next += 1
        return frame

    def start(self, rate: float) -> None:
        """Begin to record; the recorded rate stays what it was."""
        del rate
        self._recording = self._next

    def recorded(self, since: float) -> list[Frame]:
        """Return the views of the recording so far.

        Raises:
            DeviceError: there are none.
        """
        first = self._next if self._recording is None else self._recording
        frames = [f for f in map(self._frame, range(first, self._capture.views)) if f.time >= since]
        if not frames:
            raise DeviceError(f"replay: no view since {since:g} s.")
        return frames

    def stop(self) -> list[Frame]:
        """Return every view from the start of the recording to the capture's end."""
        first = self._next if self._recording is None else self._recording
        frames = [self._frame(view) for view in range(first, self._capture.views)]
        self._next, self._recording = self._capture.views, None
        return frames

    def _frame(self, view: int) -> Frame:
        return Frame(time=view * self._period, rgb=self._rgb[view], depth=self._capture.depth[view])
