"""A RealSense made of the SDK's `software_device`: what it sees, and recordings that the SDK itself writes of it.

As a program it records with whatever SDK is importable: `python tests/support/made_realsense.py rec.bag` (2.57) or
`rec.db3`.
"""

from __future__ import annotations

import ctypes
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

UNIT = 1e-4  # [m] of a step of depth: a D405's
START = 1_700_000_000.0  # [s]
PERIOD = 1 / 30  # [s]
DEPTH = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "ppx": 31.5, "ppy": 23.5}
COLOR = {"width": 96, "height": 72, "fx": 95.5, "fy": 95.0, "ppx": 46.25, "ppy": 36.0}
LENS = (-0.15, 0.05, 0.001, -0.0005, 0.0)  # of the colour camera, "Inverse Brown Conrady"
TURN, SHIFT = 0.02, (0.03, 0.001, -0.002)  # [rad] about z and [m]: T_color_depth


def sdk() -> Any:
    """Return pyrealsense2, with libusb from its wheel where the machine has none."""
    try:
        import libusb_package  # noqa: PLC0415

        ctypes.CDLL(str(libusb_package.get_library_path()), ctypes.RTLD_GLOBAL)
    except ImportError:
        pass
    import pyrealsense2  # noqa: PLC0415

    return pyrealsense2


def depth_steps(frame: int) -> np.ndarray:
    """Return (48, 64) uint16: a wall at 0.6 m, a board at 0.3 m that goes right by 2 px a frame, nothing at the top."""
    steps = np.full((DEPTH["height"], DEPTH["width"]), 6000, np.uint16)
    steps[12:36, 16 + 2 * frame : 40 + 2 * frame] = 3000
    steps[:3] = 0
    return steps


def colours(frame: int) -> np.ndarray:
    """Return (72, 96, 3) uint8: columns in red, rows in green, the frame in blue."""
    rgb = np.empty((COLOR["height"], COLOR["width"], 3), np.uint8)
    rgb[..., 0], rgb[..., 1], rgb[..., 2] = np.arange(96), 2 * np.arange(72)[:, None], 10 * frame
    return rgb


