"""A recording as k4arecorder writes it: a wall of two colours, seen by two cameras with lenses, in a small Matroska.

The lenses and the modes' parts of the sensor are applied here from outside: to rays, not to images.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

LENS = (3.13, 2.32, 0.13, 3.46, 3.35, 0.66)
"""k1 to k6 of a device's depth camera, as one of its owners printed them; the edge is moved by tens of pixels."""
NORMAL, OFFSET, EDGE = np.array([0.5, 0.1, 1.0]) / np.linalg.norm([0.5, 0.1, 1.0]), 0.75, 0.05
"""The wall in the world: NORMAL @ x = OFFSET [m]; it is red at x < EDGE [m], else blue."""
RED, BLUE = (200, 30, 30), (30, 30, 200)
PERIOD = 33_333
"""[us] between frames."""


class Eye(NamedTuple):
    """A camera: its images' size [px], the part of the sensor it shows (binned size, left, top), lens, T_eye_depth."""

    size: tuple[int, int]
    whole: tuple[float, float]
    corner: tuple[float, float]
    unit: tuple[float, float, float, float]
    lens: tuple[float, ...]
    pose: Any


@cache
def rays(size: Any, whole: Any, corner: Any, unit: Any, lens: Any) -> Any:
    """Return (H, W, 3) directions of all pixels of an `Eye`, z = 1; NaN where the lens shows nothing."""
    K = np.eye(3)
    K[0, 0], K[1, 1] = unit[2] * whole[0], unit[3] * whole[1]
    K[0, 2], K[1, 2] = (c * n - o - 0.5 for c, n, o in zip(unit[:2], whole, corner, strict=True))
    grid = np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in size)), axis=-1).reshape(-1, 1, 2)
    k1, k2, k3, k4, k5, k6 = lens
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)
    flat = cv2.undistortPointsIter(grid, K, np.array([k1, k2, P1, P2, k3, k4, k5, k6]), np.eye(3), np.eye(3), stop)
    flat[~(np.linalg.norm(flat, axis=-1) < 1.7)] = np.nan
    return np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1).reshape(*size[::-1], 3)


P1, P2 = 8.1e-5, -5.1e-5
TILT = cv2.Rodrigues(np.array([0.1, 0.003, 0.0]))[0]  # [rad] about x: the depth camera looks down by six degrees
T_COLOUR_DEPTH = np.r_[np.c_[TILT, [-0.032, -0.002, 0.004]], [[0, 0, 0, 1]]]
DEPTH = Eye((320, 288), (512, 512), (96, 90), (0.512, 0.495, 0.492, 0.4922), LENS, np.eye(4))
WIDE = DEPTH._replace(size=(512, 512), corner=(0, 0))
COLOUR = Eye(
    (1280, 720), (1280, 960), (0, 120), (0.4968, 0.5109, 0.4709, 0.6274),
    (0.7227, -2.8856, 1.6327, 0.6022, -2.7196, 1.5651), T_COLOUR_DEPTH,
)  # fmt: skip


