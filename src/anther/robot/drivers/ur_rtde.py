"""A Universal Robots arm through ur_rtde, as a `devices.Arm`. It has met no controller (docs/real_robot.md).

Sources: docstrings of ur_rtde 1.6.5; UR's script manual (servoj, rtde_set_watchdog).

Each motion has a program of its own on the controller: a watchdog, once set, ends only with its program. The next
program is started when a motion has ended, so that no motion waits for it; it waits without a watchdog, and at rest.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from anther.core.checks import check_range
from anther.core.geometry import Array
from anther.robot.devices import ArmRecord, DeviceError, JointTrajectory, More, Watch
from anther.robot.drivers._holding import NEAR
from anther.robot.drivers._readings import STALE, Reading
from anther.robot.drivers._streamed import Reference, StreamedArm, braking
from anther.robot.drivers.ur_controller import Controller, Program

ENDED = "Anther's program on it was stopped, on the pendant or by the watchdog: look why, then start anew"
PAUSED = "its program was paused on the pendant: stop it there, then start anew"


class UniversalRobot(StreamedArm):
    """An arm streamed to by servoJ. It must have been enabled, see `enable`."""

    watchdog = 20.0
    """The controller ends the program when commands come less often than this [1/s]: after 50 ms, so that a driver that
    lives brakes first."""

    def __init__(
        self,
        connect: Callable[[], Controller],
        *,
        names: Sequence[str],
        acceleration: Array,
        model: str = "",
        rate: float | None = None,
        lookahead: float = 0.03,
        gain: float = 2000.0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Connect, and start a program where the arm can be moved. Nothing moves.

        Args:
            connect: returns the controller.
            names: (J,) of the joints, from the base.
            acceleration: (J,) with which it brakes [rad/s^2].
            model: such as "ur5e"; one that does not begin with "ur" is not checked.
            rate: of the commands [1/s]; None: the controller's own.
            lookahead: with which servoJ smooths [s]; UR allows 0.03 to 0.2. UR's ROS driver has this default and that
                of the gain: they follow best.
            gain: of servoJ towards its target; UR allows 100 to 2000.
            clock, sleep: [s]; the controller's readings are told on the same clock.

        Raises:
            InputError: a value is out of its range.
            DeviceError: it is not heard, is another arm, or does not run a program.
        """
        check_range("rate", 500 if rate is None else rate, 100, 500, "commands a second")
        check_range("lookahead", lookahead, 0.03, 0.2, "s")
        check_range("gain", gain, 100, 2000)
        self._acceleration = acceleration
        self._lookahead, self._gain = lookahead, gain
        self._control: Any = None
        self._last_command = None
        self._at = connect()
        try:
            self._check_model(model)
            if rate is not None and rate > self._at.rate:
                given = f"rate: got {rate:g} commands a second; allowed: <= {self._at.rate:g}"
                raise DeviceError(f"{given}. This controller is a CB3: leave rate out.")
            commands = rate or self._at.rate
            super().__init__(
                names,
                rate=commands,
                stale=STALE,
                silence=0.03,  # it brakes when it could not give a command for so long [s]
                clock=clock,
                sleep=sleep,
                shown=0.008 - 0.5 / commands,  # 125 readings a second, whatever the controller's rate
                timeout=1 / self.watchdog,
            )
            self.joints()
            self._renew()
        except BaseException:
            self.close()
            raise

    def joints(self) -> Array:
        """Return the measured joint angles (J,) [rad]; refuse stale ones, another count, and what is no numbers."""
        return self._read().joints

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow a trajectory as `anther.robot.devices.Arm` says; commands go on while `more` is thought about."""
        record = super().follow(trajectory, watch, more)
        self._renew()
        return record

    def check_able(self) -> None:
        """Take the newest reading, and check that nothing stops or slows the arm."""
        self._read()
        if why := ENDED if self._control is None else self._why_halted() or self._at.why_slow():
            raise DeviceError(f"the arm was stopped: {why}.")

    def hold(self) -> None:
        """Brake if it moves, and end the program; the controller then holds the arm. At rest nothing is to be done."""
        if self._last_command is None:
            return
        try:
            with suppress(DeviceError):  # what went wrong first is what is reported
                super().hold()
        finally:
            self._end()
        with suppress(DeviceError):
            self._renew()

    def cannot(self) -> str:
        """Return why the arm cannot be moved now; empty if it can."""
        running = self._control is not None
        return (
            self._at.why_stopped()
            or self._at.why_not_remote()
            or (self._why_halted() or self._at.why_slow() if running else "")
        )

    def describe(self) -> list[str]:
        """Return in words what is heard of the controller."""
        reading, force = self._read(), self._current_force(self._clock())
        why, version = self.cannot(), self._at.version
        return [
            f"{self._at.model}, PolyScope {version[0]}.{version[1]}; the newest joints are "
            f"{1e3 * (self._clock() - reading.time):.0f} ms old",
            f"commands: {1 / self._period:g} a second, lookahead {self._lookahead:g} s, gain {self._gain:g}; "
            f"force {force:.1f} N",
            f"cannot move: {why}" if why else "ready to move",
        ]

    def enable(self) -> None:
        """Release a protective stop, switch the motors on, release the brakes. The arm holds where it is."""
        self._forget()
        self._at.enable()
        self._renew()

    def disable(self) -> None:
        """Switch the motors off: the brakes hold the arm."""
        self._forget()
        self._at.disable()

    def close(self) -> None:
        """End the program and the connections; a moving arm is braked."""
        try:
            self.hold()
        finally:
            self._forget()
            self._at.receive.disconnect()

    def _read(self) -> Reading:
        reading, force = self._at.read()
        if len(reading.joints) != len(self._names):
            given = f"joints: the robot has {len(reading.joints)}; allowed: {len(self._names)}, the arm model's"
            raise DeviceError(f"{given}. Name the robot's model under [arm].")
        self.readings.take(reading)
        self._take_force(*force)
        return reading

    def _begin(self, trajectory: JointTrajectory) -> None:
        """Check that a motion may begin, and set its program's watchdog."""
        if self._control is None:
            self._renew()
        why = self.cannot()
        if why or self._control is None:
            raise DeviceError(f"the arm cannot move: {why or ENDED}.")
        start, here = trajectory.positions[0], self.joints()
        far = float(np.abs(start - here).max()) if start.shape == here.shape else float("inf")
        if far > NEAR:  # servoJ has no speed limit of its own
            raise DeviceError(f"the motion begins {far:.3g} rad from where the arm is; allowed: {NEAR:g}. Plan anew.")
        self._rests(here)  # from here on `hold` has a watchdog to end
        if not self._control.setWatchdog(self.watchdog):
            raise DeviceError("the controller does not set its watchdog. Look at its pendant.")

    def _aim(self, reference: Reference, t: float) -> None:
        self._command(*reference.at(t)[:2])

    def _rest(self, q: Array) -> None:
        self._end()

    def _command(self, q: Array, rate: Array) -> None:
        """Tell joints (J,), which move at rates (J,)."""
        self._send(lambda: self._servo(q), q, rate)

    def _servo(self, q: Array) -> None:
        self._control.kickWatchdog()  # before servoJ: of two messages in one cycle the controller takes the later
        # servoJ takes a speed and an acceleration, here 0.5, and uses neither
        if not self._control.servoJ(q.tolist(), 0.5, 0.5, self._period, self._lookahead, self._gain):
            raise DeviceError(f"the arm was stopped: {self._why_halted() or 'the controller takes no commands'}.")

    def _brake(self, q: Array, rate: Array) -> Array:
        way, begin = Reference(braking(q, rate, self._acceleration)), self._clock()
        while (t := self._clock() - begin) < way.settled and not self._why_halted():
            self._command(*way.at(t)[:2])
            self._sleep(self._period)
        return way.at(way.ends)[0]

    def _refuses_commands(self) -> bool:
        return self._control is None or bool(self._why_halted())

    def _why_halted(self) -> str:
        """Return why the arm, with a program, does not follow what it is told; empty if it does."""
        if why := self._at.why_stopped():
            return why
        state = self._at.receive.getRuntimeState()
        if state <= Program.STOPPED or not self._control.isConnected():
            return ENDED
        return PAUSED if state >= Program.PAUSING else ""

    def _renew(self) -> None:
        """Start the next motion's program where the arm can be moved; one that somebody else ended stays ended."""
        if self._control is not None or self._at.why_stopped() or self._at.why_not_remote():
            return
        try:
            self._control = self._at.program()
        except RuntimeError as error:
            given = f"Anther's program does not start on the controller: {error}"
            raise DeviceError(f"{given}. Look at its pendant.") from error
        self._at.wait(lambda: not self._why_halted(), "does not run Anther's program")

    def _end(self) -> None:
        """End the motion's program, and its watchdog with it. One that is held up must not go on later."""
        self._last_command = None
        state = self._at.receive.getRuntimeState()
        if state == Program.PLAYING and self._control.isConnected():
            self._control.servoStop()
            self._forget()
        elif state >= Program.PAUSING:
            with suppress(DeviceError):
                self._at.ask("stop")

    def _forget(self) -> None:
        """Leave the program, stopped."""
        control, self._control = self._control, None
        if control is not None:
            if self._at.receive.getRuntimeState() == Program.PLAYING and control.isConnected():
                control.stopScript()
            control.disconnect()

    def _check_model(self, model: str) -> None:
        """Check the arm against "ur5e" and the like; the controller names no series: that is in its version."""
        actual, old = self._at.model.lower(), self._at.version[0] < 5
        if model.startswith("ur") and (
            model.removesuffix("e") != actual.removesuffix("e") or (old and model[-1] == "e")
        ):
            given = f"arm: the controller says {self._at.model}, PolyScope {self._at.version[0]}"
            raise DeviceError(f"{given}; the cell's model is {model}. This is not the arm that the model describes.")
