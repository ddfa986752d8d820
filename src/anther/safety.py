"""The guard: every command to the arm passes here first. A bad one is refused and the arm holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anther.devices import Arm, ArmRecord, JointTrajectory, SafetyLimits
from anther.errors import StageFailure
from anther.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class GuardedArm:
    """An arm that refuses what exceeds the limits. It is itself an `Arm`.

    Attributes:
        arm: the machine.
        limits: what no trajectory may exceed.
    """

    arm: Arm
    limits: SafetyLimits

    def joints(self) -> Array:
        """Return the measured joint angles (7,) [rad]."""
        return self.arm.joints()

    def follow(self, trajectory: JointTrajectory) -> ArmRecord:
        """Follow a trajectory within the limits.

        Raises:
            StageFailure: limits_exceeded; nothing was commanded and the arm holds.
        """
        try:
            check_trajectory(trajectory, self.arm.joints(), self.limits)
        except StageFailure:
            self.arm.hold()
            raise
        return self.arm.follow(trajectory)

    def hold(self) -> None:
        """Stop and hold the present position."""
        self.arm.hold()


def check_trajectory(trajectory: JointTrajectory, present: Array, limits: SafetyLimits) -> None:
    """Check a trajectory's start, joint range, joint speed, flange speed, workspace and keep-out boxes.

    Args:
        trajectory: about to be commanded.
        present: (7,) measured joints [rad].
        limits: what is allowed.

    Raises:
        StageFailure: limits_exceeded, with the value, what is allowed and what to do.
    """
    q, m = trajectory.positions, limits.joint_margin
    gap = float(np.max(np.abs(q[0] - present)))
    _demand("start of the path", gap, limits.start_tolerance, "rad from the present joints", "Plan from there.")
    beyond = np.maximum(limits.joint_lower + m - q, q - (limits.joint_upper - m)).max(axis=0)
    worst = int(np.argmax(beyond))
    _demand(f"joint {worst}", float(beyond[worst]), 0.0, "rad beyond its range less the margin", "Plan another branch.")
    stated = np.abs(trajectory.velocities).max(axis=0)
    travelled = np.abs(np.diff(q, axis=0) / np.diff(trajectory.times)[:, None]).max(axis=0)
    share = np.maximum(stated, travelled) / limits.joint_speed
    worst = int(np.argmax(share))
    _demand(f"speed of joint {worst}", float(share[worst]), 1.0, "of its limit", "Slow the path down.")
    position = limits.forward(q)[:, :3, 3]
    outside = np.maximum(limits.workspace.lower - position, position - limits.workspace.upper).max()
    _demand("flange", float(outside), 0.0, "m outside the workspace box", "Stay inside, or set the box larger.")
    for box in limits.keep_out:
        if box.contains(position).any():
            where = f"{box.lower} .. {box.upper} m"
            raise StageFailure("limits_exceeded", f"the path enters the keep-out box {where}. Plan around it.")
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / np.diff(trajectory.times)
    _demand("flange speed", float(speed.max()), limits.flange_speed, "m/s", "Slow the path down.")


def check_shake(amplitude: float, frequency: float, duration: float, limits: SafetyLimits) -> None:
    """Check a shake's amplitude [m], frequency [Hz] and duration [s].

    Raises:
        StageFailure: limits_exceeded.
    """
    numbers = {"amplitude": amplitude, "frequency": frequency, "duration": duration}
    for name, value in numbers.items():
        if not (np.isfinite(value) and value > 0):
            raise StageFailure("limits_exceeded", f"shake {name}: got {value}; allowed: a number > 0. Plan again.")
    speed = amplitude * 2 * np.pi * frequency
    _demand("shake amplitude x 2 pi frequency", speed, limits.shake_speed, "m/s", "Shake less or slower.")
    _demand("shake duration", duration, limits.shake_duration, "s", "Shake shorter.")


def _demand(what: str, value: float, limit: float, unit: str, do: str) -> None:
    if not value <= limit + 1e-9:
        raise StageFailure("limits_exceeded", f"{what}: got {value:.4g} {unit}; allowed: <= {limit:.4g}. {do}")
