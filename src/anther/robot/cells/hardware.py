"""The machines of a cell file as `robot.Cell`: connected, owned by this process, behind the guard."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from anther.core.errors import bad_input
from anther.core.geometry import Array
from anther.core.runs import Advance
from anther.perception.capture import Capture, Keep, View, no_keep
from anther.perception.cloud import Cloud
from anther.robot.arm.model import ArmModel
from anther.robot.arm.planner import Params as MotionParams
from anther.robot.arm.planner import Planner
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.views import Params as ViewParams
from anther.robot.arm.views import Views, plan_views
from anther.robot.cell import Cell
from anther.robot.cells import CellFile, Part, own_cell
from anther.robot.devices import Arm, Gripper, Imu, JointTrajectory, Robot, Tap, no_tap
from anther.robot.safety import CarriedArm, GuardedArm, GuardedCart, guard


@dataclass(frozen=True, slots=True, eq=False)
class HardwareCell:
    """Attributes: `robot_side`, what the pipeline is given. There is no simulated world in it, and nothing supposed."""

    robot_side: Cell
    world: None = None
    capture_seconds: None = None
    notes: tuple[str, ...] = ()


class SlowPlanner(Planner):
    """A planner, made as `Planner`, of an arm that may use only the share `ratio` of its speeds and accelerations."""

    def __init__(self, ratio: float, *words: Any, **options: Any) -> None:
        super().__init__(*words, **options)
        self._ratio = ratio

    def line(self, q_from: ArrayLike, T_world_to: ArrayLike, speed: float | None = None) -> JointTrajectory:
        """See `Planner.line`; the speed is the ratio's share of it."""
        speed = self.params.approach_speed if speed is None else speed
        return super().line(q_from, T_world_to, self._ratio * speed)

    def shake_limit(self, q: ArrayLike, direction: ArrayLike, frequencies: ArrayLike) -> Array:
        """See `Planner.shake_limit`: amplitudes go with speeds and accelerations."""
        return self._ratio * super().shake_limit(q, direction, frequencies)


def motion_params(ratio: float, home: Array | None = None) -> MotionParams:
    """Return how an arm moves that may use this share of its speeds."""
    return MotionParams(
        velocity_share=max(0.9 * ratio, 0.01),
        acceleration_share=max(0.7 * ratio, 0.01),
        flange_speed=1.45 * ratio,
        home=None if home is None else tuple(home.tolist()),
    )


def planner_around(file: CellFile, cloud: Cloud, home: Array) -> Planner:
    """Return the planner of a cell's arm, which stands at joints (J,) [rad], around what a cloud shows."""
    ratio, space = file.limits.speed_ratio, file.arm_space
    params = motion_params(ratio, home)
    boxes, arm = file.keep_out, file.model
    return SlowPlanner(ratio, cloud.yielding, cloud.rigid, boxes, space=space, params=params, arm=arm)


def guarded_arm(file: CellFile, arm: Arm, keep: Callable[[Any], Any]) -> Arm:
    """Return the cell's arm behind its guard, alone; on a cart it moves only while that stands.

    Args:
        file: the cell.
        arm: connected.
        keep: is told the cart, to close it at the end (`own_cell`).
    """
    guarded, rails = GuardedArm(arm, file.safety_limits()), file.cart_limits()
    if file.cart is None or rails is None:
        return guarded
    return CarriedArm(guarded, GuardedCart(keep(file.connect(file.cart, arm=arm)), rails, guarded))


@contextmanager
def connect_cell(file: CellFile) -> Iterator[Robot]:
    """Own the cell's arm and connect all its machines, for the block; nothing moves. The arm is in its own process.

    Raises:
        AntherError: the first that cannot be had.
    """
    with own_cell(file) as keep:
        arm = keep(file.arm_apart())

        def part(entry: Part | None) -> Any:
            return None if entry is None else keep(file.connect(entry, arm=arm))

        gripper, imu = part(file.gripper), part(file.imu)
        _check_stroke(file, gripper)
        yield Robot(
            arm=arm,
            gripper=gripper,
            wrist_camera=part(file.wrist_camera),
            side_camera=part(file.side_camera),
            T_world_side_camera=file.T_world_side_camera,
            motor=part(file.shaker),
            cart=part(file.cart),
            imu=imu,
            T_flange_imu=None if imu is None else place_of_imu(file, imu),
        )


