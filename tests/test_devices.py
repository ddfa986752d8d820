"""One conformance test that every machine behind the seam passes: the simulated cell's and a fake."""

from __future__ import annotations

import numpy as np
import pytest
from fake_robot import fake_robot
from small_planner import SmallPlanner
from straight_plant import straight_plant

from anther.arm import sawyer
from anther.devices import JointTrajectory, Robot, SafetyLimits
from anther.errors import InputError
from anther.geometry import Box
from anther.sim.cell import Cell
from anther.sim.robot import robot_of


def simulated() -> Robot:
    return robot_of(Cell(straight_plant()))


@pytest.fixture(params=[fake_robot, simulated], ids=["fake", "simulated"])
def robot(request: pytest.FixtureRequest) -> Robot:
    return request.param()


def test_arm_goes_where_it_is_told_and_says_so(robot: Robot) -> None:
    start = robot.arm.joints()
    assert start.shape == (7,)
    goal = start + 0.05
    record = robot.arm.follow(SmallPlanner().move(start, goal))
    assert np.all(np.diff(record.times) > 0)
    assert record.commanded.shape == record.measured.shape == (len(record.times), 7)
    assert record.commanded[-1] == pytest.approx(goal, abs=1e-6)
    assert robot.arm.joints() == pytest.approx(goal, abs=2e-3)
    again = robot.arm.follow(SmallPlanner().move(robot.arm.joints(), start))
    assert again.times[0] >= record.times[-1]


def test_arm_holds_where_it_is(robot: Robot) -> None:
    before = robot.arm.joints()
    robot.arm.hold()
    assert robot.arm.joints() == pytest.approx(before, abs=1e-3)


def test_gripper_opens_and_reports(robot: Robot) -> None:
    state = robot.gripper.move(0.03)
    assert state.opening == pytest.approx(0.03, abs=1e-3)
    assert not state.is_gripping
    assert robot.gripper.state() == state


def test_camera_reads_and_records_frames_of_its_size(robot: Robot) -> None:
    camera = robot.side_camera
    assert camera is not None
    size = (camera.intrinsics.height, camera.intrinsics.width)
    frame = camera.read()
    assert frame.rgb.shape == (*size, 3)
    assert frame.rgb.dtype == np.uint8
    assert frame.depth.shape == size
    assert frame.depth.dtype == np.float32
    camera.start(20.0)
    robot.arm.follow(SmallPlanner().move(robot.arm.joints(), robot.arm.joints() + 0.02))
    frames = camera.stop()
    assert len(frames) >= 4
    assert np.all(np.diff([f.time for f in frames]) > 0)


def test_a_trajectory_must_be_timed() -> None:
    with pytest.raises(InputError, match="increasing"):
        JointTrajectory(np.array([0.0, 0.0]), np.zeros((2, 7)), np.zeros((2, 7)))
    with pytest.raises(InputError, match="shape"):
        JointTrajectory(np.array([0.0, 1.0]), np.zeros((2, 6)), np.zeros((2, 6)))


def test_limits_with_an_empty_range_are_refused() -> None:
    box = Box(-np.ones(3), np.ones(3))
    with pytest.raises(InputError, match="empty range"):
        SafetyLimits(sawyer.forward, sawyer.UPPER, sawyer.LOWER, sawyer.VELOCITY, box)


def test_simulated_gripper_refuses_more_than_its_stroke() -> None:
    with pytest.raises(InputError, match="gripper opening"):
        simulated().gripper.move(0.05)
