"""Recordings of an Azure Kinect, or an Orbbec Femto (.mkv) -> a `Capture`. V views, H x W pixels.

The tracks COLOR (MJPG, NV12, YUY2 or BGRA), DEPTH (z-depth in mm, 16 bits, big-endian) and the attachment
calibration.json are read: lenses in units of the sensor's size, of which each mode shows a part. The format, the modes'
parts of the sensor and the lens are as in Microsoft's Azure-Kinect-Sensor-SDK 1.4: docs "record-file-format",
matroska_read.cpp, mode_specific_calibration.c, intrinsic_transformation.c. No recording of a real camera was tested.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core.cameras import Maps, is_shown, laid_over, straightened, straightening
from anther.core.checks import check_array, check_range
from anther.core.errors import InputError, bad_input
from anther.core.files import LARGEST_TEXT, understood
from anther.core.geometry import Array, Intrinsics, inverse
from anther.core.opencv import cv2
from anther.perception.capture import Capture, check_views
from anther.perception.formats._matroska import Frame, Matroska, Track, read_matroska
from anther.perception.formats.bags import (
    BagOptions,
    BagViews,
    FramePair,
    check_motion,
    given_poses,
    matched_views,
)
from anther.perception.images import is_intact
from anther.perception.transforms import scaled, without_rounding

_RECORD = "k4arecorder --depth-mode NFOV_UNBINNED --color-mode 1080p FILE.mkv"
_LOCATIONS = {"DEPTH": ("D0", "Depth"), "COLOR": ("PV0", "PhotoVideo")}
"""Track -> how the calibration ends the Location and the Purpose of its camera."""
_DEPTH_KINDS = {b"b16g": ">u2", b"YUY2": "<u2"}
"""How 16 bits are written; YUY2 is what the first recorders called them."""


class _Camera(NamedTuple):
    """A camera's pinhole without its lens, where its pixels lie in the image with it, and T_camera_rig."""

    intrinsics: Intrinsics
    maps: Maps | None
    T_camera_rig: Array


def read_azure_kinect(path: Path | str, options: BagOptions | None = None) -> BagViews:
    """Return the views in a recording, each at the pose that a trajectory file tells for its time.

    The poses are the colour camera's, or the depth camera's where there is no colour. Times count from the recording's
    beginning. Depth is freed of its lens and laid over colour, which is brought to about its fineness.

    Args:
        path: the .mkv.
        options: poses, camera_in_pose, tolerance, views; the others are of bags.

    Raises:
        InputError: no recording, damaged or cut off; without depth, calibration or poses; a lens, a mode or a codec
            that is not known; nothing within the tolerance.
    """
    options = options or BagOptions()
    held = read_matroska(path)
    name = str(held.path)
    with understood(name, "a recording of k4arecorder", "Copy it again, or record it anew."):
        depth, colour = _track(held, "DEPTH"), _track(held, "COLOR")
        if depth is None:
            given = f"tracks {', '.join(track.name or '?' for track in held.tracks) or 'none'}"
            raise bad_input(name, given=given, allowed="a DEPTH track", do=f"Record depth: {_RECORD}")
        cameras = _cameras(name, held, depth, colour)
        _check_options(name, options)
        depths, colours = ([held.tick * f.ticks for f in held.frames[t.number]] for t in (depth, colour or depth))
        clocks = "times count from the recording's beginning"
        views, notes = matched_views(name, depths, colours, given_poses(options), options, clocks)
        check_motion(name, views)
        capture = _capture(held, depth, colour, cameras, views)
    return BagViews(capture, np.array([view.time for view in views]), (*notes, *_notes(held)))


def _track(held: Matroska, name: str) -> Track | None:
    return next((track for track in held.tracks if track.name == name), None)


