"""The ROS 2 node: what it finds of a cloud, what its messages hold, and, through rclpy, that it answers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from anther.cli import sample_data
from anther.core.errors import InputError, StageFailure
from anther.core.geometry import transform_from_pose7
from anther.perception.formats.clouds import read_cloud
from anther.perception.skeleton import Skeleton
from anther.pollination import grasp
from anther.robot.arm.gripper_shape import GripperShape
from anther.robot.cells import CellFile
from anther.robot.safety import check_trajectory
from anther.show import ros
from anther.sim.cell_file import read_simulated

CELL = '[arm]\nmodel = "sawyer"\n[gripper]\nshape = "rethink"\n[limits]\nspeed_ratio = 0.5\n'
NO_ROS = (
    "no rclpy: pip install ros-rclpy ros-rmw-fastrtps-cpp ros-sensor-msgs ros-trajectory-msgs ros-geometry-msgs "
    "ros-std-srvs ros-visualization-msgs, or source ROS 2"
)


def make(kind: str, **fields: Any) -> Any:
    return SimpleNamespace(kind=kind, **fields)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> CellFile:
    path = tmp_path_factory.mktemp("cell") / "cell.toml"
    path.write_text(CELL)
    return read_simulated(path)


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return read_cloud(Path(sample_data.__file__).with_name("plant.ply"), "m", "z").points


@pytest.fixture(scope="module")
def answers(file: CellFile, points: np.ndarray) -> ros.PlantAnswers:
    return ros.PlantAnswers(file, points)


def test_a_plan_leads_to_the_grasp_within_the_cells_limits(file: CellFile, answers: ros.PlantAnswers) -> None:
    start = file.model.ready
    best, way = answers.best_grasp(start), answers.plan(start)
    assert best.joints is not None
    assert way.positions[0] == pytest.approx(start)
    assert file.model.forward(way.positions[-1]) == pytest.approx(best.T_world_flange, abs=1e-4)
    check_trajectory(way, start, file.safety_limits())
    last = way.times >= way.duration - 1e-9
    assert np.abs(way.velocities[last]).max() < 1e-6, "it ends at rest"
    flange = file.model.forward(way.positions)[:, :3, 3]
    near = np.linalg.norm(flange - best.T_world_flange[:3, 3], axis=1) < grasp.STAND_OFF - 0.01
    off = (flange - best.T_world_flange[:3, 3])[near]
    across = off - np.outer(off @ best.approach, best.approach)
    assert np.linalg.norm(across, axis=1).max() < 2e-3, "the last way is straight along the approach"


def test_the_cells_gripper_is_what_the_grasp_is_planned_with(
    file: CellFile, points: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[grasp.Params] = []

    def told(*words: Any, **_: Any) -> Any:
        seen.append(words[3])
        raise StageFailure("no_grasp_found", "enough")

    found = ros.PlantAnswers(file, points)
    monkeypatch.setattr(found, "_found", (None, None))
    monkeypatch.setattr(ros.grasp, "plan_grasps", told)
    with pytest.raises(StageFailure):
        found.best_grasp(file.model.ready)
    assert seen[0].gripper == GripperShape.of(file.model.tool)


def test_points_beside_the_workspace_are_obstacles(file: CellFile, points: np.ndarray) -> None:
    post = np.array([[3.0, 0.0, 0.0], [3.0, 0.0, 0.1]])
    cloud = ros.PlantAnswers(file, np.concatenate([points, post])).cloud
    assert len(cloud.points) == len(points)
    assert cloud.obstacles == pytest.approx(post)
    with pytest.raises(InputError, match="none of them in the workspace"):
        ros.PlantAnswers(file, 1000 * points)


def test_a_cylinder_of_the_scene_ends_where_its_edge_does() -> None:
    nodes = np.array([[0, 0, 0], [0, 0, 0.1], [0.05, 0, 0.1], [0.05, 0, 0.1]], dtype=float)
    tree = Skeleton(nodes, np.array([-1, 0, 1, 2]), np.array([0.004, 0.003, 0.0002, 0.001]))
    shapes = list(ros.cylinders(tree))
    assert len(shapes) == 2, "an edge without length has no direction"
    for (kind, (length, radius), T), j in zip(shapes, (1, 2), strict=True):
        ends = np.sort([T[:3, 3] - length / 2 * T[:3, 2], T[:3, 3] + length / 2 * T[:3, 2]], axis=0)
        assert kind == ros.Kind.CYLINDER
        assert ends == pytest.approx(np.sort(nodes[[j - 1, j]], axis=0))
        assert radius == max(tree.radius[j], 1e-3)


def test_moveit_is_told_of_boxes_and_plant(file: CellFile) -> None:
    tree = Skeleton(np.array([[0.7, 0, 0], [0.7, 0, 0.1]]), np.array([-1, 0]), np.array([0.004, 0.003]))
    scene = ros.planning_scene(SimpleNamespace(make=make), "header", file, tree)
    found = {thing.id: thing for thing in scene.world.collision_objects}
    assert scene.is_diff
    assert set(found) == {"anther_keep_out", "anther_plant"}
    solid, pose = found["anther_keep_out"].primitives[0], found["anther_keep_out"].primitive_poses[0]
    box = file.keep_out[0]
    assert solid.dimensions == pytest.approx(list(box.upper - box.lower))
    assert [pose.position.x, pose.position.y, pose.position.z] == pytest.approx((box.lower + box.upper) / 2)
    assert found["anther_plant"].primitives[0].dimensions == pytest.approx([0.1, 0.003])
    alone = ros.planning_scene(SimpleNamespace(make=make), "header", file, None)
    assert [thing.id for thing in alone.world.collision_objects] == ["anther_keep_out"]


def cloud(columns: dict[str, np.ndarray], *, big: bool = False, pad: int = 4) -> Any:
    """A PointCloud2 with these columns, of two rows, and padding after each point and row."""
    order = ">" if big else "<"
    kinds = {"f4": 7, "f8": 8, "u4": 6}
    layout = np.dtype({
        "names": list(columns), "formats": [order + c.dtype.str[1:] for c in columns.values()],
        "offsets": list(np.cumsum([0, *(c.dtype.itemsize for c in columns.values())])[:-1]),
        "itemsize": sum(c.dtype.itemsize for c in columns.values()) + pad,
    })  # fmt: skip
    table = np.zeros((2, len(columns["x"]) // 2), layout)
    for name, values in columns.items():
        table[name] = values.reshape(table.shape)
    offsets = [layout.fields[name][1] for name in columns]  # type: ignore[index]
    fields = [
        SimpleNamespace(name=name, offset=offset, datatype=kinds[values.dtype.str[1:]])
        for (name, values), offset in zip(columns.items(), offsets, strict=True)
    ]
    rows = [row.tobytes() + b"\xff" * pad for row in table]
    return SimpleNamespace(
        height=2, width=table.shape[1], point_step=layout.itemsize, row_step=len(rows[0]), fields=fields,
        is_bigendian=big, data=b"".join(rows),
    )  # fmt: skip


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_a_cloud_is_read_whatever_its_layout(big: bool, kind: str) -> None:
    rng = np.random.default_rng(0)
    xyz, colours = rng.normal(size=(6, 3)).astype(kind), rng.integers(0, 256, (6, 3))
    xyz[4, 1] = np.nan
    packed = (colours @ [65536, 256, 1]).astype("u4")
    columns = {"intensity": rng.normal(size=6).astype("f4"), **dict(zip("xyz", xyz.T, strict=True)), "rgb": packed}
    points, read = ros.read_points(cloud(columns, big=big))
    good = np.isfinite(xyz).all(axis=1)
    assert points == pytest.approx(xyz[good].astype(float))
    assert np.array_equal(read, colours[good])
    assert ros.read_points(cloud({k: v for k, v in columns.items() if k != "rgb"}, big=big))[1] is None


def test_a_cloud_that_says_other_than_it_holds_is_refused() -> None:
    column = np.zeros(4, "f4")
    with pytest.raises(InputError, match="fields x, y; allowed: x, y, z"):
        ros.read_points(cloud({"x": column, "y": column}))
    message = cloud({"x": column, "y": column, "z": column})
    message.data = message.data[:-5]
    with pytest.raises(InputError, match="bytes for 2 x 2 points"):
        ros.read_points(message)


def test_what_is_published_is_read_as_it_was() -> None:
    points = np.random.default_rng(1).normal(size=(5, 3))
    assert ros.read_points(ros.cloud_message(make, "header", points))[0] == pytest.approx(points, abs=1e-6)


class Client:
    """Another program's end: it publishes a cloud, calls services and hears topics, through rclpy."""

    def __init__(self) -> None:
        import rclpy  # noqa: PLC0415
        from geometry_msgs.msg import PoseStamped  # noqa: PLC0415
        from rclpy.context import Context  # noqa: PLC0415
        from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415
        from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: PLC0415
        from sensor_msgs.msg import PointCloud2  # noqa: PLC0415
        from std_srvs.srv import Trigger  # noqa: PLC0415
        from trajectory_msgs.msg import JointTrajectory  # noqa: PLC0415
        from visualization_msgs.msg import MarkerArray  # noqa: PLC0415

        self._rclpy, self._context, self._trigger = rclpy, Context(), Trigger
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("asker", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.heard: dict[str, Any] = {}
        kinds = {"grasp": PoseStamped, "trajectory": JointTrajectory, "scene": MarkerArray, "plant": PointCloud2}
        for name, kind in kinds.items():
            self.node.create_subscription(
                kind, f"/anther/{name}", lambda message, name=name: self.heard.update({name: message}), kept
            )
        self._clouds = self.node.create_publisher(PointCloud2, "/anther/cloud", 1)

    def publish(self, points: np.ndarray, frame: str) -> None:
        from anther.robot.drivers.ros2 import _kind  # noqa: PLC0415

        header = _kind("std_msgs/msg/Header")(frame_id=frame)
        self._clouds.publish(ros.cloud_message(lambda kind, **told: _kind(kind)(**told), header, points))

    def call(self, name: str, seconds: float = 120) -> Any:
        client = self.node.create_client(self._trigger, f"/anther/{name}")
        assert client.wait_for_service(60), f"nobody offers {name}"
        future = client.call_async(self._trigger.Request())
        self.wait(future.done, seconds)
        return future.result()

    def wait(self, done: Any, seconds: float = 30) -> None:
        over = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < over, "nothing came"
            self._executor.spin_once(0.1)

    def close(self) -> None:
        self.node.destroy_node()
        self._rclpy.try_shutdown(context=self._context)


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    """The node as its command starts it, in a process of its own, and who asks it."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(os.getpid() % 100))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    (tmp_path / "cell.toml").write_text(CELL)
    words = [sys.executable, "-m", "anther.cli", "cell", "serve-ros", str(tmp_path / "cell.toml"), "--frame", "base"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        client = Client()
        try:
            yield client
        finally:
            client.close()
            process.terminate()


@pytest.mark.slow
@pytest.mark.skipif(find_spec("rclpy") is None, reason=NO_ROS)
def test_a_sample_cloud_gets_skeleton_grasp_and_plan_over_ros(
    served: Client, points: np.ndarray, file: CellFile
) -> None:
    early = served.call("skeleton")
    assert not early.success
    assert "no cloud was heard yet" in early.message
    served.publish(points, "camera")
    served.wait(lambda: "frame 'camera'" in served.call("skeleton").message)
    found = served.call("skeleton")
    while not found.success:
        served.publish(points, "base")
        time.sleep(0.5)
        found = served.call("skeleton")
        assert found.success or "frame" in found.message, found.message
    assert json.loads(found.message)["stem_length_m"] > 0.3
    told = served.call("plan")
    assert told.success, told.message
    answer = json.loads(told.message)
    served.wait(lambda: {"grasp", "trajectory", "scene", "plant"} <= set(served.heard))
    pose, way = served.heard["grasp"], served.heard["trajectory"]
    assert pose.header.frame_id == "base"
    T = transform_from_pose7(np.array(answer["grasp"]["pose7"]))
    assert [pose.pose.position.x, pose.pose.position.y, pose.pose.position.z] == pytest.approx(T[:3, 3])
    assert tuple(way.joint_names) == file.model.joints
    assert file.model.forward(np.array(way.points[-1].positions)) == pytest.approx(T, abs=1e-3)
    assert "no fresh joints" in answer["begins"]
    assert {marker.ns for marker in served.heard["scene"].markers} == {"keep_out", "skeleton"}
    assert len(ros.read_points(served.heard["plant"])[0]) == len(points)
