"""The voice coil's controller as docs/gripper_motor.md describes it, behind a port without a cable."""

from __future__ import annotations

import time

import numpy as np

from anther.robot.drivers.voice_coil import seal, unseal
from anther.robot.swing import Swing

WATCHDOG = 0.1


class FakeClock:
    """Goes on when somebody sleeps or waits; other threads get their turn meanwhile."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        time.sleep(0.005)


class FakeShaker:
    """Attributes: `gain` of its carriage; `pieces` it took, as (number, Swing); `log` of its states."""

    def __init__(self, clock: FakeClock) -> None:
        self.clock, self.gain, self.fault = clock, 1.0, ""
        self.name, self.limits = "anther-shaker 1", "1500000 50000 10000 50000"
        self.pieces: list[Swing] = []
        self.state, self.running = "rest", 0
        self._replies: list[bytes] = []
        self._heard = self._begin = clock()

    def write(self, data: bytes) -> None:
        self._advance()
        words = unseal(data)
        if not words:
            return
        self._heard = self.clock()
        self._replies.append(seal(f"{words[0]} {self._answer(words[1:])}"))

    def readline(self) -> bytes:
        self._advance()
        if self._replies:
            return self._replies.pop(0)
        self.clock.now += 0.01
        return b""

    @property
    def place(self) -> float:
        """Where the carriage is [m]."""
        self._advance()
        if self.state != "swing":
            return 0.0
        piece = self.pieces[self.running]
        return self.gain * float(piece.motion([self.clock() - self._begin - piece.begin])[0][0])

    def _advance(self) -> None:
        now = self.clock()
        if self.state == "swing" and now - self._heard > WATCHDOG:
            self.state = "watchdog"
        while self.state == "swing" and now - self._begin >= self._end():
            if self.running + 1 < len(self.pieces):
                self.running += 1
            else:
                self.state = "rest"
        if self.state == "swing" and self.fault:
            self.state = self.fault

    def _end(self) -> float:
        return self.pieces[self.running].begin + self.pieces[self.running].seconds

    def _answer(self, words: list[str]) -> str:
        match words:
            case ["ID"]:
                return f"ID {self.name} {self.limits}"
            case ["STOP"]:
                self.state = "rest"
                return "OK STOP"
            case ["BEAT"]:
                amplitude = self.pieces[self.running].amplitudes.sum() if self.state == "swing" else 0.0
                since = round(1e3 * (self.clock() - self._begin))
                return f"AT {since} {self.state} {self.running} {round(1e9 * self.gain * amplitude)}"
            case ["PIECE", number, ramp, whole, *tones]:
                return self._take(int(number), int(ramp), int(whole), tones)
        return "NO what"

    def _take(self, number: int, ramp: int, whole: int, tones: list[str]) -> str:
        if number > 0 and (self.state != "swing" or number > self.running + 1):
            return f"NO {number} nothing to join"
        milli, before, after = np.array([[int(x) for x in tone.split(":")] for tone in tones]).T
        if number == 0:
            self.pieces, self.state, self.running, self._begin = [], "swing", 0, self.clock()
        begin = self.pieces[number - 1].begin + self.pieces[number - 1].seconds if number else 0.0
        taken = Swing(1e-3 * milli, 1e-9 * after, 1e-3 * whole, 1e-3 * ramp, 1e-9 * before, begin)
        self.pieces = [*self.pieces[:number], taken]
        return f"OK {number}"
