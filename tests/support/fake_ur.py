"""A Universal Robots controller without one: what ur_rtde's three objects say and do, over a small simulation.

Its servo is no better than the robot may be: while commands come it is drawn to their target; unheard it does not stop
there, but goes on as fast as it went until the watchdog ends the program. Then, and in every stop, it brakes with
`acceleration`. A watchdog that acts leaves a protective stop, and is armed as long as its program lives.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from logged_arm import LoggedArm
from small_planner import SmallPlanner

from anther.core.geometry import Array
from anther.robot.arm.arms import find_arm
from anther.robot.arm.model import ArmModel
from anther.robot.devices import Arm, JointTrajectory
from anther.robot.drivers._streamed import prioritize_thread
from anther.robot.drivers.ur_controller import Controller
from anther.robot.drivers.ur_rtde import UniversalRobot

CLOCK = 3.7  # s by which the controller's clock is ahead
FOLLOWS = 0.02  # s, the servo's time constant
GAP = 0.012  # s without a command after which the servo goes on by itself
READY = (0.36, -1.08, 2.62, -1.54, 1.94, 1.57)


def model() -> ArmModel:
    """Return the arm; what reads it the first time takes a second."""
    return find_arm("ur5e")


class FakeUR(LoggedArm):
    """Attributes: `q` where it is, `log` of (time, joints), `heard` of (time, target) of servoJ [s] on its `clock`,
    `calls` of names by every object, `programs` started; the rest is set by tests, such as whether a
    protective stop `pauses` a program, or ends it."""

    slowest = 5e-3

    def __init__(
        self,
        *,
        rate: float = 500.0,
        acceleration: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        model()  # before the controller's clock runs
        self.clock, self.sleep, self.rate, self.acceleration = clock, sleep, rate, acceleration
        self.q, self.v = np.array(READY), np.zeros(6)
        self.version, self.model, self.remote, self.mode = "5.11.1.108318", "UR5", True, 7
        self.pressed = self.protective = self.paused = self.mute = self.dead = self.unlockable = self.pauses = False
        self.safeguard, self.connected, self.slider, self.scaling, self.force = False, True, 1.0, 1.0, 1.0
        self.ahead, self.offset = CLOCK, np.zeros(6)
        self.log, self.heard, self.calls = list[tuple[float, Array]](), list[tuple[float, Array]](), list[str]()
        self.program: FakeControl | None = None
        self.programs = 0
        self._over = False
        self._tell(self.clock())
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def start(self) -> FakeControl:
        local = not self.remote and not self.version.startswith("3")
        if self.mode != 7 or self.protective or self.pressed or local:
            raise RuntimeError("ur_rtde: Failed to start control script, before timeout of 5 seconds")
        self.programs += 1
        self.program = FakeControl(self)
        return self.program

    def close(self) -> None:
        self._over = True
        self._thread.join()

    def said(self) -> tuple[float, Array]:
        return self._said

    def _run(self) -> None:
        with prioritize_thread():  # a controller is not busy with tests
            before = due = self.clock()
            while not self._over:
                due += 1 / self.rate
                self.sleep(max(due - self.clock(), 0))
                now = self.clock()
                self._move(now, max(now - before, 1e-6))
                before = now
                self.log.append((now, self.q.copy()))
                self._tell(now)

    def _move(self, now: float, dt: float) -> None:
        if self.pressed:
            self.mode = 3
        if self.pressed or self.mode != 7 or (self.protective and not self.pauses):
            self.program = None
        self.paused = self.paused or (self.protective and self.program is not None)
        program = self.program
        if program is not None and program.watchdog and now - program.heard > 1 / program.watchdog:
            self.program, self.protective = program if self.pauses else None, True
        runs = program is not None and program is self.program and not (self.paused or self.protective)
        target = program.target if program is not None and runs else None
        if target is None or program is None:
            self.v = self.v - np.clip(self.v, -self.acceleration * dt, self.acceleration * dt)
        elif now - program.told <= GAP:
            self.v = self.scaling * (target - self.q) / max(FOLLOWS, dt)
        self.q = self.q + self.v * dt

    def _tell(self, now: float) -> None:
        if not self.mute:
            self._said = now + self.ahead, self.q + self.offset

    def note(self, name: str) -> None:
        self.calls.append(name)
        while self.dead:
            time.sleep(0.05)


class FakeControl:
    """An RTDEControlInterface and its program."""

    def __init__(self, ur: FakeUR) -> None:
        self._ur, self._open = ur, True
        self.target: Array | None = None
        self.watchdog, self.heard, self.told = 0.0, ur.clock(), ur.clock()

    def setWatchdog(self, min_frequency: float = 10.0) -> bool:
        self.watchdog = min_frequency
        return self._hear("setWatchdog")

    def kickWatchdog(self) -> bool:
        return self._hear("kickWatchdog")

    def servoJ(
        self, q: list[float], speed: float, acceleration: float, time: float, lookahead_time: float, gain: float
    ) -> bool:
        servo = 0.03 <= lookahead_time <= 0.2 and 100 <= gain <= 2000
        if not (servo and 0 <= speed <= 3.14 and 0 <= acceleration <= 40):
            raise ValueError("The value is not within its range")
        if not self._hear("servoJ"):
            return False
        self.told, self.target = self._ur.clock(), np.array(q)
        self._ur.heard.append((self.told, self.target))
        return True

    def servoStop(self, a: float = 10.0) -> bool:
        self.target = None
        return self._hear("servoStop")

    def stopScript(self) -> None:
        self._hear("stopScript")
        if self._ur.program is self:
            self._ur.program = None

    def isConnected(self) -> bool:
        return self._open and self._ur.connected

    def disconnect(self) -> None:
        self._open = False

    def _hear(self, name: str) -> bool:
        self._ur.note(name)
        self.heard = self._ur.clock()
        return self._ur.program is self


class FakeReceive:
    """An RTDEReceiveInterface."""

    def __init__(self, ur: FakeUR) -> None:
        self._ur = ur

    def getTimestamp(self) -> float:
        return self._ur.said()[0]

    def getActualQ(self) -> list[float]:
        return self._ur.said()[1].tolist()

    def getActualTCPForce(self) -> list[float]:
        return [0.0, 0.0, self._ur.force + 1e-7 * random.random(), 9.0, 9.0, 9.0]  # no sensor stands

    def getSafetyMode(self) -> int:
        return 7 if self._ur.pressed else 3 if self._ur.protective else 5 if self._ur.safeguard else 1

    def getRobotMode(self) -> int:
        return self._ur.mode

    def getRuntimeState(self) -> int:
        return 1 if self._ur.program is None else 4 if self._ur.paused else 2

    def getTargetSpeedFraction(self) -> float:
        return self._ur.slider

    def getSpeedScaling(self) -> float:
        return self._ur.scaling

    def isEmergencyStopped(self) -> bool:
        return self._ur.pressed

    def isProtectiveStopped(self) -> bool:
        return self._ur.protective

    def isConnected(self) -> bool:
        return self._ur.connected

    def disconnect(self) -> None:
        self._ur.calls.append("disconnect")


class FakeDashboard:
    """A DashboardClient."""

    def __init__(self, ur: FakeUR) -> None:
        self._ur, self._open = ur, False

    def connect(self, timeout_ms: int = 2000) -> None:
        self._open = True

    def disconnect(self) -> None:
        self._open = False

    def polyscopeVersion(self) -> str:
        return self._asked("polyscopeVersion", self._ur.version)

    def getRobotModel(self) -> str:
        return self._asked("getRobotModel", self._ur.model + "\n")

    def isInRemoteControl(self) -> bool:
        return self._asked("isInRemoteControl", self._ur.remote)

    def stop(self) -> None:
        self._asked("stop", None)
        self._ur.program, self._ur.paused = None, False

    def closeSafetyPopup(self) -> None:
        self._asked("closeSafetyPopup", None)

    def unlockProtectiveStop(self) -> None:
        self._asked("unlockProtectiveStop", None)
        if not self._ur.unlockable:
            raise RuntimeError("Unlock protective stop failure: Cannot unlock until 5s after occurrence")
        self._ur.protective = False

    def powerOn(self) -> None:
        self._asked("powerOn", None)
        self._ur.mode = 5

    def brakeRelease(self) -> None:
        self._asked("brakeRelease", None)
        self._ur.mode = 7 if self._ur.mode == 5 else self._ur.mode

    def powerOff(self) -> None:
        self._asked("powerOff", None)
        self._ur.mode = 3

    def _asked(self, name: str, answer: Any) -> Any:
        if not self._open:
            raise RuntimeError("not connected")
        self._ur.calls.append(name)
        return answer


def connected(ur: FakeUR, **options: Any) -> UniversalRobot:
    given: dict[str, Any] = {"names": model().joints, "acceleration": model().acceleration, "model": "ur5e", **options}
    make = lambda: Controller(FakeReceive(ur), FakeDashboard(ur), ur.start, clock=ur.clock)  # noqa: E731
    return UniversalRobot(make, clock=ur.clock, sleep=ur.sleep, **given)


def far(arm: Arm, way: float = 0.3) -> JointTrajectory:
    return SmallPlanner(model()).move(arm.joints(), arm.joints() + way)
