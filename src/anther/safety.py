"""The guard: every command to arm and gripper passes here first, and every reading of a moving arm on its way back.

A bad command is refused before anything moves; a bad reading stops the arm. Either way the arm holds.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from anther.checks import check_array
from anther.devices import (
    Arm,
    ArmRecord,
    Camera,
    DeviceError,
    Frame,
    Gripper,
    GripperState,
    JointTrajectory,
    Robot,
    SafetyLimits,
    Watch,
)
from anther.errors import InputError, StageFailure
from anther.geometry import Array, Intrinsics
from anther.motor_guard import GuardedMotor
from anther.watchdog import Watchdog
from anther.watchdog import demand as _demand

CHECK_STEP = 0.005
"""A trajectory is checked at its own samples and, in between, this often [s]: 7.5 mm of the flange at its top speed."""
AT_REST = 0.05
"""A trajectory begins and ends no faster than this [rad/s]."""
LONGEST = 120.0
"""No trajectory lasts longer [s]."""
SOON = 1e-4
"""The flange's speed is the way it goes in this time [s]."""
TRIES = 3
"""So often a lost frame is asked for."""


def guard(robot: Robot, limits: SafetyLimits) -> Robot:
    """Return the same machines behind the guard; a guarded robot is returned as it is."""
    if isinstance(robot.arm, GuardedArm):
        return robot
    side = None if robot.side_camera is None else GuardedCamera(robot.side_camera)
    return replace(
        robot,
        arm=GuardedArm(robot.arm, limits),
        gripper=GuardedGripper(robot.gripper, limits),
        wrist_camera=GuardedCamera(robot.wrist_camera),
        side_camera=side,
        motor=None if robot.motor is None else GuardedMotor(robot.motor, limits),
    )


class GuardedArm:
    """An arm that refuses what exceeds the limits, and stops on what it feels. It is itself an `Arm`.

    Once its readings were stale the arm is not moved again through this guard: nobody knows where it is.

    Args:
        arm: the machine.
        limits: what no trajectory and no reading may exceed.
    """

    def __init__(self, arm: Arm, limits: SafetyLimits) -> None:
        self._arm, self._limits = arm, limits
        self._expected: Array | None = None
        self._lost = ""

    def joints(self) -> Array:
        """Return the measured joint angles (7,) [rad].

        Raises:
            DeviceError: the reading is not finite, or not where the arm was last sent: it is stale, or the arm was
                moved by hand.
        """
        try:
            q = check_array("measured joints", self._arm.joints(), (7,))
        except InputError as error:
            raise DeviceError(f"{error} The arm does not tell where it is.") from error
        if self._expected is not None:
            gap = float(np.abs(q - self._expected).max())
            if gap > self._limits.start_tolerance:
                self._lost = f"joints: got a reading {gap:.3g} rad from where the arm was sent; allowed: "
                self._lost += f"<= {self._limits.start_tolerance:g}. It is stale or the arm was moved: start anew."
                raise DeviceError(self._lost)
        return q

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None) -> ArmRecord:
        """Follow a trajectory within the limits.

        What was checked is a copy, and the copy is what is commanded.

        Raises:
            StageFailure: limits_exceeded, nothing was commanded; or collision, the arm pressed on something and
                stopped. Either way it holds.
            DeviceError: the arm refused, stopped, or does not tell where it is; it holds.
        """
        watchdog = Watchdog(self._limits, watch)
        try:
            if self._lost:
                raise DeviceError(self._lost)
            checked = _copied(trajectory)
            check_trajectory(checked, self.joints(), self._limits)
            self._expected = None
            record = self._arm.follow(checked, watchdog)
        except BaseException:
            self._lost = self._lost or watchdog.lost
            with suppress(Exception):  # what went wrong first is what is reported
                self._arm.hold()
            raise
        self._expected = checked.positions[-1]
        return record

    def hold(self) -> None:
        """Stop and hold the present position."""
        self._arm.hold()


