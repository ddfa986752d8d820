"""Views from a bag: RealSense .bag or .db3, ROS 1 .bag, ROS 2 folder or .mcap -> a `Capture`. V views.

Depth frames lead; colour and pose are the ones nearest in time, within a stated tolerance. Depth that is not aligned to
colour is laid over it (`alignment.laid_over`). Topics are found by their names and types unless they are given.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from anther.core.cameras import is_shown, laid_over, straightened
from anther.core.errors import bad_input
from anther.core.geometry import Array, inverse, transform_from_pose7
from anther.core.records import Range, Record
from anther.perception.capture import Capture
from anther.perception.formats import _realsense_bag
from anther.perception.formats._bag_file import BagFile, Recorded, Topics, find_topics
from anther.perception.formats._bag_messages import (
    BagCamera,
    FrameTree,
    Where,
    camera_of,
    check_size,
    colour_image,
    depth_image,
    nearest,
    pose_matrix,
    read_trajectory,
    sorted_series,
)


@dataclass(frozen=True, slots=True)
class BagOptions(Record):
    """What is taken from a bag.

    Attributes:
        color_topic, depth_topic: images; None: found by name.
        pose_topic: PoseStamped, TransformStamped, PoseWithCovarianceStamped or Odometry; None: tf where it moves the
            camera, else the only one there is.
        pose_frame: the frame in tf whose poses that topic gives; None: the one it names, else the camera's.
        poses: a trajectory file (time x y z qx qy qz qw) instead: RealSense's own bags hold no poses.
        camera_frame: the camera's optical frame in tf; None: the one its camera info names.
        world_frame: the world's frame in tf; None: the root of the camera's tree.
        camera_in_pose: 7-number pose of the camera's optical frame in the frame whose poses are given (hand-eye
            calibration, when they are the flange's); None: they are the camera's.
        tolerance: largest difference of stamps between depth, colour and pose [s].
        views: greatest number, evenly spread over the matched ones.
    """

    color_topic: str | None = None
    depth_topic: str | None = None
    pose_topic: str | None = None
    pose_frame: str | None = None
    poses: Path | None = None
    camera_frame: str | None = None
    world_frame: str | None = None
    camera_in_pose: tuple[float, float, float, float, float, float, float] | None = None
    tolerance: Annotated[float, Range(0, 10, "s")] = 0.02
    views: Annotated[int, Range(1, 10_000)] = 30


@dataclass(frozen=True, slots=True, eq=False)
class BagViews:
    """The views taken from a bag.

    Attributes:
        capture: the views.
        stamps: (V,) time of each depth frame [s].
        notes: what was left out and why.
    """

    capture: Capture
    stamps: Array
    notes: tuple[str, ...]


@dataclass(slots=True)
class _Contents:
    """What the first pass over a bag collects: every small message, and times by topic, of images those of their stamps
    or, where RealSense records them too, their own."""

    infos: dict[str, BagCamera] = field(default_factory=dict)
    poses: list[tuple[float, Array]] = field(default_factory=list)
    posed: str = ""
    times: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    frames: FrameTree = field(default_factory=FrameTree)
    extrinsics: dict[str, Array] = field(default_factory=dict)
    unit: float = 1e-3


class FramePair(NamedTuple):
    """A depth and a colour frame (which they are of their streams), the depth's time [s] and the camera's pose."""

    depth: int
    color: int
    time: float
    T_world_cam: Array


def read_bag(path: Path | str, options: BagOptions | None = None) -> BagViews:
    """Return the views in a bag.

    Args:
        path: a .bag (ROS 1, RealSense), an .mcap, a .db3 (RealSense, ROS 2), or a ROS 2 bag folder.
        options: see `BagOptions`.

    Raises:
        MissingExtra: rosbags or mcap is not installed.
        InputError: no bag, damaged, a topic is missing or ambiguous, no poses, nothing within the tolerance, or images
            that cannot be used.
    """
    options = options or BagOptions()
    with BagFile(path) as bag:
        topics = find_topics(bag, options.color_topic, options.depth_topic, options.pose_topic)
        held = _first_pass(bag, topics)
        camera, depth_camera, T_color_depth = _cameras(str(path), topics, held)
        where, more = _where(str(path), topics, held, options, camera.frame)
        depths, colours = (held.times[stream.images] for stream in (topics.depth, topics.color))
        views, notes = matched_views(str(path), depths, colours, where, options)
        images = _images(bag, topics, held.unit, views)
    for image, color in images:
        check_size(topics.depth.images, image, depth_camera.intrinsics)
        check_size(topics.color.images, color, camera.intrinsics)
    if options.world_frame is None:
        check_motion(str(path), views)
    depth = [straightened(image, depth_camera.maps, nearest=True) for image, _ in images]
    if T_color_depth is not None:
        coloured = camera.maps is None or is_shown(camera.maps, camera.intrinsics)
        depth = [laid_over(d, depth_camera.intrinsics, camera.intrinsics, T_color_depth) * coloured for d in depth]
    capture = Capture(
        depth=np.stack(depth),
        intrinsics=camera.intrinsics,
        T_world_cam=np.stack([view.T_world_cam for view in views]),
        rgb=np.stack([straightened(image, camera.maps, nearest=False) for _, image in images]),
    )
    return BagViews(capture, np.array([view.time for view in views]), (*notes, *more))


def check_motion(path: str, views: list[FramePair]) -> None:
    """Refuse views that were all taken from one and the same place."""
    if len(views) > 1 and np.ptp([view.T_world_cam for view in views], axis=0).max() == 0:
        do = "Record what moves it (/tf), or give --poses FILE."
        raise bad_input(path, given="one and the same pose in all views", allowed="a camera that moves", do=do)


def _first_pass(bag: BagFile, topics: Topics) -> _Contents:
    held = _Contents()
    for message in bag.messages(topics.all()):
        if message.topic in (topics.color.images, topics.depth.images):
            held.times[message.topic].append(message.stamp)
        else:
            _keep(held, message, bag, topics)
    for stream in (topics.color, topics.depth):
        if stream.times in held.times:
            frames, own = len(held.times[stream.images]), held.times[stream.times]
            if len(own) != frames:
                given, do = f"{frames} frames and {len(own)} times of frames", "Was it stopped early? Record it again."
                raise bad_input(stream.images, given=given, allowed="as many of both", do=do)
            held.times[stream.images] = own
    return held


def _keep(held: _Contents, message: Recorded, bag: BagFile, topics: Topics) -> None:
    value: Any = bag.decode(message)
    match message.kind.rpartition("/")[2]:
        case "CameraInfo":
            stream = topics.color if message.topic == topics.color.info else topics.depth
            rectified = "rect" in stream.images.lower()
            held.infos.setdefault(message.topic, camera_of(message.topic, value, rectified=rectified))
        case "PoseStamped":
            held.poses.append((message.stamp, pose_matrix(value.pose.position, value.pose.orientation)))
        case "PoseWithCovarianceStamped" | "Odometry":
            pose, held.posed = value.pose.pose, str(getattr(value, "child_frame_id", ""))
            held.poses.append((message.stamp, pose_matrix(pose.position, pose.orientation)))
        case "TransformStamped":
            held.posed = str(value.child_frame_id)
            held.poses.append((message.stamp, pose_matrix(value.transform.translation, value.transform.rotation)))
        case "Transform":
            held.extrinsics[message.topic] = pose_matrix(value.translation, value.rotation)
        case "Float32":
            held.unit = float(value.data)
        case "String":
            _keep_text(held, message.topic, str(value.data), topics)
        case _:
            held.frames.add(value.transforms, static=message.topic.endswith("static"))


def _keep_text(held: _Contents, topic: str, text: str, topics: Topics) -> None:
    """Keep RealSense's own messages (.db3)."""
    if topic in (topics.color.info, topics.depth.info):
        held.infos.setdefault(topic, camera_of(topic, _realsense_bag.camera_info(topic, text)))
    elif topic in (topics.color.extrinsics, topics.depth.extrinsics):
        held.extrinsics[topic] = _realsense_bag.extrinsics(topic, text)
    elif topic in (topics.color.times, topics.depth.times):
        held.times[topic].append(_realsense_bag.frame_time(topic, text))
    elif topic == topics.unit:
        held.unit = _realsense_bag.number(topic, text)


