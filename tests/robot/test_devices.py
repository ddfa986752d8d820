"""One conformance test that every machine behind the seam passes: simulated, fake, replayed, guarded, about to fail."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from inspect import isfunction

import numpy as np
import pytest
from fake_robot import LIMITS, fake_robot
from live_cameras import Bench, realsense, running
from made_arm import CELL, six
from small_planner import SmallPlanner
from straight_plant import straight_plant

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Box, Intrinsics
from anther.perception.capture import Capture
from anther.robot.arm.model import outline
from anther.robot.arm.sawyer import SAWYER
from anther.robot.cells import read_cell
from anther.robot.devices import (
    Arm,
    Camera,
    DeviceError,
    Gripper,
    GripperState,
    JointTrajectory,
    Robot,
    SafetyLimits,
)
from anther.robot.safety import GuardedGripper, guard
from anther.robot.testing import (
    ArmRig,
    CameraRig,
    check_frames,
    check_hold_at_rest,
    check_motion,
    check_recording,
    check_watcher_error,
)
from anther.show.log._machines import log_machines
from anther.sim.cell import Cell
from anther.sim.robot import robot_of
from evaluation.perception.replay_camera import ReplayCamera
from evaluation.robustness.faulty_machines import Fault, with_faults


def simulated() -> Robot:
    return robot_of(Cell(straight_plant()))


def with_six_joints() -> Robot:
    return robot_of(Cell(straight_plant(), arm=six()))


def guarded() -> Robot:
    return guard(fake_robot(), LIMITS)


def logged() -> Robot:
    return log_machines(fake_robot(), lambda what, value, when=None: None, lambda: None)


def not_yet_faulty() -> Robot:
    robot = fake_robot()
    for kind in ("arm stops", "gripper jam", "frames lost"):
        robot = with_faults(robot, Fault(kind, at=1000))
    return robot


def replayed() -> Camera:
    depth, rgb = np.ones((12, 6, 8), np.float32), np.zeros((12, 6, 8, 3), np.uint8)
    poses = np.tile(np.eye(4), (12, 1, 1))
    return ReplayCamera(Capture(depth, Intrinsics(8, 6, 10.0, 10.0, 3.5, 2.5), poses, rgb))


def of_an_example() -> Robot:
    cell = read_cell(CELL)
    arm, gripper, camera = (cell.connect(part) for part in (cell.arm, cell.gripper, cell.wrist_camera))
    return Robot(arm, gripper, camera, camera, cell.T_flange_cam)


ROBOTS = {
    "fake": fake_robot,
    "simulated": simulated,
    "six joints": with_six_joints,
    "guarded": guarded,
    "logged": logged,
    "not yet faulty": not_yet_faulty,
    "of an example": of_an_example,
}


def planner(robot: Robot) -> SmallPlanner:
    return SmallPlanner(six() if len(robot.arm.joints()) == 6 else SAWYER)


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> Robot:
    return ROBOTS[request.param]()


@pytest.fixture(params=[*ROBOTS, "replayed", "realsense"])
def camera(request: pytest.FixtureRequest) -> Iterator[Camera]:
    """A camera; the live one runs for as long as the test. A webcam is in `test_conformance.py`."""
    if request.param == "replayed":
        yield replayed()
    elif request.param == "realsense":
        pytest.importorskip("pyrealsense2", reason="no pyrealsense2", exc_type=ImportError)
        with running(Bench()) as bench, realsense(bench) as live:
            yield live
    else:
        side = ROBOTS[request.param]().side_camera
        assert side is not None
        yield side


@pytest.mark.parametrize("protocol", [Arm, Gripper, Camera])
def test_a_protocol_has_five_methods_at_most(protocol: type) -> None:
    methods = {name for name, what in vars(protocol).items() if isfunction(what) and not name.startswith("_")}
    assert 2 <= len(methods) <= 5


@pytest.mark.parametrize("check", [check_motion, check_watcher_error, check_hold_at_rest], ids=lambda c: c.__name__)
def test_arm(check: Callable[[ArmRig], None], robot: Robot) -> None:
    no_wait = lambda seconds: None  # noqa: E731
    check(ArmRig(lambda: robot.arm, time.monotonic, no_wait, np.full(len(robot.arm.joints()), 5.0)))


@pytest.mark.parametrize("check", [check_frames, check_recording], ids=lambda c: c.__name__)
def test_camera(check: Callable[[CameraRig], None], camera: Camera) -> None:
    check(CameraRig(lambda: camera, time.sleep))


def test_gripper_opens_and_reports(robot: Robot) -> None:
    state = robot.gripper.move(0.03)
    assert state.opening == pytest.approx(0.03, abs=1e-3)
    assert not state.is_gripping
    assert robot.gripper.state() == state


def test_camera_records_while_the_arm_moves(robot: Robot) -> None:
    camera = robot.side_camera
    assert camera is not None
    camera.start(20.0)
    robot.arm.follow(planner(robot).move(robot.arm.joints(), robot.arm.joints() + 0.02))
    frames = camera.stop()
    assert len(frames) >= 4
    assert np.all(np.diff([f.time for f in frames]) > 0)


def test_a_replay_ends() -> None:
    camera = replayed()
    times = [camera.read().time for _ in range(5)]
    assert np.all(np.diff(times) > 0)
    camera.start(30.0)
    assert len(camera.stop()) == 7
    with pytest.raises(DeviceError, match="all 12 views"):
        camera.read()


def test_a_trajectory_must_be_timed() -> None:
    with pytest.raises(InputError, match="increasing"):
        JointTrajectory(np.array([0.0, 0.0]), np.zeros((2, 7)), np.zeros((2, 7)))
    with pytest.raises(InputError, match="shape"):
        JointTrajectory(np.array([0.0, 1.0]), np.zeros((2, 6)), np.zeros((2, 7)))


def test_limits_with_an_empty_range_are_refused() -> None:
    box = Box(-np.ones(3), np.ones(3))
    with pytest.raises(InputError, match="empty range"):
        SafetyLimits(SAWYER.forward, outline, SAWYER.upper, SAWYER.lower, SAWYER.velocity, SAWYER.acceleration, box)


@pytest.mark.parametrize("changes", [{"contact_force": np.inf}, {"shake_duration": 1e6}, {"tracking": np.nan}])
def test_a_limit_cannot_be_switched_off(changes: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(changes))):
        replace(LIMITS, **changes)


class Squeezing:
    """A gripper that feels far too much whenever it closes."""

    def __init__(self, gripper: Gripper) -> None:
        self._gripper, self.stroke = gripper, gripper.stroke

    def move(self, opening: float) -> GripperState:
        return replace(self._gripper.move(opening), force=100.0 if opening < self.stroke else 0.0)

    def state(self) -> GripperState:
        return self._gripper.state()


def test_on_too_much_force_every_gripper_is_opened_as_far_as_it_opens(robot: Robot) -> None:
    with pytest.raises(StageFailure, match="the pads were opened"):
        GuardedGripper(Squeezing(robot.gripper), LIMITS).move(0.01)
    assert robot.gripper.state().opening == pytest.approx(robot.gripper.stroke, abs=2e-4)


def test_simulated_gripper_refuses_more_than_its_stroke() -> None:
    with pytest.raises(InputError, match="gripper opening"):
        simulated().gripper.move(0.05)