def place_of_imu(file: CellFile, imu: Imu) -> Array:
    """Return T_flange_imu (4, 4), by the file or by the wrist camera in which the sensor is.

    Raises:
        InputError: neither says it.
    """
    if file.T_flange_imu is not None:
        return file.T_flange_imu
    if imu.T_cam_imu is None:
        do = "Measure where it is mounted."
        allowed = "T_flange_imu: 7 numbers, x y z [m] qx qy qz qw"
        raise bad_input(file.source.where(("imu",)), given="no T_flange_imu", allowed=allowed, do=do)
    return file.T_flange_cam @ imu.T_cam_imu


def _check_stroke(file: CellFile, gripper: Gripper) -> None:
    """Check that the gripper opens as far as plans are made for.

    Raises:
        InputError: it does not.
    """
    planned, has = file.model.tool.stroke, gripper.stroke
    if planned > has + 1e-3:  # [m]: `devices.SafetyLimits.grip_tolerance` bears it
        allowed = f"at most {has:.4f} m, which the gripper says it opens"
        do = "Write what it opens as opening under [gripper.shape]."
        raise bad_input(file.source.where(("gripper", "shape")), given=f"{planned:.4f} m", allowed=allowed, do=do)


@contextmanager
def hardware_cell(file: CellFile, views: ViewParams, tap: Tap = no_tap) -> Iterator[HardwareCell]:
    """Connect a cell for one trial; see `connect_cell`. `tap` listens to the bare machines."""
    limits, ratio, arm = file.safety_limits(), file.limits.speed_ratio, file.model
    boxes = file.keep_out
    with connect_cell(file) as bare:
        robot = guard(tap(bare, limits, file.T_flange_cam, time.monotonic), limits, file.cart_limits())

        def take_views(advance: Advance, keep: Keep) -> Capture:
            begin, motion = robot.arm.joints(), motion_params(ratio)
            hand_eye = file.T_flange_cam
            planned = plan_views(file.region, boxes, views, start=begin, T_flange_cam=hand_eye, motion=motion, arm=arm)
            return capture_views(robot, planned, hand_eye, advance, arm, keep)

        def plan_around(cloud: Cloud) -> Planner:
            return planner_around(file, cloud, robot.arm.joints())

        yield HardwareCell(Cell(take_views, plan_around, robot, file.workspace, limits))


def move_and_stand(arm: Arm, motion: JointTrajectory) -> None:
    """Follow a motion, and stand before a picture is taken: an arm swings a little when it stops."""
    arm.follow(motion)
    arm.follow(JointTrajectory.standstill(motion.positions[-1], 0.5))  # [s], a guess


def capture_views(
    robot: Robot,
    views: Views,
    T_flange_cam: Array,
    advance: Advance,
    model: ArmModel = SAWYER,
    keep: Keep = no_keep,
) -> Capture:
    """Go to each view, stand still, take a picture; return them with the poses that the arm read.

    `keep` hears of each view while the arm goes on.

    Raises:
        StageFailure: what arm and camera raise.
    """
    camera, count = robot.wrist_camera.intrinsics, len(views.motions)
    depth = np.empty((count, camera.height, camera.width), np.float32)
    rgb, joints, poses = np.empty((*depth.shape, 3), np.uint8), [], np.empty((count, 4, 4))
    for number, motion in enumerate(views.motions):
        move_and_stand(robot.arm, motion)
        frame = robot.wrist_camera.read()
        joints.append(robot.arm.joints())
        depth[number], rgb[number], poses[number] = frame.depth, frame.rgb, model.forward(joints[-1]) @ T_flange_cam
        keep(View(depth[number], rgb[number], camera, poses[number]))
        advance(number + 1, count)
    return Capture(depth, camera, poses, rgb, np.array(joints))
