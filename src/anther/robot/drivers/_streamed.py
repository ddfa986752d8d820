"""The base of every arm driver that streams commands: one loop that commands, reads and watches.

Its threads run with real-time priority, readings are put on this machine's clock, and the next motion is asked for in
time. J joints.
"""

from __future__ import annotations

import os
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any, Generic, TypeVar

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from anther.core.geometry import Array
from anther.robot.devices import LEAD, ArmRecord, ArmSample, DeviceError, JointTrajectory, More, Watch
from anther.robot.drivers._holding import LastCommand, Late, find_rest_joints
from anther.robot.drivers._readings import Readings

PRIORITY = 20
"""Of Linux' real-time classes, 1 to 99: before all ordinary work, behind the kernel's own."""
SHARED_PRIORITY = PRIORITY - 1
"""Of all that shares Python's lock with such a thread: what has the lock and is not served keeps it waiting."""


@contextmanager
def prioritize_thread(priority: int = PRIORITY, *, threads_too: bool = False) -> Iterator[None]:
    """Run this thread with real-time priority within the block, where the system allows it.

    Linux asks for a limit `rtprio` (docs/real_robot.md) or root. Threads that are begun within are ordinary ones but
    for `threads_too`.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):
        kind = os.SCHED_RR if threads_too else os.SCHED_RR | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, kind, os.sched_param(priority))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, *before)


@contextmanager
def shorten_thread_turns() -> Iterator[None]:
    """Let Python's threads take turns every millisecond: commands do not wait for other threads."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-3)
    try:
        yield
    finally:
        sys.setswitchinterval(before)


T = TypeVar("T")


class Coming(Generic[T]):
    """What comes next, asked for in a thread of its own, so that nothing waits for the answer.

    Attributes:
        over: whether nothing more can come.
    """

    def __init__(self, more: Callable[[], T | None] | None) -> None:
        self.over, self._more = more is None, more
        self._answer: Future[T | None] | None = None
        self._pool = ThreadPoolExecutor(1)

    def begin(self) -> None:
        """Begin its thread here, to be served as the process is."""
        if not self.over:
            self._pool.submit(lambda: None)

    @property
    def asked(self) -> bool:
        """Whether an answer is waited for."""
        return self._answer is not None

    @property
    def there(self) -> bool:
        """Whether an answer is there."""
        return self._answer is not None and self._answer.done()

    def ask(self) -> None:
        """Ask, but for an answer that is waited for."""
        if self._more is not None and not self.over and not self.asked:
            self._answer = self._pool.submit(self._more)

    def take(self) -> T | None:
        """Return the answer, or raise what the asking raised."""
        assert self._answer is not None
        answer, self._answer = self._answer.result(), None
        self.over = answer is None
        return answer

    def close(self) -> None:
        """Wait for no answer any more."""
        self._pool.shutdown(wait=False, cancel_futures=True)


class Reference:
    """Joints, rates and accelerations over time [s] from 0 on; what comes next is asked for `LEAD` before its time."""

    def __init__(self, first: JointTrajectory, more: More | None = None) -> None:
        self._coming = Coming(more)
        self._coming.begin()
        self._pieces: list[tuple[float, Any]] = []
        self.ends = 0.0
        self.join(first)

    @property
    def whole(self) -> bool:
        """Whether nothing more can come."""
        return self._coming.over

    @property
    def settled(self) -> float:
        """When the motion counts as over [s]: its end is commanded for a while."""
        return self.ends + 0.1

    def look_ahead(self, t: float) -> None:
        """Ask for what comes after the present end, and take it once it is there; refuse what comes too late."""
        if self.whole:
            return
        if t >= self.ends - LEAD:
            self._coming.ask()
        if self._coming.there:
            following = self._coming.take()
            if following is not None:
                self.join(following)
        elif t >= self.ends:
            raise DeviceError(f"the next motion comes too late: not within {LEAD:g} s. Look at what else runs here.")

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """Return joints, rates, accelerations, each (J,), at time t [s]; at rest before the begin and after the end."""
        begin, curve = next((piece for piece in reversed(self._pieces) if piece[0] <= t), self._pieces[0])
        inside = float(np.clip(t - begin, 0.0, curve.x[-1]))
        if not 0 <= t < self.ends:
            still = np.zeros(curve.c.shape[-1])
            return curve(inside), still, still
        return curve(inside), curve(inside, 1), curve(inside, 2)

    def close(self) -> None:
        """Wait for no answer any more."""
        self._coming.close()

    def join(self, motion: JointTrajectory) -> None:
        """Take a motion that begins where the last one ends."""
        curve = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
        self._pieces = [*self._pieces[-1:], (self.ends, curve)]  # readings are a little older than commands
        self.ends += motion.duration


