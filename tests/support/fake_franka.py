"""A Franka arm without one: what pylibfranka says and does, over a small simulation that keeps the time.

Its time goes by cycles of a millisecond, slower than the wall's: it waits a while for the answer to each state.
It is no kinder than the robot: a command that breaks the FR3's limits, or 20 that are missing, end in a reflex.
"""

from __future__ import annotations

import enum
import random
import threading
import time
from multiprocessing import Pipe
from types import SimpleNamespace
from typing import Any

import numpy as np
from logged_arm import LoggedArm
from slow_clock import SLOWER
from small_planner import SmallPlanner

from anther.core.geometry import Array
from anther.robot.arm.arms import find_arm
from anther.robot.arm.model import ArmModel
from anther.robot.devices import Arm, JointTrajectory
from anther.robot.drivers._franka_loop import CYCLE, Loop
from anther.robot.drivers.franka import Franka

READY = (0.3, -0.5, 0.1, -1.9, 0.2, 1.6, 0.7)
ACCELERATION, JERK, LOST = 10.0, 5000.0, 20  # FR3: Franka's robot specifications, network requirements
PATIENCE = 0.5  # s of the wall's clock in which a state is to be answered
CLOCK = 57.7  # s by which the robot's clock is behind


def model() -> ArmModel:
    """Return the arm; what reads it the first time takes a second."""
    return find_arm("fr3")


class FrankaException(Exception):
    pass


class ControlException(RuntimeError):
    pass


class CommandException(RuntimeError):
    pass


class NetworkException(RuntimeError):
    pass


class RealtimeException(RuntimeError):
    pass


class InvalidOperationException(RuntimeError):
    pass


class RobotMode(enum.Enum):
    Other, Idle, Move, Guiding, Reflex, UserStopped, AutomaticErrorRecovery = range(7)


class RealtimeConfig(enum.Enum):
    kEnforce, kIgnore = range(2)


class ControllerMode(enum.Enum):
    JointImpedance, CartesianImpedance = range(2)


class Errors:
    communication_constraints_violation = joint_reflex = False
    joint_motion_generator_acceleration_discontinuity = joint_motion_generator_velocity_discontinuity = False
    joint_motion_generator_velocity_limits_violation = False


class JointPositions:
    def __init__(self, q: list[float]) -> None:
        assert len(q) == 7
        self.q, self.motion_finished = q, False


class Duration:
    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def to_sec(self) -> float:
        return self._seconds


class FakeFranka(LoggedArm):
    """Attributes: `q`, `aim` where it is and is commanded; `log` of (time, aim) of every cycle; `sag` between the two;
    the rest is set by tests: `mute` says nothing, `lag` [s], `dead` hears nothing, `force` [N]."""

    slowest = 5e-3

    def __init__(self) -> None:
        model()  # before the robot's clock runs
        self.now, self.mode, self.force, self.sag, self.lag = 100.0, RobotMode.Idle, 1.0, 1e-3, 0.0
        self.aim, self.v, self.a = np.array(READY), np.zeros(7), np.zeros(7)
        self.log, self.calls, self.recovered = list[tuple[float, Array]](), list[str](), True
        self.mute = self.dead = False
        self.current, self.last = Errors(), Errors()
        self.missing, self.cycle = 0, 0
        self.command: JointPositions | None = None
        self.offset = np.zeros(7)
        self.news = threading.Condition()
        self._over = False
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    @property
    def q(self) -> Array:
        return self.aim - self.sag + self.offset

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        until = self.now + seconds
        while self.now < until and self.thread.is_alive():
            time.sleep(1e-3)

    def close(self) -> None:
        self._over = True
        self.thread.join()

    def stand(self, error: str, mode: RobotMode) -> None:
        """Be in a mode at rest; return once it has been told."""
        self.reflex(error, mode)
        self.sleep(0.01)

    def reflex(self, error: str, mode: RobotMode = RobotMode.Reflex) -> None:
        self.mode, self.command = mode, None
        self.current, self.last = Errors(), Errors()
        if error:
            setattr(self.current, error, True)
            setattr(self.last, error, True)

    def state(self) -> Any:
        return SimpleNamespace(
            time=Duration(self.now - self.lag - CLOCK), q=self.q.tolist(), q_d=self.aim.tolist(), robot_mode=self.mode,
            O_F_ext_hat_K=[0.0, 0.0, self.force + 1e-7 * random.random(), 9.0, 9.0, 9.0],
            control_command_success_rate=1.0,
            current_errors=self.current, last_motion_errors=self.last,
        )  # fmt: skip

    def _run(self) -> None:
        due = time.monotonic()
        while not self._over:
            due = max(due + SLOWER * CYCLE, time.monotonic() - 0.1)
            time.sleep(max(due - time.monotonic(), 0))
            with self.news:
                if self.mode is RobotMode.Move and self.cycle > 1 and not self.dead and not self.mute:
                    self.news.wait_for(lambda: self.command is not None or self._over, PATIENCE)
                self._step()
                self.now += CYCLE
                self.cycle += 1
                self.log.append((self.now, self.aim.copy()))
                self.news.notify_all()

    def _step(self) -> None:
        before = self.aim
        if self.mode is not RobotMode.Move:
            self.v = self.v - np.clip(self.v, -ACCELERATION * CYCLE, ACCELERATION * CYCLE)
            self.aim, self.a = before + self.v * CYCLE, np.zeros(7)
            return
        command, self.command = self.command, None
        if command is None and self.cycle > 1:
            self.missing += 1
            if self.missing >= LOST:
                self.reflex("communication_constraints_violation")
        elif command is not None:
            self.missing = 0
            self._check(np.array(command.q))
            if command.motion_finished and self.mode is RobotMode.Move:
                self.mode = RobotMode.Idle
            return
        self.v = self.v + self.a * CYCLE
        self.aim = before + self.v * CYCLE

    def _check(self, q: Array) -> None:
        v = (q - self.aim) / CYCLE
        a = (v - self.v) / CYCLE
        jerk = (a - self.a) / CYCLE
        if np.any(np.abs(v) > model().velocity):
            self.reflex("joint_motion_generator_velocity_limits_violation")
        elif np.abs(a).max() > ACCELERATION:
            self.reflex("joint_motion_generator_velocity_discontinuity")
        elif np.abs(jerk).max() > JERK:
            self.reflex("joint_motion_generator_acceleration_discontinuity")
        else:
            self.aim, self.v, self.a = q, v, a


