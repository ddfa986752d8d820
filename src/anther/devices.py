"""The seam between Anther and machines: small Protocols that simulation, replay and hardware satisfy alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array, check_range
from anther.errors import AntherError, bad_input
from anther.geometry import Array, Box, Intrinsics


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectory:
    """A timed joint path, densely sampled. T samples.

    Attributes:
        times: (T,) from 0, increasing [s].
        positions: (T, 7) [rad].
        velocities: (T, 7) [rad/s].
    """

    times: Array
    positions: Array
    velocities: Array

    def __post_init__(self) -> None:
        n = len(self.times)
        object.__setattr__(self, "times", check_array("trajectory times", self.times, (n,)))
        object.__setattr__(self, "positions", check_array("trajectory positions", self.positions, (n, 7)))
        object.__setattr__(self, "velocities", check_array("trajectory velocities", self.velocities, (n, 7)))
        if n < 2 or self.times[0] != 0 or np.any(np.diff(self.times) <= 0):
            raise bad_input(
                "trajectory times", given=f"{n} samples", allowed="two or more, from 0, increasing", do="Resample."
            )

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.times[-1])


@dataclass(frozen=True, slots=True, eq=False)
class ArmRecord:
    """What the arm did while following a trajectory: T samples.

    Attributes:
        times: (T,) [s], on the robot's clock.
        commanded, measured: (T, 7) joint angles [rad].
    """

    times: Array
    commanded: Array
    measured: Array

    def __post_init__(self) -> None:
        n = len(self.times)
        object.__setattr__(self, "times", check_array("record times", self.times, (n,)))
        object.__setattr__(self, "commanded", check_array("commanded joints", self.commanded, (n, 7)))
        object.__setattr__(self, "measured", check_array("measured joints", self.measured, (n, 7)))


@dataclass(frozen=True, slots=True)
class GripperState:
    """Attributes: opening [m] between the pads, force [N] on them, and whether something is held."""

    opening: float
    force: float
    is_gripping: bool


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One RGB-D image: time [s] on the robot's clock, rgb (H, W, 3) uint8, depth (H, W) float32 [m], 0 = no reading."""

    time: float
    rgb: NDArray[Any]
    depth: NDArray[Any]


class DeviceError(AntherError):
    """A machine refused a command or stopped."""


class Arm(Protocol):
    """A seven-joint arm."""

    def joints(self) -> Array:
        """Return the measured joint angles (7,) [rad]."""
        ...

    def follow(self, trajectory: JointTrajectory) -> ArmRecord:
        """Follow a trajectory that starts at the present joints; return when it has ended.

        Raises:
            DeviceError: the arm refused or stopped on the way; it holds where it is.
        """
        ...

    def hold(self) -> None:
        """Stop and hold the present position."""
        ...


class Gripper(Protocol):
    """A parallel gripper. Its force cannot be set (facts: Intera 5.1 and later): it closes to a width."""

    def move(self, opening: float) -> GripperState:
        """Move the pads to `opening` [m] apart, or until they meet resistance; return the state then.

        Raises:
            DeviceError: the gripper refused or jammed.
        """
        ...

    def state(self) -> GripperState:
        """Return the present state."""
        ...


class Camera(Protocol):
    """An RGB-D camera, depth aligned to colour."""

    @property
    def intrinsics(self) -> Intrinsics:
        """Of every frame."""
        ...

    def read(self) -> Frame:
        """Return one frame taken now."""
        ...

    def start(self, rate: float) -> None:
        """Begin to record at `rate` frames per second."""
        ...

    def stop(self) -> list[Frame]:
        """End the recording and return its frames in order of time; a device may keep only part of a long one."""
        ...


@dataclass(frozen=True, slots=True)
class Robot:
    """The machines of one cell.

    Attributes:
        arm, gripper: what grasps and shakes.
        wrist_camera: rides on the flange; takes the views.
        side_camera: stands still at `T_world_side_camera`; watches the flowers during the shake. None if there is none.
    """

    arm: Arm
    gripper: Gripper
    wrist_camera: Camera
    side_camera: Camera | None = None
    T_world_side_camera: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SafetyLimits:
    """What no command may exceed, whoever gives it. `anther.safety` checks every command against them.

    Attributes:
        forward: the arm's kinematics, joints (T, 7) [rad] -> flange poses (T, 4, 4) in the world.
        joint_lower, joint_upper: (7,) the arm's range [rad].
        joint_speed: (7,) [rad/s].
        joint_margin: kept from either end of the range [rad].
        workspace: where the flange may be, world [m].
        keep_out: boxes the flange must not enter: pot, bench.
        flange_speed: [m/s]. The SDK's default for straight motions is 0.6 (facts: sawyer 1); joint motions are faster.
        shake_speed: largest amplitude x 2 pi frequency of a shake [m/s].
        shake_duration: [s]; plants are shaken at most 5 s a visit (facts: pollination 1d).
        start_tolerance: largest gap between the present joints and a trajectory's start [rad].
    """

    forward: Callable[[Array], Array]
    joint_lower: Array
    joint_upper: Array
    joint_speed: Array
    workspace: Box
    joint_margin: float = 0.02
    keep_out: tuple[Box, ...] = field(default=())
    flange_speed: float = 1.5
    shake_speed: float = 0.5
    shake_duration: float = 5.0
    start_tolerance: float = 0.05

    def __post_init__(self) -> None:
        for name in ("joint_lower", "joint_upper", "joint_speed"):
            object.__setattr__(self, name, check_array(name, getattr(self, name), (7,)))
        if np.any(self.joint_lower + 2 * self.joint_margin >= self.joint_upper) or np.any(self.joint_speed <= 0):
            raise bad_input(
                "safety limits",
                given="an empty range",
                allowed="lower + 2 margin < upper, speed > 0",
                do="Check units.",
            )
        check_range("joint margin", self.joint_margin, 0, 1, "rad")
        check_range("flange speed limit", self.flange_speed, 1e-3, 3, "m/s")
        check_range("shake speed limit", self.shake_speed, 1e-4, 3, "m/s")
        check_range("shake duration limit", self.shake_duration, 0.01, 60, "s")
