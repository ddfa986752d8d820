"""Any arm under ROS 2's joint_trajectory_controller, as a `devices.Arm`; on metal it has not run (docs/real_robot.md).

The controller goes on with the last message that it heard and has no timeout by default. So every message holds the
next moments of the motion, and then the way to rest: an arm that hears nothing more brakes by itself.
"""

from __future__ import annotations

import importlib
import threading
import time
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from anther.core.checks import check_array, check_range
from anther.core.errors import MissingExtra, bad_input
from anther.core.geometry import Array
from anther.robot.devices import DeviceError
from anther.robot.drivers._holding import NEAR, LastCommand, find_rest_joints
from anther.robot.drivers._readings import STALE
from anther.robot.drivers._streamed import Reference, StreamedArm, braking, prioritize_thread

AHEAD = 0.03
"""A message holds so much of the motion before it brakes [s]; commands further apart than this end the motion."""
INSTALL = "Source your ROS 2, or run: pip install 'anther[ros2]'"
TRAJECTORY, POINT = "trajectory_msgs/msg/JointTrajectory", "trajectory_msgs/msg/JointTrajectoryPoint"


class Node:
    """A node of ROS 2 in a context of its own: what else uses rclpy in this process is left alone."""

    def __init__(self, name: str, threads: int = 1) -> None:
        """Begin; the domain is ROS_DOMAIN_ID's.

        Args:
            name: of the node.
            threads: on which it hears and answers; a service that takes long wants more than one.

        Raises:
            MissingExtra: rclpy is not installed.
            DeviceError: no middleware.
        """
        self._rclpy = _module("rclpy")
        self._context = _module("rclpy.context").Context()
        try:
            self._rclpy.init(context=self._context)
            self._node = self._rclpy.create_node(name, context=self._context, start_parameter_services=False)
        except Exception as error:  # of the middleware's own kinds
            raise DeviceError(f"ROS 2: no node can be made ({error}). Is a middleware installed? {INSTALL}.") from error
        executors = _module("rclpy.executors")
        self._executor = (
            executors.SingleThreadedExecutor(context=self._context)
            if threads == 1
            else executors.MultiThreadedExecutor(threads, context=self._context)
        )
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, kind: str, receive: Callable[[Any], None]) -> None:
        """Call `receive` with every message of a topic, from another thread. Publishers of every reliability count."""
        with self._check_topic():
            self._node.create_subscription(_kind(kind), topic, receive, _module("rclpy.qos").qos_profile_sensor_data)

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Any:
        """Return what publishes a topic.

        It is reliable, and only the newest message is sent again: an old one would begin anew when it comes. With
        `latched`, who subscribes later still hears the newest.

        Raises:
            InputError: no name of a topic.
        """
        with self._check_topic():
            if not latched:
                return self._node.create_publisher(_kind(kind), topic, 1)
            qos = _module("rclpy.qos")
            profile = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
            return self._node.create_publisher(_kind(kind), topic, profile)

    def service(self, name: str, kind: str, answer: Callable[[Any], Any]) -> None:
        """Let `answer` fill in the response of every request to a service, from another thread, one after the other."""
        group = _module("rclpy.callback_groups").MutuallyExclusiveCallbackGroup()
        with self._check_topic():
            self._node.create_service(_kind(kind), name, lambda _, filled: answer(filled), callback_group=group)

    def now(self) -> Any:
        """Return the time on ROS's clock, as a stamp."""
        return self._node.get_clock().now().to_msg()

    def publishers(self, topic: str) -> int:
        """Return how many publish a topic."""
        return self._node.count_publishers(topic)

    def make(self, kind: str, **fields: Any) -> Any:
        """Return a message, such as of "sensor_msgs/msg/JointState"."""
        return _kind(kind)(**fields)

    def close(self) -> None:
        """End the node."""
        self._rclpy.try_shutdown(context=self._context)
        self._thread.join(5)
        self._node.destroy_node()

    @contextmanager
    def _check_topic(self) -> Iterator[None]:
        """Say of a topic that cannot be one that it is so."""
        try:
            yield
        except _module("rclpy.exceptions").NameValidationException as error:
            reason = " ".join(str(error).split())
            raise bad_input("topic", given=reason, allowed="such as /joint_states", do="Correct it.") from error

    def _spin(self) -> None:
        with prioritize_thread(), suppress(_module("rclpy.executors").ExternalShutdownException):
            self._executor.spin()


