"""A log of a trial that people can open: an MCAP file with Foxglove's schemas, written while the trial goes on.

What machines and stages say is appended to a queue, and a thread of its own writes it. Who says something never waits:
a full queue, a slow disk or a full one costs messages, which are counted, and nothing else. docs/log.md lists topics.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

from anther.core.geometry import Array
from anther.robot.devices import Robot, SafetyLimits
from anther.show.log._machines import log_machines
from anther.show.log._messages import LogFile, Scribe

__all__ = ["Kept", "Log"]


@dataclass(frozen=True, slots=True)
class Kept:
    """What became of a log.

    Attributes:
        messages: in the file.
        dropped: messages that are not; what never became one counts as one.
        size: of the file [bytes].
        error: why some are missing; None if all are there.
    """

    messages: int
    dropped: int
    size: int
    error: str | None


class Log:
    """An MCAP file that is being written. Nothing that goes wrong with it raises or waits.

    Times are the robot's clock, moved to the present date where it was tapped. A simulated robot's clock stands still
    while the computer thinks.

    Args:
        path: of the file; one that is there is replaced.
        waiting: how many things may wait to be written, 40 s of an arm that reads 100 a second; more are dropped.
        opened: opens the file for writing bytes, unbuffered.
    """

    _flushes_every = 0.5
    """How often what was written goes to the disk [s]."""
    _patience = 5.0
    """So long the end of a trial waits for what is still to be written [s]."""

    def __init__(
        self, path: Path, *, waiting: int = 4096, opened: Callable[[Path], Any] = lambda path: path.open("wb", 0)
    ) -> None:
        self._queue, self._most = deque[tuple[float, str, Any]](), waiting
        self._file = LogFile(path, opened)
        self._scribe = Scribe(self._file)
        self._clock: Callable[[], float] = time.time
        self._epoch, self._messages, self._safe, self._dropped, self._told = 0.0, 0, 0, 0, 0
        self._watched: Any = None
        self._steps = 0
        self._lock, self._ended, self._error, self._kept = Lock(), Event(), "", None
        self._thread = Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def tap(self, robot: Robot, limits: SafetyLimits, T_flange_cam: Array, clock: Callable[[], float]) -> Robot:
        """Return the same machines, which tell the log what they are asked and what they read.

        Args:
            robot: the bare machines; a guard goes around what is returned.
            limits: `forward` and `outline` show where the arm is.
            T_flange_cam: the wrist camera on the flange (4, 4).
            clock: the robot's [s].
        """
        self._clock, self._epoch = clock, time.time() - clock()
        self._scribe.meet(robot, limits, T_flange_cam)
        self.say("cell", self._epoch)
        return log_machines(robot, self.say, self._look)

    def say(self, what: str, value: Any, when: float | None = None) -> None:
        """Keep something; returns at once, whatever the disk does.

        Args:
            what: its name: a stage of `runs.FILES`, or one of those that `messages.Scribe` knows; others are left out.
            value: must not change afterwards.
            when: on the robot's clock [s]; None: now.
        """
        if len(self._queue) >= self._most or self._kept is not None:
            with self._lock:
                self._dropped += 1
            return
        seconds = (self._clock() if when is None else when) + self._epoch
        self._queue.append((seconds, what, value))

    def told(self, what: str, value: Any) -> None:
        """Keep what a run tells: `Run.told`. A shake that is watched is asked for its steps from now on."""
        if what == "watched":
            self._watched, self._steps = value, 0
            return
        self._look()
        self.say(what, value)

    def close(self) -> Kept:
        """Write what is still to be written, for some seconds at most, and return what became of the log."""
        if self._kept is None:
            self._look()
            self._ended.set()
            self._thread.join(self._patience)
            late, hangs = len(self._queue), self._thread.is_alive()
            if hangs:
                late += 1
                self._error = self._error or f"the disk took longer than {self._patience:g} s"
            lost = self._messages - self._safe if hangs or self._file.broken else 0
            error = self._file.error or self._error
            if not error and self._dropped:
                error = "more was said at once than could be written"
            self._kept = Kept(self._messages - lost, self._dropped + late + lost, self._file.size, error or None)
            self._queue.clear()
        return self._kept

    def _look(self) -> None:
        """Keep the steps of a watched shake that are new."""
        steps = () if self._watched is None else self._watched.steps
        for step in steps[self._steps :]:
            self.say("step", step)
        self._steps = len(steps)

    def _write(self) -> None:
        flushed = time.monotonic()
        ended = False
        while not ended:
            ended = self._ended.wait(0.05)  # s
            self._drain()
            if time.monotonic() - flushed > self._flushes_every:
                self._flush()
                flushed = time.monotonic()
        self._scribe.close()

    def _flush(self) -> None:
        self._scribe.flush()
        if not self._file.broken:
            self._safe = self._messages

    def _drain(self) -> None:
        for count in range(len(self._queue)):
            if self._kept is not None:
                return
            self._messages += self._written(*self._queue.popleft())
            if count % 8 == 7:  # keep Python's lock from nobody for long
                time.sleep(5e-4)

    def _written(self, when: float, what: str, value: Any) -> int:
        """Return how many messages something became."""
        lost = self._dropped - self._told
        if not self._file.full:
            try:
                if lost:
                    self._scribe.write(when, "lost", lost)
                    self._told += lost
                return self._scribe.write(when, what, value)
            except Exception as error:  # a log that cannot say something says the rest
                self._error = self._error or f"{what}: {error!r}"
        with self._lock:
            self._dropped += 1
            self._told += 1
        return 0
