"""A ROS 2 node that tells of a plant's cloud where its skeleton is, where to grasp it and how the arm gets there.

It speaks in standard messages alone (docs/ros.md): a plant's PointCloud2 comes in, std_srvs/Trigger asks, and what is
found goes out on topics whose newest message is kept for who comes later. It moves nothing. N points, J joints.
"""

from __future__ import annotations

import json
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from enum import IntEnum
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.core.errors import AntherError, InputError, StageFailure, bad_input
from anther.core.geometry import Array, pose7, transform
from anther.perception.cloud import Cloud
from anther.perception.flowers import flower_centres
from anther.perception.skeleton import Skeleton, skeletonize
from anther.perception.stem import Stem, find_stem
from anther.perception.supports import find_supports
from anther.pollination import grasp
from anther.robot.arm.gripper_shape import GripperShape
from anther.robot.arm.motions import join
from anther.robot.arm.planner import Planner
from anther.robot.cells import CellFile
from anther.robot.cells.hardware import planner_around
from anther.robot.devices import JointTrajectory
from anther.robot.drivers.ros2 import Node
from anther.robot.safety import check_trajectory

NAME = "anther"


class Kind(IntEnum):
    """As shape_msgs/SolidPrimitive and visualization_msgs/Marker both number them."""

    BOX = 1
    CYLINDER = 3


Shape = tuple[int, tuple[float, ...], Array]
"""Kind, dimensions as shape_msgs/SolidPrimitive has them [m], pose (4, 4) in the base frame."""


class PlantAnswers:
    """What is found of one cloud, each thing once.

    Args:
        file: the cell.
        points: (N, 3) in the arm's base frame [m]; those outside the cell's workspace are obstacles.
        colours: (N, 3) uint8, or None.

    Raises:
        InputError: no point is in the workspace.
    """

    def __init__(self, file: CellFile, points: Array, colours: NDArray[Any] | None = None) -> None:
        inside = file.workspace.contains(points)
        if not inside.any():
            given = f"{len(points)} points, none of them in the workspace"
            allowed = f"the plant within {file.workspace.lower} .. {file.workspace.upper} m"
            raise bad_input("cloud", given=given, allowed=allowed, do="Is it in metres, in the arm's base frame?")
        self.file, self.arm = file, file.model
        self.cloud = find_supports(
            Cloud(points[inside], None, None if colours is None else colours[inside], obstacles=points[~inside])
        )
        self._found: tuple[Skeleton, Stem] | None = None
        self._grasp: tuple[grasp.Grasp, Planner] | None = None

    def skeleton(self) -> tuple[Skeleton, Stem]:
        """Return the skeleton and its main stem.

        Raises:
            StageFailure: no plant, or no stem.
        """
        if self._found is None:
            tree = skeletonize(self.cloud)
            self._found = tree, find_stem(tree, flowers_at=flower_centres(self.cloud))
        return self._found

    def best_grasp(self, joints: Array) -> grasp.Grasp:
        """Return the best grasp that the arm reaches from joints (J,) [rad].

        Raises:
            StageFailure: there is none.
        """
        if self._grasp is None:
            tree, stem = self.skeleton()
            planner = planner_around(self.file, self.cloud, joints)
            params = grasp.Params(gripper=GripperShape.of(self.arm.tool))
            self._grasp = grasp.plan_grasps(stem, tree, self.cloud, params, reach=planner.reach)[0], planner
        return self._grasp[0]

    def plan(self, joints: Array) -> JointTrajectory:
        """Return the way from joints (J,) [rad] to the grasp: freely to the pre-grasp, then straight in.

        Raises:
            StageFailure: there is none, or it is not within the cell's limits.
        """
        best = self.best_grasp(joints)
        assert self._grasp is not None
        assert best.joints is not None
        planner = self._grasp[1]
        out = planner.line(best.joints, best.pregrasp(grasp.STAND_OFF))
        free = planner.move(joints, out.positions[-1])
        limits = self.file.safety_limits()
        way = join([free, out.backwards()])
        check_trajectory(way, joints, limits)
        return way


def cylinders(skeleton: Skeleton) -> Iterator[Shape]:
    """Give a cylinder around each of a skeleton's edges, which ends at node j and is as thick as that."""
    thinnest = 1e-3  # radius [m]
    for j, (start, end) in enumerate(skeleton.nodes[skeleton.edges], start=1):
        way = end - start
        length = float(np.linalg.norm(way))
        if length > 0:
            turn = Rotation.align_vectors([way / length], [[0.0, 0.0, 1.0]])[0].as_matrix()
            radius = max(float(skeleton.radius[j]), thinnest)
            yield Kind.CYLINDER, (length, radius), transform(turn, (start + end) / 2)


