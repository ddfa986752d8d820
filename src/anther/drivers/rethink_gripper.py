"""Rethink's electric parallel gripper on a Sawyer, as a `devices.Gripper`. Facts: sawyer 3, 5. Not run on metal.

It is an I/O device of the robot: its signals are set and read over ROS 1. Its force cannot be set (Intera 5.1 and
later): it closes to a width. When nobody speaks to it any more it ends its motion and holds.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from anther.arm import sawyer
from anther.checks import check_range
from anther.devices import DeviceError, GripperState
from anther.drivers.intera import IoDevice
from anther.drivers.ros1 import Node

DEVICE = "end_effector/right_gripper"
HEARD, MOVES = 3.0, 4.0
"""The gripper is heard within the first [s], and has moved within the second."""
POLL = 0.05


class RethinkGripper:
    """The gripper of a Sawyer. It must have been calibrated, see `enable`.

    Attributes:
        stroke: [m].
    """

    stroke = sawyer.STROKE

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
        self._wait(lambda: self._io.value("position_response_m") is not None, HEARD, "is not heard. Is it attached?")

    def move(self, opening: float) -> GripperState:
        """Move the pads to `opening` [m] apart, or until they meet resistance; return the state then.

        Raises:
            InputError: beyond the stroke.
            DeviceError: it is not calibrated, has an error, or does not obey.
        """
        check_range("gripper opening", opening, 0, self.stroke, "m")
        self._check_able()
        self._io.set("position_m", float(opening))
        self._wait(lambda: not self._io.value("is_moving"), MOVES, "does not come to rest. Look what is in its way.")
        return self.state()

    def state(self) -> GripperState:
        """Return the present state.

        Raises:
            DeviceError: see `move`.
        """
        self._check_able()
        opening, force, held = (self._io.value(n) for n in ("position_response_m", "force_response_n", "is_gripping"))
        return GripperState(float(opening), float(force or 0.0), bool(held))

    def enable(self) -> None:
        """Calibrate it and choose its slowest speed: it closes and opens all the way. Keep hands and plants out.

        Raises:
            DeviceError: it does not get through.
        """
        if self._io.value("has_error"):
            self._io.set("reboot", True)
        self._io.set("calibrate", True)
        self._wait(lambda: bool(self._io.value("is_calibrated")), MOVES, "does not calibrate. Look what is in its way.")
        self._io.set("speed_mps", sawyer.TOOL.speed)

    def close(self) -> None:
        """Sign off from the master; the gripper holds."""
        self._node.close()

    def _check_able(self) -> None:
        if self._io.value("has_error"):
            raise DeviceError("gripper: it reports an error. Look at it, then: anther cell enable.")
        if not self._io.value("is_calibrated"):
            raise DeviceError("gripper: it is not calibrated. Then: anther cell enable.")

    def _wait(self, done: Callable[[], bool], seconds: float, what: str) -> None:
        until = self._clock() + seconds
        self._sleep(POLL)
        while not done():
            if self._clock() > until:
                raise DeviceError(f"gripper: it {what}")
            self._sleep(POLL)
