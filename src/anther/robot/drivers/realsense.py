"""A RealSense D405, D435 or D455 through librealsense, for `free_running.FreeRunningCamera`. Faults: docs/cameras.md.

Depth is laid over colour here, not by the SDK's align: that leaves the colour lens out (SDK 2.59,
`docs/reports/machines.md`).
"""

from __future__ import annotations

import ctypes
import importlib
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.cameras import laid_over, straightened, straightening
from anther.core.errors import MissingExtra
from anther.core.geometry import Array, Intrinsics, transform
from anther.robot.devices import DeviceError
from anther.robot.drivers.free_running import STALLED, FreeRunningCamera, Shot

INSTALL = "pip install 'anther[realsense]'"

Found = Callable[[], Sequence[Any]]
"""Gives the devices that are connected now."""


def open_realsense(
    serial: str | None = None,
    *,
    size: tuple[int, int] = (848, 480),
    rate: int = 30,
    preset: str | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> FreeRunningCamera:
    """Return a connected camera, running and warmed up.

    Args:
        serial: which, as printed on it; None: the only one.
        size: of both images (width, height) [px]. At 848 x 480 a D405 sees from 70 mm on, at 1280 x 720 from 100 mm.
        rate: [Hz].
        preset: of the depth sensor, e.g. "High Accuracy"; None: as it is.
        clock: the robot's [s].

    Raises:
        MissingExtra: pyrealsense2 is not installed.
        DeviceError: no such camera, or it cannot do what is asked.
    """
    return FreeRunningCamera(RealSense(serial, size=size, rate=rate, preset=preset, clock=clock))


def load_sdk() -> Any:
    """Return pyrealsense2; where the machine has no libusb, with that of the libusb-package wheel.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        with suppress(ImportError):
            return importlib.import_module("pyrealsense2")
        usb: Any = importlib.import_module("libusb_package")
        ctypes.CDLL(str(usb.get_library_path()), ctypes.RTLD_GLOBAL)
        return importlib.import_module("pyrealsense2")
    except (ImportError, OSError) as error:
        raise MissingExtra(f"RealSense: no pyrealsense2 ({error}). Install it with: {INSTALL}") from error


def find_device(rs: Any, devices: Found, serial: str | None) -> Any:
    """Return the device with a serial number; None: the only one.

    Raises:
        DeviceError: it is not connected.
    """
    there = list(devices())
    serials = [info_of(d, rs.camera_info.serial_number) for d in there]
    if not there:
        raise DeviceError("RealSense: none is connected. Plug it in (USB 3); on Linux it needs the SDK's udev rules.")
    if serial is None and len(there) > 1:
        raise DeviceError(f"RealSense: {len(there)} are connected. Name one by its serial: {', '.join(serials)}.")
    if serial is not None and serial not in serials:
        raise DeviceError(f"RealSense {serial}: not connected; there are {', '.join(serials)}. Plug it in.")
    return there[0 if serial is None else serials.index(serial)]


@contextmanager
def closed_on_error(close: Callable[[], None], what: str) -> Iterator[None]:
    """Close what the block did not get open, and raise the SDK's own error as a DeviceError.

    Raises:
        DeviceError: the SDK raised one of its own.
    """
    try:
        yield
    except RuntimeError as error:  # the SDK's
        close()
        raise DeviceError(f"{what}: {error}. Is another program using it? Unplug it and plug it in.") from error
    except BaseException:
        close()
        raise


def stamp_in_host_time(rs: Any, sensor: Any) -> None:
    """Have a sensor stamp in the host's time, where it can."""
    if sensor.supports(rs.option.global_time_enabled):
        sensor.set_option(rs.option.global_time_enabled, 1)


def way_between(one: Any, other: Any) -> Array:
    """Return T_other_one (4, 4) between two streams' profiles [m]."""
    between = one.get_extrinsics_to(other)
    return transform(np.reshape(between.rotation, (3, 3)).T, between.translation)  # by columns


class Stamps:
    """When frames of a RealSense were taken, on the robot's clock.

    Args:
        rs: the SDK.
        clock: the robot's [s].
    """

    def __init__(self, rs: Any, clock: Callable[[], float]) -> None:
        self._rs, self._clock = rs, clock
        self._offsets: deque[float] = deque(maxlen=300)  # the quickest tells the clocks' offset

    def forget(self) -> None:
        """Take the camera's clock for another one from now on."""
        self._offsets.clear()

    def time(self, frame: Any) -> float:
        """Return when a frame was taken, in the middle of its exposure, on the robot's clock [s].

        Stamps in the host's time (domains global and system) need only the offset of two clocks of this machine. A
        clock of the camera's own is tied to ours by the frame that came quickest of the last hundreds; its way of some
        milliseconds stays in.
        """
        arrival, host = self._clock(), time.time()
        rs, stamp = self._rs, 1e-3 * frame.get_timestamp() - self._since_exposure(frame)
        domains = rs.timestamp_domain.global_time, rs.timestamp_domain.system_time
        tolerance = 1.0  # stamps in the host's time are believed if they are no farther from it [s]; a recording's are
        if frame.get_frame_timestamp_domain() in domains and abs(host - stamp) < tolerance:
            return min(stamp + (arrival - host), arrival)
        if self._offsets and abs(arrival - stamp - self._offsets[-1]) > tolerance:
            self._offsets.clear()  # the camera's clock began anew
        self._offsets.append(arrival - stamp)
        return stamp + min(self._offsets)

    def _since_exposure(self, frame: Any) -> float:
        """Return what passed between the middle of the exposure and the stamp, at readout [s]; 0 if it is not told."""
        value = self._rs.frame_metadata_value
        if not all(frame.supports_frame_metadata(v) for v in (value.frame_timestamp, value.sensor_timestamp)):
            return 0.0
        passed = 1e-6 * (
            frame.get_frame_metadata(value.frame_timestamp) - frame.get_frame_metadata(value.sensor_timestamp)
        )
        return passed if 0 <= passed < 0.1 else 0.0


class RealSense:
    """A RealSense as a `free_running.Source`.

    Args:
        serial, size, rate, preset, clock: see `open_realsense`; a size or rate of None takes what is offered first.
        devices: gives what is connected; None: the SDK's own search. A recording: `open_recording(path)`.

    Attributes:
        unpaired: framesets so far that lacked depth or colour.

    Raises:
        MissingExtra: pyrealsense2 is not installed.
    """

    def __init__(
        self,
        serial: str | None = None,
        *,
        size: tuple[int, int] | None = None,
        rate: int | None = None,
        preset: str | None = None,
        clock: Callable[[], float] = time.monotonic,
        devices: Found | None = None,
    ) -> None:
        self._rs = load_sdk()
        self._serial, self._size, self._rate, self._preset, self._clock = serial, size, rate, preset, clock
        self._devices: Found = devices or self._rs.context().query_devices
        self._open: list[Any] = []
        self._stamps = Stamps(self._rs, clock)
        self.unpaired = 0

    def clock(self) -> float:
        """Return the robot's clock [s]."""
        return self._clock()

    def open(self) -> Intrinsics:
        """Start both streams."""
        with closed_on_error(self.close, "RealSense"):
            device = find_device(self._rs, self._devices, self._serial)
            self._name = info_of(device, self._rs.camera_info.name) or "RealSense"
            self._serial = info_of(device, self._rs.camera_info.serial_number) or None  # no other one takes its place
            depth, color = self._streams(device)
            self._set_up(device, depth)
            self._start(depth, color)
            return self._geometry(depth[1], color[1])

    def next(self) -> Shot:
        """Wait for depth and colour of one time."""
        until = time.monotonic() + STALLED
        while time.monotonic() < until:
            try:
                there, frames = self._syncer.try_wait_for_frames(round(1e3 * STALLED))
            except RuntimeError as error:
                raise DeviceError(f"{self._name}: {error}. Check its cable.") from error
            if not there:
                break
            depth, color = frames.get_depth_frame(), frames.get_color_frame()
            if depth and color:
                return Shot(self._stamps.time(color), color.get_frame_number(), partial(self._images, depth, color))
            self.unpaired += 1
        raise DeviceError(self._why_silent())

    def close(self) -> None:
        """Stop both streams and let go of the sensors; those of an unplugged camera as well."""
        for sensor in self._open:
            with suppress(RuntimeError):
                sensor.stop()
            with suppress(RuntimeError):
                sensor.close()
        self._open = []

    def _streams(self, device: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
        """Return (sensor, profile) of depth and colour.

        Raises:
            DeviceError: it does not offer what is asked.
        """
        rs, chosen, sensors = self._rs, list[tuple[Any, Any]](), list(device.query_sensors())
        for kind, form in ((rs.stream.depth, rs.format.z16), (rs.stream.color, rs.format.rgb8)):
            offers = [
                (sensor, profile.as_video_stream_profile())
                for sensor in sensors
                for profile in sensor.get_stream_profiles()
                if profile.stream_type() == kind and profile.format() == form
            ]
            fitting = [o for o in offers if self._size in (None, _size(o[1])) and self._rate in (None, o[1].fps())]
            if not fitting:
                asked = f"{self._size} px at {self._rate} Hz" if self._size else "any"
                there = sorted({f"{_size(o[1])} at {o[1].fps()}" for o in offers})
                usb = info_of(device, rs.camera_info.usb_type_descriptor) or "?"
                raise DeviceError(
                    f"{self._name}: got {kind.name} {asked}; it has {', '.join(there) or 'none'} on USB {usb}. "
                    "USB 2 carries less: use a USB 3 cable and port."
                )
            chosen.append(fitting[0])
        return chosen[0], chosen[1]

    def _set_up(self, device: Any, depth: tuple[Any, Any]) -> None:
        """Choose the preset, and stamps in the host's time where the camera can."""
        option = self._rs.option
        for sensor in device.query_sensors():
            stamp_in_host_time(self._rs, sensor)
        if self._preset is None:
            return
        names = dict[str, float]()
        if depth[0].supports(option.visual_preset):
            span = depth[0].get_option_range(option.visual_preset)
            for value in np.arange(span.min, span.max + 0.5 * span.step, span.step):
                name = depth[0].get_option_value_description(option.visual_preset, float(value))
                if name:
                    names[name.lower()] = float(value)
        if self._preset.lower() not in names:
            raise DeviceError(f"{self._name}: got preset '{self._preset}'; it has {', '.join(names) or 'none'}.")
        depth[0].set_option(option.visual_preset, names[self._preset.lower()])

    def _start(self, depth: tuple[Any, Any], color: tuple[Any, Any]) -> None:
        self._syncer = self._rs.syncer(8)  # of 16 that the SDK keeps
        self._stamps.forget()
        if depth[0] is color[0]:
            wanted = [(depth[0], [depth[1], color[1]])]
        else:
            wanted = [(depth[0], [depth[1]]), (color[0], [color[1]])]
        for sensor, profiles in wanted:
            sensor.open(profiles)
            self._open.append(sensor)
        for sensor, _ in wanted:
            sensor.start(self._syncer)

    def _geometry(self, depth: Any, color: Any) -> Intrinsics:
        """Read cameras, lenses, the way between them and the depth unit off the sensors."""
        self._depth_camera, self._depth_maps = self._camera(depth)
        self._color_camera, self._color_maps = self._camera(color)
        self._T_color_depth = way_between(depth, color)
        self._unit = np.float32(self._open[0].get_option(self._rs.option.depth_units))
        # compiled now: the first frame must not wait for it
        laid_over(np.zeros((1, 1), np.float32), self._depth_camera, self._color_camera, self._T_color_depth)
        return self._color_camera

    def _camera(self, profile: Any) -> tuple[Intrinsics, Any]:
        i = profile.get_intrinsics()
        camera = Intrinsics(i.width, i.height, i.fx, i.fy, i.ppx, i.ppy)
        return camera, straightening(self._name, camera, np.array(i.coeffs), i.model.name.replace("_", " "))

    def _images(self, depth: Any, color: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        steps, rgb = np.asarray(depth.get_data()), np.asarray(color.get_data())
        sizes = [(c.height, c.width) for c in (self._depth_camera, self._color_camera)]
        if steps.shape != sizes[0] or rgb.shape != (*sizes[1], 3):
            raise DeviceError(f"{self._name}: got images of {steps.shape} and {rgb.shape}; its cameras are {sizes}.")
        metres = straightened(steps.astype(np.float32) * self._unit, self._depth_maps, nearest=True)
        over = laid_over(metres, self._depth_camera, self._color_camera, self._T_color_depth)
        return np.array(straightened(rgb, self._color_maps, nearest=False)), over

    def _why_silent(self) -> str:
        try:
            find_device(self._rs, self._devices, self._serial)
        except (DeviceError, RuntimeError) as error:
            return f"{self._name}: unplugged ({error})"
        return (
            f"{self._name}: no frame in {STALLED:g} s, though it is connected. Check cable and hub; it is opened anew."
        )


def open_recording(path: str) -> Found:
    """Return how a recording (.bag, .db3) is found as a camera: played in its own time, and anew after its end."""
    sdk = load_sdk()
    return lambda: [sdk.context().load_device(path)]


def _size(profile: Any) -> tuple[int, int]:
    return profile.width(), profile.height()


def info_of(device: Any, info: Any) -> str:
    """Return what a device says of itself; nothing where it does not say it."""
    return device.get_info(info) if device.supports(info) else ""