def _cameras(path: str, topics: Topics, held: _Contents) -> tuple[BagCamera, BagCamera, Array | None]:
    """Return the colour camera, the depth camera, and T_color_depth where depth is not aligned (else None)."""
    color = held.infos.get(topics.color.info)
    if color is None:
        raise bad_input(path, given=f"nothing on {topics.color.info}", allowed="a CameraInfo", do="Record it as well.")
    depth = held.infos.get(topics.depth.info, color)
    a, b = color.intrinsics, depth.intrinsics
    same = (a.width, a.height) == (b.width, b.height) and np.allclose(a.matrix, b.matrix, rtol=1e-3)
    ends = [held.extrinsics.get(topic) for topic in (topics.color.extrinsics, topics.depth.extrinsics)]
    if ends[0] is not None and ends[1] is not None:
        T_color_depth = ends[0] @ inverse(ends[1])
    elif depth is color:
        T_color_depth = np.eye(4)
    elif topics.by_sdk or not (color.frame and depth.frame):
        T_color_depth = None  # librealsense names every frame "", "0" or after its version
    else:
        T_color_depth = held.frames.between(color.frame, depth.frame)
    if T_color_depth is None:
        joint = (
            f"{_realsense_bag.stream_of(topics.depth.images)}/tf/N and the colour's" if topics.by_sdk else "/tf_static"
        )
        raise bad_input(
            path,
            given=f"depth in frame '{depth.frame}', colour in '{color.frame}', and no fixed transform between them",
            allowed=f"depth aligned to colour, or what joins them: {joint}",
            do="Record both streams with the SDK's recorder."
            if topics.by_sdk
            else "Record aligned_depth_to_color (realsense2_camera: align_depth.enable:=true) or /tf_static.",
        )
    return color, depth, None if same and np.allclose(T_color_depth, np.eye(4), atol=1e-5) else T_color_depth