class GuardedGripper:
    """A gripper that refuses openings beyond its stroke, lets go of what it would crush, and tells when it jams.

    Args:
        gripper: the machine.
        limits: its stroke and force.
    """

    def __init__(self, gripper: Gripper, limits: SafetyLimits) -> None:
        self._gripper, self._limits = gripper, limits

    def move(self, opening: float) -> GripperState:
        """Move the pads to `opening` [m] apart, or until they meet resistance; return the state then.

        Raises:
            StageFailure: limits_exceeded: beyond the stroke (nothing was commanded), or more than the grip force or
                the stem stress allowed (the pads were opened).
            DeviceError: the gripper refused or jammed.
        """
        limits = self._limits
        if not 0 <= opening <= limits.stroke:
            given = f"gripper opening: got {opening:g} m; allowed: 0 <= opening <= {limits.stroke:g} m."
            raise StageFailure("limits_exceeded", f"{given} Check the unit.")
        before = self.state().opening
        state = _readable(self._gripper.move(opening))
        stress = stem_stress(state, limits)
        if (state.force > limits.grip_force or stress > limits.stem_stress) and opening < limits.stroke:
            self._gripper.move(limits.stroke)
            _demand("grip force", state.force, limits.grip_force, "N; the pads were opened", "Close less far.")
            _demand("stem stress", stress, limits.stem_stress, "Pa; the pads were opened", "Close less far.")
        short = abs(state.opening - opening)
        if short > limits.grip_tolerance and (opening > before or not state.is_gripping):
            asked = f"sent to {1000 * opening:.1f} mm, the pads stand at {1000 * state.opening:.1f} mm"
            raise DeviceError(f"the gripper jammed: {asked} with {state.force:.1f} N. Free it by hand.")
        return state

    def state(self) -> GripperState:
        """Return the present state.

        Raises:
            DeviceError: the reading is not finite.
        """
        return _readable(self._gripper.state())


def stem_stress(state: GripperState, limits: SafetyLimits) -> float:
    """Return the greatest pressure of a pad on what is held, taken as a stiff round stem [Pa]; 0 if nothing is.

    Hertz, a cylinder pressed across a flat: p = sqrt(F E* / (pi w r)) with E* = E / (1 - nu^2) of the pad alone, which
    is far softer than a stem (30-300 MPa), nu = 0.5 (Johnson, Contact Mechanics, 1985, section 4.2).
    """
    if not state.is_gripping or state.opening <= 0:
        return 0.0
    modulus = limits.pad_modulus / (1 - 0.5**2)
    return float(np.sqrt(max(state.force, 0.0) * modulus / (np.pi * limits.pad_width * state.opening / 2)))


