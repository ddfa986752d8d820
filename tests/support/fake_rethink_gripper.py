"""Rethink's gripper as an I/O device on ROS 1: it closes up to something `width` wide. Facts: sawyer 5."""

from __future__ import annotations

import json
import threading
import time
from typing import Any

from anther.robot.drivers.intera import types
from anther.robot.drivers.ros1 import Node

DEVICE = "/io/end_effector/right_gripper/"
SIGNALS = {
    "position_m": "float", "speed_mps": "float", "position_response_m": "float", "force_response_n": "float",
    "is_gripping": "bool", "is_moving": "bool", "is_calibrated": "bool", "has_error": "bool", "calibrate": "bool",
    "reboot": "bool",
}  # fmt: skip


class FakeRethinkGripper:
    """Attributes: `width` of what is between the pads [m]; `values` of its signals; `deaf`; `force_told`, `grip_told`:
    whether these two are its own, or whatever a test has set."""

    def __init__(self, master: str) -> None:
        self.width, self.deaf, self._over = 0.0, False, False
        self.force_told = self.grip_told = True
        self.values: dict[str, Any] = {name: False if kind == "bool" else 0.02 for name, kind in SIGNALS.items()}
        self._done: list[Any] = []
        self.node = Node(master, "/fake_gripper", types())
        self._says = self.node.publisher(DEVICE + "state", "intera_core_msgs/msg/IODeviceStatus")
        self.node.subscribe(DEVICE + "command", "intera_core_msgs/msg/IOComponentCommand", self._hear)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over = True
        self._thread.join()
        self.node.close()

    def _hear(self, message: Any) -> None:
        if self.deaf or message.time in self._done:
            return
        for name, setting in json.loads(message.args)["signals"].items():
            assert setting["format"] == {"type": SIGNALS[name]}
            self.values[name] = setting["data"][0]
        if self.values["calibrate"]:
            self.values["is_calibrated"] = True
        if self.values["reboot"]:
            self.values["has_error"] = False
        self._done.append(message.time)

    def _run(self) -> None:
        v = self.values
        while not self._over:
            time.sleep(0.02)
            goal = max(v["position_m"], self.width if v["position_response_m"] >= self.width else 0.0)
            way = goal - v["position_response_m"]
            v["position_response_m"] += min(max(way, -0.004), 0.004)
            v["is_moving"] = abs(way) > 1e-6
            if self.grip_told:
                v["is_gripping"] = not v["is_moving"] and v["position_m"] < goal
            if self.force_told:
                v["force_response_n"] = 9.0 if v["is_gripping"] else 0.0
            self._tell()

    def _tell(self) -> None:
        make, now = self.node.types.types, time.time()
        status = make["intera_core_msgs/msg/IOStatus"]("ready", "", "")
        signals = [
            make["intera_core_msgs/msg/IODataStatus"](name, json.dumps({"type": kind}), f"[{json.dumps(v)}]", status)
            for (name, kind), v in zip(SIGNALS.items(), list(self.values.values()), strict=True)
        ]
        stamp = make["builtin_interfaces/msg/Time"](int(now), 0)
        device = make["intera_core_msgs/msg/IOComponentStatus"]("right_gripper", status)
        self._says.publish(
            make["intera_core_msgs/msg/IODeviceStatus"](stamp, device, [], signals, self._done[-100:], [])
        )