def _where(
    path: str, topics: Topics, held: _Contents, options: BagOptions, frame: str
) -> tuple[Where, tuple[str, ...]]:
    """Return what gives the camera's pose at a time, and notes."""
    frame = (options.camera_frame or frame).lstrip("/")
    explicit = any(o is not None for o in (options.pose_topic, options.pose_frame, options.camera_in_pose))
    by_tf = held.frames.moves(frame) and not explicit
    notes: tuple[str, ...] = ()
    if options.poses is not None:
        return given_poses(options), notes
    camera = _mount(options)
    if held.poses and not by_tf:
        where = sorted_series(held.poses).at
        if options.camera_in_pose is None:
            camera, notes = _in_pose(topics.poses[0], held, options.pose_frame, frame)
    elif held.frames.parent:
        where = held.frames.lookup(frame, options.world_frame)
        notes = (f"poses are those of tf; {topics.poses[0]} is not used (--pose-topic)",) if held.poses else ()
    else:
        raise bad_input(
            path,
            given="no poses",
            allowed="a topic of PoseStamped, TransformStamped or Odometry, /tf, or a trajectory file",
            do="Record one, or give --poses FILE with rows: time x y z qx qy qz qw (camera in world).",
        )
    return _carried(where, camera), notes


def given_poses(options: BagOptions) -> Where:
    """Return what tells the camera's pose by the trajectory file that is given.

    Raises:
        InputError: see `read_trajectory`.
    """
    assert options.poses is not None
    return _carried(read_trajectory(options.poses).at, _mount(options))


def _mount(options: BagOptions) -> Array:
    """Return the camera's pose in the frame whose poses are given."""
    return np.eye(4) if options.camera_in_pose is None else transform_from_pose7(options.camera_in_pose)


def _carried(where: Where, camera: Array) -> Where:
    """Return what tells the pose of a camera on what `where` tells the pose of."""

    def camera_at(time: float) -> tuple[Array, float]:
        T, off = where(time)
        return T @ camera, off

    return camera_at