def pose(frame: int) -> Any:
    """Return T_world_colour of a frame: the camera goes right by 10 mm a frame and turns a little."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.0, 0.02 * frame, 0.01]))[0]
    T[:3, 3] = 0.01 * frame, 0.0, -0.02
    return T


def seen(eye: Eye, T_world_eye: Any) -> tuple[Any, Any]:
    """Return (H, W) z-depth of the wall up to 3 m [m], 0 elsewhere, and (H, W, 3) its colours."""
    turned = rays(*eye[:5]) @ T_world_eye[:3, :3].T
    depth = (OFFSET - NORMAL @ T_world_eye[:3, 3]) / (turned @ NORMAL)
    x = T_world_eye[0, 3] + depth * turned[..., 0]
    depth = np.where((depth > 0) & (depth < 3), depth, 0)
    return depth, np.where((x < EDGE)[..., None], RED, BLUE).astype(np.uint8)


def calibration(depth: Eye = DEPTH, colour: Eye = COLOUR, **changes: Any) -> dict[str, Any]:
    """Return calibration.json; `changes` are of both cameras."""
    cameras = []
    for name, purpose, eye, sensor in (("D0", "Depth", depth, 1024), ("PV0", "PhotoVideo", colour, 4096)):
        lens = [*eye.unit, *eye.lens, 0.0, 0.0, P2, P1]
        told = {
            "Intrinsics": {
                "ModelParameterCount": 14, "ModelParameters": lens,
                "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
            },
            "Location": f"CALIBRATION_CameraLocation{name}", "Purpose": f"CALIBRATION_CameraPurpose{purpose}",
            "MetricRadius": 1.74 if name == "D0" else 0, "Rt": {
                "Rotation": np.float32(eye.pose[:3, :3]).ravel().tolist(), "Translation": eye.pose[:3, 3].tolist(),
            }, "SensorWidth": sensor, "SensorHeight": sensor if name == "D0" else 3072,
        }  # fmt: skip
        told["Intrinsics"] |= changes.get("lens", {})
        cameras.append(told | {k: v for k, v in changes.items() if k != "lens"})
    return {"CalibrationInformation": {"Cameras": cameras, "InertialSensors": []}}


def element(kind: int, *content: bytes | int | str, size: int | None = None) -> bytes:
    """Return an EBML element of bytes, a number or a text; `size` is what it states, -1 for unknown."""
    body = b"".join(
        c if isinstance(c, bytes) else c.encode() if isinstance(c, str) else c.to_bytes(8, "big") for c in content
    )
    stated = len(body) if size is None else size
    length = b"\x01" + b"\xff" * 7 if stated < 0 else (stated | 1 << 56).to_bytes(8, "big")
    return kind.to_bytes((kind.bit_length() + 7) // 8, "big") + length + body


def colour_bytes(kind: bytes, rgb: Any) -> bytes:
    """Return an image as a FOURCC has it."""
    if kind == b"MJPG":
        return cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    if kind == b"BGRA":
        return np.dstack([rgb[..., ::-1], np.full(rgb.shape[:2], 255, np.uint8)]).tobytes()
    if kind == b"YUY2":
        return cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_YUY2).tobytes()
    planar = cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420).reshape(-1)
    luma, chroma = np.split(planar, [rgb.shape[0] * rgb.shape[1]])
    return np.r_[luma, chroma.reshape(2, -1).T.reshape(-1)].tobytes()


def recording(
    path: Path,
    *,
    frames: int = 3,
    depth: Eye | None = DEPTH,
    colour: bytes | None = b"MJPG",
    told: dict[str, Any] | None = None,
    depth_kind: bytes = b"b16g",
    packing: tuple[bytes, Callable[[bytes], bytes]] | None = None,
    closed: bool = True,
    tags: dict[str, str] | None = None,
) -> None:
    """Write a recording: colour 8 ms after depth, and some IMU. `told` {}: no calibration."""
    named = [(1, "COLOR", COLOUR.size, colour), (2, "DEPTH", (depth or DEPTH).size, depth_kind if depth else None)]
    entries = [
        element(
            0xAE, element(0xD7, n), element(0x83, b"\x01"), element(0x536E, name), element(0x86, "V_MS/VFW/FOURCC"),
            element(0x63A2, struct.pack("<IiiHH4s20x", 40, *size, 1, 16, kind)),
            element(0xE0, element(0xB0, size[0]), element(0xBA, size[1])), packing[0] if packing and n == 2 else b"",
        )
        for n, name, size, kind in named if kind
    ]  # fmt: skip
    entries.append(element(0xAE, element(0xD7, 3), element(0x536E, "IMU"), element(0x86, "S_K4A/IMU")))
    clusters = []
    for i in range(frames):
        blocks = [(3, 0, b"\0" * 40)]
        if depth:
            steps, _ = seen(depth, pose(i) @ T_COLOUR_DEPTH)
            data = np.round(1000 * steps).astype(">u2" if depth_kind == b"b16g" else "<u2").tobytes()
            blocks.append((2, 0, packing[1](data) if packing else data))
        if colour:
            blocks.append((1, 8000, colour_bytes(colour, seen(COLOUR, pose(i))[1])))
        parts = [
            element(0xA3, bytes([0x80 | n]), struct.pack(">hB", late, 0), data) if n != 2
            else element(0xA0, element(0xA1, bytes([0x80 | n]), struct.pack(">hB", late, 0), data))
            for n, late, data in blocks
        ]  # fmt: skip
        clusters.append(element(0x1F43B675, element(0xE7, PERIOD * i), *parts, size=None if closed else -1))
    attached = json.dumps(calibration(depth or DEPTH) if told is None else told).encode()
    file = element(0x61A7, element(0x466E, "calibration.json"), element(0x465C, attached))
    said = [element(0x7373, element(0x67C8, element(0x45A3, k), element(0x4487, v))) for k, v in (tags or {}).items()]
    body = b"".join([
        element(0x1549A966, element(0x2AD7B1, 1000)), element(0x1654AE6B, *entries),
        element(0x1941A469, file) if told != {} else b"", element(0x1254C367, *said), *clusters,
    ])  # fmt: skip
    head = element(0x1A45DFA3, element(0x4282, "matroska"))
    path.write_bytes(head + element(0x18538067, body, size=None if closed else -1))


def poses(path: Path, frames: int = 3) -> None:
    """Write the trajectory of the colour camera at the times of depth."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

    rows = [
        [i * PERIOD * 1e-6, *pose(i)[:3, 3], *Rotation.from_matrix(pose(i)[:3, :3]).as_quat()] for i in range(frames)
    ]
    np.savetxt(path, rows)