class Plan(NamedTuple):
    """What one message says: N moments of J joints.

    Attributes:
        times: (N,) from 0, increasing [s].
        q, rate, acceleration: (N, J) [rad], [rad/s], [rad/s^2].
    """

    times: Array
    q: Array
    rate: Array
    acceleration: Array

    def at(self, t: float) -> tuple[Array, Array]:
        """Return joints and rates (J,) at time t [s]; at rest after the end."""
        if len(self.times) == 1 or t >= self.times[-1]:
            return self.q[-1], np.zeros_like(self.q[-1])
        curve = CubicHermiteSpline(self.times, self.q, self.rate)
        return curve(max(t, 0.0)), curve(max(t, 0.0), 1)


def still(q: Array, after: float) -> Plan:
    """Return what a message says for an arm to stand at joints (J,) `after` so long [s]."""
    none = np.zeros((1, len(q)))
    return Plan(np.array([after]), q[None], none, none)


def brake(q: Array, rate: Array, acceleration: Array) -> Plan:
    """Return the straight way to rest from joints q (J,) at `rate`, with no more than `acceleration` of any joint."""
    way = braking(q, rate, acceleration)
    slowing = np.tile(-rate / way.duration, (len(way.times), 1))
    slowing[-1] = 0.0
    return Plan(way.times, way.positions, way.velocities, slowing)


def plan(reference: Reference, t: float, acceleration: Array) -> Plan:
    """Return what a message says at time t [s]: the next `AHEAD` of a motion, as far as it is known, then to rest."""
    left = min(AHEAD, reference.ends - t)
    if left <= 0:
        return still(reference.at(t)[0], 0.0)
    # samples are 0.01 s apart, which the controller joins by polynomials, and no less than 0.1 ms
    times = np.linspace(0.0, left, max(round(left / 0.01), 1) + 1) if left > 1e-4 else np.zeros(1)
    inside = np.minimum(t + times, np.nextafter(reference.ends, 0.0))  # at the end itself it stands
    motion = Plan(times, *(np.array(rows) for rows in zip(*map(reference.at, inside), strict=True)))
    tail = brake(motion.q[-1], motion.rate[-1], acceleration)
    if np.abs(motion.rate[-1]).max() < 1e-6:  # it stands
        motion.rate[-1] = motion.acceleration[-1] = 0.0
        return motion
    return Plan(
        np.r_[motion.times, motion.times[-1] + tail.times[1:]],
        np.r_[motion.q, tail.q[1:]],
        np.r_[motion.rate, tail.rate[1:]],
        np.r_[motion.acceleration, tail.acceleration[1:]],
    )


