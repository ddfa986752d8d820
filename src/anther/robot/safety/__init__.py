"""The guard: every command to arm and gripper passes here first, and every reading of a moving arm on its way back.

A bad command is refused before anything moves; a bad reading stops the arm. Either way the arm holds.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from anther.core.checks import check_array
from anther.core.errors import InputError, StageFailure, bad_input
from anther.core.geometry import Array, Intrinsics
from anther.robot.devices import (
    Arm,
    ArmRecord,
    ArmSample,
    Camera,
    CartLimits,
    DeviceError,
    Frame,
    Gripper,
    GripperState,
    JointTrajectory,
    More,
    MoreSwing,
    Motor,
    Robot,
    SafetyLimits,
    Watch,
    wrap,
)
from anther.robot.safety._cart import CarriedArm, CarriedMotor, GuardedCart
from anther.robot.safety._grip import IDLE, check_closing, check_idle, check_let_go, check_readable
from anther.robot.safety._motion import (
    AT_REST,
    JUMP,
    LONGEST,
    ForceCheck,
    Watchdog,
    check_pieces,
    check_shake,
    check_swing,
    check_trajectory,
    demand,
    shake_amplitude,
)  # fmt: skip
from anther.robot.swing import Swing

__all__ = [
    "IDLE",
    "CarriedArm",
    "GuardedArm",
    "GuardedCamera",
    "GuardedCart",
    "GuardedGripper",
    "GuardedMotor",
    "check_idle",
    "check_let_go",
    "check_pieces",
    "check_shake",
    "check_trajectory",
    "guard",
    "shake_amplitude",
    "stem_stress",
]


def guard(robot: Robot, limits: SafetyLimits, cart: CartLimits | None = None) -> Robot:
    """Return the same machines, each behind a guard with these limits.

    A guard with other limits that is there already stays, and a command has to pass both: limits are tightened, never
    loosened. Of a robot on a cart never do both move (`GuardedCart`).

    Raises:
        InputError: a cart without limits.
    """

    def behind_guard(kind: Any) -> Callable[[Any], Any]:
        return lambda old: old if isinstance(old, kind) and old._limits is limits else kind(old, limits)

    def watch_camera(camera: Camera) -> GuardedCamera:
        return camera if isinstance(camera, GuardedCamera) else GuardedCamera(camera)

    guarded = wrap(
        robot,
        arm=behind_guard(GuardedArm),
        gripper=behind_guard(GuardedGripper),
        wrist_camera=watch_camera,
        side_camera=watch_camera,
        motor=behind_guard(GuardedMotor),
    )
    if guarded.cart is None:
        return guarded
    if isinstance(guarded.cart, GuardedCart):  # who is carried by it already is, below its other guard
        return guarded
    if cart is None:
        raise bad_input("guard", given="a cart", allowed="a cart with CartLimits", do="Say where its axes end.")
    carrier = GuardedCart(guarded.cart, cart, guarded.arm, guarded.gripper)
    carried = wrap(guarded, arm=lambda arm: CarriedArm(arm, carrier), motor=lambda m: CarriedMotor(m, carrier))
    return replace(carried, cart=carrier)


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
        self._force = ForceCheck()

    def joints(self) -> Array:
        """Return the measured joint angles (J,) [rad].

        Raises:
            DeviceError: the reading is not finite, or not where the arm was last sent: it is stale, or the arm was
                moved by hand.
        """
        try:
            q = check_array("measured joints", self._arm.joints(), self._limits.joint_lower.shape)
        except InputError as error:
            raise DeviceError(f"{error} The arm does not tell where it is.") from error
        if self._expected is not None:
            gap = float(np.abs(q - self._expected).max())
            if gap > self._limits.start_tolerance:
                self._lost = f"joints: got a reading {gap:.3g} rad from where the arm was sent; allowed: "
                self._lost += f"<= {self._limits.start_tolerance:g}. It is stale or the arm was moved: start anew."
                raise DeviceError(self._lost)
        return q

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow a trajectory, and what follows it, within the limits.

        What was checked is a copy, and the copy is what is commanded.

        Raises:
            StageFailure: limits_exceeded, nothing was commanded; or collision, the arm pressed on something and
                stopped. Either way it holds.
            DeviceError: the arm refused, stopped, or does not tell where it is; it holds.
        """
        watchdog = Watchdog(self._limits, watch, self._force)
        try:
            if self._lost:
                raise DeviceError(self._lost)
            checked = _copy(trajectory)
            check_trajectory(checked, self.joints(), self._limits, goes_on=more is not None)
            self._expected = None
            motions = [checked]
            onward = None if more is None else lambda: self._next(motions, more)
            record = self._arm.follow(checked, watchdog, onward)
        except BaseException:
            self._lost = self._lost or watchdog.lost
            with suppress(Exception):  # what went wrong first is what is reported
                self._arm.hold()
            raise
        self._expected = motions[-1].positions[-1]
        return record

    def hold(self) -> None:
        """Stop and hold the present position."""
        self._arm.hold()

    def _next(self, motions: list[JointTrajectory], more: More) -> JointTrajectory | None:
        """Return what follows these motions without a stop, checked and noted; None where the last ends at rest."""
        following, last = more(), motions[-1]
        if following is None:
            ends = float(np.abs(last.velocities[-1]).max())
            demand("speed at the ends", ends, AT_REST, "rad/s", "Let the last motion end at rest.")
            return None
        checked = _copy(following)
        seconds = sum(motion.duration for motion in [*motions, checked])
        demand("length of the motion", seconds, LONGEST, "s", "Plan shorter motions.")
        jump = float(np.abs(checked.velocities[0] - last.velocities[-1]).max())
        demand("jump in speed between motions", jump, JUMP, "rad/s", "Join them with equal speed.")
        check_trajectory(checked, last.positions[-1], self._limits, joined=True, goes_on=True)
        motions.append(checked)
        return checked


