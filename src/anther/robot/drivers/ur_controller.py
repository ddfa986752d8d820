"""The controller of a Universal Robots arm through ur_rtde: what it measures, why it would not move, its dashboard.

Sources: docstrings of ur_rtde 1.6.5; UR's RTDE guide (modes and states).
"""

from __future__ import annotations

import importlib
import re
import time
from collections.abc import Callable
from contextlib import suppress
from enum import IntEnum
from typing import Any

import numpy as np

from anther.core.errors import MissingExtra
from anther.robot.devices import DeviceError
from anther.robot.drivers._readings import Reading, RobotClock, check_finite_joints, check_fresh

SAFETY = ("?", "normal", "reduced", "protective stop", "recovery", "safeguard stop", "system emergency stop",
          "robot emergency stop", "violation", "fault")  # fmt: skip
MODES = ("disconnected", "confirm safety", "booting", "power off", "power on", "idle", "backdrive", "running",
         "updating firmware")  # fmt: skip
REMOTE = "it is not in remote control: switch it from Local to Remote on the pendant, at the top right"


class Mode(IntEnum):
    """Places in `MODES`."""

    POWER_OFF, IDLE, RUNNING = 3, 5, 7


class Program(IntEnum):
    """Runtime states of a program; PAUSING and more: it is held up, and may go on."""

    STOPPED, PLAYING, PAUSING = 1, 2, 3


