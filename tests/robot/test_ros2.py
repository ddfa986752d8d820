"""The driver for ROS 2's joint_trajectory_controller: against a fake controller in this process, and through rclpy."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_robot import LIMITS
from fake_ros2 import CLOCK, FakeController, FakeNode, RosNode, moments, refusal, sampled
from made_arm import six
from slow_clock import AGAIN_IF_HELD_UP, clock, sleep
from small_planner import SmallPlanner
from streamed_motions import check_kept_up, halfway, raising_beyond, thought_about, three_pieces

from anther.core.errors import InputError, MissingExtra, StageFailure
from anther.robot.arm.model import outline
from anther.robot.cells import _parts, read_cell
from anther.robot.devices import Arm, ArmSample, DeviceError, JointTrajectory
from anther.robot.drivers import ros2
from anther.robot.drivers._streamed import Reference, StreamedArm
from anther.robot.safety import GuardedArm

HERE = Path(__file__).parents[1] / "support"
MODEL = six()
ACCELERATION = MODEL.acceleration
READY = np.array([0.0, -0.6, -1.4, 0.0, 0.8, 0.0])
INSTALL = (
    "no rclpy: pip install ros-rclpy ros-rmw-fastrtps-cpp ros-sensor-msgs ros-trajectory-msgs ros-geometry-msgs, "
    "or source ROS 2"
)
pytestmark = AGAIN_IF_HELD_UP
needs_ros = pytest.mark.skipif(find_spec("rclpy") is None, reason=INSTALL)
OVER_ROS = pytest.mark.parametrize("wire", [pytest.param("ros", marks=needs_ros)], indirect=True)
"""With the fake node it is checked in test_conformance.py."""


@pytest.fixture
def wire(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """What carries messages to the controller: this process, or where a test asks for it, ROS 2."""
    if getattr(request, "param", "fake") == "fake":
        yield FakeNode()
        return
    monkeypatch.setenv("ROS_DOMAIN_ID", str(os.getpid() % 100))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with closing(RosNode()) as node:
        yield node


@pytest.fixture
def robot(wire: Any) -> Iterator[FakeController]:
    with closing(FakeController(MODEL.joints, READY, wire.tell, clock=clock, sleep=sleep)) as fake:
        wire.deliver = fake.hear
        yield fake


@pytest.fixture
def arm(wire: Any, robot: FakeController) -> Iterator[ros2.JointTrajectoryArm]:
    with closing(connected(wire)) as driver:
        yield driver


def connected(wire: Any, **options: Any) -> ros2.JointTrajectoryArm:
    node = wire if isinstance(wire, FakeNode) else ros2.Node("anther")
    words = {"names": MODEL.joints, "acceleration": ACCELERATION, "clock": clock, "sleep": sleep} | options
    return ros2.JointTrajectoryArm(node, **words)


def far(arm: Arm, way: float = 0.4) -> JointTrajectory:
    return SmallPlanner(MODEL).move(arm.joints(), arm.joints() + way)


def longest_stop(speed: float) -> float:
    """Return the longest that an arm may move on when nothing more is said [s]: the message's motion, and braking."""
    return ros2.AHEAD + speed / float(ACCELERATION.min()) + 2 / 200  # and two cycles of the controller


def bent(duration: float, speed: float) -> JointTrajectory:
    """Return a motion of all joints that is as fast at its end as it gets."""
    t = np.linspace(0, duration, 60)[:, None]
    along = np.linspace(0.5, 1.0, 6)
    rate = speed * (t / duration) ** 2 * (3 - 2 * t / duration)
    q = READY + speed * duration * ((t / duration) ** 3 - 0.5 * (t / duration) ** 4) * along
    return JointTrajectory(t[:, 0], q, rate * along)


