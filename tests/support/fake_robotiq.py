"""A Robotiq 2F's registers, served by pymodbus' own simulator with TCP's frames or a serial line's."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

from pymodbus import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

COMMAND, STATUS = 1000, 2000
RATE = 600.0  # counts a second: quicker than the real one


class FakeRobotiq:
    """Attributes: `scheme`, `port` of its address; `thick` is what lies between the pads, a count; `writes` to it;
    `met`: what its object detection says at rest, whatever is between the pads."""

    def __init__(self, *, serial: bool = False) -> None:
        self.scheme = "socket" if serial else "tcp"
        self.thick, self.fault, self.mute, self.stuck, self.active = 255, 0, False, False, False
        self.met: int | None = None
        self.lowest, self.highest = 3, 228
        self.writes: list[list[int]] = []
        self.count, self._goal, self._word, self._since = 100.0, 0, 0, time.monotonic()
        self._framer = FramerType.RTU if serial else FramerType.SOCKET
        self._loop, ready = asyncio.new_event_loop(), threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(ready,), daemon=True)
        self._thread.start()
        ready.wait(10)
        self.port: int = self._server.transport.sockets[0].getsockname()[1]

    def close(self) -> None:
        self.mute = False
        time.sleep(0.1)
        asyncio.run_coroutine_threadsafe(self._server.shutdown(), self._loop).result(5)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5)

    def _serve(self, ready: threading.Event) -> None:
        asyncio.set_event_loop(self._loop)

        async def begin() -> None:
            blocks = [SimData(at, values=[0] * 3, datatype=DataType.REGISTERS) for at in (COMMAND, STATUS)]
            device = SimDevice(9, simdata=blocks, action=self._act)
            self._server = ModbusTcpServer(device, framer=self._framer, address=("127.0.0.1", 0))
            await self._server.serve_forever(background=True)
            ready.set()

        self._loop.run_until_complete(begin())
        self._loop.run_forever()

    async def _act(
        self, function: int, start: int, address: int, count: int, registers: list[int], values: Any
    ) -> None:
        while self.mute:
            await asyncio.sleep(0.02)
        self._move()
        if address == COMMAND and values is not None:
            self.writes.append(list(values))
            self._word, self._goal = values[0] >> 8, values[1] & 0xFF
        if address == STATUS:
            registers[address - start : address - start + 3] = self._status()

    def _move(self) -> None:
        now = time.monotonic()
        way, self._since = RATE * (now - self._since), now
        if self._word & 8 and not self.stuck:
            goal = min(max(self._goal, self.lowest), self.highest, self.thick if self._goal > self.thick else 255)
            self.count += min(max(goal - self.count, -way), way)

    def _status(self) -> list[int]:
        there = abs(self.count - min(max(self._goal, self.lowest), self.highest)) < 0.5
        met = 3 if there else 2 if self.count == self.thick else 0
        met = met if self.met is None or met == 0 else self.met
        active = self._word & 1 or self.active
        bits = active | self._word & 8 | (3 if active else 0) << 4 | met << 6
        return [bits << 8, self.fault << 8 | self._goal, round(self.count) << 8]