def boxes(file: CellFile) -> Iterator[Shape]:
    """Give the cell's keep-out boxes."""
    for box in file.keep_out:
        yield Kind.BOX, tuple((box.upper - box.lower).tolist()), transform(np.eye(3), (box.lower + box.upper) / 2)


class PlantNode:
    """The node, which answers as long as it is open. docs/ros.md has its topics and services.

    Args:
        file: the cell: arm, gripper, workspace, keep-out boxes and limits.
        frame: name of the arm's base frame.

    Raises:
        MissingExtra: rclpy or a message package is not installed.
    """

    def __init__(self, file: CellFile, frame: str = "base_link") -> None:
        self._file, self._frame, self._names = file, frame, _joint_names(file)
        self._answers: PlantAnswers | str = "no cloud was heard yet on ~/cloud"
        self._joints: tuple[float, Array] | None = None
        self._one = threading.Lock()
        self._node = Node(NAME, threads=3)
        latched = {
            "plant": "sensor_msgs/msg/PointCloud2",
            "scene": "visualization_msgs/msg/MarkerArray",
            "grasp": "geometry_msgs/msg/PoseStamped",
            "trajectory": "trajectory_msgs/msg/JointTrajectory",
        }
        self._out = {name: self._node.publisher(f"~/{name}", kind, latched=True) for name, kind in latched.items()}
        self._moveit = find_spec("moveit_msgs") is not None
        if self._moveit:
            self._out["planning scene"] = self._node.publisher("/planning_scene", "moveit_msgs/msg/PlanningScene")
        self._node.subscribe("~/cloud", "sensor_msgs/msg/PointCloud2", self._hear_cloud)
        self._node.subscribe("/joint_states", "sensor_msgs/msg/JointState", self._hear_joints)
        asked = {"skeleton": self._skeleton, "grasp_pose": self._grasp_pose, "plan": self._plan}
        for name, answer in asked.items():
            self._node.service(f"~/{name}", "std_srvs/srv/Trigger", self._answering(answer))
        self._show(None)

    @property
    def words(self) -> str:
        """What it offers, in a line."""
        scene = "and to /planning_scene" if self._moveit else "(no moveit_msgs here: nothing to /planning_scene)"
        return f"/{NAME} hears ~/cloud in {self._frame}, answers ~/skeleton, ~/grasp_pose, ~/plan; ~/scene {scene}"

    def close(self) -> None:
        """End the node."""
        self._node.close()

    def _answering(self, answer: Callable[[PlantAnswers], dict[str, Any]]) -> Callable[[Any], Any]:
        """Return what fills in a Trigger's response: JSON, or why there is none."""

        def filled(response: Any) -> Any:
            with self._one:
                try:
                    if isinstance(self._answers, str):
                        raise StageFailure("no_plant_found", f"{self._answers}.")
                    response.message, response.success = json.dumps(answer(self._answers)), True
                except AntherError as error:
                    response.message, response.success = str(error), False
            return response

        return filled

    def _skeleton(self, answers: PlantAnswers) -> dict[str, Any]:
        tree, stem = answers.skeleton()
        self._out["plant"].publish(self._cloud(answers.cloud.points))
        self._show(tree)
        return {
            "nodes": len(tree.nodes),
            "stem_length_m": float(stem.arc_length[-1]),
            "stem_m": tree.nodes[stem.node_ids].round(5).tolist(),
            "stem_radius_m": tree.radius[stem.node_ids].round(5).tolist(),
            "notes": [*answers.cloud.notes, *tree.notes, *stem.notes],
        }

    def _grasp_pose(self, answers: PlantAnswers) -> dict[str, Any]:
        best = answers.best_grasp(self._start()[0])
        self._skeleton(answers)
        make, T = self._node.make, best.T_world_flange
        stamped = make("geometry_msgs/msg/PoseStamped", header=self._header(), pose=self._pose(T))
        self._out["grasp"].publish(stamped)
        return {
            "pose7": pose7(T).tolist(),
            "point_m": best.point.tolist(),
            "stem_diameter_m": best.stem_diameter,
            "opening_m": best.opening,
            "clearance_m": best.clearance,
            "confidence": best.confidence,
            "joints_rad": dict(zip(self._names, map(float, best.joints), strict=True))
            if best.joints is not None
            else {},
            "reason": best.reason,
        }

    def _plan(self, answers: PlantAnswers) -> dict[str, Any]:
        joints, heard = self._start()
        way = answers.plan(joints)
        told = self._grasp_pose(answers)
        self._out["trajectory"].publish(self._trajectory(way))
        begins = "where the arm is" if heard else "where the arm's model is ready: no fresh joints were heard"
        return {"seconds": way.duration, "samples": len(way.times), "begins": begins, "grasp": told}

    def _start(self) -> tuple[Array, bool]:
        """Return the joints (J,) that a way begins at [rad], and whether they were heard."""
        if self._joints is None or time.monotonic() - self._joints[0] > 1.0:  # s
            return self._file.model.ready, False
        return self._joints[1], True

    def _hear_cloud(self, message: Any) -> None:
        try:
            if message.header.frame_id not in ("", self._frame):
                given, allowed = f"frame '{message.header.frame_id}'", f"'{self._frame}', the arm's base"
                raise bad_input("cloud", given=given, allowed=allowed, do="Transform it before, or give --frame.")
            self._answers = PlantAnswers(self._file, *read_points(message))
        except InputError as error:
            self._answers = str(error).rstrip(".")

    def _hear_joints(self, message: Any) -> None:
        at = dict(zip(message.name, message.position, strict=False))
        if set(self._names) <= set(at):
            self._joints = time.monotonic(), np.array([at[name] for name in self._names])

    def _show(self, tree: Skeleton | None) -> None:
        """Publish the scene: keep-out boxes, and the plant where it is known."""
        markers = [
            self._marker("keep_out", i, shape, (0.6, 0.45, 0.3, 0.4)) for i, shape in enumerate(boxes(self._file))
        ]
        if tree is not None:
            markers.append(self._lines(tree))
        self._out["scene"].publish(self._node.make("visualization_msgs/msg/MarkerArray", markers=markers))
        if self._moveit:
            self._out["planning scene"].publish(planning_scene(self._node, self._header(), self._file, tree))

    def _marker(self, space: str, number: int, shape: Shape, colour: tuple[float, ...]) -> Any:
        kind, size, T = shape
        scale = self._node.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", size, strict=True)))
        told = {"header": self._header(), "ns": space, "id": number, "type": kind, "scale": scale}
        return self._node.make("visualization_msgs/msg/Marker", **told, pose=self._pose(T), color=self._colour(colour))

    def _lines(self, tree: Skeleton) -> Any:
        make = self._node.make
        points = [_point(make, p) for p in tree.nodes[tree.edges].reshape(-1, 3)]  # of type 5, a list of lines
        told = {"header": self._header(), "ns": "skeleton", "type": 5, "points": points}
        scale = make("geometry_msgs/msg/Vector3", x=0.003, y=0.0, z=0.0)
        whole = self._pose(np.eye(4))
        return make(
            "visualization_msgs/msg/Marker", **told, scale=scale, pose=whole, color=self._colour((0.2, 0.6, 0.2, 1.0))
        )

    def _colour(self, rgba: tuple[float, ...]) -> Any:
        return self._node.make("std_msgs/msg/ColorRGBA", **dict(zip("rgba", rgba, strict=True)))

    def _header(self) -> Any:
        return self._node.make("std_msgs/msg/Header", frame_id=self._frame, stamp=self._node.now())

    def _pose(self, T: Array) -> Any:
        return pose_message(self._node.make, T)

    def _cloud(self, points: Array) -> Any:
        return cloud_message(self._node.make, self._header(), points)

    def _trajectory(self, way: JointTrajectory) -> Any:
        make, points = self._node.make, []
        for t, q, rate in zip(way.times, way.positions, way.velocities, strict=True):
            seconds, rest = divmod(round(float(t) * 1e9), 10**9)
            since = make("builtin_interfaces/msg/Duration", sec=seconds, nanosec=rest)
            told = {"positions": array("d", q), "velocities": array("d", rate), "time_from_start": since}
            points.append(make("trajectory_msgs/msg/JointTrajectoryPoint", **told))
        return make("trajectory_msgs/msg/JointTrajectory", joint_names=list(self._names), points=points)


