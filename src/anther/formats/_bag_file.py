"""Open a ROS 1 bag, a ROS 2 bag folder or its .db3 alone (RealSense's recordings), or an MCAP file, in one way.

Needs the extra `anther[bags]`: rosbags reads bags and decodes messages, mcap reads MCAP files. Message types are the
standard ones of ROS; definitions that a bag carries are not needed, which RealSense's own types would only spoil.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from anther.errors import InputError, MissingExtra, bad_input
from anther.files import existing
from anther.formats._realsense_bag import shared_extrinsics, stream_of, units_of, unpacked, without_unit

INSTALL = "pip install 'anther[bags]'"
_TFMESSAGE = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True, slots=True)
class Recorded:
    """One message as recorded.

    Attributes:
        topic: its topic.
        kind: its type, e.g. "sensor_msgs/msg/Image".
        stamp: time in its header, or when it was recorded if it has none or zero [s].
        index: how many messages of its topic came before it.
        data: the serialised message.
        ros1: whether it is serialised as ROS 1 does, else CDR.
    """

    topic: str
    kind: str
    stamp: float
    index: int
    data: bytes
    ros1: bool


class BagFile:
    """A bag of any kind, open for reading. Use it as a context manager.

    Args:
        path: a .bag, an .mcap, a .db3, or a folder with metadata.yaml (ROS 2).

    Attributes:
        path: as given.
        topics: topic -> message type ("package/msg/Name").

    Raises:
        MissingExtra: rosbags or mcap is not installed.
        InputError: missing, unreadable, or no bag.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = existing(path)
        try:
            import mcap  # noqa: F401, PLC0415
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415
        except ImportError as error:
            raise MissingExtra(f"{path}: bags need rosbags and mcap. Install them with: {INSTALL}") from error
        self._stores = {True: get_typestore(Stores.ROS1_NOETIC), False: get_typestore(Stores.ROS2_HUMBLE)}
        for name in _TFMESSAGE:
            self._stores[True].register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
        self._stack = ExitStack()
        self._reader: Any = None
        self.topics: dict[str, str] = {}

    def __enter__(self) -> BagFile:
        try:
            if self.path.suffix == ".mcap":
                self._open_mcap()
            else:
                self._open_rosbag()
        except InputError:
            raise
        except Exception as error:  # each reader raises errors of its own
            raise self._unreadable(error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def messages(self, topics: set[str]) -> Iterator[Recorded]:
        """Yield the messages of some topics in the order they were recorded.

        Raises:
            InputError: the bag is damaged.
        """
        counts = dict.fromkeys(topics, 0)
        try:
            for topic, kind, time, data, ros1 in self._raw(topics):
                yield Recorded(topic, kind, _stamp(kind, data, time, ros1), counts[topic], data, ros1)
                counts[topic] += 1
        except InputError:
            raise
        except Exception as error:
            raise self._unreadable(error) from error

    def decode(self, message: Recorded) -> Any:
        """Return a message as an object with the fields of its ROS type.

        Raises:
            InputError: the type is not a standard one, or the data does not fit it.
        """
        store = self._stores[message.ros1]
        try:
            if message.ros1:
                return store.deserialize_ros1(without_unit(message.topic, message.data), message.kind)
            return store.deserialize_cdr(message.data, message.kind)
        except Exception as error:
            raise self._unreadable(error) from error

    def _open_rosbag(self) -> None:
        from rosbags.rosbag1 import Reader as Reader1  # noqa: PLC0415
        from rosbags.rosbag2 import Reader as Reader2  # noqa: PLC0415

        if self.path.suffix not in (".bag", ".db3") and not (self.path / "metadata.yaml").is_file():
            allowed = ".bag, .mcap, .db3, or a ROS 2 bag folder with metadata.yaml"
            raise bad_input(str(self.path), given="no bag", allowed=allowed, do="Name the bag itself.")
        self._reader = self._stack.enter_context((Reader1 if self.path.suffix == ".bag" else Reader2)(self.path))
        self.topics = {c.topic: _full(c.msgtype) for c in self._reader.connections}

    def _open_mcap(self) -> None:
        from mcap.reader import make_reader  # noqa: PLC0415

        self._reader = make_reader(self._stack.enter_context(self.path.open("rb")), validate_crcs=True)
        summary = self._reader.get_summary()
        if summary is None:
            raise ValueError("no summary: it was not closed")
        for channel in summary.channels.values():
            if channel.message_encoding in ("ros1", "cdr") and channel.schema_id in summary.schemas:
                self.topics[channel.topic] = _full(summary.schemas[channel.schema_id].name)

    def _raw(self, topics: set[str]) -> Iterator[tuple[str, str, int, bytes, bool]]:
        if self.path.suffix == ".mcap":
            for schema, channel, message in self._reader.iter_messages(topics=sorted(topics)):
                ros1 = channel.message_encoding == "ros1"
                yield channel.topic, _full(schema.name), message.log_time, message.data, ros1
            return
        ros1 = self.path.suffix == ".bag"
        connections = [c for c in self._reader.connections if c.topic in topics]
        for connection, time, data in self._reader.messages(connections=connections) if connections else ():
            yield connection.topic, _full(connection.msgtype), time, unpacked(bytes(data)), ros1

    def _unreadable(self, error: Exception) -> InputError:
        do = "Is it truncated, or not closed? `rosbag reindex` or `mcap recover` may repair it."
        return bad_input(str(self.path), given=f"unreadable ({error})", allowed="a whole bag", do=do)


def _full(kind: str) -> str:
    return kind if "/msg/" in kind else kind.replace("/", "/msg/", 1)


def _stamp(kind: str, data: bytes, time: int, ros1: bool) -> float:
    """Return the header's stamp [s]: it begins at byte 4, after seq (ROS 1) or after CDR's own four bytes."""
    if kind.rpartition("/")[2] not in _WITH_HEADER or len(data) < 12:
        return time * 1e-9
    order = "<" if ros1 or data[1] else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", data, 4)
    return (seconds + nanoseconds * 1e-9) or time * 1e-9


_WITH_HEADER = {"Image", "CompressedImage", "CameraInfo", "PoseStamped", "TransformStamped"}


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