class Robot:
    fake: FakeFranka

    def __init__(self, robot_ip_address: str, realtime_config: RealtimeConfig = RealtimeConfig.kEnforce) -> None:
        self._seen = -1

    def read_once(self) -> Any:
        with self.fake.news:
            if not self.fake.news.wait_for(lambda: self.fake.cycle > self._seen and not self.fake.mute, 2.0):
                raise NetworkException("libfranka: UDP receive: Timeout")
            self._seen = self.fake.cycle
            return self.fake.state()

    def start_joint_position_control(self, controller_mode: ControllerMode) -> ActiveControlBase:
        fake = self.fake
        with fake.news:
            if fake.mode is not RobotMode.Idle:
                raise CommandException("libfranka: Move command rejected: command not possible in the current mode!")
            fake.mode, fake.missing, fake.command, fake.cycle = RobotMode.Move, 0, None, 0
            self._seen = -1  # of a count that begins anew
            fake.v = fake.a = np.zeros(7)
            fake.calls.append("start")
        return ActiveControlBase(fake)

    def automatic_error_recovery(self) -> None:
        self.fake.calls.append("recover")
        if not self.fake.recovered:
            raise CommandException("libfranka: Automatic error recovery command aborted: manual recovery required!")
        if self.fake.mode is RobotMode.Reflex:
            self.fake.mode, self.fake.current = RobotMode.Idle, Errors()


class ActiveControlBase:
    def __init__(self, fake: FakeFranka) -> None:
        self._fake, self._seen, self._first = fake, 0, True

    def readOnce(self) -> tuple[Any, Duration]:
        fake = self._fake
        with fake.news:
            if not fake.news.wait_for(lambda: fake.cycle > self._seen and not fake.mute and not fake.dead, 3.0):
                raise NetworkException("libfranka: UDP receive: Timeout")
            self._check(RobotMode.Move)
            passed, self._first = 0 if self._first else fake.cycle - self._seen, False
            self._seen = fake.cycle
            return fake.state(), Duration(CYCLE * passed)

    def writeOnce(self, command: JointPositions) -> None:
        with self._fake.news:
            self._check(RobotMode.Move)
            self._fake.command = command
            self._fake.news.notify_all()
            if command.motion_finished:  # libfranka returns when the robot has ended the motion
                self._fake.news.wait_for(lambda: self._fake.mode is not RobotMode.Move, 3.0)
                self._check(RobotMode.Idle)

    def _check(self, wanted: RobotMode) -> None:
        if self._fake.mode is not wanted:
            raise ControlException("libfranka: Move command aborted: motion aborted by reflex!")


def library(fake: FakeFranka) -> Any:
    """Return the module pylibfranka with this arm behind it."""
    robot = type("Robot", (Robot,), {"fake": fake})
    kinds = (Errors, JointPositions, RealtimeConfig, ControllerMode, RobotMode, FrankaException, RealtimeException)
    return SimpleNamespace(Robot=robot, **{kind.__name__: kind for kind in kinds})


def connected(fake: FakeFranka, **options: Any) -> Franka:
    """Return the driver, and its loop in a thread."""
    here, there = Pipe()
    sdk = library(fake)
    loop = Loop(there, sdk, sdk.Robot("fake"), model().acceleration, fake.clock)
    thread = threading.Thread(target=loop.serve, daemon=True)
    thread.start()
    given = {"names": model().joints, "clock": fake.clock, "sleep": fake.sleep, **options}
    return Franka(here, gone=lambda: thread.join(5), **given)


def far(arm: Arm, way: float = 0.3) -> JointTrajectory:
    return SmallPlanner(model()).move(arm.joints(), arm.joints() + way * np.array([1, 1, 1, 1, 1, 1, 1]))
