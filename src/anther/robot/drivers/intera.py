"""Rethink's Intera 5.3: its messages that the drivers use, its I/O devices, and the Sawyer's electric parallel gripper.

Facts: sawyer 3, 5 (intera_common). The gripper has not run on metal: its signals are set and read over ROS 1. Its force
cannot be set (Intera 5.1 and later): it closes to a width. When nobody speaks to it any more it ends its motion and
holds.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from anther.core.checks import check_range
from anther.robot.arm.sawyer import TOOL
from anther.robot.devices import DeviceError, GripperState
from anther.robot.drivers.ros1 import Node, typestore

DEFINITIONS = {
    "intera_core_msgs/msg/JointCommand": """
        std_msgs/Header header
        int32 mode
        string[] names
        float64[] position
        float64[] velocity
        float64[] acceleration
        float64[] effort
        int32 POSITION_MODE=1
        int32 VELOCITY_MODE=2
        int32 TORQUE_MODE=3
        int32 TRAJECTORY_MODE=4""",
    "intera_core_msgs/msg/RobotAssemblyState": """
        bool homed
        bool ready
        bool enabled
        bool stopped
        bool error
        bool lowVoltage
        uint8 estop_button
        uint8 ESTOP_BUTTON_UNPRESSED = 0
        uint8 ESTOP_BUTTON_PRESSED   = 1
        uint8 ESTOP_BUTTON_UNKNOWN   = 2
        uint8 ESTOP_BUTTON_RELEASED  = 3
        uint8 estop_source
        uint8 ESTOP_SOURCE_NONE      = 0
        uint8 ESTOP_SOURCE_USER      = 1
        uint8 ESTOP_SOURCE_UNKNOWN   = 2
        uint8 ESTOP_SOURCE_FAULT     = 3
        uint8 ESTOP_SOURCE_ENGINE    = 4""",
    "intera_core_msgs/msg/EndpointState": """
        std_msgs/Header header
        geometry_msgs/Pose pose
        geometry_msgs/Twist twist
        geometry_msgs/Wrench wrench
        bool valid""",
    "intera_core_msgs/msg/CollisionDetectionState": """
        std_msgs/Header header
        bool collision_state""",
    "intera_core_msgs/msg/IOStatus": """
        string tag
        string DOWN      = down
        string READY     = ready
        string BUSY      = busy
        string UNREADY   = unready
        string ERROR     = error
        string id
        string detail""",
    "intera_core_msgs/msg/IODataStatus": """
        string name
        string format
        string data
        intera_core_msgs/IOStatus status""",
    "intera_core_msgs/msg/IOComponentStatus": """
        string name
        intera_core_msgs/IOStatus status""",
    "intera_core_msgs/msg/IODeviceStatus": """
        time time
        intera_core_msgs/IOComponentStatus device
        intera_core_msgs/IODataStatus[] ports
        intera_core_msgs/IODataStatus[] signals
        time[] commands
        string[] responses""",
    "intera_core_msgs/msg/IOComponentCommand": """
        time time
        string op
        string args""",
}
"""Their check sums are the robot's own: the constants count too, in their order."""


def types() -> Any:
    """Return rosbags' store with these messages in it."""
    return typestore(DEFINITIONS)


