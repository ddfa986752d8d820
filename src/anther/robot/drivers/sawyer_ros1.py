"""A Rethink Sawyer over ROS 1, as a `devices.Arm`. Facts: sawyer 5; on metal it has not run (docs/real_robot.md)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from anther.core.checks import check_range
from anther.core.geometry import Array
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import DeviceError
from anther.robot.drivers._readings import STALE
from anther.robot.drivers._streamed import Reference, StreamedArm, braking
from anther.robot.drivers.intera import IoDevice
from anther.robot.drivers.ros1 import Node

LIMB = "/robot/limb/right/"
Mode = Literal["position", "trajectory"]


class Sawyer(StreamedArm):
    """A Sawyer behind a ROS master, streamed to at `rate`. It must have been enabled, see `enable`.

    In "position" mode the robot's own controller limits the speed and avoids self-collision: for bring-up. A shake
    needs "trajectory" mode, in which it follows what it is told.

    Attributes:
        node: through which it is spoken to.
        readings: of its joints.
    """

    _longest_silence = 0.03
    """The arm stops by itself when it hears no command for so long [s] (joint_command_timeout), and so does the driver
    when it could not give one."""

    def __init__(
        self,
        node: Node,
        *,
        names: Sequence[str] = SAWYER.joints,
        acceleration: Array = SAWYER.acceleration,
        mode: Mode = "position",
        rate: float = 100.0,
        speed_ratio: float = 0.1,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Connect. Nothing moves.

        Args:
            node: registered with the robot's master.
            names: (J,) of the joints, in Anther's order.
            acceleration: (J,) with which it brakes [rad/s^2].
            mode: see the class.
            rate: of the commands [1/s].
            speed_ratio: of the robot's own controller, in position mode.
            clock, sleep: [s]; the clock that readings are told on.

        Raises:
            DeviceError: it is not heard, or has other joints.
        """
        check_range("rate", rate, 50, 800, "commands a second")
        check_range("speed ratio", speed_ratio, 0.01, 1)
        super().__init__(names, rate=rate, stale=STALE, silence=self._longest_silence, clock=clock, sleep=sleep)
        self.node, self._acceleration, self._mode = node, acceleration, mode
        self._state: Any = None
        self._collided = False
        node.subscribe("/robot/joint_states", "sensor_msgs/msg/JointState", self.readings.receive)
        node.subscribe("/robot/state", "intera_core_msgs/msg/RobotAssemblyState", self._on_state)
        node.subscribe(LIMB + "endpoint_state", "intera_core_msgs/msg/EndpointState", self._on_force)
        kind = "intera_core_msgs/msg/CollisionDetectionState"
        node.subscribe(LIMB + "collision_detection_state", kind, self._on_collision)
        self._cuff = IoDevice(node, "robot/cuff", sleep=sleep)
        self._commands = node.publisher(LIMB + "joint_command", "intera_core_msgs/msg/JointCommand")
        self._enable = node.publisher("/robot/set_super_enable", "std_msgs/msg/Bool")
        self._reset = node.publisher("/robot/set_super_reset", "std_msgs/msg/Empty")
        ratio, silence = (
            node.publisher(LIMB + topic, "std_msgs/msg/Float64", latch=True)
            for topic in ("set_speed_ratio", "joint_command_timeout")
        )
        ratio.publish(self._make("std_msgs/msg/Float64", speed_ratio))
        silence.publish(self._make("std_msgs/msg/Float64", self._silence))
        self._wait(lambda: self.readings.last is not None and self._state is not None, "is not heard")
        self._wait(lambda: bool(np.isfinite(self._current_force(clock()))), "tells no force")
        self._check_names()
        self._wait(lambda: self._commands.readers > 0, "does not listen to joint_command")
        first = self._message(np.zeros(len(self._names)))
        self._commands.packet(first)  # slow at first

    def cannot(self) -> str:
        """Return why the arm cannot be moved now; empty if it can."""
        state = self._state
        if state is None:
            return "its state is not known"
        pressed = state.estop_button == state.ESTOP_BUTTON_PRESSED
        reasons = {
            "it is stopped: the stop button is pressed": pressed,
            "it is stopped: look why, then reset and enable it with anther cell enable": state.stopped,
            "it reports an error: look at its display": state.error,
            "it is not enabled: anther cell enable does that": not state.enabled,
            "its cuff is held by somebody": self._cuff.value("right_cuff"),
            "it felt a collision: look what it touches": self._collided,
            "nobody listens to joint_command: is the robot still on?": not self._commands.readers,
        }
        return next((why for why, holds in reasons.items() if holds), "")

    def check_able(self) -> None:
        """Check that the arm can be moved, and tells its joints and, as every Sawyer does, its force."""
        super().check_able()
        if not np.isfinite(self._current_force(self._clock())):
            old = f"the force on {LIMB}endpoint_state is {2e3 * self._stale:.0f} ms old, or no number"
            raise DeviceError(f"{old}. Check the robot; then start anew.")

    def describe(self) -> list[str]:
        """Return in words what is heard of the robot."""
        why = self.cannot()
        return [
            self._describe_readings(),
            f"commands: {self._mode}, {1 / self._period:g} a second; force {self._current_force(self._clock()):.1f} N",
            f"cannot move: {why}" if why else "ready to move",
        ]

    def enable(self) -> None:
        """Switch the motors on; after a stop that was released, reset it first. The arm holds where it is."""
        if self._state.stopped or self._state.error:
            if self._state.estop_button == self._state.ESTOP_BUTTON_PRESSED:
                raise DeviceError(
                    "the stop button is pressed. Look why; turn it until it comes out; then enable again."
                )
            empty = self._make("std_msgs/msg/Empty")
            clear = lambda: not (self._state.stopped or self._state.error)  # noqa: E731
            self._wait(clear, "does not reset", lambda: self._reset.publish(empty))
        self._switch(True)
        self._last_command = None

    def disable(self) -> None:
        """Switch the motors off: the brakes hold the arm."""
        self._switch(False)

    def close(self) -> None:
        """Sign off from the master."""
        self.node.close()

    def _switch(self, on: bool) -> None:
        says, what = self._make("std_msgs/msg/Bool", on), f"is not {'en' if on else 'dis'}abled"
        self._wait(lambda: self._state.enabled == on, what, lambda: self._enable.publish(says))

    def _aim(self, reference: Reference, t: float) -> None:
        self._command(*reference.at(t))

    def _command(self, q: Array, rate: Array, acceleration: Array) -> None:
        packet = self._commands.packet(self._message(q, rate, acceleration))  # takes long: before the time is checked
        self._send(lambda: self._commands.send(packet), q, rate)

    def _brake(self, q: Array, rate: Array) -> Array:
        way, begin = Reference(braking(q, rate, self._acceleration)), self._clock()
        while (t := self._clock() - begin) < way.ends:
            self._command(*way.at(t))
            self._sleep(self._period)
        return way.at(way.ends)[0]

    def _rest(self, q: Array) -> None:
        self._commands.publish(self._message(q))
        self._rests(q)

    def _message(self, q: Array, rate: Array | None = None, acceleration: Array | None = None) -> Any:
        follows = self._mode == "trajectory" and rate is not None
        none, now = np.zeros(0), time.time_ns()
        stamp = self._make("builtin_interfaces/msg/Time", now // 10**9, now % 10**9)
        return self._make(
            "intera_core_msgs/msg/JointCommand",
            self._make("std_msgs/msg/Header", 0, stamp, ""),
            4 if follows else 1,
            list(self._names),
            q,
            rate if follows else none,
            acceleration if follows else none,
            none,
        )

    def _make(self, kind: str, *values: Any) -> Any:
        return self.node.types.types[kind](*values)

    def _on_state(self, message: Any) -> None:
        self._state = message

    def _on_collision(self, message: Any) -> None:
        self._collided = bool(message.collision_state)

    def _on_force(self, message: Any) -> None:
        force = message.wrench.force
        self._take_force(force.x, force.y, force.z)

    def _check_names(self) -> None:
        names = self.node.parameter("/robot_config/right_config/joint_names")
        if names is not None and set(names) != set(self._names):
            given = f"joints: the robot has {', '.join(map(str, names))}; allowed: {', '.join(self._names)}"
            raise DeviceError(f"{given}. This is not the arm that Anther's model describes.")