def _check_options(path: str, options: BagOptions) -> None:
    if options.poses is None:
        do = (
            "Give --poses FILE with rows: time x y z qx qy qz qw (camera in world; time [s] from the recording's "
            "beginning). Of a camera that stands still one row, and --views 1."
        )
        raise bad_input(path, given="no poses: a recording holds none", allowed="a trajectory file", do=do)
    of_bags = ("color_topic", "depth_topic", "pose_topic", "pose_frame", "camera_frame", "world_frame")
    given = [f"--{key.replace('_', '-')}" for key in of_bags if getattr(options, key) is not None]
    if given:
        raise bad_input(path, given=", ".join(given), allowed="options of bags for bags", do="Leave it out.")


def _notes(held: Matroska) -> list[str]:
    """Return what the recording states and is not used."""
    others = [track.name or "?" for track in held.tracks if track.name not in _LOCATIONS]
    notes = [f"tracks not used: {', '.join(others)}"] if others else []
    for tag, said in (
        ("K4A_DEPTH_DELAY_NS", "depth was taken {} s after colour; each takes the colour nearest in time"),
        ("K4A_START_OFFSET_NS", "the recording begins at {} s of the camera's clock; times of poses count from there"),
    ):
        nanoseconds = int(held.tags.get(tag, "0"))
        if nanoseconds:
            notes.append(said.format(f"{nanoseconds * 1e-9:g}"))
    return notes + ["its recorder was stopped hard: what it was writing at the end is left out"] * held.cut


def _cameras(path: str, held: Matroska, depth: Track, colour: Track | None) -> dict[str, _Camera]:
    """Return the cameras of the tracks by the attached calibration."""
    place = held.attachments.get("calibration.json")
    if place is None or place.size > LARGEST_TEXT:
        given = "no attachment calibration.json"
        raise bad_input(path, given=given, allowed="a recording with its calibration", do=f"Record it anew: {_RECORD}")
    with understood(f"{path}: calibration.json", "an Azure Kinect's calibration", "Record it anew."):
        text = held.read(place).rstrip(b"\0")
        told = json.loads(text)["CalibrationInformation"]["Cameras"]
        return {t.name: _camera(f"{path}: {t.name}", t, told) for t in (depth, colour) if t is not None}


def _camera(what: str, track: Track, told: list[dict[str, Any]]) -> _Camera:
    """Return a track's camera by the calibration's list of cameras.

    The world of the rotations and translations [m] is the depth camera; they map from it to each camera.
    """
    ends = _LOCATIONS[track.name]
    found = [one for one in told if any(str(one.get(key)).endswith(ends) for key in ("Location", "Purpose"))]
    if len(found) != 1:
        raise ValueError(f"{len(found)} cameras {ends[0]}")
    lens, pose, T_camera_rig = found[0]["Intrinsics"], found[0]["Rt"], np.eye(4)
    sensor = int(found[0]["SensorWidth"]), int(found[0]["SensorHeight"])
    numbers = check_array("ModelParameters", lens["ModelParameters"], (14,))
    D = _distortion(str(lens["ModelType"]), numbers)
    radius = check_range("MetricRadius", float(found[0].get("MetricRadius", 0)), 0, 3, "of the focal length")
    camera = _pinhole(what, track, sensor, numbers)
    widest = 1.7  # of the focal length: the SDK's, where the calibration tells no radius in which its lens holds
    straight, maps = _straight(what, camera, D, radius if radius > 1e-4 else widest, wider=track.name == "DEPTH")
    T_camera_rig[:3, :3] = check_array("Rotation", pose["Rotation"], (9,)).reshape(3, 3)
    T_camera_rig[:3, 3] = check_array("Translation", pose["Translation"], (3,))
    return _Camera(straight, maps, without_rounding("Rt", T_camera_rig))


def _distortion(kind: str, numbers: Array) -> Array:
    """Return OpenCV's k1, k2, p1, p2, k3 to k6 of k1 to k6, the centre of distortion, p2, p1."""
    k, centre, (p2, p1) = numbers[4:10], numbers[10:12], numbers[12:14]
    model = kind.removeprefix("CALIBRATION_LensDistortionModel")
    # Rational6KT counts p1 and p2 once where Brown and Conrady count them twice
    known = model == "BrownConrady" or (model == "Rational6KT" and not (p1 or p2))
    if not known or centre.any():
        beside = f", distortion centre {centre[0]:g}, {centre[1]:g}" if centre.any() else ""
        allowed, do = "BrownConrady around the principal point", "Export undistorted images with the SDK."
        raise bad_input("lens", given=f"{model[:60]}, p1 {p1:g}, p2 {p2:g}{beside}", allowed=allowed, do=do)
    return np.array([k[0], k[1], p1, p2, *k[2:]])


