"""What arms have in common that are told again and again where to be: one loop that commands, reads and watches."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np

from anther.devices import ArmRecord, ArmSample, DeviceError, JointTrajectory, More, Watch
from anther.drivers._priority import quick_turns, served_first
from anther.drivers._readings import Readings
from anther.drivers._reference import Reference
from anther.geometry import Array

SETTLE = 0.1
"""The end of a motion is commanded for so long before it counts as over [s]."""
WAITING = 5.0
"""Something of a robot that is on is heard within this [s]."""
NEAR = 0.05
"""An arm further than this from where it was sent is held where it is instead [rad]."""


class StreamedArm(ABC):
    """An `anther.devices.Arm` but for what a robot's own protocol says: how to command, and why it cannot move.

    Attributes:
        readings: of its joints.
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        rate: float,
        stale: float,
        silence: float,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        """Nothing is heard or said yet.

        Args:
            names: (J,) of the joints, in Anther's order.
            rate: of the commands [1/s].
            stale: joints older than this are not believed [s].
            silence: a motion ends where two commands are further apart [s].
            clock, sleep: [s]; the clock that readings are told on.
        """
        self.readings = Readings(names, clock)
        self._names, self._period, self._stale, self._silence = tuple(names), 1 / rate, stale, silence
        self._clock, self._sleep = clock, sleep
        self._force = (float("-inf"), float("nan"))  # when [s] and how much [N]

    @abstractmethod
    def cannot(self) -> str:
        """Return why the arm cannot be moved now; empty if it can."""

    @abstractmethod
    def hold(self) -> None:
        """Brake if it moves, and hold."""

    @abstractmethod
    def _aim(self, reference: Reference, t: float) -> None:
        """Command what the reference says from `t` [s] on."""

    @abstractmethod
    def _rest(self, q: Array) -> None:
        """Command joints (J,) at which the arm then stays without being told again."""

    def joints(self) -> Array:
        """Return the measured joint angles (J,) [rad].

        Raises:
            DeviceError: they are stale, or cannot be read.
        """
        return self.readings.newest(self._stale).joints.copy()

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow a trajectory as `anther.devices.Arm` says; commands go on while `more` is thought about.

        Raises:
            DeviceError: the arm cannot move, is stopped, says nothing, or the commands came too late; it holds.
        """
        samples, reference = list[ArmSample](), Reference(trajectory, more)
        try:
            self.check_able()
            with quick_turns(), served_first():
                self._stream(reference, watch, samples)
        except BaseException:
            self.hold()
            raise
        finally:
            reference.close()
        return ArmRecord.of(samples)

    def check_able(self) -> None:
        """Check that the arm can be moved and is heard.

        Raises:
            DeviceError: why not.
        """
        why = self.cannot()
        if why:
            raise DeviceError(f"the arm cannot move: {why}.")
        self.joints()

    def _stream(self, reference: Reference, watch: Watch | None, samples: list[ArmSample]) -> None:
        last = begin = due = self._clock()
        seen = begin - self._stale if self.readings.last is None else self.readings.last.time
        while True:
            now = self._clock()
            if now - last > self._silence:
                late = f"{1e3 * (now - last):.0f} ms after the one before; allowed: {1e3 * self._silence:.0f} ms"
                raise DeviceError(f"a command came {late}. Let nothing else run on this machine.")
            reference.look_ahead(now - begin)
            self._aim(reference, now - begin)
            last = now
            self.check_able()
            reading = self.readings.last
            if reading is not None and reading.time > seen:
                seen = reading.time
                wanted = reference.at(seen - begin)[0]
                samples.append(ArmSample(seen, wanted, reading.joints, self._felt(now)))
                if watch:
                    watch(samples[-1])
            if reference.whole and now - begin >= reference.ends + SETTLE:
                break
            due = max(due + self._period, now)
            self._sleep(max(due - self._clock(), 0))
        self._rest(reference.at(reference.ends)[0])

    def _feel(self, x: float, y: float, z: float) -> None:
        """Take a force that was told now [N]."""
        self._force = (self._clock(), float(np.linalg.norm([x, y, z])))

    def _felt(self, now: float) -> float:
        """Return how much the arm feels [N]; NaN where it does not tell."""
        return self._force[1] if now - self._force[0] < 2 * self._stale else float("nan")

    def _seen(self) -> str:
        """Return in words what is heard of the joints."""
        r = self.readings
        return (
            f"{r.rate:.0f} readings a second, the newest {1e3 * r.age():.0f} ms old; its clock is "
            f"{-1e3 * (r.offset - self._clock() + time.time()):+.0f} ms ahead of this machine's"
        )

    def _wait(self, done: Callable[[], bool], what: str, ask: Callable[[], None] = lambda: None) -> None:
        until = time.monotonic() + WAITING
        while not done():
            if time.monotonic() > until:
                raise DeviceError(f"the robot {what} within {WAITING:g} s. {self.readings.trouble or 'Is it on?'}")
            ask()
            time.sleep(0.05)