def _joint_names(file: CellFile) -> tuple[str, ...]:
    """Return what the robot calls its joints: as the ros2 driver's key says, else as the model does."""
    names = file.arm.table.get("joints")
    return tuple(names) if isinstance(names, list) and len(names) == file.model.count else file.model.joints


def planning_scene(node: Any, header: Any, file: CellFile, tree: Skeleton | None) -> Any:
    """Return a moveit_msgs/PlanningScene that adds the cell's boxes and the plant's cylinders to MoveIt's world."""
    parts = {"anther_keep_out": list(boxes(file)), "anther_plant": [] if tree is None else list(cylinders(tree))}
    objects = []
    for name, shapes in parts.items():
        if not shapes:
            continue
        solids = [node.make("shape_msgs/msg/SolidPrimitive", type=kind, dimensions=list(d)) for kind, d, _ in shapes]
        poses = [pose_message(node.make, T) for _, _, T in shapes]
        told = {"header": header, "id": name, "primitives": solids, "primitive_poses": poses}
        objects.append(
            node.make(
                "moveit_msgs/msg/CollisionObject", **told, pose=pose_message(node.make, np.eye(4)), operation=b"\x00"
            )
        )
    world = node.make("moveit_msgs/msg/PlanningSceneWorld", collision_objects=objects)
    return node.make("moveit_msgs/msg/PlanningScene", is_diff=True, world=world)