def braking(q: Array, rate: Array, acceleration: Array) -> JointTrajectory:
    """Return the straight way to rest (J,), from joints q at `rate`, with no more than `acceleration` of any joint."""
    seconds = max(float((np.abs(rate) / acceleration).max()), 1e-3)
    t = np.linspace(0, seconds, 20)[:, None]
    return JointTrajectory(t[:, 0], q + rate * t * (1 - t / (2 * seconds)), rate * (1 - t / seconds))


class StreamedArm(ABC):
    """An `anther.robot.devices.Arm` but for what a robot's own protocol says: how to command, and why it cannot move.

    Attributes:
        readings: of its joints.
    """

    _patience = 5.0
    """Something of a robot that is on is heard within this [s]."""

    def __init__(
        self,
        names: Sequence[str],
        *,
        rate: float,
        stale: float,
        silence: float,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
        shown: float = 0.0,
        timeout: float | None = None,
    ) -> None:
        """Nothing is heard or said yet.

        Args:
            names: (J,) of the joints, in Anther's order.
            rate: of the commands [1/s].
            stale: joints older than this are not believed [s].
            silence: a motion ends where two commands are further apart [s].
            clock, sleep: [s]; the clock that readings are told on.
            shown: readings go to the watcher no closer than this [s].
            timeout: the robot stops by itself when it hears nothing for so long [s]; None: `silence`.
        """
        self.readings = Readings(names, clock)
        self._names, self._period, self._stale, self._silence = tuple(names), 1 / rate, stale, silence
        self._clock, self._sleep, self._shown = clock, sleep, shown
        self._timeout = silence if timeout is None else timeout
        self._force = (float("-inf"), float("nan"))  # when [s] and how much [N]
        self._last_command: LastCommand | None = None
        self._last = float("-inf")  # when a command was last in time [s]

    @abstractmethod
    def cannot(self) -> str:
        """Return why the arm cannot be moved now; empty if it can."""

    @abstractmethod
    def _aim(self, reference: Reference, t: float) -> None:
        """Command what the reference says from `t` [s] on."""

    @abstractmethod
    def _rest(self, q: Array) -> None:
        """Command joints (J,) at which the arm then stays without being told again."""

    @abstractmethod
    def _brake(self, q: Array, rate: Array) -> Array:
        """Command the way to rest from joints q (J,) at `rate`, each command by `_send`; return where it ends."""

    def _refuses_commands(self) -> bool:
        """Return whether the robot must not be sent anything."""
        return bool(self.cannot())

    def _stay(self, q: Array) -> None:
        """Command joints (J,) near which the arm stands."""
        self._rest(q)

    def _extrapolate(self, last: LastCommand, now: float) -> LastCommand:
        """Return the joints that the robot has reached now [s]: it goes on at the rate of the last command."""
        return LastCommand(now, last.joints + last.rate * (now - last.time), last.rate)

    def hold(self) -> None:
        """Brake if it moves, and hold, by the rule of `_holding`. A robot that refuses commands is sent nothing."""
        if self._last_command is None or self._last_command.rests or self._refuses_commands():
            return
        begin = self._stop_from(self._last_command)
        if begin is None:
            self._last_command = None
            return
        q, rate = begin
        try:
            self._last = self._clock()
            self._stay(self._brake(q, rate) if np.any(rate) else q)
        except Late:  # held up once more: the last command is void
            self.hold()

    def _stop_from(self, last: LastCommand) -> tuple[Array, Array] | None:
        """Return joints and rates (J,) from which to stop; None: nothing is to be sent."""
        now = self._clock()
        if now - last.time <= self._timeout:
            return self._extrapolate(last, now)[1:]
        while self._clock() - now < 0.5 and not self.readings.trouble:
            with suppress(DeviceError):  # too old yet
                self.joints()
            here = find_rest_joints(self.readings, now)
            if here is not None and self.readings.age() <= self._stale:
                return here, np.zeros_like(here)
            self._sleep(self._period)
        return None

    def _check_in_time(self) -> None:
        """Refuse to go on where the robot waited too long for a command."""
        waited = self._clock() - self._last
        if waited > self._silence:
            late = f"{1e3 * waited:.0f} ms after the one before; allowed: {1e3 * self._silence:.0f} ms"
            raise Late(f"a command came {late}. Let nothing else run on this machine.")

    def _send(self, send: Callable[[], Any], q: Array, rate: Array) -> None:
        """Send a command that goes on from the one before, of joints q (J,) at `rate`, if it still comes in time."""
        self._check_in_time()
        send()
        self._last = self._clock()
        self._last_command = LastCommand(self._last, q, rate)

    def _rests(self, q: Array) -> None:
        """Note that the robot was commanded to stay at joints q (J,)."""
        self._last_command = LastCommand(float("inf"), q, np.zeros(len(q)))

    def joints(self) -> Array:
        """Return the measured joint angles (J,) [rad]; refuse stale ones."""
        return self.readings.newest(self._stale).joints.copy()

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow a trajectory as `anther.robot.devices.Arm` says; commands go on while `more` is thought about."""
        samples, reference = list[ArmSample](), Reference(trajectory, more)
        try:
            self._begin(trajectory)
            with shorten_thread_turns(), prioritize_thread():
                self._stream(reference, watch, samples)
        except BaseException:
            with shorten_thread_turns(), prioritize_thread():
                self.hold()
            raise
        finally:
            reference.close()
        return ArmRecord.of(samples)

    def check_able(self) -> None:
        """Check that the arm can be moved and is heard."""
        why = self.cannot()
        if why:
            raise DeviceError(f"the arm cannot move: {why}.")
        self.joints()

    def _begin(self, trajectory: JointTrajectory) -> None:
        """Check that a motion may begin."""
        self.check_able()

    def _stream(self, reference: Reference, watch: Watch | None, samples: list[ArmSample]) -> None:
        self._last = begin = due = self._clock()
        newest = begin - self._stale if self.readings.last is None else self.readings.last.time
        while True:
            now = self._clock()
            self._check_in_time()
            self.check_able()
            reference.look_ahead(now - begin)
            self._aim(reference, now - begin)
            reading, over = self.readings.last, reference.whole and now - begin >= reference.settled
            if reading is not None and reading.time > newest and (over or reading.time >= newest + self._shown):
                newest = reading.time
                wanted = reference.at(newest - begin)[0]
                samples.append(ArmSample(newest, wanted, reading.joints, self._current_force(now)))
                if watch:
                    watch(samples[-1])
            if over:
                break
            due = max(due + self._period, now)
            self._sleep(max(due - self._clock(), 0))
        self._rest(reference.at(reference.ends)[0])

    def _take_force(self, x: float, y: float, z: float) -> None:
        """Take a force that was measured now [N]."""
        self._force = (self._clock(), float(np.linalg.norm([x, y, z])))

    def _current_force(self, now: float) -> float:
        """Return the size of the measured force [N]; NaN where none is recent."""
        return self._force[1] if now - self._force[0] < 2 * self._stale else float("nan")

    def _describe_readings(self) -> str:
        """Return in words what is heard of the joints."""
        r = self.readings
        return (
            f"{r.rate:.0f} readings a second, the newest {1e3 * r.age():.0f} ms old; its clock is "
            f"{-1e3 * (r.clock.offset - self._clock() + time.time()):+.0f} ms ahead of this machine's"
        )

    def _wait(self, done: Callable[[], bool], what: str, ask: Callable[[], None] = lambda: None) -> None:
        until = time.monotonic() + self._patience
        while not done():
            if time.monotonic() > until:
                raise DeviceError(
                    f"the robot {what} within {self._patience:g} s. {self.readings.trouble or 'Is it on?'}"
                )
            ask()
            time.sleep(0.05)
