"""The Sawyer's driver through ROS 1's own protocols: a fake robot behind a small master, and behind roscore."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_robot import LIMITS
from fake_ros_master import DEBIAN, NO_ROSCORE, FakeMaster, debian_roscore, free_port, has_roscore
from fake_sawyer import CLOCK, FakeSawyer, swing
from slow_clock import AGAIN_IF_HELD_UP, clock, sleep
from small_planner import SmallPlanner
from streamed_motions import halfway

from anther.core.errors import InputError
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import Arm, ArmSample, DeviceError, JointTrajectory
from anther.robot.drivers.intera import DEFINITIONS, types
from anther.robot.drivers.ros1 import Node
from anther.robot.drivers.sawyer_ros1 import Sawyer
from anther.robot.safety import GuardedArm

HERE = Path(__file__).parents[1] / "support"
pytestmark = AGAIN_IF_HELD_UP


@pytest.fixture(scope="module")
def roscore() -> Iterator[str]:
    if not has_roscore():
        pytest.skip(NO_ROSCORE)
    with debian_roscore() as uri:
        yield uri


@pytest.fixture
def master(request: pytest.FixtureRequest) -> Iterator[str]:
    """A small one, or where a test asks for it, ROS' own."""
    if getattr(request, "param", "") == "roscore":
        yield request.getfixturevalue("roscore")
        return
    small = FakeMaster()
    yield small.uri
    small.stop()


WITH_ROS = pytest.mark.parametrize("master", ["small", "roscore"], indirect=True)


@pytest.fixture
def robot(master: str) -> Iterator[FakeSawyer]:
    with closing(FakeSawyer(master, clock=clock, sleep=sleep)) as fake:
        yield fake


@pytest.fixture
def arm(master: str, robot: FakeSawyer) -> Iterator[Sawyer]:
    with closing(connected(master, mode="trajectory")) as driver:
        yield driver


def connected(master: str, **options: Any) -> Sawyer:
    return Sawyer(Node(master, "/anther", types()), clock=clock, sleep=sleep, **options)


def far(arm: Arm, way: float = 0.3) -> JointTrajectory:
    return SmallPlanner().move(arm.joints(), arm.joints() + way)


@pytest.mark.parametrize("master", ["roscore"], indirect=True)
def test_it_goes_where_it_is_told_and_says_so(arm: Sawyer, robot: FakeSawyer) -> None:
    conforms: Arm = arm
    start, seen = conforms.joints(), list[ArmSample]()
    assert start == pytest.approx(SAWYER.neutral, abs=1e-9)  # though the robot names its joints in another order
    record = arm.follow(far(arm, 0.05), seen.append)
    assert record.commanded[-1] == pytest.approx(start + 0.05, abs=1e-6)
    assert arm.joints() == pytest.approx(start + 0.05, abs=1e-3)
    assert np.all(np.diff(record.times) > 0)
    assert len(seen) == len(record.times) > 50 * (record.times[-1] - record.times[0])
    assert max(np.abs(s.measured - s.commanded).max() for s in seen) < 0.02
    assert seen[-1].force == pytest.approx(1.0)
    assert arm.follow(far(arm, -0.05)).times[0] >= record.times[-1]


def test_what_the_robot_is_set_to_before_anything_moves(arm: Sawyer, robot: FakeSawyer) -> None:
    sleep(0.2)
    assert (robot.ratio, robot.timeout) == (0.1, 0.03)
    assert robot.heard == []
    assert arm.joints() == pytest.approx(SAWYER.neutral, abs=1e-9)  # though the robot names its joints in another order
    assert arm.readings.clock.offset == pytest.approx(-CLOCK, abs=0.05)


def test_in_position_mode_the_arm_takes_its_time(master: str, robot: FakeSawyer) -> None:
    with closing(connected(master, speed_ratio=1.0)) as arm:
        record = arm.follow(far(arm, 0.1))
        assert record.measured[-1] == pytest.approx(record.commanded[-1], abs=2e-3)


