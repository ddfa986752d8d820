"""The drivers a cell file can name. Their arguments are its keys; those in `GIVEN` come from the rest of the cell."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from anther.core.errors import InputError, bad_input
from anther.core.files import understood
from anther.core.geometry import Intrinsics, transform_from_pose7
from anther.robot.arm.model import ArmModel
from anther.robot.arm.urdf import from_urdf
from anther.robot.cells._reading import Pose
from anther.robot.devices import Arm, CartLimits
from anther.robot.drivers._rails import Axis
from anther.robot.drivers.franka import Franka, open_franka
from anther.robot.drivers.free_running import FreeRunningCamera
from anther.robot.drivers.intera import RethinkGripper, types
from anther.robot.drivers.realsense import open_realsense
from anther.robot.drivers.realsense_imu import RealSenseImu
from anther.robot.drivers.robotiq import Name, Robotiq2F, open_line
from anther.robot.drivers.ros1 import Node
from anther.robot.drivers.ros2 import JointTrajectoryArm
from anther.robot.drivers.ros2 import Node as Ros2Node
from anther.robot.drivers.ros2_cart import VelocityCart
from anther.robot.drivers.ros2_imu import Ros2Imu
from anther.robot.drivers.sawyer_ros1 import Mode, Sawyer
from anther.robot.drivers.ur_controller import open_controller
from anther.robot.drivers.ur_rtde import UniversalRobot
from anther.robot.drivers.uvc import open_uvc
from anther.robot.drivers.voice_coil import VoiceCoil, open_port

GIVEN = ("arm", "speed_ratio", "arm_master", "arm_model", "cart_limits")
NAME = "/anther"
GRIPPER_NAME = "/anther_gripper"
CART_NAME = "/anther_cart"
IMU_NAME = "/anther_imu"


@contextmanager
def _close_on_error(node: Any) -> Iterator[Any]:
    """Yield a node, and close it where the machine behind it cannot be had."""
    try:
        yield node
    except BaseException:
        node.close()
        raise


def sawyer_ros1(
    master: str, *, host: str = "", mode: Mode = "position", rate: float = 100.0, speed_ratio: float = 0.1
) -> Sawyer:
    """Return a Sawyer behind a ROS master, such as "http://sawyer.local:11311"; host: this machine's own address."""
    with _close_on_error(Node(master, NAME, types(), host)) as node:
        return Sawyer(node, mode=mode, rate=rate, speed_ratio=speed_ratio)


def ur(
    host: str, *, arm_model: ArmModel, rate: float | None = None, lookahead: float = 0.03, gain: float = 2000.0
) -> UniversalRobot:
    """Return a Universal Robots arm at its controller's address, such as "192.168.1.20"."""
    return UniversalRobot(
        partial(open_controller, host),
        names=arm_model.joints,
        acceleration=arm_model.acceleration,
        model=arm_model.name,
        rate=rate,
        lookahead=lookahead,
        gain=gain,
    )


def franka(host: str, *, arm_model: ArmModel, realtime: bool = True) -> Franka:
    """Return a Franka arm at its address; realtime: ask for a real-time kernel, without which commands may be late."""
    return open_franka(host, names=arm_model.joints, acceleration=arm_model.acceleration, realtime=realtime)


def ros2(
    *,
    arm_model: ArmModel,
    joints: list[str] | None = None,
    controller: str = "/joint_trajectory_controller",
    rate: float = 100.0,
    states: str = "/joint_states",
    wrench: str = "",
) -> JointTrajectoryArm:
    """Return an arm under ROS 2; joints: how the robot calls them, in the model's order. See `JointTrajectoryArm`."""
    names = arm_model.joints if joints is None else tuple(joints)
    if len(names) != len(arm_model.joints):
        wanted = f"{len(arm_model.joints)}, in the order of {', '.join(arm_model.joints)}"
        raise bad_input("joints", given=f"{len(names)} names", allowed=wanted, do="Correct it.")
    options: dict[str, Any] = {"controller": controller, "rate": rate, "states": states, "wrench": wrench}
    with _close_on_error(Ros2Node(NAME.strip("/"))) as node:
        return JointTrajectoryArm(node, names, arm_model.acceleration, **options)


def rethink(*, arm_master: str) -> RethinkGripper:
    """Return the electric gripper of a Sawyer, behind the same master."""
    if not arm_master:
        raise InputError("gripper 'rethink': it is reached through a Sawyer's ROS master; the arm has none.")
    with _close_on_error(Node(arm_master, GRIPPER_NAME, types())) as node:
        return RethinkGripper(node)


def robotiq_2f(
    port: str,
    *,
    model: Name = "2f-85",
    force: float | None = None,
    speed: float | None = None,
    counts: tuple[int, int] = (3, 230),
) -> Robotiq2F:
    """Return a Robotiq 2F at a serial port, or at "tcp://HOST:PORT"."""
    return Robotiq2F(open_line(port), model=model, force=force, speed=speed, counts=counts)