class Controller:
    """A controller that is heard.

    Attributes:
        receive: an RTDEReceiveInterface.
        program: starts a program on the controller and returns its RTDEControlInterface.
        version: PolyScope's, major and minor.
        model: such as "UR5"; the series is not in it.
    """

    def __init__(
        self,
        receive: Any,
        dashboard: Any,
        program: Callable[[], Any],
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Wait until it is heard.

        Args:
            receive: an RTDEReceiveInterface.
            dashboard: a DashboardClient, not connected.
            program: see the class.
            clock: that readings are told on [s].

        Raises:
            DeviceError: it is not heard, or its dashboard server does not answer.
        """
        self.receive, self.program, self._dashboard, self._clock = receive, program, dashboard, clock
        self._robot, self._stamp = RobotClock(), float("nan")
        try:
            self.wait(self._responds, "is not heard")
            said = re.search(r"(\d+)\.(\d+)", str(self.ask("polyscopeVersion")))
            self.version: tuple[int, int] = (int(said[1]), int(said[2])) if said else (5, 0)
            self.model = str(self.ask("getRobotModel")).strip()
        except BaseException:
            receive.disconnect()
            raise

    @property
    def rate(self) -> float:
        """Commands that it takes a second: a CB3 (PolyScope 3) 125, later ones 500."""
        return 125.0 if self.version[0] <= 3 else 500.0

    def read(self) -> tuple[Reading, list[float]]:
        """Return what was measured last, joints (J,) and force on the hand (x, y, z) [N]; set the clocks by it."""
        stamp, joints, force = self._state()
        check_fresh(self._set_clocks(stamp) - stamp - self._robot.offset)
        return Reading(stamp + self._robot.offset, check_finite_joints(np.array(joints, dtype=float))), force[:3]

    def why_stopped(self) -> str:
        """Return what keeps the arm from moving at all; empty if nothing does."""
        says = self.receive
        safety, mode = says.getSafetyMode(), says.getRobotMode()
        status = SAFETY[safety] if 0 <= safety < len(SAFETY) else f"safety mode {safety}"
        power = MODES[mode] if 0 <= mode < len(MODES) else f"robot mode {mode}"
        reasons = {
            "the connection is lost: check network and controller, then start anew": not says.isConnected(),
            "its emergency stop is pressed: look why, release it, then anther cell enable": says.isEmergencyStopped(),
            "it made a protective stop: look what it touched, then anther cell enable": says.isProtectiveStopped(),
            f"its safety system says {status}: look at its pendant": status not in ("normal", "reduced"),
            f"its motors are not on ({power}): anther cell enable does that": mode != Mode.RUNNING,
        }
        return next((why for why, holds in reasons.items() if holds), "")

    def why_slow(self) -> str:
        """Return why a running program moves the arm more slowly than it is told; empty if it does not."""
        slider, scaling = self.receive.getTargetSpeedFraction(), self.receive.getSpeedScaling()
        full = 0.99  # speed slider and speed scaling below this are slower than what was planned
        if slider < full:
            return f"its speed slider stands at {slider:.0%}; plans need 100 %: set it on the pendant"
        if scaling < full:
            return f"it goes at {scaling:.0%} of the speed it is told; plans need 100 %: look at its pendant"
        return ""

    def why_not_remote(self) -> str:
        """Return what to do if commands are not taken from outside; PolyScope tells it since 5.6."""
        return REMOTE if self.version >= (5, 6) and not self.ask("isInRemoteControl") else ""

    def enable(self) -> None:
        """Release a protective stop, switch the motors on, release the brakes.

        A program that was held up is stopped first, so that nothing goes on by itself.
        """
        says = self.receive
        if says.isEmergencyStopped():
            raise DeviceError("the emergency stop is pressed. Look why; turn it until it comes out; then enable again.")
        if why := self.why_not_remote():
            raise DeviceError(f"the arm cannot be enabled: {why}.")
        if says.getRuntimeState() != Program.STOPPED:
            self.ask("stop")
            self.wait(lambda: says.getRuntimeState() == Program.STOPPED, "does not stop its program")
        if says.isProtectiveStopped():
            self.ask("closeSafetyPopup")
            self.ask("unlockProtectiveStop")
            self.wait(lambda: not says.isProtectiveStopped(), "stays in its protective stop")
        if says.getRobotMode() != Mode.RUNNING:
            self.ask("powerOn")
            self.wait(lambda: says.getRobotMode() in (Mode.IDLE, Mode.RUNNING), "does not switch its motors on", 60.0)
            self.ask("brakeRelease")
            self.wait(lambda: says.getRobotMode() == Mode.RUNNING, "does not release its brakes", 60.0)

    def disable(self) -> None:
        """Switch the motors off: the brakes hold the arm."""
        self.ask("powerOff")
        self.wait(lambda: self.receive.getRobotMode() <= Mode.POWER_OFF, "does not switch its motors off")

    def ask(self, name: str) -> Any:
        """Return what the dashboard server answers. It is connected each time: an idle line may be dropped."""
        try:
            self._dashboard.connect()
            return getattr(self._dashboard, name)()
        except RuntimeError as error:
            raise DeviceError(f"the controller's dashboard server refuses {name}: {error}") from error
        finally:
            self._dashboard.disconnect()

    def wait(self, done: Callable[[], bool], what: str, seconds: float = 5.0) -> None:
        """Wait until something is so."""
        until = time.monotonic() + seconds
        while not done():
            if time.monotonic() > until:
                raise DeviceError(f"the controller {what} within {seconds:g} s. Look at its pendant.")
            time.sleep(0.01)

    def _state(self) -> tuple[float, list[float], list[float]]:
        says = self.receive
        for _ in range(3):  # the library takes in states between two calls; all is to be of one
            state = says.getTimestamp(), says.getActualQ(), says.getActualTCPForce()
            if says.getTimestamp() == state[0]:
                return state
        return says.getTimestamp(), says.getActualQ(), says.getActualTCPForce()

    def _set_clocks(self, stamp: float) -> float:
        """Return the time on this machine's clock [s]; a new stamp sets the controller's behind it."""
        now, before, self._stamp = self._clock(), self._stamp, stamp
        if stamp != before and not np.isnan(before):  # the first stamp that is found may be old
            self._robot.receive(stamp, now)
        return now

    def _responds(self) -> bool:
        with suppress(RuntimeError):
            self._set_clocks(self.receive.getTimestamp())
        return not np.isnan(self._robot.offset)


def open_controller(host: str) -> Controller:
    """Return the controller at an address.

    Raises:
        MissingExtra: ur_rtde is not installed.
        DeviceError: it does not answer.
    """
    try:
        control, receive, dashboard = (
            importlib.import_module(name) for name in ("rtde_control", "rtde_receive", "dashboard_client")
        )
    except ImportError as error:
        raise MissingExtra(f"arm: no ur_rtde ({error}). Install it with: pip install 'anther[ur]'.") from error
    try:
        hears = receive.RTDEReceiveInterface(host)
    except RuntimeError as error:
        do = "Check the address, the cable, and that the controller is on."
        raise DeviceError(f"no Universal Robots controller answers at {host}: {error}. {do}") from error
    return Controller(hears, dashboard.DashboardClient(host), lambda: control.RTDEControlInterface(host))
