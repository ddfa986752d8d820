"""The seam between Anther and machines: small Protocols that simulation, replay and hardware satisfy alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import Array, Box, Intrinsics
from anther.core.records import Range, Record, Shape
from anther.robot.pressing import PRESSING, Pressing
from anther.robot.swing import Swing


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectory(Record):
    """A timed joint path, densely sampled. T samples of J joints.

    Attributes:
        times: (T,) from 0, increasing [s].
        positions: (T, J) [rad].
        velocities: (T, J) [rad/s].
    """

    CALLED = "trajectory"
    times: Annotated[Array, Shape("T"), Range(unit="s")]
    positions: Annotated[Array, Shape("T", "J"), Range(unit="rad")]
    velocities: Annotated[Array, Shape("T", "J"), Range(unit="rad/s")]

    def _check(self) -> None:
        n = len(self.times)
        if n < 2 or self.times[0] != 0 or np.any(np.diff(self.times) <= 0):
            raise bad_input(
                "trajectory times", given=f"{n} samples", allowed="two or more, from 0, increasing", do="Resample."
            )

    @classmethod
    def standstill(cls, joints: Array, duration: float) -> JointTrajectory:
        """Return the trajectory of an arm that waits at joints (J,) for `duration` [s]."""
        return cls(np.array([0.0, duration]), np.tile(joints, (2, 1)), np.zeros((2, len(joints))))

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.times[-1])

    def backwards(self) -> JointTrajectory:
        """Return the same path from its end to its start."""
        return JointTrajectory(self.duration - self.times[::-1], self.positions[::-1], -self.velocities[::-1])


@dataclass(frozen=True, slots=True, eq=False)
class ArmSample:
    """One reading of an arm that is following a trajectory.

    Attributes:
        time: when the joints were read [s], on the robot's clock.
        commanded, measured: (J,) joint angles [rad].
        force: size of the force that the world exerts on arm and gripper [N]; NaN if the arm cannot tell. A Sawyer
            estimates it from its joint torques (endpoint_state, wrench; facts: sawyer 5).
    """

    time: float
    commanded: Array
    measured: Array
    force: float = float("nan")


Watch = Callable[[ArmSample], None]
"""Sees every reading of an arm that is moving; the arm stops when it raises."""

LEAD = 0.3
"""A machine that may go on without a stop asks for its next motion so long before the present one ends [s]."""
More = Callable[[], "JointTrajectory | None"]
"""What comes next, joined to the end of the motion under way with the same place and speed; None: nothing does."""
MoreSwing = Callable[[], Swing | None]
"""The same of a swing."""


@dataclass(frozen=True, slots=True, eq=False)
class ArmRecord(Record):
    """What the arm did while following a trajectory: T samples of J joints.

    Attributes:
        times: (T,) [s], on the robot's clock.
        commanded, measured: (T, J) joint angles [rad].
    """

    CALLED = "record"
    times: Annotated[Array, Shape("T"), Range(unit="s")]
    commanded: Annotated[Array, Shape("T", "J"), Range(unit="rad")]
    measured: Annotated[Array, Shape("T", "J"), Range(unit="rad")]

    @classmethod
    def of(cls, samples: Sequence[ArmSample]) -> ArmRecord:
        """Return the record that a watcher's samples make."""
        joints = np.array([(s.commanded, s.measured) for s in samples]) if samples else np.zeros((0, 2, 0))
        return cls(np.array([s.time for s in samples], dtype=float), joints[:, 0], joints[:, 1])


@dataclass(frozen=True, slots=True)
class GripperState:
    """Attributes: opening [m] between the pads, force [N] on them, and whether something is held.

    A force that the gripper does not tell now is NaN, never 0. A gripper without a sensor tells the force to which its
    motor is set, once something stopped it; before, and with open pads, every gripper tells about 0.
    """

    opening: float
    force: float
    is_gripping: bool


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One RGB-D image: time [s] on the robot's clock, rgb (H, W, 3) uint8, depth (H, W) float32 [m], 0 = no reading."""

    time: float
    rgb: NDArray[Any]
    depth: NDArray[Any]