def _in_pose(topic: str, held: _Contents, given: str | None, frame: str) -> tuple[Array, tuple[str, ...]]:
    """Return the camera's pose in the frame whose poses a topic gives, and notes.

    Raises:
        InputError: it is another frame than the camera's, or that is not stated, and nothing joins them.
    """
    own, above = (given or held.posed).lstrip("/"), held.frames.parent.get(frame)
    if own:
        T = np.eye(4) if own == frame else held.frames.between(own, frame)
        if T is None:
            fault, allowed = f"poses of '{own}', a camera in '{frame}'", "fixed transforms between them in /tf_static"
            do = "Record them, or give --camera-in-pose x y z qx qy qz qw, or --pose-frame if it is another frame's."
            raise bad_input(topic, given=fault, allowed=allowed, do=do)
        return T, (f"{topic} gives the poses of '{own}'; the camera is '{frame}' on it",) if own != frame else ()
    if above is not None:
        fault = f"poses of an unnamed frame: the camera's '{frame}' or of what carries it, as '{above}'"
        do = f"Say it: --pose-frame {frame}, or another of {', '.join(sorted({*held.frames.parent.values()}))}."
        raise bad_input(topic, given=fault, allowed="the frame's name", do=do)
    return np.eye(4), (f"{topic} is taken for the poses of the camera's optical frame; else see --camera-in-pose",)


def matched_views(
    path: str,
    depth: Sequence[float],
    color: Sequence[float],
    where: Where,
    options: BagOptions,
    clocks: str = "RealSense's own stamps are not ROS time",
) -> tuple[list[FramePair], tuple[str, ...]]:
    """Return the views whose colour and pose are near enough in time, and notes on the others.

    Args:
        path: for messages, as is what is to be known of the `clocks`.
        depth, color: times of the frames [s].
        where: tells the camera's pose at a time.
        options: tolerance and views.

    Raises:
        InputError: there are none.
    """
    if not color or not depth:
        given = f"{len(color)} colour and {len(depth)} depth frames"
        raise bad_input(path, given=given, allowed="some of both", do="Was the recording stopped early?")
    order = np.argsort(color, kind="stable")
    stamps = np.array(color)[order]
    views, gaps = [], []
    for i, time in enumerate(depth):
        k = nearest(stamps, time)
        T, pose_off = where(time)
        gap = (abs(float(stamps[k]) - time), pose_off)
        gaps.append(gap)
        if max(gap) <= options.tolerance:
            views.append(FramePair(i, int(order[k]), time, T))
    if not views:
        off, pose = (min(column) for column in zip(*gaps, strict=True))
        raise bad_input(
            path,
            given=f"no depth frame with both near in time (nearest colour {off:.4g} s, nearest pose {pose:.4g} s)",
            allowed=f"within {options.tolerance:g} s",
            do=f"Raise --tolerance, or check that all clocks are one ({clocks}).",
        )
    lost = len(gaps) - len(views)
    notes = [f"{lost} of {len(gaps)} depth frames had no colour or pose within {options.tolerance:g} s"] if lost else []
    if len(views) > options.views:
        notes.append(f"{options.views} of {len(views)} matched views taken, evenly spread")
        views = [views[k] for k in np.round(np.linspace(0, len(views) - 1, options.views)).astype(int)]
    return views, tuple(notes)


def _images(bag: BagFile, topics: Topics, unit: float, views: list[FramePair]) -> list[tuple[Any, Any]]:
    """Return (depth [m], RGB) of every view, in a second pass that decodes only these."""
    depth, color = topics.depth.images, topics.color.images
    wanted = {depth: {v.depth for v in views}, color: {v.color for v in views}}
    found: dict[tuple[str, int], Any] = {}
    for message in bag.messages({depth, color}):
        if message.index in wanted[message.topic]:
            image = bag.decode(message)
            found[message.topic, message.index] = (
                depth_image(depth, image, unit) if message.topic == depth else colour_image(color, image)
            )
    return [(found[depth, view.depth], found[color, view.color]) for view in views]