class IoDevice:
    """An I/O device of the robot, such as "robot/cuff" or "end_effector/right_gripper"."""

    def __init__(self, node: Node, name: str, *, sleep: Callable[[float], None] = time.sleep) -> None:
        """Begin to listen to it. There may be no such device: then it has no signals."""
        self._node, self._name, self._sleep = node, name, sleep
        self._signals: dict[str, tuple[str, Any]] = {}
        self._done: set[tuple[int, int]] = set()
        self._commands = node.publisher(f"/io/{name}/command", "intera_core_msgs/msg/IOComponentCommand")
        node.subscribe(f"/io/{name}/state", "intera_core_msgs/msg/IODeviceStatus", self._receive)

    def names(self) -> tuple[str, ...]:
        """Return the names of its signals; none as long as nothing was heard of it."""
        return tuple(self._signals)

    def value(self, signal: str) -> Any:
        """Return what a signal reads; None if there is none of that name."""
        return self._signals.get(signal, ("", None))[1]

    def set(self, signal: str, value: Any) -> None:
        """Set a signal; return when the device says that it has done so."""
        if signal not in self._signals:
            known = ", ".join(self._signals) or "none: nothing was heard of it"
            raise DeviceError(f"I/O device {self._name}: no signal '{signal}'; it has {known}.")
        make, now = self._node.types.types, time.time_ns()
        stamp = (now // 10**9, now % 10**9)
        setting = {"format": {"type": self._signals[signal][0]}, "data": [value]}
        command = make["intera_core_msgs/msg/IOComponentCommand"](
            make["builtin_interfaces/msg/Time"](*stamp), "set", json.dumps({"signals": {signal: setting}})
        )
        for _ in range(20):  # for two seconds; as intera_sdk
            self._commands.publish(command)
            self._sleep(0.1)
            if stamp in self._done:
                return
        raise DeviceError(f"I/O device {self._name} does not acknowledge {signal}. Is it attached, and its brake off?")

    def _receive(self, message: Any) -> None:
        self._done = {(t.sec, t.nanosec) for t in message.commands}
        for signal in message.signals:
            with suppress(ValueError, LookupError, TypeError):
                kind, self._signals[signal.name] = json.loads(signal.format)["type"], ("", None)
                self._signals[signal.name] = (kind, (json.loads(signal.data) or [None])[0])


DEVICE = "end_effector/right_gripper"


class RethinkGripper:
    """The gripper of a Sawyer. It must have been calibrated, see `enable`.

    Attributes:
        stroke: [m].
    """

    stroke = TOOL.stroke

    def __init__(
        self,
        node: Node,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Listen to it. Nothing moves.

        Raises:
            DeviceError: it is not heard.
        """
        self._node = node
        self._io, self._clock, self._sleep = IoDevice(node, DEVICE, sleep=sleep), clock, sleep
        self._wait(lambda: self._io.value("position_response_m") is not None, "is not heard. Is it attached?", 3.0)

    def move(self, opening: float) -> GripperState:
        """Move the pads to `opening` [m] apart, or until they meet resistance; return the state then.

        Raises:
            InputError: beyond the stroke.
            DeviceError: it is not calibrated, has an error, or does not obey.
        """
        check_range("gripper opening", opening, 0, self.stroke, "m")
        self._check_able()
        self._io.set("position_m", float(opening))
        self._wait(lambda: not self._io.value("is_moving"), "does not come to rest. Look what is in its way.")
        return self.state()

    def state(self) -> GripperState:
        """Return the present state; NaN where a signal is missing or no number.

        Raises:
            DeviceError: it is not calibrated, has an error, or does not say whether it holds something.
        """
        self._check_able()
        if not isinstance(held := self._io.value("is_gripping"), bool | int):
            raise DeviceError("gripper: it does not tell is_gripping. Look at its signals: anther cell check.")
        return GripperState(self._number("position_response_m"), self._number("force_response_n"), bool(held))

    def enable(self) -> None:
        """Calibrate it and choose its slowest speed: it closes and opens all the way. Keep hands and plants out."""
        if self._io.value("has_error"):
            self._io.set("reboot", True)
        self._io.set("calibrate", True)
        self._wait(lambda: bool(self._io.value("is_calibrated")), "does not calibrate. Look what is in its way.")
        self._io.set("speed_mps", TOOL.speed)

    def close(self) -> None:
        """Sign off from the master; the gripper holds."""
        self._node.close()

    def _number(self, signal: str) -> float:
        value = self._io.value(signal)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else float("nan")

    def _check_able(self) -> None:
        if self._io.value("has_error"):
            raise DeviceError("gripper: it reports an error. Look at it, then: anther cell enable.")
        if not self._io.value("is_calibrated"):
            raise DeviceError("gripper: it is not calibrated. Then: anther cell enable.")

    def _wait(self, done: Callable[[], bool], what: str, seconds: float = 4.0) -> None:
        until, poll = self._clock() + seconds, 0.05
        self._sleep(poll)
        while not done():
            if self._clock() > until:
                raise DeviceError(f"gripper: it {what}")
            self._sleep(poll)