def pose_message(make: Callable[..., Any], T: Array) -> Any:
    """Return a geometry_msgs/Pose of a transform (4, 4)."""
    x, y, z, *quaternion = (float(v) for v in pose7(T))
    turned = make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", quaternion, strict=True)))
    return make("geometry_msgs/msg/Pose", position=_point(make, np.array([x, y, z])), orientation=turned)


def _point(make: Callable[..., Any], place: Array) -> Any:
    return make("geometry_msgs/msg/Point", **dict(zip("xyz", map(float, place), strict=True)))


def cloud_message(make: Callable[..., Any], header: Any, points: Array) -> Any:
    """Return a sensor_msgs/PointCloud2 of points (N, 3) [m]."""
    fields = [
        make("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=7, count=1)  # of 4 bytes
        for i, name in enumerate("xyz")
    ]
    data = array("B", np.ascontiguousarray(points, dtype="<f4").tobytes())
    size = {"height": 1, "width": len(points), "point_step": 12, "row_step": 12 * len(points)}
    told = {"header": header, "fields": fields, "is_bigendian": False, "is_dense": True, "data": data}
    return make("sensor_msgs/msg/PointCloud2", **told, **size)


def read_points(message: Any) -> tuple[Array, NDArray[Any] | None]:
    """Return a PointCloud2's points (N, 3) [m] without those that are no numbers, and colours (N, 3) uint8 or None.

    Raises:
        InputError: it has no x, y, z, or is not as long as it says.
    """
    order = ">" if message.is_bigendian else "<"
    # sensor_msgs/PointField's datatype -> numpy's
    kinds = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), start=1))
    fields = {f.name: (f.offset, order + kinds.get(f.datatype, "f4")) for f in message.fields}
    if not {"x", "y", "z"} <= set(fields):
        allowed = "x, y, z, and rgb or rgba if there is colour"
        raise bad_input("cloud", given=f"fields {', '.join(fields)}", allowed=allowed, do="Publish those.")
    rows, width, step = message.height, message.width, message.point_step
    whole = np.frombuffer(bytes(message.data), dtype=np.uint8)
    if len(whole) < rows * message.row_step or message.row_step < width * step:
        given = f"{len(whole)} bytes for {rows} x {width} points"
        raise bad_input("cloud", given=given, allowed="height x row_step bytes", do="Look at its publisher.")
    packed = whole[: rows * message.row_step].reshape(rows, message.row_step)[:, : width * step]
    packed = np.ascontiguousarray(packed).reshape(-1, step)

    def column(name: str) -> NDArray[Any]:
        offset, kind = fields[name]
        return np.ascontiguousarray(packed[:, offset : offset + int(kind[2:])]).view(kind)[:, 0]

    points = np.column_stack([column(axis) for axis in "xyz"]).astype(np.float64)
    there = np.isfinite(points).all(axis=1)
    colour = next((name for name in ("rgb", "rgba") if name in fields), None)
    if colour is None:
        return points[there], None
    bits = column(colour).view(f"{order}u4")[there]
    return points[there], np.column_stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255]).astype(np.uint8)