class SoftwareCamera:
    """Attributes: rs, the SDK; device; sensors (a D405 has but one) and profiles, depth before colour."""

    def __init__(
        self,
        rs: Any,
        *,
        serial: str = "0123",
        joined: bool = True,
        one_sensor: bool = False,
        depth: dict[str, float] = DEPTH,
        colour: dict[str, float] = COLOR,
        lens: tuple[float, ...] = LENS,
        turn: float = TURN,
        shift: tuple[float, float, float] = SHIFT,
    ) -> None:
        self.rs, self.device = rs, rs.software_device()
        for info, text in (("name", "RealSense D4xx"), ("serial_number", serial), ("usb_type_descriptor", "3.2")):
            self.device.register_info(getattr(rs.camera_info, info), text)
        stereo = self.device.add_sensor("Stereo Module")
        self.sensors = [stereo, stereo if one_sensor else self.device.add_sensor("RGB Camera")]
        self.sensors[0].add_read_only_option(rs.option.depth_units, UNIT)
        self.profiles = [
            self.sensors[0].add_video_stream(self._stream(rs.stream.depth, rs.format.z16, 1, 2, depth, (0.0,) * 5)),
            self.sensors[1].add_video_stream(self._stream(rs.stream.color, rs.format.rgb8, 2, 3, colour, lens)),
        ]
        if joined:
            extrinsics = rs.extrinsics()
            c, s = np.cos(turn), np.sin(turn)
            extrinsics.rotation, extrinsics.translation = [c, s, 0, -s, c, 0, 0, 0, 1], list(shift)  # by columns
            self.profiles[0].register_extrinsics_to(self.profiles[1], extrinsics)
        self.device.create_matcher(rs.matchers.default)

    def _stream(self, kind: Any, form: Any, uid: int, bpp: int, camera: dict[str, float], lens: Any) -> Any:
        intrinsics, stream = self.rs.intrinsics(), self.rs.video_stream()
        for name, value in camera.items():
            setattr(intrinsics, name, value)
        intrinsics.model, intrinsics.coeffs = self.rs.distortion.inverse_brown_conrady, list(lens)
        stream.type, stream.fmt, stream.index, stream.uid, stream.bpp, stream.fps = kind, form, 0, uid, bpp, 30
        stream.width, stream.height, stream.intrinsics = camera["width"], camera["height"], intrinsics
        return stream

    def show(self, number: int, stamp: float, *, late: float = 0.001, domain: str = "global_time") -> None:
        """Deliver a pair of made-up frames; colour is `late` after depth [s]."""
        self.deliver(number, stamp, depth_steps(number % 8), colours(number % 8), late=late, domain=domain)

    def deliver(
        self,
        number: int,
        stamp: float,
        depth: np.ndarray,
        rgb: np.ndarray,
        *,
        late: float = 0.0,
        domain: str = "hardware_clock",
        rate: float = 30.0,
    ) -> None:
        """Deliver a pair of frames: depth (H, W) uint16 in steps of `UNIT`, rgb (H, W, 3) uint8; [s] and [Hz]."""
        for k, (image, bpp) in enumerate(((depth, 2), (rgb, 3))):
            sensor, frame = self.sensors[k], self.rs.software_video_frame()
            told = round(1e3 * rate)  # above the true rate nothing is ever paired
            sensor.set_metadata(self.rs.frame_metadata_value.actual_fps, told)
            frame.pixels, frame.bpp, frame.stride = np.ascontiguousarray(image), bpp, bpp * image.shape[1]
            frame.timestamp, frame.frame_number = 1e3 * (stamp + k * late), number
            frame.domain = getattr(self.rs.timestamp_domain, domain)
            frame.profile = self.profiles[k].as_video_stream_profile()
            if k == 0 and hasattr(frame, "depth_units"):
                frame.depth_units = UNIT
            sensor.on_video_frame(frame)


def record(rs: Any, path: Path | str, frames: int = 3, *, joined: bool = True) -> None:
    """Write a recording with the SDK's own recorder: .bag up to SDK 2.57, .db3 from 2.58 on."""
    camera = SoftwareCamera(rs, joined=joined)
    recorder = rs.recorder(str(path), camera.device)
    sensors, taken = recorder.query_sensors(), rs.frame_queue(50)
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles()[0])
        sensor.start(taken)
    for number in range(frames):
        camera.show(number, START + number * PERIOD)
        time.sleep(0.02)
    for sensor in sensors:
        sensor.stop()
        sensor.close()


def aligned_by_sdk(rs: Any, path: Path | str) -> dict[int, np.ndarray]:
    """Return what the SDK's own align makes of a recording: frame -> (72, 96) depth [m] on the colour image.

    The syncer loses pairs now and then, the first one often: the recording is played until two are there.
    """
    found: dict[int, np.ndarray] = {}
    for _ in range(20):
        if len(found) < 2:
            found |= _played(rs, path)
    return found


def _played(rs: Any, path: Path | str) -> dict[int, np.ndarray]:
    device, found = rs.context().load_device(str(path)), {}
    device.as_playback().set_real_time(False)
    syncer, align = rs.syncer(100), rs.align(rs.stream.color)
    sensors = device.query_sensors()
    scale = next(s.as_depth_sensor().get_depth_scale() for s in sensors if s.is_depth_sensor())
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
    for sensor in sensors:
        sensor.start(syncer)
    while True:
        there, frames = syncer.try_wait_for_frames(300)
        if not there:
            break
        if frames.get_depth_frame() and frames.get_color_frame():
            depth = align.process(frames).get_depth_frame()
            found[frames.get_depth_frame().get_frame_number()] = scale * np.array(depth.get_data(), dtype=float)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    return found


if __name__ == "__main__":
    record(sdk(), sys.argv[1])