def ros2_cart(
    *,
    cart_limits: CartLimits,
    speed: float = 0.3,
    acceleration: float = 0.2,
    commands: str = "/cmd_vel",
    odometry: str = "/odom",
    stamped: bool = True,
    axis: Axis = "x",
    zero: float = 0.0,
    rate: float = 20.0,
) -> VelocityCart:
    """Return a cart on rails under ROS 2; see `VelocityCart`."""
    options: dict[str, Any] = {"speed": speed, "acceleration": acceleration, "commands": commands, "odometry": odometry}
    options |= {"stamped": stamped, "axis": axis, "zero": zero, "rate": rate}
    with _close_on_error(Ros2Node(CART_NAME.strip("/"))) as node:
        return VelocityCart(node, cart_limits, **options)


def voice_coil(port: str, *, arm: Arm) -> VoiceCoil:
    """Return a motor in the gripper at a serial port."""
    return VoiceCoil(open_port(port), arm)


def realsense(
    serial: str = "", *, width: int = 848, height: int = 480, rate: int = 30, preset: str = ""
) -> FreeRunningCamera:
    """Return a connected RealSense; serial: as printed on it, "" is the only one."""
    return open_realsense(serial or None, size=(width, height), rate=rate, preset=preset or None)


def uvc(
    source: str, *, width: int, height: int, fx: float, fy: float, cx: float, cy: float, rate: float = 30.0,
    latency: float = 0.0,
) -> FreeRunningCamera:  # fmt: skip
    """Return any camera that OpenCV opens, by number, address or file, with its intrinsics [px]."""
    where = int(source) if source.isdigit() else source
    return open_uvc(where, Intrinsics(width, height, fx, fy, cx, cy), rate=rate, latency=latency)


def realsense_imu(serial: str = "") -> RealSenseImu:
    """Return the inertial sensor in a RealSense D435i or D455; serial: as printed on it, "" is the only one."""
    return RealSenseImu(serial or None)


def ros2_imu(topic: str = "/imu") -> Ros2Imu:
    """Return an inertial sensor under ROS 2 that publishes sensor_msgs/Imu."""
    with _close_on_error(Ros2Node(IMU_NAME.strip("/"))) as node:
        return Ros2Imu(node, topic)


ARMS: dict[str, Callable[..., Any]] = {"sawyer-ros1": sawyer_ros1, "ros2": ros2, "ur": ur, "franka": franka}
GRIPPERS: dict[str, Callable[..., Any]] = {"rethink": rethink, "robotiq-2f": robotiq_2f}
CAMERAS: dict[str, Callable[..., Any]] = {"realsense": realsense, "uvc": uvc}
CARTS: dict[str, Callable[..., Any]] = {"ros2": ros2_cart}
IMUS: dict[str, Callable[..., Any]] = {"realsense": realsense_imu, "ros2": ros2_imu}
SHAKERS: dict[str, Callable[..., Any]] = {"voice-coil": voice_coil}


def arm_of_urdf(
    urdf: Path,
    base: str,
    tip: str,
    acceleration: list[float],
    ready: list[float],
    *,
    name: str = "",
    T_tip_flange: Pose | None = None,
    packages: Path | None = None,
    floor: float = 0.0,
) -> ArmModel:
    """Return an arm by its URDF file, see `anther.robot.arm.urdf.from_urdf`; name: by default the file's."""
    T = None if T_tip_flange is None else transform_from_pose7(np.array(T_tip_flange))
    options = {"acceleration": acceleration, "ready": ready, "T_tip_flange": T, "packages": packages, "floor": floor}
    with understood(urdf, "a URDF of an arm", "docs/arm.md says what it must hold."):
        return from_urdf(name or urdf.stem, urdf, base=base, tip=tip, **options)


def own_driver(name: str, where: str, folder: Path) -> Callable[..., Any]:
    """Return what "package.module:callable" names, installed or in a folder."""
    module, _, callable_ = name.partition(":")
    if str(folder.resolve()) not in sys.path:
        sys.path.append(str(folder.resolve()))  # to stay: the arm's own process looks there too
    try:
        found = getattr(importlib.import_module(module), callable_)
    except (ImportError, AttributeError, ValueError) as error:
        do = "Is its package installed, and the name right?"
        raise bad_input(where, given=f'"{name}" ({error})', allowed="a driver that Python finds", do=do) from error
    if not callable(found):
        raise bad_input(where, given=f'"{name}"', allowed="a class or function", do="Name what makes the driver.")
    return found


def none(**keys: Any) -> NoReturn:
    """Stand for the driver of a cell that is read to be simulated: there is no machine to connect to."""
    raise InputError(f"a simulated cell has no machine to connect to (asked with {', '.join(keys) or 'no keys'}).")


def usual(make: Callable[..., Any]) -> dict[str, Any]:
    """Return the keys of a driver that need not be in the file, with what they then are."""
    given = inspect.signature(make).parameters.values()
    return {p.name: p.default for p in given if p.default is not p.empty and p.name not in GIVEN}


def takes(make: Callable[..., Any], argument: str) -> bool:
    """Return whether a driver wants an argument."""
    return argument in inspect.signature(make).parameters