@pytest.mark.parametrize("motion", [bent(0.6, 0.8), SmallPlanner(MODEL).move(READY, READY + 0.4)], ids=["on", "rests"])
def test_every_message_begins_on_the_way_and_ends_at_rest(motion: JointTrajectory) -> None:
    """Heard to its end it keeps to the motion, brakes within the arm's accelerations, and stands."""
    reference = Reference(motion, lambda: None)  # something may follow: the motion need not end at rest
    top = np.abs(motion.velocities).max()
    for t in np.linspace(0, motion.duration, 73):
        plan = ros2.plan(reference, t, ACCELERATION)
        rows = np.stack([plan.q, plan.rate, plan.acceleration], axis=1)
        assert np.all(np.diff(plan.times) > 0)
        assert plan.times[0] == 0.0
        assert plan.times[-1] <= ros2.AHEAD + top / ACCELERATION.min() + 1e-3
        assert not np.any(plan.rate[-1])
        assert not np.any(plan.acceleration[-1])
        known = min(ros2.AHEAD, motion.duration - t)
        for s in np.linspace(0, known, 7, endpoint=False):
            assert sampled(plan.times, rows, s)[0] == pytest.approx(reference.at(t + s)[0], abs=1e-5)
        after = np.array([sampled(plan.times, rows, s)[1] for s in np.arange(known, plan.times[-1], 1e-3)])
        if len(after) > 10:  # where moments meet, the controller's polynomials go a little beyond
            assert np.abs(np.diff(after[::5], axis=0)).max() / 5e-3 < 1.3 * ACCELERATION.min()
    reference.close()


@OVER_ROS
def test_it_goes_where_it_is_told_and_says_so(arm: ros2.JointTrajectoryArm, robot: FakeController) -> None:
    conforms: Arm = arm
    start, seen = conforms.joints(), list[ArmSample]()
    assert start == pytest.approx(READY, abs=1e-9)  # though the robot names its joints in another order
    record = arm.follow(far(arm, 0.1), seen.append)
    assert record.commanded[-1] == pytest.approx(start + 0.1, abs=1e-6)
    assert arm.joints() == pytest.approx(start + 0.1, abs=1e-3)
    assert np.all(np.diff(record.times) > 0)
    assert len(seen) == len(record.times) > 50 * (record.times[-1] - record.times[0])
    assert max(np.abs(s.measured - s.commanded).max() for s in seen) < 0.02
    assert np.isnan(seen[-1].force)
    assert arm.follow(far(arm, -0.1)).times[0] >= record.times[-1]
    assert robot.refused == []


def test_nothing_is_said_before_anything_moves(arm: ros2.JointTrajectoryArm, robot: FakeController) -> None:
    arm.hold()
    sleep(0.2)
    assert robot.heard == []
    assert arm.joints() == pytest.approx(READY, abs=1e-9)  # though the robot names its joints in another order
    assert arm.readings.clock.offset == pytest.approx(-CLOCK, abs=0.05)
    assert any("contact is not felt" in line for line in arm.describe())


@pytest.mark.slow
@OVER_ROS
def test_motions_join_without_a_stop_while_the_next_is_thought_about(
    arm: ros2.JointTrajectoryArm, robot: FakeController
) -> None:
    begin, middle, end = three_pieces(arm.joints())
    record = arm.follow(begin, None, thought_about(middle, end))
    assert record.commanded[-1] == pytest.approx(end.positions[-1], abs=1e-6)
    check_kept_up([when for when, _ in robot.heard])
    times, speed = robot.speed()
    moving = times[speed > 0.01]
    assert speed[(times > moving[0] + 0.3) & (times < moving[-1] - 0.3)].min() > 0.1
    assert robot.refused == []


@OVER_ROS
def test_it_stops_where_its_watcher_raises(arm: ros2.JointTrajectoryArm, robot: FakeController) -> None:
    start = arm.joints()
    with pytest.raises(KeyboardInterrupt, match="enough"):
        arm.follow(far(arm), raising_beyond(start, KeyboardInterrupt("enough")))
    sleep(0.1)
    there = arm.joints()
    assert np.abs(there - start).max() == pytest.approx(0.1, abs=0.06)
    arm.hold()
    sleep(0.1)
    assert arm.joints() == pytest.approx(there, abs=2e-3)
    assert robot.refused == []


