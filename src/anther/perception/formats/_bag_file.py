"""Open a ROS 1 bag, a ROS 2 bag folder or its .db3 alone (RealSense's recordings), or an MCAP file, in one way.

Needs the extra `anther[bags]`: rosbags reads bags and decodes messages, mcap reads MCAP files, those of ROS 1 too.
Message types are the standard ones of ROS; definitions that a bag carries are not needed, which RealSense's own types
would only spoil.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from anther.core.errors import InputError, MissingExtra, bad_input
from anther.core.files import existing
from anther.perception.formats._realsense_bag import shared_extrinsics, stream_of, units_of, unpacked, without_unit

INSTALL = "pip install 'anther[bags]'"
_FRAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True, slots=True)
class Recorded:
    """One message as recorded, of a kind such as "sensor_msgs/msg/Image", after `index` others of its topic.

    Its stamp is the time in its header, or when it was recorded if it has none or zero [s]; `data` is as ROS 1 writes
    it, else CDR.
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
        for name in _FRAMES:
            self._stores[True].register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
        self._stack = ExitStack()
        self._reader: Any = None
        self.topics: dict[str, str] = {}

    def __enter__(self) -> BagFile:
        with self._understood():
            if self.path.suffix == ".mcap":
                self._open_mcap()
            else:
                self._open_rosbag()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def messages(self, topics: set[str]) -> Iterator[Recorded]:
        """Yield the messages of some topics in the order they were recorded."""
        counts = dict.fromkeys(topics, 0)
        with self._understood():
            for topic, kind, time, data, ros1 in self._raw(topics):
                yield Recorded(topic, kind, _stamp(kind, data, time, ros1), counts[topic], data, ros1)
                counts[topic] += 1

    def decode(self, message: Recorded) -> Any:
        """Return a message as an object with the fields of its ROS type, which must be a standard one."""
        store = self._stores[message.ros1]
        with self._understood():
            if message.ros1:
                return store.deserialize_ros1(without_unit(message.topic, message.data), message.kind)
            return store.deserialize_cdr(message.data, message.kind)

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

    @contextmanager
    def _understood(self) -> Iterator[None]:
        """Turn what the readers raise, each errors of its own, into one clear error."""
        try:
            yield
        except InputError:
            raise
        except Exception as error:
            do = "Is it truncated, or not closed? `rosbag reindex` or `mcap recover` may repair it."
            raise bad_input(str(self.path), given=f"unreadable ({error})", allowed="a whole bag", do=do) from error


def _full(kind: str) -> str:
    return kind if "/msg/" in kind else kind.replace("/", "/msg/", 1)


def _stamp(kind: str, data: bytes, time: int, ros1: bool) -> float:
    """Return the header's stamp [s]: it begins at byte 4, after seq (ROS 1) or after CDR's own four bytes."""
    if kind.rpartition("/")[2] not in _WITH_HEADER or len(data) < 12:
        return time * 1e-9
    order = "<" if ros1 or data[1] else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", data, 4)
    return (seconds + nanoseconds * 1e-9) or time * 1e-9


_WITH_HEADER = {
    "Image", "CompressedImage", "CameraInfo", "PoseStamped", "TransformStamped", "PoseWithCovarianceStamped",
    "Odometry",
}  # fmt: skip
_ALIGNED = ("aligned_depth", "depth_registered", "depth_to_rgb", "depth_to_color")
_POSES = (
    *(f"geometry_msgs/msg/{name}Stamped" for name in ("Pose", "Transform", "PoseWithCovariance")),
    "nav_msgs/msg/Odometry",
)
_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_TEXT = "std_msgs/msg/String"


class Stream(NamedTuple):
    """Topics of a camera: images, CameraInfo; RealSense's transform from a stream that both share and the frames' own
    times (.db3), or "" each."""

    images: str
    info: str
    extrinsics: str
    times: str


class Topics(NamedTuple):
    """The topics that are read.

    Attributes:
        color, depth: of the cameras; aligned depth that has no CameraInfo of its own has the colour's.
        poses: one of PoseStamped, TransformStamped, PoseWithCovarianceStamped or Odometry, and those of tf.
        unit: the depth unit [m], or "".
        by_sdk: whether librealsense's recorder wrote the images: its frame names mean nothing.
    """

    color: Stream
    depth: Stream
    poses: tuple[str, ...]
    unit: str
    by_sdk: bool

    def all(self) -> set[str]:
        """Return every topic that is there."""
        return {*self.color, *self.depth, *self.poses, self.unit} - {""}


def find_topics(bag: BagFile, color: str | None, depth: str | None, pose: str | None) -> Topics:
    """Return the topics to read; those that are given are only checked."""
    images = {t for t, kind in bag.topics.items() if kind in (_IMAGE, _COMPRESSED)}
    deep = {t for t in images if bag.topics[t] == _IMAGE or "depth" in t.lower()}
    colourful = {t for t in images if "depth" not in t.lower() and ("color" in t.lower() or "rgb" in t.lower())}
    color = _one(bag, "colour", color, images, colourful, ("rect", "raw", "data"))
    depth = _one(bag, "depth", depth, deep, {t for t in deep if "depth" in t.lower()}, _ALIGNED)
    infos = {image: _camera_info(bag, image) for image in (color, depth)}
    for image, info in infos.items():
        if not info and (image == color or not any(word in image.lower() for word in _ALIGNED)):
            raise _missing(bag, f"no camera info for {image}", "sensor_msgs/CameraInfo", "Record it as well.")
    by_sdk, unit = bool(stream_of(color) or stream_of(depth)), units_of(depth)
    if stream_of(depth) and unit not in bag.topics:
        do = "Record it with the SDK's recorder."
        raise _missing(bag, f"no depth unit on {unit}", "RealSense's own recording", do)
    extrinsics = shared_extrinsics(set(bag.topics), color, depth) if by_sdk else ("", "")
    return Topics(
        Stream(color, infos[color], extrinsics[0], _times(bag, color)),
        Stream(depth, infos[depth] or infos[color], extrinsics[1], _times(bag, depth)),
        poses=() if by_sdk and pose is None else _pose_topics(bag, pose),
        unit=unit,
        by_sdk=by_sdk,
    )


def _one(
    bag: BagFile, what: str, given: str | None, among: set[str], fitting: set[str], better: tuple[str, ...]
) -> str:
    """Return the topic given, else the only one that fits; of several, those with a better word in their name."""
    option = f"--{'color' if what == 'colour' else what}-topic"
    if given is not None:
        if given not in among:
            allowed = " ".join(sorted(among)) or "images"
            raise _missing(bag, f"no {what} images on {given}", allowed, f"Correct {option}.")
        return given
    found = sorted(fitting)
    for word in better:
        found = [t for t in found if word in t.lower()] or found
    found = [t for t in found if bag.topics[t] == _IMAGE] or found
    found = [t for t in found if t.endswith("/compressedDepth")] or found
    if len(found) != 1:
        given = f"{len(found)} topics with {what} images" + (f" ({', '.join(found)})" if found else "")
        raise _missing(bag, given, f"one of {', '.join(sorted(among)) or 'sensor_msgs/Image'}", f"Name it: {option}.")
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