class GuardedMotor:
    """A motor that refuses what exceeds the limits, and is stopped whatever goes wrong. It is itself a `Motor`.

    Args:
        motor: the machine.
        limits: what no piece and no reading may exceed.
    """

    def __init__(self, motor: Motor, limits: SafetyLimits) -> None:
        self._motor, self._limits, self._force = motor, limits, ForceCheck()

    def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
        """Swing within the limits; return, at rest, what the arm's joints did meanwhile.

        What was checked is a copy, and the copy is what is commanded.

        Raises:
            StageFailure: limits_exceeded: a piece exceeds a limit, does not join the one before, or nothing follows one
                that does not end at rest; collision: the arm presses on something. The motor was stopped.
            DeviceError: the motor refused or stopped, the pads move further than asked, the arm does not stand still or
                does not tell where it is. The motor was stopped.
        """
        pieces: list[Swing] = []

        def next_piece() -> Swing | None:
            piece = more() if more else None
            if piece is not None:
                pieces.append(check_swing(piece, pieces[-1], self._limits))
            elif not pieces[-1].stops:
                raise StageFailure("limits_exceeded", "the swing would end in motion. End it with amplitudes of 0.")
            return None if piece is None else pieces[-1]

        at_rest = 0.1e-3  # what a motor at rest may read [m]

        def check_amplitude(sample: ArmSample) -> None:
            asked = max(piece.reach for piece in pieces)
            # 1.3: what a motor that is 15 % off does, and as much again
            if not (amplitude := self._motor.amplitude()) <= 1.3 * asked + at_rest:
                given = f"the motor moves the pads by {1e3 * amplitude:.2g} mm; asked were {1e3 * asked:.2g} mm."
                raise DeviceError(f"{given} Check its sensor.")
            if watch:
                watch(sample)

        still = replace(self._limits, tracking=self._limits.start_tolerance)
        try:
            pieces.append(check_swing(first, None, self._limits))
            record = self._motor.swing(pieces[0], Watchdog(still, check_amplitude, self._force), next_piece)
            if not (left := self._motor.amplitude()) <= at_rest:
                raise DeviceError(f"the motor does not come to rest: it still moves by {1e3 * left:.2g} mm.")
            if not pieces[-1].stops:
                raise DeviceError("the motor ended before the swing did.")
        except BaseException:
            self.stop()
            raise
        return record

    def stop(self) -> None:
        """Stop the motor; what keeps it from stopping is not raised, so that what went wrong before is not hidden."""
        with suppress(Exception):
            self._motor.stop()

    def amplitude(self) -> float:
        """Return what the motor's own sensor reads, see `Motor` [m]."""
        return self._motor.amplitude()


