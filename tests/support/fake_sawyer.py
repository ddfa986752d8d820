"""A Sawyer's ROS 1 interface without a Sawyer: it moves as it is told and, unheard, stops by itself. Facts: sawyer 5.

In trajectory mode it goes on with the last rate it was told until `timeout` has passed without a command, then brakes
with the arm's greatest acceleration: no better than the robot may be.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from logged_arm import LoggedArm

from anther.core.geometry import Array
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import JointTrajectory
from anther.robot.drivers._streamed import prioritize_thread
from anther.robot.drivers.intera import types
from anther.robot.drivers.ros1 import Node

CLOCK = 3.7  # s by which the robot's clock is ahead
ENCODERS = 1e-6  # rad, of their noise
LIMB = "/robot/limb/right/"


class FakeSawyer(LoggedArm):
    """Attributes: `q` where it is; `log` of (time, joints); `heard` of the times of commands [s], on its `clock`;
    `commands` of (time, mode, joints, rates)."""

    def __init__(
        self,
        master: str,
        *,
        rate: float = 200.0,
        joints: Array = SAWYER.neutral,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.clock, self.sleep = clock, sleep
        self.q, self.v = np.array(joints), np.zeros(7)
        self.names = ["head_pan", *reversed(SAWYER.joints), "torso_t0"]
        self.enabled, self.stopped, self.pressed, self.error = True, False, False, False
        self.cuff = self.collided = self.mute = False
        self.timeout, self.ratio, self.force, self.lag, self.ahead = 0.2, 0.3, 1.0, 0.0, CLOCK
        self.noise = np.random.default_rng(0)  # of its force: none where its sensor is `dead`; `numb`: none is told
        self.dead = self.numb = False
        self.offset = np.zeros(7)  # rad, between what it does and what it says
        self.frozen = np.full(7, np.nan)  # rad, where it says that a joint is for good, but for the noise of encoders
        self.log: list[tuple[float, Array]] = []
        self.heard: list[float] = []
        self.commands: list[tuple[float, int, Array, Array]] = []
        self._target: tuple[float, int, Array, Array] | None = None
        self._rate, self._over, self._held = rate, False, list[tuple[float, Any]]()
        self.node = Node(master, "/fake_sawyer", types())
        say, hear = self.node.publisher, self.node.subscribe
        self._joints = say("/robot/joint_states", "sensor_msgs/msg/JointState")
        self._state = say("/robot/state", "intera_core_msgs/msg/RobotAssemblyState")
        self._endpoint = say(LIMB + "endpoint_state", "intera_core_msgs/msg/EndpointState")
        self._collision = say(LIMB + "collision_detection_state", "intera_core_msgs/msg/CollisionDetectionState")
        self._io = say("/io/robot/cuff/state", "intera_core_msgs/msg/IODeviceStatus")
        hear(LIMB + "joint_command", "intera_core_msgs/msg/JointCommand", self._command)
        hear(LIMB + "joint_command_timeout", "std_msgs/msg/Float64", lambda m: setattr(self, "timeout", m.data))
        hear(LIMB + "set_speed_ratio", "std_msgs/msg/Float64", lambda m: setattr(self, "ratio", m.data))
        hear("/robot/set_super_enable", "std_msgs/msg/Bool", self._enable)
        hear("/robot/set_super_reset", "std_msgs/msg/Empty", self._reset)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over = True
        self._thread.join()
        self.node.close()

    def _command(self, message: Any) -> None:
        order = [message.names.index(name) for name in SAWYER.joints]
        rate = message.velocity[order] if message.mode == 4 else np.zeros(7)
        self._target = (self.clock(), message.mode, message.position[order], rate)
        self.heard.append(self._target[0])
        self.commands.append(self._target)

    def _enable(self, message: Any) -> None:
        if not self.stopped:
            self.enabled, self._target = message.data, None

    def _reset(self, message: Any) -> None:
        if not self.pressed:
            self.stopped = self.error = self.enabled = False

    def _run(self) -> None:
        with prioritize_thread():  # a robot's own computer is not busy with tests
            self._go_on()

    def _go_on(self) -> None:
        before = due = self.clock()
        while not self._over:
            due += 1 / self._rate
            self.sleep(max(due - self.clock(), 0))
            now = self.clock()
            self._move(now, now - before)
            before = now
            self.log.append((now, self.q.copy()))
            if not self.mute:
                self._tell()

    def _move(self, now: float, dt: float) -> None:
        if self.pressed:
            self.stopped, self.enabled = True, False
        if self._target is None or not self.enabled or self.cuff:
            self.v = np.zeros(7)
            return
        told, mode, q, rate = self._target
        if mode == 1:
            step = np.clip(q - self.q, -self.ratio * SAWYER.velocity * dt, self.ratio * SAWYER.velocity * dt)
            self.q, self.v = self.q + step, step / dt
        elif now - told <= self.timeout:
            self.q, self.v = q + rate * (now - told), rate
        else:
            less = np.clip(self.v, -SAWYER.acceleration * dt, SAWYER.acceleration * dt)
            self.v = self.v - less
            self.q = self.q + self.v * dt

    def _tell(self) -> None:
        make, now = self.node.types.types, self.clock() + self.ahead
        stamp = make["builtin_interfaces/msg/Time"](int(now), int(now % 1 * 1e9))
        header = make["std_msgs/msg/Header"](0, stamp, "base")
        noisy = self.frozen + ENCODERS * self.noise.standard_normal(7)
        told = np.where(np.isnan(self.frozen), self.q + self.offset, noisy)
        said = dict(zip(SAWYER.joints, told, strict=True))
        angles, none = np.array([said.get(name, 0.1) for name in self.names]), np.zeros(0)
        self._held.append((self.clock(), make["sensor_msgs/msg/JointState"](header, self.names, angles, none, none)))
        while self._held and self._held[0][0] <= self.clock() - self.lag:
            self._joints.publish(self._held.pop(0)[1])
        flags = (True, self.enabled, self.enabled, self.stopped, self.error, False)
        button = 1 if self.pressed else 3 if self.stopped else 0
        self._state.publish(make["intera_core_msgs/msg/RobotAssemblyState"](*flags, button, int(self.stopped)))
        vector, point, turn = (make[f"geometry_msgs/msg/{n}"] for n in ("Vector3", "Point", "Quaternion"))
        pose = make["geometry_msgs/msg/Pose"](point(0, 0, 0), turn(0, 0, 0, 1))
        twist = make["geometry_msgs/msg/Twist"](vector(0, 0, 0), vector(0, 0, 0))
        wrench = make["geometry_msgs/msg/Wrench"](
            vector(0, 0, self.force + (not self.dead) * 1e-7 * self.noise.random()), vector(0, 0, 0)
        )
        if not self.numb:
            self._endpoint.publish(make["intera_core_msgs/msg/EndpointState"](header, pose, twist, wrench, True))
        self._collision.publish(make["intera_core_msgs/msg/CollisionDetectionState"](header, self.collided))
        status = make["intera_core_msgs/msg/IOStatus"]("ready", "", "")
        device = make["intera_core_msgs/msg/IOComponentStatus"]("cuff", status)
        signal = make["intera_core_msgs/msg/IODataStatus"](
            "right_cuff", '{"type": "bool", "role": "input"}', f"[{str(self.cuff).lower()}]", status
        )
        self._io.publish(make["intera_core_msgs/msg/IODeviceStatus"](stamp, device, [], [signal], [], []))


def swing(seconds: float, amplitude: float) -> JointTrajectory:
    """Return a swing of every joint [rad] about the neutral ones, at 1.9 Hz, that begins and ends at rest."""
    t = np.arange(0, seconds, 0.002)
    share = np.clip(np.minimum(t, t[-1] - t) / 0.5, 0, 1)
    q = amplitude * share**2 * (3 - 2 * share) * np.sin(2 * np.pi * 1.9 * t)
    joints = SAWYER.neutral + q[:, None] * np.ones(len(SAWYER.neutral))
    return JointTrajectory(t, joints, np.gradient(joints, t, axis=0))