def test_a_command_that_was_made_before_a_pause_is_not_sent_after_it(
    arm: Sawyer, robot: FakeSawyer, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, made = arm._commands.packet, list[float]()

    def paused(message: Any) -> bytes:
        made.append(clock())
        if len(made) == 50:
            sleep(0.2)
        return make(message)

    monkeypatch.setattr(arm._commands, "packet", paused)
    with pytest.raises(DeviceError, match="after the one before"):
        arm.follow(far(arm))
    sleep(0.1)
    after = [command for command in robot.commands if command[0] > made[49] + 0.15]
    assert all(np.all(rates == 0) for _, _, _, rates in after)
    assert all(np.abs(joints - robot.q).max() < 1e-3 for _, _, joints, _ in after)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["head_pan", *SAWYER.joints[:-1], "right_j7"], "right_j6 missing"),
        ([*SAWYER.joints, "right_j0"], "names twice"),
    ],
)
def test_joints_with_other_names_are_refused(arm: Sawyer, robot: FakeSawyer, names: list[str], message: str) -> None:
    robot.names = names
    sleep(0.1)
    with pytest.raises(DeviceError, match=message):
        arm.follow(far_from_neutral())


def far_from_neutral() -> JointTrajectory:
    return SmallPlanner().move(SAWYER.neutral, SAWYER.neutral + 0.1)


def test_an_arm_with_other_joints_is_not_connected_to() -> None:
    small = FakeMaster()
    small.parameters["/robot_config/right_config/joint_names"] = ["left_j0", "left_j1"]
    with (
        closing(FakeSawyer(small.uri, clock=clock, sleep=sleep)),
        closing(Node(small.uri, "/anther", types())) as node,
        pytest.raises(DeviceError, match="the robot has left_j0, left_j1"),
    ):
        Sawyer(node)
    small.stop()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pressed": True}, "the stop button is pressed"),
        ({"cuff": True}, "cuff is held"),
        ({"collided": True}, "felt a collision"),
        ({"error": True}, "reports an error"),
        ({"enabled": False}, "anther cell enable"),
    ],
)
def test_the_robots_own_reasons_stop_a_motion(
    arm: Sawyer, robot: FakeSawyer, change: dict[str, bool], message: str
) -> None:
    path = far(arm, 0.4)
    halfway(path, lambda: vars(robot).update(change))
    with pytest.raises(DeviceError, match=message):
        arm.follow(path)
    sleep(0.1)
    commands = len(robot.heard)
    with pytest.raises(DeviceError, match=message):
        arm.follow(path)
    assert len(robot.heard) == commands


@WITH_ROS
def test_after_a_stop_it_is_released_reset_enabled_and_does_not_jump(arm: Sawyer, robot: FakeSawyer) -> None:
    arm.follow(far(arm, 0.05))
    robot.pressed = True
    sleep(0.1)
    with pytest.raises(DeviceError, match="turn it until it comes out"):
        arm.enable()
    robot.pressed, robot.q = False, robot.q - 0.1  # it sank, or somebody moved it
    sleep(0.1)
    arm.enable()
    before = robot.q.copy()
    arm.hold()
    sleep(0.2)
    assert robot.enabled
    assert robot.q == pytest.approx(before)
    arm.disable()
    assert not robot.enabled


def test_a_robot_that_goes_away_is_told(arm: Sawyer, robot: FakeSawyer) -> None:
    path = far(arm, 0.4)
    halfway(path, robot.close)
    with pytest.raises(DeviceError, match=r"nobody listens|ms old"):
        arm.follow(path)


def test_behind_the_guard_it_is_an_arm(arm: Sawyer, robot: FakeSawyer) -> None:
    guarded = GuardedArm(arm, LIMITS)
    record = guarded.follow(far(arm, 0.05))
    assert guarded.joints() == pytest.approx(record.commanded[-1], abs=2e-3)
    robot.force = 30.0
    with pytest.raises(Exception, match="contact force"):
        guarded.follow(far(arm, -0.05))


@pytest.mark.parametrize(
    ("what", "value", "message"),
    [("dead", True, "the same to the last bit"), ("force", np.nan, "or no number")],
    ids=["stuck", "not a number"],
)
def test_a_force_that_is_lost_on_the_way_stops_the_arm(
    arm: Sawyer, robot: FakeSawyer, what: str, value: Any, message: str
) -> None:
    path, seen = swing(5.0, 0.02), list[ArmSample]()
    halfway(path, lambda: setattr(robot, what, value))
    with pytest.raises(DeviceError, match=message):
        GuardedArm(arm, LIMITS).follow(path, seen.append)
    assert seen[-1].time - seen[0].time < 0.85 * path.duration


