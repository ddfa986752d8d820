"""A Robotiq 2F gripper over Modbus RTU or TCP, as a `devices.Gripper`. It has not run on metal (docs/real_robot.md).

Registers and bits: Robotiq's instruction manual of the 2F-85 and 2F-140, chapter 4. The gripper does not measure its
force: it stops at the one it was set to, and says whether it met something. When nobody speaks to it any more it ends
its motion and holds.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Any, Literal, NamedTuple
from urllib.parse import urlparse

from anther.core.checks import check_range
from anther.core.errors import MissingExtra
from anther.robot.devices import DeviceError, GripperState

FAULTS = {
    0x05: "it must be activated before it moves",
    0x07: "it is not activated",
    0x08: "it is too hot: let it cool",
    0x0A: "its voltage is too low",
    0x0B: "it is being released automatically",
    0x0C: "its inner processor failed",
    0x0D: "its activation failed: look what is in its way",
    0x0E: "its motor took too much current",
    0x0F: "it was released automatically: activate it again",
}


class Action(IntFlag):
    """What the gripper is asked to do."""

    ACTIVATE, GO = 0x01, 0x08


class Met(IntEnum):
    """Of gOBJ: on the way; stopped by something while opening, and while closing."""

    MOVING, OPENING, CLOSING = 0, 1, 2


@dataclass(frozen=True, slots=True)
class Ranges:
    """Attributes: stroke [m]; force [N] and speed [m/s], each from and to (the manual's chapter 6)."""

    stroke: float
    force: tuple[float, float]
    speed: tuple[float, float]


Name = Literal["2f-85", "2f-140"]
MODELS: dict[Name, Ranges] = {
    "2f-85": Ranges(0.085, (20.0, 235.0), (0.020, 0.150)),
    "2f-140": Ranges(0.140, (10.0, 125.0), (0.030, 0.250)),
}


class Status(NamedTuple):
    """What the gripper's status registers say."""

    activation: int
    met: int
    fault: int
    echo: int
    position: int


def open_line(port: str) -> Any:
    """Return a Modbus client for a serial port such as "/dev/ttyUSB0", or "tcp://HOST:PORT" of a Modbus gateway.

    Raises:
        MissingExtra: pymodbus is not installed.
        DeviceError: nothing is there.
    """
    try:
        modbus: Any = importlib.import_module("pymodbus.client")
    except ImportError as error:
        raise MissingExtra("gripper: pymodbus is not installed. Run: pip install 'anther[gripper]'.") from error
    where = urlparse(port)
    if where.scheme == "tcp" and where.hostname:
        line = modbus.ModbusTcpClient(where.hostname, port=where.port or 502, timeout=0.5, retries=2)
    else:
        line = modbus.ModbusSerialClient(port, baudrate=115200, timeout=0.2, retries=2)
    if not line.connect():
        raise DeviceError(f"gripper: nothing answers at {port}. Check the cable, its name, and your right to use it.")
    return line


class Robotiq2F:
    """A gripper behind a Modbus line. It must have been activated, see `enable`.

    Attributes:
        stroke: [m].
        force: with which it closes [N].
    """

    _active = 3
    """Of gSTA: activation is complete."""

    _poll = 0.02
    """Between two readings of a moving gripper [s]."""

    def __init__(
        self,
        line: Any,
        *,
        model: Name = "2f-85",
        force: float | None = None,
        speed: float | None = None,
        counts: tuple[int, int] = (3, 230),
        device: int = 9,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Ask the gripper how it is. Nothing moves.

        Args:
            line: from `open_line`.
            model: which it is.
            force: with which it closes [N]; None: the least it can.
            speed: of the pads against each other [m/s]; None: the slowest.
            counts: what its position reads open and closed, out of 255; `enable` measures them.
            device: its Modbus address.
            clock, sleep: [s].

        Raises:
            InputError: it has no such force or speed.
            DeviceError: it does not answer.
        """
        has = MODELS[model]
        self.stroke = has.stroke
        self.force = check_range("grip force", has.force[0] if force is None else force, *has.force, "N")
        self._speed = check_range("gripper speed", has.speed[0] if speed is None else speed, *has.speed, "m/s")
        self._bytes = _share(self._speed, has.speed) << 8 | _share(self.force, has.force)
        self._line, self._device, self._clock, self._sleep = line, device, clock, sleep
        self.counts = counts
        self.status()

    def move(self, opening: float) -> GripperState:
        """Move the pads to `opening` [m] apart, or until they meet resistance; return the state then.

        Raises:
            InputError: beyond the stroke.
            DeviceError: it is not activated, has a fault, or says nothing.
        """
        check_range("gripper opening", opening, 0, self.stroke, "m")
        opened, closed = self.counts
        self._go(round(closed + (opened - closed) * opening / self.stroke))
        return self.state()

    def state(self) -> GripperState:
        """Return the present state; the force is the one it was set to, where it met something while closing."""
        status, (opened, closed) = self._able(), self.counts
        share = (closed - status.position) / (closed - opened)
        held = status.met == Met.CLOSING
        return GripperState(self.stroke * min(max(share, 0.0), 1.0), self.force if held else 0.0, held)

    def enable(self) -> None:
        """Activate it: it opens and closes all the way, twice. Keep hands and plants out. Measures `counts`."""
        self._write(0, 0)
        self._sleep(self._poll)
        self._write(Action.ACTIVATE, 0)
        until = self._clock() + 15.0
        while self.status().activation != self._active:
            self._check_in_time(until, "activation")
        closed, opened = self._go(255), self._go(0)
        if closed - opened < 100:
            raise DeviceError(
                f"gripper: it reads {opened} open and {closed} closed, of 255. Look what is between the pads."
            )
        self.counts = (opened, closed)

    def status(self) -> Status:
        """Return what its registers say."""
        answer = self._request(lambda: self._line.read_input_registers(0x07D0, count=3, device_id=self._device))
        first, second, third = answer.registers
        bits = first >> 8
        return Status(bits >> 4 & 3, bits >> 6, second >> 8 & 0x0F, second & 0xFF, third >> 8)

    def close(self) -> None:
        """Leave the line; the gripper holds."""
        self._line.close()

    def _able(self) -> Status:
        status = self.status()
        if status.fault or status.activation != self._active:
            why = FAULTS.get(status.fault, f"fault {status.fault:#04x}") if status.fault else FAULTS[0x07]
            raise DeviceError(f"gripper: {why}. Then: anther cell enable.")
        return status

    def _go(self, count: int) -> int:
        """Send the pads to a count; return the one at which they came to rest."""
        before = self._able()
        self._write(Action.ACTIVATE | Action.GO, count)
        way = abs(count - before.position) / 255 * self.stroke
        until = self._clock() + 2 * way / self._speed + 2.0
        while True:
            self._check_in_time(until, "motion")
            status = self._able()
            if status.echo == count and status.met != Met.MOVING and status.position == before.position:
                return status.position
            before = status

    def _check_in_time(self, until: float, what: str) -> None:
        self._sleep(self._poll)
        if self._clock() > until:
            raise DeviceError(f"gripper: its {what} does not end. Look what is in its way, and at its lamp.")

    def _write(self, action: int, count: int) -> None:
        words = [action << 8, count, self._bytes]
        self._request(lambda: self._line.write_registers(0x03E8, words, device_id=self._device))

    def _request(self, ask: Callable[[], Any]) -> Any:
        errors: Any = importlib.import_module("pymodbus.exceptions")
        try:
            answer = ask()
        except (errors.ModbusException, OSError) as error:
            raise DeviceError(f"gripper: no answer ({error}). Check power, cable and Modbus address.") from error
        if answer.isError():
            raise DeviceError(f"gripper: it refuses ({answer}). Is it a 2F, and its Modbus address {self._device}?")
        return answer


def _share(value: float, span: tuple[float, float]) -> int:
    return round(255 * (value - span[0]) / (span[1] - span[0]))
