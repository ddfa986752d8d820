"""The seam between Anther and machines: small Protocols that simulation, replay and hardware satisfy alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import bad_input
from anther.geometry import Array, Intrinsics


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


class Arm(Protocol):
    """A seven-joint arm."""

    def joints(self) -> Array:
        """Return the measured joint angles (7,) [rad]."""
        ...

    def follow(self, trajectory: JointTrajectory) -> ArmRecord:
        """Follow a trajectory that starts at the present joints; return when it has ended."""
        ...

    def hold(self) -> None:
        """Stop and hold the present position."""
        ...


class Gripper(Protocol):
    """A parallel gripper. Its force cannot be set (facts: Intera 5.1 and later): it closes to a width."""

    def move(self, opening: float) -> GripperState:
        """Move the pads to `opening` [m] apart, or until they meet resistance; return the state then."""
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
        """End the recording and return its frames."""
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
