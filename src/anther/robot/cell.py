"""The robot's side of a cell: what a trial is given, and what it asks of the planner of an arm's motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from anther.core.geometry import Array, Box, ComplexArray
from anther.core.runs import Advance
from anther.perception.capture import Capture, Keep
from anther.perception.cloud import Cloud
from anther.robot.devices import JointTrajectory, Robot, SafetyLimits
from anther.robot.swing import Swing

GripMotion = Callable[[ComplexArray, Array, Array], ComplexArray]
"""(phasors of the motors (Q, J) [rad], frequencies (Q,) [Hz], deviates (S,)) -> the grip's, world (S, Q, 3) [m].

An arm reads its motors, not its links: what the grip does hangs on how stiff its joints are. They are so many standard
deviations off what is believed of them (`anther.robot.arm.compliance`), all alike or each of the joints (S, J)."""


JOINT_SCATTER = 0.4
"""Standard deviation of a joint's own stiffness beside what all of an arm have in common, in `GripMotion`'s deviates:
28 % of it, a guess."""


class TrajectoryPlanner(Protocol):
    """What execution asks of an arm's motion planner. Every trajectory keeps the arm's own limits."""

    def move(self, q_from: Array, q_to: Array) -> JointTrajectory:
        """Return a collision-free path between joint angles (J,) [rad]."""
        ...

    def line(self, q_from: Array, T_world_to: Array, speed: float) -> JointTrajectory:
        """Return a straight flange line to a pose (4, 4) at `speed` [m/s], starting at joints (J,) [rad]."""
        ...

    def swing(self, q: Array, direction: Array, pieces: Sequence[Swing], reach: float) -> JointTrajectory:
        """Return joined pieces of a flange shake about joints (J,) that all keep within `reach` [m]."""
        ...


class MotionPlanner(TrajectoryPlanner, Protocol):
    """What a trial asks of an arm's planner, beyond the motions that execution asks for."""

    def moved(self, T: Array) -> MotionPlanner:
        """Return a planner among what the cloud shows, moved by T (4, 4)."""
        ...

    def reach(self, T_world_pregrasp: Array, T_world_grasp: Array) -> Array | None:
        """See `grasp.Reach`."""
        ...

    def prepare(self, q_grasp: Array, T_world_pregrasp: Array) -> None:
        """Seek the way from where the arm waits to before a grasp at joints (J,) [rad], which `move` then takes."""
        ...

    def shake_limit(self, q: Array, direction: Array, frequencies: Array) -> Array:
        """Return the largest amplitude (Q,) [m] the arm manages about joints (J,) [rad]."""
        ...

    def delivered(self, q: Array, directions: Array, frequencies: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation (Q, D) of ln of what the grip does over what is commanded about joints
        (J,) [rad], along directions (D, 3)."""
        ...

    def grip_motion(self, q: Array, motors: ComplexArray, frequencies: Array, deviates: Array) -> ComplexArray:
        """Return what `GripMotion` does, about joints (J,) [rad]."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """One robot before one plant, simulated or real.

    Attributes:
        take_views: moves a camera past the plant and returns the views; tells each as it is taken.
        plan_around: Cloud -> a motion planner that keeps clear of what the cloud shows.
        robot: arm, gripper and cameras.
        workspace: box the plant stands in, world [m].
        limits: what no command may exceed.
        odometry: of a cart that carries that camera, standard deviation per axis after a metre [m]; 0: an arm does.
        drive_up: brings the robot from where the views were taken to where they say that it stands, as far as odometry
            can say; the side camera then shows where it does. None: it stands there.
    """

    take_views: Callable[[Advance, Keep], Capture]
    plan_around: Callable[[Cloud], MotionPlanner]
    robot: Robot
    workspace: Box
    limits: SafetyLimits
    odometry: float = 0.0
    drive_up: Callable[[], None] | None = None