def _pinhole(what: str, track: Track, sensor: tuple[int, int], numbers: Array) -> Intrinsics:
    """Return the camera of a mode's images, with its lens: cx, cy, fx, fy are in units of the whole sensor."""
    size, (cx, cy, fx, fy) = (track.width, track.height), numbers[:4].tolist()
    if track.name == "DEPTH":
        # width and height -> binning, and where the image begins on the binned sensor [px]
        modes = {(640, 576): (1, 192, 180), (320, 288): (2, 96, 90), (1024, 1024): (1, 0, 0), (512, 512): (2, 0, 0)}
        side = 1024  # px, both ways, of the depth camera's sensor
        if size not in modes or sensor != (side, side):
            raise _other_mode(what, size, sensor, f"{sorted(modes)} of {side} x {side}")
        binning, left, top = modes[size]
        whole = side / binning, side / binning
    else:
        shape = Fraction(*sensor)
        # all show the whole width of a sensor of 4 to 3, and the middle of its height
        sizes = {(1280, 720), (1920, 1080), (2560, 1440), (2048, 1536), (3840, 2160), (4096, 3072)}
        if size not in sizes or shape not in (Fraction(4, 3), Fraction(16, 9)):
            raise _other_mode(what, size, sensor, f"{sorted(sizes)} of 4 to 3 or 16 to 9")
        if shape == Fraction(16, 9):  # of the first devices: the middle of the sensor
            cy, fy = cy * 0.75 + 0.125, fy * 0.75
        whole = size[0], 0.75 * size[0]
        left, top = 0, (whole[1] - size[1]) / 2
    return Intrinsics(*size, fx * whole[0], fy * whole[1], cx * whole[0] - left - 0.5, cy * whole[1] - top - 0.5)


def _other_mode(what: str, size: tuple[int, int], sensor: tuple[int, int], allowed: str) -> InputError:
    given = f"{size[0]} x {size[1]} px of a sensor of {sensor[0]} x {sensor[1]} px"
    return bad_input(what, given=given, allowed=f"sizes {allowed} px", do=f"Record it anew: {_RECORD}")


def _straight(what: str, camera: Intrinsics, D: Array, radius: float, *, wider: bool) -> tuple[Intrinsics, Maps | None]:
    """Return the camera without its lens, and where its pixels lie: nowhere beyond the radius in which the lens holds.

    Args:
        what: for messages.
        camera: with its lens.
        D: see `_distortion`.
        radius: of what is seen [of the focal length].
        wider: let the image grow to all that the lens shows; else it keeps its size.
    """
    half = np.ceil(radius * np.array([camera.fx, camera.fy])).astype(int).tolist()
    straight = Intrinsics(2 * half[0] + 1, 2 * half[1] + 1, camera.fx, camera.fy, *half) if wider else camera
    maps = straightening(what, camera, D, "rational_polynomial", straight)
    if maps is None:
        return camera, None
    x = (np.arange(straight.width) - straight.cx) / straight.fx
    y = (np.arange(straight.height) - straight.cy) / straight.fy
    maps[0][x**2 + y[:, None] ** 2 > radius**2] = -1  # outside of the image
    if not wider:
        return straight, maps
    inside = is_shown(maps, camera)
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not len(rows):
        raise ValueError("a lens that shows nothing")
    kept = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    cx, cy = straight.cx - columns[0], straight.cy - rows[0]
    straight = Intrinsics(int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1, camera.fx, camera.fy, cx, cy)
    return straight, (np.ascontiguousarray(maps[0][kept]), np.ascontiguousarray(maps[1][kept]))


