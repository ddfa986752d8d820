"""ROS 2's joint_trajectory_controller without an arm, and a node without ROS 2.

The controller does what ros2_controllers' does with a message: it refuses what does not end at rest; a message without
a stamp begins when it comes, from wherever the arm is; then it goes on with the last message, whatever happens. Moments
are joined by polynomials of fifth order. The arm does exactly what it is told.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from logged_arm import LoggedArm
from scipy.interpolate import BPoly

from anther.core.geometry import Array
from anther.robot.drivers._streamed import prioritize_thread

CLOCK = 3.7  # s by which the robot's clock is ahead
RATE = 200.0


class FakeController(LoggedArm):
    """Attributes: `q` where the arm is; `log` of (time, joints); `heard` of (time, message); `refused`, with reasons.

    `tell` publishes (names, joints, stamp) and `hear` takes a message, both of whatever carries them.
    """

    def __init__(
        self,
        names: Sequence[str],
        joints: Array,
        tell: Callable[[list[str], Array, float], None],
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.clock, self.sleep, self._tell = clock, sleep, tell
        self.q, self._names = np.array(joints, dtype=float), tuple(names)
        self.names = ["gripper", *reversed(names)]  # as told: in an order of its own, with a joint beside
        self.mute, self.stuck, self.ahead, self.offset = False, False, CLOCK, np.zeros(len(names))
        self.log: list[tuple[float, Array]] = []
        self.heard: list[tuple[float, Any]] = []
        self.refused: list[str] = []
        self._told: tuple[float, Array, Array] | None = None  # from when, times (N,), q rate acceleration (N, 3, J)
        self._over = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over = True
        self._thread.join()

    def hear(self, message: Any) -> None:
        now = self.clock()
        self.heard.append((now, message))
        why = refusal(message, self._names)
        if why:
            self.refused.append(why)
            return
        order = [message.joint_names.index(name) for name in self._names]
        times, rows = moments(message)
        rows = rows[:, :, order]
        if times[0] > 0:  # what lies before the first moment is the controller's
            here = np.stack([self.q, np.zeros_like(self.q), np.zeros_like(self.q)])
            times, rows = np.r_[0.0, times], np.concatenate([here[None], rows])
        self._told = (now, times, rows)

    def _run(self) -> None:
        with prioritize_thread():  # a robot's own computer is not busy with tests
            due = self.clock()
            while not self._over:
                due += 1 / RATE
                self.sleep(max(due - self.clock(), 0))
                now = self.clock()
                if self._told is not None and not self.stuck:
                    since, times, rows = self._told
                    self.q = sampled(times, rows, now - since)[0]
                self.log.append((now, self.q.copy()))
                if not self.mute:
                    said = dict(zip(self._names, self.q + self.offset, strict=True))
                    self._tell(self.names, np.array([said.get(n, 0.1) for n in self.names]), now + self.ahead)


def moments(message: Any) -> tuple[Array, Array]:
    """Return the times (N,) [s] of a message and its joints, rates, accelerations (N, 3, J)."""
    times = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points])
    return times, np.array([(p.positions, p.velocities, p.accelerations) for p in message.points])


def sampled(times: Array, rows: Array, t: float) -> tuple[Array, Array, Array]:
    """Return joints, rates and accelerations (J,) at time t [s]; after the end the last, as it is."""
    if t >= times[-1] or len(times) == 1:
        return rows[-1][0], rows[-1][1], rows[-1][2]
    i = max(int(np.searchsorted(times, t, side="right")) - 1, 0)
    curve: Any = BPoly.from_derivatives(times[i : i + 2], rows[i : i + 2])
    return curve(t), curve(t, 1), curve(t, 2)


def refusal(message: Any, names: Sequence[str]) -> str:
    """Return why the controller does not take a message; empty if it does."""
    stamp = message.header.stamp
    if stamp.sec or stamp.nanosec:
        return "it is stamped"
    if sorted(message.joint_names) != sorted(names):
        return f"other joints: {message.joint_names}"
    if not message.points:
        return "no moments"
    times, rows = moments(message)
    if np.any(np.diff(times) <= 0) or times[0] < 0:
        return f"times do not increase: {times}"
    if rows.shape[2] != len(names) or not np.isfinite(rows).all():
        return "no numbers"
    return "" if np.abs(rows[-1][1]).max() < 1e-7 else f"it ends at {rows[-1][1]} rad/s"


class FakeNode:
    """A node whose publishers and subscribers meet in this process. Attributes: `cut`: nothing said arrives any more;
    `listeners`: how many hear the commands; `said` of everything published, as (topic, message)."""

    def __init__(self) -> None:
        self.hears: dict[str, Callable[[Any], None]] = {}
        self.said: list[tuple[str, Any]] = []
        self.cut, self.listeners, self.closed = False, 1, False
        self.deliver: Callable[[Any], None] = lambda message: None

    def subscribe(self, topic: str, kind: str, hear: Callable[[Any], None]) -> None:
        self.hears[topic] = hear

    def publisher(self, topic: str, kind: str) -> Any:
        def publish(message: Any) -> None:
            self.said.append((topic, message))
            if not self.cut:
                self.deliver(message)

        return SimpleNamespace(publish=publish, get_subscription_count=lambda: self.listeners)

    def publishers(self, topic: str) -> int:
        return 1

    def make(self, kind: str, **fields: Any) -> Any:
        if kind.endswith("/JointTrajectory"):
            fields["header"] = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0))
        return SimpleNamespace(**fields)

    def close(self) -> None:
        self.closed = True

    def tell(self, names: list[str], joints: Array, stamp: float) -> None:
        """Tell joints as on /joint_states."""
        time_ = SimpleNamespace(sec=int(stamp), nanosec=int(stamp % 1 * 1e9))
        state = SimpleNamespace(header=SimpleNamespace(stamp=time_), name=names, position=list(joints))
        if "/joint_states" in self.hears:
            self.hears["/joint_states"](state)


class RosEnd:
    """The machine's end of the real ROS 2, with the QoS of the real controller (the system's default).

    Attributes: `deliver`, called with each command.
    """

    def __init__(self, name: str, told: tuple[Any, str], commanded: tuple[Any, str]) -> None:
        """Begin; `told` and `commanded` are kinds of message and topics."""
        import rclpy  # noqa: PLC0415
        from rclpy.context import Context  # noqa: PLC0415
        from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415
        from rclpy.qos import qos_profile_system_default  # noqa: PLC0415

        self._context, self._rclpy, self._kind = Context(), rclpy, told[0]
        rclpy.init(context=self._context)
        self._node = rclpy.create_node(name, context=self._context)
        self.deliver: Callable[[Any], None] = lambda message: None
        self._publisher = self._node.create_publisher(*told, qos_profile_system_default)
        self._node.create_subscription(*commanded, self._take, qos_profile_system_default)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _take(self, message: Any) -> None:
        self.deliver(message)

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException  # noqa: PLC0415

        try:
            with prioritize_thread():
                self._executor.spin()
        except ExternalShutdownException:
            pass

    def publish(self, message: Any, stamp: float) -> None:
        if self._context.ok():
            message.header.stamp.sec, message.header.stamp.nanosec = int(stamp), int(stamp % 1 * 1e9)
            self._publisher.publish(message)

    def close(self) -> None:
        self._rclpy.try_shutdown(context=self._context)
        self._thread.join(5)
        self._node.destroy_node()


class RosNode(RosEnd):
    """The controller's end."""

    def __init__(self) -> None:
        from sensor_msgs.msg import JointState  # noqa: PLC0415
        from trajectory_msgs.msg import JointTrajectory  # noqa: PLC0415

        commands = "/joint_trajectory_controller/joint_trajectory"
        super().__init__("fake_controller", (JointState, "/joint_states"), (JointTrajectory, commands))

    def tell(self, names: list[str], joints: Array, stamp: float) -> None:
        self.publish(self._kind(name=names, position=joints.tolist()), stamp)