class GuardedCamera:
    """A camera that asks again for a lost frame, and drops those of a recording that are of no use.

    Args:
        camera: the machine.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    @property
    def intrinsics(self) -> Intrinsics:
        """Of every frame."""
        return self._camera.intrinsics

    def read(self) -> Frame:
        """Return one frame taken now.

        Raises:
            DeviceError: it was lost, `TRIES` times in a row.
        """
        reasons = []
        for _ in range(TRIES):
            try:
                frame = self._camera.read()
            except DeviceError as error:
                reasons.append(str(error))
            else:
                if self._whole(frame):
                    return frame
                reasons.append(f"an image of {frame.depth.shape} pixels")
        raise DeviceError(f"camera: no frame in {TRIES} tries ({reasons[-1]}). Check its cable.")

    def start(self, rate: float) -> None:
        """Begin to record at `rate` frames per second."""
        self._camera.start(rate)

    def stop(self) -> list[Frame]:
        """End the recording and return its whole frames whose time goes forward."""
        frames: list[Frame] = []
        for frame in self._camera.stop():
            if self._whole(frame) and (not frames or frame.time > frames[-1].time):
                frames.append(frame)
        return frames

    def _whole(self, frame: Frame) -> bool:
        size = (self.intrinsics.height, self.intrinsics.width)
        return bool(np.isfinite(frame.time)) and frame.depth.shape == size and frame.rgb.shape == (*size, 3)


def check_trajectory(trajectory: JointTrajectory, present: Array, limits: SafetyLimits) -> None:
    """Check all that is known of a motion before it begins.

    What is checked is the curve that the arm follows, cubic between the samples: at every sample and every
    `CHECK_STEP`. Start at the present joints, rest at both ends, joint range less the margin, joint speed and
    acceleration; of the flange workspace and speed; of all of arm and tool the keep-out boxes.

    Args:
        trajectory: about to be commanded.
        present: (7,) measured joints [rad].
        limits: what is allowed.

    Raises:
        StageFailure: limits_exceeded, with the value, what is allowed and what to do.
    """
    _demand("length of the motion", trajectory.duration, LONGEST, "s", "Plan shorter motions.")
    gap = float(np.abs(trajectory.positions[0] - present).max())
    _demand("start of the path", gap, limits.start_tolerance, "rad from the present joints", "Plan from there.")
    ends = float(np.abs(trajectory.velocities[[0, -1]]).max())
    _demand("speed at the ends", ends, AT_REST, "rad/s", "Begin and end at rest.")
    times = np.union1d(trajectory.times, np.arange(0, trajectory.duration, CHECK_STEP))
    q, rates = _check_joints(trajectory, times, limits)
    position = limits.forward(q)[:, :3, 3]
    outside = float(np.maximum(limits.workspace.lower - position, position - limits.workspace.upper).max())
    _demand("flange", outside, 0.0, "m outside the workspace box", "Stay inside, or set the box larger.")
    soon = limits.forward(q + SOON * rates)[:, :3, 3]
    speed = float(np.linalg.norm(soon - position, axis=1).max()) / SOON
    _demand("flange speed", speed, limits.flange_speed, "m/s", "Slow the path down.")
    _check_keep_out(q, limits)


def _check_joints(trajectory: JointTrajectory, times: Array, limits: SafetyLimits) -> tuple[Array, Array]:
    """Check range, speed and acceleration; return joints and rates, both (T, 7), at (T,) times."""
    curve = CubicHermiteSpline(trajectory.times, trajectory.positions, trajectory.velocities)
    q, rates, m = curve(times), curve(times, 1), limits.joint_margin
    beyond = np.maximum(limits.joint_lower + m - q, q - (limits.joint_upper - m)).max(axis=0)
    worst = int(np.argmax(beyond))
    _demand(f"joint {worst}", float(beyond[worst]), 0.0, "rad beyond its range less the margin", "Plan another branch.")
    # between two samples the acceleration of a cubic is linear: its extremes are at the ends, seen from inside
    ends = np.concatenate([curve(trajectory.times[:-1], 2), curve(np.nextafter(trajectory.times[1:], 0), 2)])
    shares = {"speed": np.abs(rates) / limits.joint_speed, "acceleration": np.abs(ends) / limits.joint_acceleration}
    for name, share in shares.items():
        worst = int(np.argmax(share.max(axis=0)))
        _demand(f"{name} of joint {worst}", float(share[:, worst].max()), 1.0, "of its limit", "Slow the path down.")
    return q, rates


def _check_keep_out(q: Array, limits: SafetyLimits) -> None:
    for some in np.array_split(q, len(q) // 1000 + 1) if limits.keep_out else ():
        balls = limits.outline(some)
        for box in limits.keep_out:
            gap = np.maximum(np.maximum(box.lower - balls[..., :3], balls[..., :3] - box.upper), 0)
            if np.any(np.linalg.norm(gap, axis=-1) <= balls[..., 3]):
                where = f"{box.lower} .. {box.upper} m"
                raise StageFailure(
                    "limits_exceeded", f"arm or tool would enter the keep-out box {where}. Plan around it."
                )


def check_shake(amplitude: float, frequency: float, duration: float, limits: SafetyLimits) -> None:
    """Check a shake's amplitude [m], frequency [Hz] and duration [s].

    Raises:
        StageFailure: limits_exceeded.
    """
    numbers = {"amplitude": amplitude, "frequency": frequency, "duration": duration}
    for name, value in numbers.items():
        if not (np.isfinite(value) and value > 0):
            raise StageFailure("limits_exceeded", f"shake {name}: got {value}; allowed: a number > 0. Plan again.")
    omega = 2 * np.pi * frequency
    _demand("shake amplitude x 2 pi frequency", amplitude * omega, limits.shake_speed, "m/s", "Shake less or slower.")
    acceleration = amplitude * omega**2
    limit = limits.shake_acceleration
    _demand("shake amplitude x (2 pi frequency)^2", acceleration, limit, "m/s^2", "Shake less or slower.")
    _demand("shake duration", duration, limits.shake_duration, "s", "Shake shorter.")


def _copied(trajectory: JointTrajectory) -> JointTrajectory:
    """Return a copy nobody else can change, its times and numbers checked again."""
    try:
        arrays = (trajectory.times, trajectory.positions, trajectory.velocities)
        return JointTrajectory(*(np.array(x, dtype=float) for x in arrays))
    except InputError as error:
        raise StageFailure("limits_exceeded", str(error)) from error


def _readable(state: GripperState) -> GripperState:
    if not (np.isfinite(state.opening) and np.isfinite(state.force)):
        raise DeviceError(f"the gripper reads {state.opening} m and {state.force} N. Check its connection.")
    return state
