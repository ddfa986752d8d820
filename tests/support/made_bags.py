"""Bags as ROS 1, RealSense, ROS 2 and MCAP recorders leave them, written with rosbags and mcap for the tests."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from anther.core.geometry import Intrinsics, pose7

START = 1_700_000_000  # [s]


@dataclass
class BagMaker:
    """Messages of one bag, in the dialect of ROS 1 or 2."""

    ros1: bool = True
    messages: list[tuple[str, str, float, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            tf = get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
            self.store.register(tf)

    def make(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, time: float, frame: str = "camera") -> Any:
        whole = int(np.floor(time))
        stamp = self.make("builtin_interfaces/msg/Time", sec=whole, nanosec=round((time - whole) * 1e9))
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if self.ros1 else {}))

    def add(self, topic: str, kind: str, time: float, **values: Any) -> None:
        self.messages.append((topic, kind, time, self.make(kind, **values)))

    def image(self, topic: str, time: float, pixels: np.ndarray, encoding: str, frame: str = "camera") -> None:
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
        rows = np.pad(rows, ((0, 0), (0, 4)))  # drivers may pad rows
        self.add(
            topic,
            "sensor_msgs/msg/Image",
            time,
            header=self.header(time, frame),
            height=len(pixels),
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1],
            data=rows.ravel(),
        )

    def compressed(self, topic: str, time: float, data: bytes, form: str = "png") -> None:
        kind, header = "sensor_msgs/msg/CompressedImage", self.header(time)
        self.add(topic, kind, time, header=header, format=form, data=np.frombuffer(data, np.uint8))

    def odometry(self, topic: str, time: float, T: np.ndarray, child: str) -> None:
        """A nav_msgs/Odometry; with an empty child, a PoseWithCovarianceStamped."""
        position, orientation = self._vector("Point", T)
        pose = self.make("geometry_msgs/msg/Pose", position=position, orientation=orientation)
        posed = self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
        if not child:
            kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
            self.add(topic, kind, time, header=self.header(time, "odom"), pose=posed)
            return
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        twist = self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
        header = self.header(time, "odom")
        self.add(topic, "nav_msgs/msg/Odometry", time, header=header, child_frame_id=child, pose=posed, twist=twist)

    def camera_info(
        self, topic: str, camera: Intrinsics, frame: str = "camera", model: str = "plumb_bob", D: Any = (0.0,) * 5
    ) -> None:
        roi = self.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        P = np.zeros(12)
        arrays = {"D": np.asarray(D, float), "K": camera.matrix.ravel(), "R": np.eye(3).ravel(), "P": P}
        self.add(
            topic,
            "sensor_msgs/msg/CameraInfo",
            START,
            header=self.header(START, frame),
            height=camera.height,
            width=camera.width,
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **(arrays if self.ros1 else {name.lower(): value for name, value in arrays.items()}),
        )

    def _vector(self, kind: str, T: np.ndarray) -> tuple[Any, Any]:
        x, y, z, *q = pose7(T)
        vector = self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)
        return vector, self.make("geometry_msgs/msg/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3])

    def pose(self, topic: str, time: float, T: np.ndarray) -> None:
        position, orientation = self._vector("Point", T)
        pose = self.make("geometry_msgs/msg/Pose", position=position, orientation=orientation)
        self.add(topic, "geometry_msgs/msg/PoseStamped", time, header=self.header(time, "world"), pose=pose)

    def transform(self, topic: str, time: float, T: np.ndarray) -> None:
        translation, rotation = self._vector("Vector3", T)
        self.add(topic, "geometry_msgs/msg/Transform", time, translation=translation, rotation=rotation)

    def tf(self, topic: str, time: float, links: list[tuple[str, str, np.ndarray]]) -> None:
        transforms = []
        for parent, child, T in links:
            translation, rotation = self._vector("Vector3", T)
            transform = self.make("geometry_msgs/msg/Transform", translation=translation, rotation=rotation)
            transforms.append(
                self.make(
                    "geometry_msgs/msg/TransformStamped",
                    header=self.header(time, parent),
                    child_frame_id=child,
                    transform=transform,
                )
            )
        self.add(topic, "tf2_msgs/msg/TFMessage", time, transforms=transforms)

    def write(self, path: Path) -> None:
        """Write .bag (ROS 1), .mcap (ROS 1 or 2), or a ROS 2 folder, as the suffix says."""
        if path.suffix == ".mcap":
            self._write_mcap(path)
            return
        writer: Any = Writer1(path) if path.suffix == ".bag" else Writer2(path, version=9)
        with writer:
            connections: dict[str, Any] = {}
            for topic, kind, time, message in self.messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(connections[topic], round(time * 1e9), self._bytes(message, kind))

    def _write_mcap(self, path: Path) -> None:
        with path.open("wb") as stream:
            writer = McapWriter(stream)
            writer.start(profile="ros1" if self.ros1 else "ros2")
            channels: dict[str, int] = {}
            for topic, kind, time, message in self.messages:
                if topic not in channels:
                    name = kind.replace("/msg/", "/") if self.ros1 else kind
                    definition = self.store.generate_msgdef(kind, ros_version=1 if self.ros1 else 2)[0].encode()
                    schema = writer.register_schema(name, "ros1msg" if self.ros1 else "ros2msg", definition)
                    channels[topic] = writer.register_channel(topic, "ros1" if self.ros1 else "cdr", schema)
                log = round(time * 1e9)
                writer.add_message(channels[topic], log, self._bytes(message, kind), log)
            writer.finish()

    def _bytes(self, message: Any, kind: str) -> bytes:
        return bytes(self.store.serialize_ros1(message, kind) if self.ros1 else self.store.serialize_cdr(message, kind))