class GuardedGripper:
    """A gripper that refuses openings beyond its stroke, lets go of what it would crush, and tells when it jams.

    Its force must fit the way of its pads, step by step as they close (`_grip`).

    Args:
        gripper: the machine.
        limits: of its force.
    """

    def __init__(self, gripper: Gripper, limits: SafetyLimits) -> None:
        self._gripper, self._limits = gripper, limits
        self._closing: list[GripperState] = []

    @property
    def stroke(self) -> float:
        """Largest opening between the pads [m]."""
        return self._gripper.stroke

    def move(self, opening: float) -> GripperState:
        """Move the pads to `opening` [m] apart, or until they meet resistance; return the state then.

        Raises:
            StageFailure: limits_exceeded: beyond the stroke (nothing was commanded), or more than the grip force or
                the stem stress allowed (the pads were opened).
            DeviceError: the gripper refused or jammed; its force is missing, or does not fit the pads' way. Pads are
                opened whatever the force reads.
        """
        limits, stroke = self._limits, self.stroke
        if not 0 <= opening <= stroke:
            given = f"gripper opening: got {opening:g} m; allowed: 0 <= opening <= {stroke:g} m."
            raise StageFailure("limits_exceeded", f"{given} Check the unit.")
        before = self._gripper.state().opening
        state = self._gripper.move(opening)
        opens = opening >= before and np.isfinite(state.opening)
        if not opens:
            check_readable(state)
        stress = stem_stress(state, limits)
        if (state.force > limits.grip_force or stress > limits.pressing.stem_stress) and opening < stroke:
            self._gripper.move(stroke)
            demand("grip force", state.force, limits.grip_force, "N; the pads were opened", "Close less far.")
            demand("stem stress", stress, limits.pressing.stem_stress, "Pa; the pads were opened", "Close less far.")
        short = abs(state.opening - opening)
        if short > limits.grip_tolerance and (opens or not state.is_gripping):
            asked = f"sent to {1000 * opening:.1f} mm, the pads stand at {1000 * state.opening:.1f} mm"
            raise DeviceError(f"the gripper jammed: {asked} with {state.force:.1f} N. Free it by hand.")
        self._closing = [] if opens else [*self._closing, state]
        if self._closing:
            check_closing(self._closing, opening)
        return state

    def state(self) -> GripperState:
        """Return the present state.

        Raises:
            DeviceError: the reading is not finite.
        """
        return check_readable(self._gripper.state())


def stem_stress(state: GripperState, limits: SafetyLimits) -> float:
    """Return the greatest pressure of a pad on what is held, taken as a stiff round stem [Pa]; 0 if nothing is."""
    if not state.is_gripping or state.opening <= 0:
        return 0.0
    return float(limits.pressing.stress(max(state.force, 0.0), state.opening))


class GuardedCamera:
    """A camera that asks again for a lost frame, and drops those of a recording that are of no use.

    A recording shows what moves, so a picture in it that is the one before, with a new time, is of no use either.

    Args:
        camera: the machine.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._last: Frame | None = None  # of a recording that has ended

    @property
    def intrinsics(self) -> Intrinsics:
        """Of every frame."""
        return self._camera.intrinsics

    @property
    def rates(self) -> tuple[float, ...]:
        """At which a recording may be begun [1/s]."""
        return self._camera.rates

    def read(self) -> Frame:
        """Return one frame taken now.

        Raises:
            DeviceError: it was lost, three times in a row.
        """
        reasons = []
        for _ in range(3):
            try:
                frame = self._camera.read()
            except DeviceError as error:
                reasons.append(str(error))
            else:
                if not self._whole(frame):
                    reasons.append(f"an image of {frame.depth.shape} pixels")
                elif self._last is not None and _same(frame, self._last):
                    reasons.append("the last picture of the recording again")
                else:
                    return frame
        raise DeviceError(f"camera: no frame in 3 tries ({reasons[-1]}). Check its cable.")

    def start(self, rate: float) -> None:
        """Begin to record at `rate` frames per second."""
        self._last = None
        self._camera.start(rate)

    def recorded(self, since: float) -> list[Frame]:
        """Return the whole frames so far whose time goes forward and whose picture is not the one before.

        Raises:
            DeviceError: there are none, or all show the same picture.
        """
        return self._in_order(self._camera.recorded(since))

    def stop(self) -> list[Frame]:
        """End the recording and return its frames, as `recorded` does.

        Raises:
            DeviceError: all show the same picture. If the last ones do, the next `read` says so.
        """
        frames = self._in_order(self._camera.stop())
        self._last = frames[-1] if frames else None
        return frames

    def _in_order(self, recorded: list[Frame]) -> list[Frame]:
        frames: list[Frame] = []
        again = 0
        for frame in recorded:
            if not self._whole(frame) or (frames and frame.time <= frames[-1].time):
                continue
            if frames and _same(frame, frames[-1]):
                again += 1
            else:
                frames.append(frame)
        if again and len(frames) == 1:
            given = f"camera: got {again + 1} frames with the same picture; allowed: 1."
            raise DeviceError(f"{given} Restart it, or uncover it.")
        return frames

    def _whole(self, frame: Frame) -> bool:
        size = (self.intrinsics.height, self.intrinsics.width)
        return bool(np.isfinite(frame.time)) and frame.depth.shape == size and frame.rgb.shape == (*size, 3)


def _same(one: Frame, other: Frame) -> bool:
    """Return whether two frames show the same picture, by every 16th pixel.

    Noise alone changes nearly all of them (0.999 of those of a simulated D455).
    """
    apart = np.any(one.rgb[::4, ::4] != other.rgb[::4, ::4], axis=2)
    return float(apart.mean()) < 1e-3


def _copy(trajectory: JointTrajectory) -> JointTrajectory:
    """Return a copy nobody else can change, its times and numbers checked again."""
    try:
        arrays = (trajectory.times, trajectory.positions, trajectory.velocities)
        return JointTrajectory(*(np.array(x, dtype=float) for x in arrays))
    except InputError as error:
        raise StageFailure("limits_exceeded", str(error)) from error