def _capture(
    held: Matroska, depth: Track, colour: Track | None, cameras: dict[str, _Camera], views: list[FramePair]
) -> Capture:
    of, onto = cameras["DEPTH"], cameras.get("COLOR", cameras["DEPTH"])
    finer = max(1, int(onto.intrinsics.fx / of.intrinsics.fx))
    camera = scaled(onto.intrinsics, (onto.intrinsics.width // finer, onto.intrinsics.height // finer))
    size = check_views(len(views), camera)
    T_onto_of = onto.T_camera_rig @ inverse(of.T_camera_rig)
    shown = np.ones(size[::-1], bool) if onto.maps is None else is_shown(onto.maps, onto.intrinsics)
    coloured = cv2.resize(shown.astype(np.float32), size, interpolation=cv2.INTER_AREA) == 1
    depths, colours = [], []
    for view in views:
        image = _depth(held, depth, held.frames[depth.number][view.depth])
        image = straightened(image, of.maps, nearest=True)
        if colour is not None:
            image = laid_over(image, of.intrinsics, camera, T_onto_of)
            image[~coloured] = 0
            rgb = straightened(_colour(held, colour, held.frames[colour.number][view.color]), onto.maps, nearest=False)
            colours.append(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
        depths.append(image)
    poses = np.stack([view.T_world_cam for view in views])
    return Capture(np.stack(depths), camera, poses, np.stack(colours) if colours else None)


def _kind(track: Track, kinds: Collection[bytes]) -> bytes:
    """Return the FOURCC of a track, in the BITMAPINFOHEADER that VFW keeps."""
    kind = track.header[16:20] if track.codec == "V_MS/VFW/FOURCC" else b""
    if kind not in kinds:
        given = f"{track.codec} {kind.decode('latin-1')}".strip()
        do = "Take the file as k4arecorder wrote it, not converted."
        raise bad_input(track.name, given=given, allowed=", ".join(k.decode() for k in kinds), do=do)
    return kind


def _raw(held: Matroska, track: Track, frame: Frame, size: int) -> bytes:
    data = held.frame(track, frame, size)
    if len(data) != size:
        given = f"{len(data)} bytes for {track.width} x {track.height} px"
        raise bad_input(track.name, given=given, allowed=f"{size} bytes", do="Record it anew.")
    return data


def _depth(held: Matroska, track: Track, frame: Frame) -> NDArray[np.float32]:
    """Return (H, W) z-depth [m], 0 where there is none."""
    order = _DEPTH_KINDS[_kind(track, _DEPTH_KINDS)]
    data = _raw(held, track, frame, 2 * track.width * track.height)
    return np.frombuffer(data, order).reshape(track.height, track.width).astype(np.float32) * np.float32(1e-3)


def _colour(held: Matroska, track: Track, frame: Frame) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB."""
    kinds = {b"MJPG": None, b"NV12": 1.5, b"YUY2": 2, b"BGRA": 4}  # and bytes a pixel
    kind, width, height = _kind(track, kinds), track.width, track.height
    share = kinds[kind]
    if share is None:
        data, flags = held.frame(track, frame, LARGEST_TEXT), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if is_intact(data) else None
        if image is None or image.shape != (height, width, 3):
            given = "a damaged JPEG" if image is None else f"a JPEG of {image.shape[1]} x {image.shape[0]} px"
            raise bad_input(track.name, given=given, allowed=f"{width} x {height} px", do="Record it anew.")
        return np.asarray(image[..., ::-1], np.uint8)
    flat = np.frombuffer(_raw(held, track, frame, int(share * width * height)), np.uint8)
    match kind:
        case b"NV12":
            image = cv2.cvtColor(flat.reshape(-1, width), cv2.COLOR_YUV2RGB_NV12)
        case b"YUY2":
            image = cv2.cvtColor(flat.reshape(height, width, 2), cv2.COLOR_YUV2RGB_YUY2)
        case _:
            image = flat.reshape(height, width, 4)[..., 2::-1]
    return np.asarray(image, np.uint8)