def test_braking_begins_where_the_arm_is_by_then(arm: ros2.JointTrajectoryArm, robot: FakeController) -> None:
    """A watcher that thinks before it raises leaves the last message behind: the stop takes the arm on, not back."""
    goal, thinks, said = arm.joints() + 0.2, 0.025, list[int]()

    def watch(sample: ArmSample) -> None:
        if np.all(sample.measured > goal):
            said.append(len(robot.heard))
            sleep(thinks)
            raise DeviceError("enough")

    with pytest.raises(DeviceError, match="enough"):
        arm.follow(far(arm), watch)
    last, stop = (moments(robot.heard[i][1]) for i in (said[0] - 1, said[0]))
    assert np.all(stop[1][0, 0] > sampled(*last, thinks)[0] - 1e-6)
    assert np.all(np.diff(stop[1][:, 0], axis=0) > 0)


@pytest.mark.slow
def test_when_the_network_comes_back_the_way_to_rest_does_not_begin_anew(
    wire: FakeNode, arm: ros2.JointTrajectoryArm, robot: FakeController
) -> None:
    """What a middleware still delivers then is the last message: it must be one that leads there gently."""
    path = far(arm)

    def break_it() -> None:
        wire.cut = robot.mute = True

    halfway(path, break_it)
    with pytest.raises(DeviceError, match="ms old"):
        arm.follow(path)
    assert robot.stopped_after(clock()) == 0.0
    began = len(robot.log)
    wire.deliver(wire.said[-1][1])
    sleep(0.7)
    _, speed = robot.speed()
    assert speed[began:].max() < 0.3 * np.abs(path.velocities).max()
    assert np.abs(robot.q - robot.log[began][1]).max() > 1e-3  # it did go there


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["j0", "j1", "j2", "j3", "j4"], "j5 missing; allowed: j0, j1"),
        (["left_j0", "left_j1"], "tells other joints: left_j0, left_j1; wanted: j0"),
    ],
)
def test_an_arm_with_other_joints_is_not_connected_to(
    wire: FakeNode, robot: FakeController, monkeypatch: pytest.MonkeyPatch, names: list[str], message: str
) -> None:
    monkeypatch.setattr(StreamedArm, "_patience", 0.5)
    robot.names = names
    sleep(0.1)
    with pytest.raises(DeviceError, match=message):
        connected(wire)


def test_joints_that_are_renamed_on_the_way_stop_it(arm: ros2.JointTrajectoryArm, robot: FakeController) -> None:
    path = far(arm)
    halfway(path, lambda: setattr(robot, "names", ["j0", "j1", "elbow"]))
    with pytest.raises(DeviceError, match="missing"):
        arm.follow(path)
    assert robot.stopped_after(clock()) < 0.05


def test_a_controller_that_goes_away_is_told(wire: FakeNode, arm: ros2.JointTrajectoryArm) -> None:
    path = far(arm)
    halfway(path, lambda: setattr(wire, "listeners", 0))
    with pytest.raises(DeviceError, match="nobody listens to /joint_trajectory_controller/joint_trajectory"):
        arm.follow(path)
    with pytest.raises(DeviceError, match="nobody listens"):
        arm.follow(path)
    assert any("cannot move: nobody listens" in line for line in arm.describe())


def test_it_brakes_by_itself_when_nothing_more_is_heard(
    wire: FakeNode, arm: ros2.JointTrajectoryArm, robot: FakeController
) -> None:
    """As after kill -9: no last word, no hold."""
    path = far(arm)
    halfway(path, lambda: setattr(wire, "cut", True))
    arm.follow(path)
    last = robot.heard[-1][0]
    assert np.abs(robot.q - path.positions[-1]).max() > 0.05  # it did stop on the way
    assert robot.stopped_after(last) < longest_stop(np.abs(path.velocities).max())


