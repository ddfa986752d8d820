"""Which topics of a bag hold colour, depth, cameras and poses, by the names that RealSense's and ROS's drivers use.

RealSense's own recordings (librealsense, src/media/readme.md): /device_0/sensor_0/Depth_0/image/data, and beside it the
camera, .../tf/N, the transform from a reference stream to this one, and the sensor's depth unit as an option.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from anther.errors import bad_input
from anther.formats.bag_file import BagFile
from anther.formats.bag_realsense import shared_extrinsics, stream_of, units_of

_ALIGNED = ("aligned_depth", "depth_registered", "depth_to_rgb", "depth_to_color")
_POSES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")
_FRAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_TEXT = "std_msgs/msg/String"


@dataclass(frozen=True, slots=True)
class Topics:
    """The topics that are read.

    Attributes:
        color, depth: images.
        color_info, depth_info: their CameraInfo; the colour's where aligned depth has none of its own.
        color_extrinsics, depth_extrinsics: RealSense's transforms from one reference stream, or "".
        color_times, depth_times: RealSense's texts with the frames' own times (.db3), or "".
        poses: topics with the poses: one of PoseStamped or TransformStamped, or those of tf.
        unit: the depth unit [m], or "".
        by_sdk: whether librealsense's recorder wrote the images: its frame names mean nothing.
    """

    color: str
    depth: str
    color_info: str
    depth_info: str
    color_extrinsics: str
    depth_extrinsics: str
    color_times: str
    depth_times: str
    poses: tuple[str, ...]
    unit: str
    by_sdk: bool

    def all(self) -> set[str]:
        """Return every topic that is there."""
        cameras = {self.color_info, self.depth_info, self.color_extrinsics, self.depth_extrinsics, self.unit}
        return {self.color, self.depth, self.color_times, self.depth_times, *cameras, *self.poses} - {""}


def find_topics(bag: BagFile, color: str | None, depth: str | None, pose: str | None) -> Topics:
    """Return the topics to read; those that are given are only checked.

    Raises:
        InputError: a topic is missing, or several would do.
    """
    images = {t for t, kind in bag.topics.items() if kind in (_IMAGE, _COMPRESSED)}
    deep = {t for t in images if bag.topics[t] == _IMAGE or t.endswith("/compressedDepth")}
    color = _one(
        bag,
        "colour",
        color,
        images,
        lambda t: "depth" not in t and ("color" in t or "rgb" in t),
        ("rect", "raw", "data"),
    )
    depth = _one(bag, "depth", depth, deep, lambda t: "depth" in t, _ALIGNED)
    color_info = _camera_info(bag, color)
    if not color_info:
        raise _missing(bag, f"no camera info beside {color}", "sensor_msgs/CameraInfo", "Record it as well.")
    depth_info = _camera_info(bag, depth)
    if not depth_info and not any(word in depth.lower() for word in _ALIGNED):
        raise _missing(bag, f"no camera info beside {depth}", "sensor_msgs/CameraInfo", "Record it as well.")
    by_sdk = bool(stream_of(color) or stream_of(depth))
    unit = units_of(depth)
    if stream_of(depth) and unit not in bag.topics:
        raise _missing(
            bag, f"no depth unit on {unit}", "RealSense's own recording", "Record it with the SDK's recorder."
        )
    color_extrinsics, depth_extrinsics = shared_extrinsics(set(bag.topics), color, depth) if by_sdk else ("", "")
    return Topics(
        color=color,
        depth=depth,
        color_info=color_info,
        depth_info=depth_info or color_info,
        color_extrinsics=color_extrinsics,
        depth_extrinsics=depth_extrinsics,
        color_times=_times(bag, color),
        depth_times=_times(bag, depth),
        poses=() if by_sdk and pose is None else _pose_topics(bag, pose),
        unit=unit,
        by_sdk=by_sdk,
    )


def _one(
    bag: BagFile, what: str, given: str | None, among: set[str], fits: Callable[[str], bool], better: tuple[str, ...]
) -> str:
    """Return the topic given, else the only one that fits; of several, those with a better word in their name."""
    option = f"--{'color' if what == 'colour' else what}-topic"
    if given is not None:
        if given not in among:
            raise _missing(
                bag, f"no {what} images on {given}", " ".join(sorted(among)) or "images", f"Correct {option}."
            )
        return given
    found = sorted(t for t in among if fits(t.lower()))
    for word in better:
        found = [t for t in found if word in t.lower()] or found
    uncompressed = [t for t in found if bag.topics[t] == _IMAGE]
    found = uncompressed or found
    if len(found) != 1:
        told = f"{len(found)} topics with {what} images" + (f" ({', '.join(found)})" if found else "")
        raise _missing(bag, told, f"one of {', '.join(sorted(among)) or 'sensor_msgs/Image'}", f"Name it: {option}.")
    return found[0]


def _camera_info(bag: BagFile, image: str) -> str:
    """Return the camera info in the image's own folder, or one above it (compressed/); RealSense's in the stream's."""
    stream = stream_of(image)
    folders = (f"{stream}/info", stream) if stream else [image.rsplit("/", up)[0] for up in (1, 2)]
    return next((f"{f}/camera_info" for f in folders if f"{f}/camera_info" in bag.topics), "")


def _times(bag: BagFile, image: str) -> str:
    """Return RealSense's topic with the frames' own times; "" where the images' headers have them."""
    times = stream_of(image) + "/image/metadata"
    return times if stream_of(image) and bag.topics.get(times) == _TEXT else ""


def _pose_topics(bag: BagFile, given: str | None) -> tuple[str, ...]:
    """Return the pose topic (given, or the only one) and the topics of tf, whose fixed frames may join the cameras."""
    among = sorted(t for t, kind in bag.topics.items() if kind in _POSES)
    frames = tuple(sorted(t for t, kind in bag.topics.items() if kind in _FRAMES))
    if given is not None and given not in among:
        raise _missing(bag, f"no poses on {given}", ", ".join(among) or "PoseStamped", "Correct --pose-topic.")
    if given is None and len(among) > 1 and not frames:
        raise _missing(bag, f"{len(among)} topics with poses", ", ".join(among), "Name one: --pose-topic.")
    chosen = (given,) if given is not None else tuple(among) if len(among) == 1 else ()
    return (*chosen, *frames)


def _missing(bag: BagFile, given: str, allowed: str, do: str) -> Exception:
    return bad_input(str(bag.path), given=given, allowed=allowed, do=do)