class JointTrajectoryArm(StreamedArm):
    """An arm of J joints whose controller hears trajectory_msgs/JointTrajectory.

    Attributes:
        node: through which it is spoken to.
        readings: of its joints.
    """

    def __init__(
        self,
        node: Node,
        names: Sequence[str],
        acceleration: Array,
        *,
        controller: str = "/joint_trajectory_controller",
        rate: float = 100.0,
        states: str = "/joint_states",
        wrench: str = "",
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Connect. Nothing moves.

        Args:
            node: a `Node`.
            names: (J,) of the joints, in Anther's order.
            acceleration: (J,) with which it brakes [rad/s^2].
            controller: its name; it listens to its own topic joint_trajectory.
            rate: of the commands [1/s].
            states: topic of the sensor_msgs/JointState.
            wrench: topic of a geometry_msgs/WrenchStamped of what the world exerts on the hand; empty: no force is
                known.
            clock, sleep: [s]; the clock that readings are told on.

        Raises:
            InputError: a rate, topic or name is not possible.
            DeviceError: it is not heard, has other joints, or its controller does not listen.
        """
        check_range("rate", rate, 50, 250, "commands a second")
        if len(set(names)) != len(names):
            raise bad_input("joints", given=", ".join(names), allowed="every name once", do="Correct it.")
        self._acceleration = check_array("joint acceleration", acceleration, (len(names),))
        super().__init__(names, rate=rate, stale=STALE, silence=AHEAD, clock=clock, sleep=sleep)
        self.node, self._controller, self._wrench = node, controller.rstrip("/"), wrench
        self._topic = f"{self._controller}/joint_trajectory"
        self._plan = still(np.zeros(len(names)), 0.0)
        node.subscribe(states, "sensor_msgs/msg/JointState", self.readings.receive)
        if wrench:
            node.subscribe(wrench, "geometry_msgs/msg/WrenchStamped", self._on_wrench)
        self._commands = node.publisher(self._topic, TRAJECTORY)
        self._wait_for(lambda: self.readings.last is not None, f"does not tell its joints on {states}")
        self._wait_for(self._listens, f"has nobody who listens to {self._topic}")
        if wrench:
            self._wait_for(lambda: self._feels(clock()), f"tells no force on {wrench}")
        self._message(still(np.zeros(len(names)), 0.0))  # slow at first

    def cannot(self) -> str:
        """Return why the arm cannot be moved now; empty if it can. ROS 2 has no common topic for stops or errors."""
        if not self._listens():
            return f"nobody listens to {self._topic}: is the controller still active?"
        if self._wrench and not self._feels(self._clock()):
            return f"the force on {self._wrench} is {2e3 * self._stale:.0f} ms old, or no number: is the sensor on?"
        return ""

    def describe(self) -> list[str]:
        """Return in words what is heard of the robot."""
        why, others = self.cannot(), self.node.publishers(self._topic) - 1
        force = (
            f"force {self._current_force(self._clock()):.1f} N"
            if self._wrench
            else "no force is told: contact is not felt"
        )
        said = [self._describe_readings(), f"commands: {1 / self._period:g} a second to {self._topic}; {force}"]
        if others > 0:
            said.append(f"{others} others can command it too: end them")
        return [*said, f"cannot move: {why}" if why else "ready to move, as far as ROS 2 tells"]

    def close(self) -> None:
        """End the node."""
        self.node.close()

    def _aim(self, reference: Reference, t: float) -> None:
        self._say(plan(reference, t, self._acceleration))

    def _brake(self, q: Array, rate: Array) -> Array:
        way = brake(q, rate, self._acceleration)
        self._say(way)
        self._sleep(float(way.times[-1]))
        return way.q[-1]

    def _rest(self, q: Array) -> None:
        self._commands.publish(self._message(still(q, 0.0)))
        self._rests(q)

    def _stay(self, q: Array) -> None:
        here = find_rest_joints(self.readings, self._clock() - self._stale)
        if here is not None and np.abs(here - q).max() > NEAR:  # it met something: it shall not press on
            q = here
        self._commands.publish(self._message(still(q, 0.5)))
        self._rests(q)

    def _refuses_commands(self) -> bool:
        return not self._listens()

    def _extrapolate(self, last: LastCommand, now: float) -> LastCommand:
        return LastCommand(now, *self._plan.at(now - last.time))

    def _say(self, plan: Plan) -> None:
        message = self._message(plan)
        self._send(lambda: self._commands.publish(message), plan.q[0], plan.rate[0])
        self._plan = plan

    def _message(self, plan: Plan) -> Any:
        points = [
            self.node.make(
                POINT,
                positions=array("d", q),
                velocities=array("d", rate),
                accelerations=array("d", acceleration),
                time_from_start=self._duration(t),
            )
            for t, q, rate, acceleration in zip(*plan, strict=True)
        ]
        return self.node.make(TRAJECTORY, joint_names=list(self._names), points=points)  # no stamp: begin now

    def _duration(self, t: float) -> Any:
        seconds, rest = divmod(round(t * 1e9), 10**9)
        return self.node.make("builtin_interfaces/msg/Duration", sec=seconds, nanosec=rest)

    def _listens(self) -> bool:
        return self._commands.get_subscription_count() > 0

    def _on_wrench(self, message: Any) -> None:
        force = message.wrench.force
        self._take_force(force.x, force.y, force.z)

    def _feels(self, now: float) -> bool:
        return bool(np.isfinite(self._current_force(now)))

    def _wait_for(self, done: Callable[[], bool], what: str) -> None:
        try:
            self._wait(done, what)
        except DeviceError as error:
            others = self.readings.others
            listed = f" It tells other joints: {', '.join(others)}; wanted: {', '.join(self._names)}." if others else ""
            raise DeviceError(f"{error}{listed}") from error


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtra(f"ROS 2: {name.partition('.')[0]} is not there ({error}). {INSTALL}.") from error


def _kind(name: str) -> Any:
    """Return the class of a message or service, such as "sensor_msgs/msg/JointState"."""
    package, group, kind = name.split("/")
    return getattr(_module(f"{package}.{group}"), kind)