MOVES = """
import sys; sys.path[:0] = [{here!r}]
from slow_clock import AGAIN_IF_HELD_UP, clock, sleep
from small_planner import SmallPlanner
from anther.robot.drivers.intera import types
from anther.robot.drivers.ros1 import Node
from anther.robot.drivers.sawyer_ros1 import Sawyer
arm = Sawyer(Node(sys.argv[1], "/anther", types()), mode="trajectory", clock=clock, sleep=sleep)
print("ready", flush=True)
arm.follow(SmallPlanner().move(arm.joints(), arm.joints() + 0.8))
"""


@WITH_ROS
def test_a_driver_that_is_killed_leaves_an_arm_at_rest_within_100_ms(master: str, robot: FakeSawyer) -> None:
    """kill -9 in full motion, at 0.6 rad/s."""
    words = [sys.executable, "-c", MOVES.format(here=str(HERE)), master]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        assert driver.stdout.readline() == "ready\n"
        while np.abs(robot.v).max() < 0.4:
            time.sleep(0.01)
        driver.kill()
        killed = clock()
    assert robot.stopped_after(killed) <= 0.1


def test_a_node_that_does_not_find_what_it_wants_says_so() -> None:
    with pytest.raises(InputError, match="http://HOST:PORT"):
        Node("sawyer.local", "/anther", types())
    with pytest.raises(DeviceError, match="no ROS master answers"):
        Node(f"http://127.0.0.1:{free_port()}", "/anther", types())
    small = FakeMaster()
    with closing(Node(small.uri, "/anther", types())) as node:
        assert node.parameter("/nothing") is None
    small.stop()


def test_other_messages_under_a_topics_name_are_not_taken() -> None:
    small, heard = FakeMaster(), list[float]()
    with closing(Node(small.uri, "/a", types())) as a, closing(Node(small.uri, "/b", types())) as b:
        says = a.publisher("/number", "std_msgs/msg/Float64", latch=True)
        says.publish(a.types.types["std_msgs/msg/Float64"](1.5))
        b.subscribe("/number", "std_msgs/msg/Bool", heard.append)
        time.sleep(0.3)
        assert says.readers == 0
        b.subscribe("/number", "std_msgs/msg/Float64", lambda m: heard.append(m.data))
        time.sleep(0.3)
        assert heard == [1.5]
    small.stop()


ROSPY = """
import os, sys
import rospy
from std_msgs.msg import Float64
rospy.init_node("debian")
out = rospy.Publisher("/back", Float64, queue_size=10)
rospy.Subscriber("/there", Float64, lambda m: out.publish(m.data + 1))
print("ready", flush=True)
rospy.spin()
"""


def test_ros_itself_understands_what_is_said(roscore: str) -> None:
    """Debian's rospy hears a message and answers it."""
    heard, environment = list[float](), {"ROS_MASTER_URI": roscore, "ROS_IP": "127.0.0.1", "HOME": "/tmp"}
    with (
        subprocess.Popen([DEBIAN, "-c", ROSPY], env=environment, stdout=subprocess.PIPE, text=True) as debian,
        closing(Node(roscore, "/anther", types())) as node,
    ):
        assert debian.stdout is not None
        assert debian.stdout.readline() == "ready\n"
        node.subscribe("/back", "std_msgs/msg/Float64", lambda m: heard.append(m.data))
        says = node.publisher("/there", "std_msgs/msg/Float64")
        for _ in range(100):
            says.publish(node.types.types["std_msgs/msg/Float64"](2.0))
            if heard:
                break
            time.sleep(0.05)
        debian.terminate()
    assert heard[0] == 3.0


SUMS = """
import json, sys, genpy.dynamic as g
for name, text in json.load(sys.stdin).items():
    whole = g.generate_dynamic(name, text)[name]
    print(name, whole._md5sum)
"""


def test_ros_itself_makes_the_same_check_sums(roscore: str) -> None:
    import json  # noqa: PLC0415

    store = types()
    texts = {name.replace("/msg/", "/"): store.generate_msgdef(name, ros_version=1)[0] for name in DEFINITIONS}
    done = subprocess.run([DEBIAN, "-c", SUMS], input=json.dumps(texts), capture_output=True, text=True, check=True)
    sums = dict(line.split() for line in done.stdout.splitlines())
    assert sums == {name.replace("/msg/", "/"): store.generate_msgdef(name, ros_version=1)[1] for name in DEFINITIONS}
    assert sums["intera_core_msgs/JointCommand"] == "c8c85922d297da6209a089a906207e5d"  # facts: sawyer 5