def test_a_wrench_is_felt_and_must_not_fall_silent(wire: FakeNode, robot: FakeController) -> None:
    over = threading.Event()

    def tell() -> None:
        while not over.is_set():
            if "/wrench" in wire.hears:
                force = SimpleNamespace(x=3.0, y=0.0, z=4.0)
                wire.hears["/wrench"](SimpleNamespace(wrench=SimpleNamespace(force=force)))
            sleep(0.01)

    threading.Thread(target=tell, daemon=True).start()
    with closing(connected(wire, wrench="/wrench")) as arm:
        seen = list[ArmSample]()
        arm.follow(far(arm, 0.1), seen.append)
        assert {s.force for s in seen} == {5.0}
        path = far(arm)
        halfway(path, over.set)
        with pytest.raises(DeviceError, match="the force on /wrench"):
            arm.follow(path)


@pytest.mark.slow
def test_behind_the_guard_an_arm_that_does_not_follow_is_held_where_it_is(
    arm: ros2.JointTrajectoryArm, robot: FakeController
) -> None:
    limits = replace(
        LIMITS,
        forward=MODEL.forward,
        outline=partial(outline, MODEL),
        joint_lower=MODEL.lower,
        joint_upper=MODEL.upper,
        joint_speed=MODEL.velocity,
        joint_acceleration=ACCELERATION,
    )
    guarded = GuardedArm(arm, limits)
    record = guarded.follow(far(arm, 0.1))
    assert guarded.joints() == pytest.approx(record.commanded[-1], abs=2e-3)
    path = far(arm, 0.6)
    noise = np.random.default_rng(0)

    def block() -> None:
        robot.stuck = True
        for _ in range(100):
            robot.offset = noise.normal(0, 1e-6, 6)  # an encoder is never quite still
            sleep(0.005)

    halfway(path, block)
    with pytest.raises(StageFailure, match="joint 0 reads the same"):
        guarded.follow(path)
    stuck = robot.q.copy()
    arm.hold()
    robot.stuck = False
    sleep(0.7)
    assert robot.q == pytest.approx(stuck, abs=0.02)


MOVES = """
import sys; sys.path[:0] = [{here!r}, {beside!r}]
from test_ros2 import MODEL, connected, far
from slow_clock import clock
arm = connected(None)
print("ready", flush=True)
arm.follow(far(arm, 0.8))
"""


@needs_ros
@pytest.mark.parametrize("wire", ["ros"], indirect=True)
def test_a_driver_that_is_killed_leaves_an_arm_at_rest(robot: FakeController) -> None:
    """kill -9 in full motion, at about 0.8 rad/s."""
    with subprocess.Popen(
        [sys.executable, "-c", MOVES.format(here=str(HERE), beside=str(Path(__file__).parent))], stdout=subprocess.PIPE
    ) as driver:
        assert driver.stdout is not None
        assert driver.stdout.readline() == b"ready\n"
        while not robot.log or robot.speed()[1][-20:].max() < 0.5:
            time.sleep(0.01)
        driver.kill()
        killed = clock()
    speed = robot.speed()[1].max()
    assert robot.stopped_after(killed) <= longest_stop(speed)
    assert robot.refused == []


@needs_ros
@pytest.mark.parametrize("wire", ["ros"], indirect=True)
def test_a_topic_that_can_be_none_is_refused(wire: RosNode) -> None:
    with closing(ros2.Node("anther")) as node:
        with pytest.raises(InputError, match=r"topic: .*such as /joint_states"):
            node.subscribe("/joint states", "sensor_msgs/msg/JointState", lambda message: None)
        with pytest.raises(InputError, match="topic"):
            node.publisher("//", ros2.TRAJECTORY)


def test_without_ros_2_it_is_said_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(MissingExtra, match=r"Source your ROS 2, or run: pip install 'anther\[ros2\]'"):
        ros2.Node("anther")


CELL = (HERE / "cells" / "sawyer.toml").read_text()
ARM = 'driver = "sawyer-ros1"\nmaster = "MASTER"\nmode = "trajectory"\n'