class DeviceError(StageFailure):
    """A machine refused a command, stopped, or does not tell where it is. Its kind is "device_fault"."""

    def __init__(self, message: str) -> None:
        super().__init__("device_fault", message)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the one argument that it takes."""
        return type(self), (str(self),)


class Arm(Protocol):
    """An arm of J joints."""

    def joints(self) -> Array:
        """Return the measured joint angles (J,) [rad]."""
        ...

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow a trajectory, cubic between its samples, that starts at the present joints; return when it has ended.

        Args:
            trajectory: the motion.
            watch: called with every reading on the way, at least 50 times a second. When it raises, or anything else
                does (Ctrl-C), the arm stops where it is, holds, and the error goes on to the caller.
            more: asked `LEAD` seconds before the end, while the arm moves on, for what follows without a stop; again
                for each motion it gives, until it says None.

        Raises:
            DeviceError: the arm refused or stopped on the way; it holds where it is.
        """
        ...

    def hold(self) -> None:
        """Stop and hold the present position."""
        ...


class Gripper(Protocol):
    """A parallel gripper. Its force cannot be set (facts: Intera 5.1 and later): it closes to a width."""

    @property
    def stroke(self) -> float:
        """Largest opening between the pads [m]."""
        ...

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

    @property
    def rates(self) -> tuple[float, ...]:
        """At which a recording may be begun [1/s]."""
        ...

    def read(self) -> Frame:
        """Return one frame taken now.

        Raises:
            DeviceError: the frame was lost.
        """
        ...

    def start(self, rate: float) -> None:
        """Begin to record at `rate` frames per second, one of `rates`."""
        ...

    def recorded(self, since: float) -> list[Frame]:
        """Return the frames of the recording under way that were taken from `since` on [s], in order of time.

        Raises:
            DeviceError: there are none.
        """
        ...

    def stop(self) -> list[Frame]:
        """End the recording and return its frames in order of time; a device may keep only part of a long one.

        Raises:
            DeviceError: all of them were lost.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ImuReadings(Record):
    """What an inertial sensor read: N readings in its own frame.

    Attributes:
        times: (N,) [s], on the robot's clock, rising.
        acceleration: (N, 3) what the accelerometer reads [m/s2]: at rest 9.81 upwards.
        rate: (N, 3) what the gyroscope reads [rad/s].
    """

    CALLED = "inertial readings"
    times: Annotated[Array, Shape("N"), Range(unit="s")]
    acceleration: Annotated[Array, Shape("N", 3), Range(unit="m/s2")]
    rate: Annotated[Array, Shape("N", 3), Range(unit="rad/s")]

    @classmethod
    def none(cls) -> ImuReadings:
        """Return no readings."""
        return cls(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))


class Imu(Protocol):
    """An inertial sensor that rides with the gripper: an accelerometer and a gyroscope, as many wrist cameras have."""

    @property
    def T_cam_imu(self) -> Array | None:
        """(4, 4) where it is in the frame of the wrist camera [m]; None: it is no part of that."""
        ...

    def start(self) -> None:
        """Begin to record."""
        ...

    def recorded(self, since: float) -> ImuReadings:
        """Return what was read from `since` on [s]; nothing (N = 0) if nothing was.

        Raises:
            DeviceError: the sensor was lost.
        """
        ...

    def stop(self) -> None:
        """End the recording."""
        ...


class Motor(Protocol):
    """A motor in the gripper that moves the closed pads to and fro, while the arm stands still."""

    def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
        """Move the pads; return, at rest, what the arm's joints did meanwhile.

        Args:
            first: begins at rest; the last piece ends at rest.
            watch: called with every reading of the standing arm on the way. When it raises, or anything else does
                (Ctrl-C), the motor stops.
            more: asked `LEAD` seconds before the end of a piece for the next (`Swing.then`); None: nothing follows.

        Raises:
            DeviceError: the motor refused or stopped on the way.
        """
        ...

    def stop(self) -> None:
        """Bring the pads to rest in the middle of their stroke, at once."""
        ...

    def amplitude(self) -> float:
        """Return half of what the pads moved on the hand, peak to peak, in the last 0.1 s [m], by the motor's sensor.

        The arm gives way a little under the motor, and the stem between the pads: they move less.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class CartState:
    """One reading of a cart of A axes.

    Attributes:
        time: when it was read [s], on the robot's clock.
        place: (A,) [m]: travel along the rails, then lift, as far as it has one.
        is_moving: whether any of them moves, by the cart's own word.
    """

    time: float
    place: Array
    is_moving: bool


