"""A voice coil in the gripper on a serial line, as a `devices.Motor`. The line protocol: docs/gripper_motor.md.

The motor's own controller makes the motion, piece by piece, and stops by itself when it hears nothing for 100 ms.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple, TypeVar

import numpy as np

from anther.core.errors import MissingExtra
from anther.robot.devices import LEAD, Arm, ArmRecord, ArmSample, DeviceError, MoreSwing, Watch
from anther.robot.drivers._streamed import Coming
from anther.robot.swing import Swing

NAME, VERSION = "anther-shaker", "1"
REPLY = 0.03
"""An answer comes within this [s]; then the line is sent again."""


T = TypeVar("T")


def open_port(name: str) -> Any:
    """Open a serial port at 115200 baud, such as "/dev/ttyACM0", "COM3" or pyserial's "loop://".

    Raises:
        MissingExtra: pyserial is not installed.
        DeviceError: there is no such port.
    """
    try:
        serial: Any = importlib.import_module("serial")
    except ImportError as error:
        raise MissingExtra("serial port: pyserial is not installed. Run: pip install 'anther[motor]'.") from error
    try:
        return serial.serial_for_url(name, baudrate=115200, timeout=REPLY / 3, write_timeout=REPLY)
    except (OSError, ValueError) as error:
        raise DeviceError(f"motor: no serial port {name} ({error}). Check the cable and its name.") from error


class _State(NamedTuple):
    """What a heartbeat brings: seconds [s] of the motor's clock since the swing began, state, piece under way, and half
    of what the carriage moved, peak to peak, in the last 0.1 s [m]."""

    seconds: float
    state: str
    piece: int
    amplitude: float


class VoiceCoil:
    """A motor behind a serial port.

    Attributes:
        stroke: [m], acceleration: [m/s^2], lowest, highest: [Hz]; what the motor says it has.
    """

    def __init__(
        self,
        port: Any,
        arm: Arm,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Ask the motor who it is.

        Args:
            port: where it is, as pyserial's: `readline` returns what came of a line until its own timeout.
            arm: whose gripper it is in; it is read while the motor runs.
            clock, sleep: [s]; the robot's clock.

        Raises:
            DeviceError: it does not answer, or is something else.
        """
        self._port, self._arm, self._clock, self._sleep = port, arm, clock, sleep
        self._number, self._amplitude = 0, 0.0
        name, version, *numbers = self._ask(
            "ID", lambda words: words if words[0] == "ID" and len(words) == 7 else None
        )[1:]
        if (name, version) != (NAME, VERSION):
            raise DeviceError(
                f"motor: got {name} {version}; allowed: {NAME} {VERSION}. Check the port and its firmware."
            )
        stroke, acceleration, lowest, highest = (int(word) for word in numbers)
        self.stroke, self.acceleration = 1e-9 * stroke, 1e-3 * acceleration
        self.lowest, self.highest = 1e-3 * lowest, 1e-3 * highest
        self.stop()

    def swing(self, first: Swing, watch: Watch | None = None, more: MoreSwing | None = None) -> ArmRecord:
        """Move the pads as `anther.robot.devices.Motor` says.

        `more` is asked in another thread, so that the motor goes on hearing that somebody watches.
        """
        still, samples = self._arm.joints(), list[ArmSample]()

        def beat() -> _State:
            state = self._beat()
            samples.append(ArmSample(self._clock(), still, self._arm.joints()))
            if watch:
                watch(samples[-1])
            return state

        coming = Coming(more)
        try:
            self._follow(first, beat, coming)
        except BaseException:
            with suppress(DeviceError):  # what went wrong first is what is reported; unheard, the motor stops by itself
                self.stop()
            raise
        finally:
            coming.close()
        return ArmRecord.of(samples)

    def stop(self) -> None:
        """Bring the pads to rest."""
        self._ask("STOP", lambda words: words if words == ["OK", "STOP"] else None)
        self._amplitude = 0.0

    def amplitude(self) -> float:
        """Return what the motor's sensor read at the last heartbeat, see `anther.robot.devices.Motor` [m]."""
        return self._amplitude

    def _follow(self, piece: Swing, beat: Callable[[], _State], coming: Coming[Swing]) -> None:
        self._send(0, piece)
        number = 0
        every = 0.02  # between two heartbeats [s]: the motor stops itself when five of them are missing
        while True:
            began = self._clock()
            now = beat()
            ended = now.state == "rest" and (piece.stops or coming.over)
            if ended and coming.over:
                return
            if now.state != "swing" and not ended:
                why = "what comes next came too late" if now.state == "rest" else f"it says: {now.state}"
                raise DeviceError(f"the motor stopped on the way: {why}. Look at it, then start anew.")
            self._check_moves(piece, now)
            if now.piece == number and piece.begin + piece.seconds - now.seconds <= LEAD:
                coming.ask()
            after = coming.take() if coming.there else None
            if after is not None:
                piece, number = after, number + 1
                self._send(number, piece)
            self._sleep(max(every - (self._clock() - began), 0))

    def _check_moves(self, piece: Swing, now: _State) -> None:
        """Raise where a steady tone is not followed."""
        settled = now.seconds > piece.begin + piece.ramp + 0.15
        asked = float(piece.amplitudes.sum())
        if len(piece.frequencies) == 1 and settled and now.amplitude < asked / 2:
            moves = f"{1e3 * now.amplitude:.2g} of {1e3 * asked:.2g} mm"
            raise DeviceError(f"the motor does not follow: it moves {moves}. Is the stem too stiff, or is it jammed?")

    def _send(self, number: int, piece: Swing) -> None:
        """Send a piece.

        Raises:
            DeviceError: the motor has not what it needs.
        """
        place, rate = piece.motion(np.arange(0, piece.seconds, 2.5e-4))
        most = float(np.abs(place).max()), float(np.abs(np.diff(rate)).max()) / 2.5e-4
        for what, value, limit, unit in zip(
            ("amplitude", "acceleration"), most, (self.stroke, self.acceleration), ("m", "m/s^2"), strict=True
        ):
            if value > limit * (1 + 1e-6):
                raise DeviceError(f"motor {what}: got {value:.3g} {unit}; it has {limit:.3g}. Swing less or slower.")
        f = piece.frequencies
        if f.min() < self.lowest or f.max() > self.highest:
            band = f"{self.lowest:g} to {self.highest:g} Hz"
            raise DeviceError(f"motor frequency: got {f} Hz; it has {band}. Choose others.")
        milli = np.rint(1e3 * f).astype(int)
        nano = (np.rint(1e9 * a).astype(int) for a in (piece.before, piece.amplitudes))
        tones = " ".join(":".join(str(x) for x in tone) for tone in zip(milli, *nano, strict=True))
        text = f"PIECE {number} {round(1e3 * piece.ramp)} {round(1e3 * piece.seconds)} {tones}"
        answer = self._ask(text, lambda words: words if words[1:2] == [str(number)] else None)
        if answer[0] != "OK":
            raise DeviceError(f"the motor refuses: {' '.join(answer[2:])}. Swing less or slower.")

    def _beat(self) -> _State:
        def read(words: list[str]) -> _State | None:
            if words[0] != "AT" or len(words) != 5:
                return None
            return _State(1e-3 * int(words[1]), words[2], int(words[3]), 1e-9 * int(words[4]))

        state = self._ask("BEAT", read)
        self._amplitude = state.amplitude
        return state

    def _ask(self, text: str, read: Callable[[list[str]], T | None]) -> T:
        """Return what `read` makes of the answer to a line; what it makes nothing of is garbage and passed over.

        Raises:
            DeviceError: no answer, or no port any more.
        """
        self._number += 1
        line = b""
        try:
            for _ in range(3):
                self._port.write(seal(f"{self._number} {text}"))
                until = self._clock() + REPLY
                while self._clock() < until:
                    line = self._port.readline() or line
                    words = unseal(line)
                    if len(words) > 1 and words[0] == str(self._number):
                        with suppress(ValueError):
                            answer = read(words[1:])
                            if answer is not None:
                                return answer
        except OSError as error:
            raise DeviceError(
                f"motor: the port is gone ({error}). Check the cable; the motor stops by itself."
            ) from error
        reply = f"the last it said: {line[:40]!r}" if line else "it says nothing"
        raise DeviceError(f"motor: no answer to {text.split(maxsplit=1)[0]}; {reply}. Check power, cable and port.")


def seal(text: str) -> bytes:
    """Return a line with its check sum, two hexadecimal digits of all its bytes' exclusive or, as in NMEA 0183."""
    return f"{text}*{_sum(text.encode()):02X}\n".encode()


def unseal(line: bytes) -> list[str]:
    """Return the words of a line whose check sum is right; none otherwise."""
    body, star, seal = line.strip().rpartition(b"*")
    with suppress(ValueError):
        if star and len(seal) == 2 and int(seal, 16) == _sum(body):
            return body.decode("ascii").split()
    return []


def _sum(body: bytes) -> int:
    return int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8), initial=0))