@pytest.fixture
def cell(tmp_path: Path) -> Callable[[str], Any]:
    """Return a cell file's reader, of an [arm] with further keys."""

    def read(keys: str) -> Any:
        (tmp_path / "cell.toml").write_text(CELL.replace(ARM, f'driver = "ros2"\nmodel = "ur5e"\n{keys}\n'))
        return read_cell(tmp_path / "cell.toml")

    return read


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("rate = true", r"line 5: arm.rate: got True; allowed: a number"),
        ('stats = "/js"', r"arm.stats: got an unknown key 'stats'; .*Did you mean states"),
        ("joints = [1, 2]", r"arm.joints: got \[1, 2\]; allowed: .*text in quotes"),
        ('arm_model = "a"', r"unknown key 'arm_model'"),
    ],
)
def test_a_cell_files_wrong_words_are_told(cell: Callable[[str], Any], keys: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        cell(keys)


def test_the_manuals_example_is_read(cell: Callable[[str], Any]) -> None:
    page = (HERE.parents[1] / "docs" / "arm_drivers.md").read_text().split("## Any arm under ROS 2")[1]
    keys = page.split('model = "ur5e"', 1)[1].split("\n", 1)[1].split("```")[0]
    table = cell(keys).arm.table
    assert set(table) == {"controller", "rate", "states", "wrench", "joints"}
    assert len(table["joints"]) == 6


def test_a_cell_file_gives_what_its_model_says(
    cell: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, wire: FakeNode
) -> None:
    file = cell('controller = "/scaled"\nstates = "/joint_states"\nrate = 100')
    monkeypatch.setattr(_parts, "Ros2Node", lambda name: wire)
    with ExitStack() as stack:
        robot = stack.enter_context(closing(FakeController(file.model.joints, np.zeros(6), wire.tell)))
        wire.deliver = robot.hear
        arm = file.connect(file.arm)
        for _ in range(20):
            arm.hold()
        assert wire.said == []
        arm._rest(np.zeros(6))
        topic, message = wire.said[-1]
        assert topic == "/scaled/joint_trajectory"
        assert tuple(message.joint_names) == file.model.joints
        assert arm._acceleration == pytest.approx(file.model.acceleration)
    assert file.owner_name == "ros2 scaled"


def test_a_cell_file_may_name_the_joints_as_the_robot_does(
    cell: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, wire: FakeNode
) -> None:
    monkeypatch.setattr(_parts, "Ros2Node", lambda name: wire)
    few = cell('joints = ["a", "b"]')
    with pytest.raises(InputError, match=r"arm: joints: got 2 names; allowed: 6, in the order of shoulder_pan_joint"):
        few.connect(few.arm)
    names = [f"left_{i}" for i in range(6)]
    with closing(FakeController(names, READY, wire.tell)):
        file = cell(f"joints = {names}".replace("'", '"'))
        assert file.connect(file.arm).joints() == pytest.approx(READY)
    fast = cell("rate = 1000")
    with pytest.raises(InputError, match="rate: got 1000"):
        fast.connect(fast.arm)
    assert wire.closed


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"stamp": 1.0}, "stamped"),
        ({"rates": 0.1}, "it ends at"),
        ({"times": 0.0}, "do not increase"),
        ({"names": ["a"]}, "other joints"),
    ],
)
def test_the_fake_controller_refuses_what_the_real_one_does(change: dict[str, Any], why: str) -> None:
    node, rest = FakeNode(), np.zeros(1)
    arm_says = [(0.0, rest, rest, rest), (change.get("times", 0.1), rest, rest + change.get("rates", 0.0), rest)]
    points = [
        SimpleNamespace(
            time_from_start=SimpleNamespace(sec=0, nanosec=int(1e9 * t)),
            positions=q,
            velocities=v,
            accelerations=a,
        )
        for t, q, v, a in arm_says
    ]
    message = node.make(ros2.TRAJECTORY, joint_names=change.get("names", ["j"]), points=points)
    message.header.stamp.sec = int(change.get("stamp", 0))
    assert why in refusal(message, ["j"])
    assert moments(message)[1].shape == (2, 3, 1)