class Cart(Protocol):
    """What carries an arm along a row, and up and down: A axes, travel first."""

    def state(self) -> CartState:
        """Return the newest reading, at once.

        Raises:
            DeviceError: there is none.
        """
        ...

    def move(self, place: Array) -> CartState:
        """Go to a place (A,) [m] and stand there; return the state then. Ctrl-C stops the cart on the way.

        Raises:
            DeviceError: the cart refused or stopped on the way; it stands, with its brakes on.
        """
        ...

    def stop(self) -> None:
        """Stop all axes at once, and hold them."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class CartLimits(Record):
    """What no command to a cart may exceed, and when the arm on it may move. A axes, J joints.

    Attributes:
        lower, upper: (A,) ends of its axes [m].
        stowed: (J,) where the arm keeps within the cart's outline: only so does the cart move [rad].
        stowed_tolerance: largest gap from there [rad].
        tolerance: by which a cart that stands may be off [m]; more is a motion.
        stale_after: a cart that gives no newer reading for so long is not believed [s].
    """

    CALLED = "cart limits"
    lower: Annotated[Array, Shape("A"), Range(unit="m")]
    upper: Annotated[Array, Shape("A"), Range(unit="m")]
    stowed: Annotated[Array, Shape("J"), Range(unit="rad")]
    stowed_tolerance: Annotated[float, Range(1e-3, 0.5, "rad")] = 0.05
    tolerance: Annotated[float, Range(1e-4, 0.05, "m")] = 0.003
    stale_after: Annotated[float, Range(0.02, 1.0, "s")] = 0.2

    def _check(self) -> None:
        if len(self.lower) == 0 or np.any(self.lower >= self.upper):
            given = f"{self.lower} .. {self.upper} m"
            raise bad_input("cart limits", given=given, allowed="lower < upper on every axis", do="Swap them.")


@dataclass(frozen=True, slots=True)
class Robot:
    """The machines of one cell.

    Attributes:
        arm, gripper: what grasps and shakes.
        wrist_camera: rides on the flange; takes the views.
        side_camera: stands still at `T_world_side_camera`; watches the flowers during the shake. None if there is none.
        motor: in the gripper; None if there is none.
        cart: carries the arm; None if it stands on the floor.
        imu: rides on the flange, at `T_flange_imu`; tells what the arm's joints let the gripper do. None if there is
            none.
    """

    arm: Arm
    gripper: Gripper
    wrist_camera: Camera
    side_camera: Camera | None = None
    T_world_side_camera: Array | None = None
    motor: Motor | None = None
    cart: Cart | None = None
    imu: Imu | None = None
    T_flange_imu: Array | None = None


class Proxy:
    """A machine that passes on to the one within all that its class does not change, as the log's and the faults' do.

    The guard's are none: what they do not check they do not pass on.
    """

    def __init__(self, machine: Any) -> None:
        self._machine = machine

    def __getattr__(self, name: str) -> Any:
        """Return what the machine within has under a name that is not defined here."""
        return getattr(self._machine, name)


def wrap(robot: Robot, **wrappers: Callable[[Any], Any]) -> Robot:
    """Return the robot with some of its machines wrapped, by the names of its fields; those that it lacks stay None."""
    machines = {name: getattr(robot, name) for name in wrappers}
    return replace(robot, **{name: wrappers[name](found) for name, found in machines.items() if found is not None})


@dataclass(frozen=True, slots=True, eq=False)
class SafetyLimits(Record):
    """What no command may exceed, whoever gives it. `anther.robot.safety` holds every command and reading against them.

    T samples, S balls. How many joints J the arm has is told by `joint_lower`.

    Attributes:
        forward: the arm's kinematics, joints (T, J) [rad] -> flange poses (T, 4, 4) in the world.
        outline: where arm and tool are, joints (T, J) -> balls (T, S, 4): centre in the world and radius [m].
        joint_lower, joint_upper: (J,) the arm's range [rad].
        joint_speed: (J,) [rad/s].
        joint_acceleration: (J,) [rad/s^2].
        workspace: where the flange may be, world [m].
        keep_out: boxes that no part of arm and tool may enter: pot, bench.
        joint_margin: kept from either end of the range [rad].
        start_tolerance: largest gap between the present joints and a trajectory's start [rad].
        flange_speed: [m/s]. The SDK's default for straight motions is 0.6 (facts: sawyer 1); joint motions are faster.
        contact_force: with which arm and tool may press on anything [N]. Our estimate: a stem that is shaken pulls
            with about 0.3 N in simulation, and what a Sawyer makes of its joint torques is good to a few newtons.
        tracking: largest gap between commanded and measured joints on the way [rad]; the SDK's action server has the
            same default (facts: sawyer 5).
        stale_after: joints that read the same for so long although the command moves on are not believed [s].
        shake_speed, shake_acceleration: largest amplitude x 2 pi frequency [m/s], and x (2 pi frequency)^2 [m/s^2], of
            a shake. At 12 m/s^2 a Sawyer is at its own limits (facts: sawyer 6: 11.6 mm at 5 Hz, 2.9 mm at 10 Hz).
        shake_duration: of all shaking of a visit [s]. Trellises are shaken for 60 s (facts: pollination 1a); half of
            that leaves a watched shake of twenty seconds time to go on where decisions are late.
        motor_stroke: farthest that a motor may move the pads to either side [m] (`shake.VIBRATING_GRIPPER`).
        motor_acceleration: with which it may move them [m/s^2]: moves a flower with 50 m/s^2 at gain 1 (facts:
            pollination 1b). A guess.
        grip_force: largest force between the pads [N]: the URDF's effort limit of a finger (facts: sawyer 3).
        pressing: what a stem bears of the pads, see `Pressing`.
        grip_tolerance: pads that stop further than this from where they were sent, with nothing between them, are
            jammed [m].
    """

    forward: Callable[[Array], Array]
    outline: Callable[[Array], Array]
    joint_lower: Annotated[Array, Shape("J"), Range(unit="rad")]
    joint_upper: Annotated[Array, Shape("J"), Range(unit="rad")]
    joint_speed: Annotated[Array, Shape("J"), Range(unit="rad/s")]
    joint_acceleration: Annotated[Array, Shape("J"), Range(unit="rad/s^2")]
    workspace: Box
    keep_out: tuple[Box, ...] = ()
    # nobody switches a limit off: the ranges are wide, but not infinite
    joint_margin: Annotated[float, Range(0.0, 1.0, "rad")] = 0.02
    start_tolerance: Annotated[float, Range(1e-4, 0.2, "rad")] = 0.05
    flange_speed: Annotated[float, Range(1e-3, 3.0, "m/s")] = 1.5
    contact_force: Annotated[float, Range(0.1, 150.0, "N")] = 10.0
    tracking: Annotated[float, Range(1e-3, 0.5, "rad")] = 0.2
    stale_after: Annotated[float, Range(0.01, 1.0, "s")] = 0.1
    shake_speed: Annotated[float, Range(1e-4, 3.0, "m/s")] = 0.5
    shake_acceleration: Annotated[float, Range(1e-3, 500.0, "m/s^2")] = 12.0
    shake_duration: Annotated[float, Range(0.01, 60.0, "s")] = 30.0
    motor_stroke: Annotated[float, Range(1e-5, 0.02, "m")] = 1.5e-3
    motor_acceleration: Annotated[float, Range(1e-3, 500.0, "m/s^2")] = 50.0
    grip_force: Annotated[float, Range(0.1, 100.0, "N")] = 20.0
    pressing: Pressing = PRESSING
    grip_tolerance: Annotated[float, Range(1e-4, 0.02, "m")] = 0.003

    def _check(self) -> None:
        empty = np.any(self.joint_lower + 2 * self.joint_margin >= self.joint_upper)
        if empty or np.any(self.joint_speed <= 0) or np.any(self.joint_acceleration <= 0):
            raise bad_input(
                "safety limits",
                given="an empty range",
                allowed="lower + 2 margin < upper; speed and acceleration > 0",
                do="Check units.",
            )


Tap = Callable[[Robot, SafetyLimits, Array, Callable[[], float]], Robot]
"""Returns the same machines, listened to; of (robot, limits, wrist camera on the flange (4, 4), robot's clock [s])."""


def no_tap(robot: Robot, limits: SafetyLimits, T_flange_cam: Array, clock: Callable[[], float]) -> Robot:
    """Return the machines as they are: a `Tap`."""
    return robot
