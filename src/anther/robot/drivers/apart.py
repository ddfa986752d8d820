"""An arm whose driver runs in a process of its own: what plans beside it cannot delay a command.

Python's threads share one lock, and a search or a simulation holds it for longer than an arm can wait. The process has
its own guard, so that limits and readings are checked there too, and it brakes when whoever started it is gone.
"""

from __future__ import annotations

import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from anther.core.errors import AntherError, InputError, MissingExtra, StageFailure
from anther.core.geometry import Array
from anther.robot.devices import ArmRecord, ArmSample, DeviceError, JointTrajectory, More, SafetyLimits, Watch
from anther.robot.drivers._streamed import SHARED_PRIORITY, Coming, prioritize_thread
from anther.robot.safety import GuardedArm

LOST = "the arm's own process is gone; the arm stops by its own timeout. Look at it, and start anew."
GONE = "who asked for it is gone"


class ArmApart:
    """An arm in a process of its own. It is itself an `Arm`; what else its driver can do is asked by `call`."""

    _patience = 30.0
    """The process answers a question within this, or is given up [s]."""

    def __init__(self, make: Callable[..., Any], options: dict[str, Any], limits: SafetyLimits) -> None:
        """Start the process and connect there.

        Args:
            make: returns the arm; a function or class that can be named, so that it can be pickled.
            options: its arguments.
            limits: of the guard in that process.

        Raises:
            AntherError: what connecting raised.
        """
        context = get_context("spawn")
        self._pipe, other = context.Pipe()
        self._lock, self.has = threading.Lock(), frozenset[str]()
        self._process = context.Process(target=_serve, args=(other, make, options, limits, os.getpid()), daemon=True)
        self._process.start()
        other.close()
        self.has = frozenset(self._done(self._receive(120.0)))  # a busy machine begins late

    def joints(self) -> Array:
        """See `anther.robot.devices.Arm`."""
        return self.call("joints")

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """See `anther.robot.devices.Arm`; `watch` is called as soon as this process comes to it."""
        coming = Coming(more)
        with self._lock:
            self._say("follow", trajectory, more is not None)
            try:
                answer = self._until_it_ends(watch, coming)
            except BaseException:
                self._stop()
                raise
            finally:
                coming.close()
        return self._done(answer)

    def hold(self) -> None:
        """See `anther.robot.devices.Arm`."""
        self.call("hold")

    def call(self, name: str, *words: Any) -> Any:
        """Return what a method of the driver returns, such as `enable`."""
        with self._lock:
            self._say("call", name, words)
            return self._done(self._receive(self._patience))

    def close(self) -> None:
        """End the process; a moving arm is braked."""
        with suppress(DeviceError):
            self._say("end")
        self._process.join(5)
        if self._process.is_alive():
            self._process.kill()
        self._pipe.close()

    def _until_it_ends(self, watch: Watch | None, coming: Coming[JointTrajectory]) -> tuple[str, Any] | None:
        """Show the readings to `watch` and pass on what comes next; return how the motion ended."""
        while True:
            if coming.there:
                self._say("next", coming.take())
            answer = self._receive(0.005 if coming.asked else self._patience)
            match answer:
                case ("sample", sample):
                    self._say("seen", sample.time)
                    if watch:
                        watch(sample)
                case ("more", _):
                    coming.ask()
                case None if coming.asked:
                    pass
                case _:
                    return answer

    def _stop(self) -> None:
        """Stop the motion under way and pass over what was said of it."""
        with suppress(DeviceError):
            self._say("stop")
            until = time.monotonic() + self._patience
            while time.monotonic() < until:
                answer = self._receive(0.1)
                if answer is not None and answer[0] in ("done", "failed"):
                    return

    def _say(self, *words: Any) -> None:
        try:
            self._pipe.send(words)
        except OSError as error:
            raise DeviceError(LOST) from error

    def _receive(self, seconds: float) -> tuple[str, Any] | None:
        try:
            return self._pipe.recv() if self._pipe.poll(seconds) else None
        except (EOFError, OSError) as error:
            raise DeviceError(LOST) from error

    def _done(self, answer: tuple[str, Any] | None) -> Any:
        if answer is None:
            raise DeviceError(
                f"the arm's own process says nothing for {self._patience:g} s. Look at the arm, and start anew."
            )
        what, value = answer
        if what == "failed":
            raise value
        return value


class _Stopped(DeviceError):
    """The other process asks for a stop, hangs, or is gone."""


class _Server:
    """The process that has the arm."""

    _patience = 1.0
    """Readings that nobody looked at for so long end a motion [s]: who should watch hangs."""

    def __init__(self, pipe: Connection, parent: int) -> None:
        self._pipe, self._parent, self._why = pipe, parent, ""
        self._nexts, self._asks = queue.SimpleQueue[Any](), queue.SimpleQueue[tuple[Any, ...] | None]()
        self._unseen: float | None = None  # since when a reading waits for somebody to look [s]
        threading.Thread(target=self._read, daemon=True).start()

    def serve(self, arm: Any, guarded: GuardedArm) -> None:
        """Do what is asked until nobody is left to ask."""
        while (ask := self._asks.get()) is not None:
            what, *words = ask
            try:
                if what == "follow":
                    self._say("done", self._follow(guarded, *words))
                else:
                    name, arguments = words
                    self._say("done", getattr(guarded if name == "joints" else arm, name)(*arguments))
            except Exception as error:
                self._say("failed", _portable(error))

    def _follow(self, arm: GuardedArm, trajectory: JointTrajectory, goes_on: bool) -> ArmRecord:
        self._why, self._unseen = self._why if self._why == GONE else "", None
        nexts = self._nexts = queue.SimpleQueue[Any]()

        def more() -> JointTrajectory | None:
            self._say("more", None)
            return nexts.get()

        try:
            return arm.follow(trajectory, self._watch, more if goes_on else None)
        finally:
            nexts.put(None)  # nobody waits for an answer any more

    def _watch(self, sample: ArmSample) -> None:
        if os.getppid() != self._parent:
            self._why = GONE
        if self._why:
            raise _Stopped(f"the motion was called off: {self._why}.")
        now, unwatched = time.monotonic(), self._unseen
        if unwatched is not None and now - unwatched > self._patience:
            hangs = f"nobody looked at the arm's readings for {self._patience:g} s"
            raise _Stopped(f"{hangs}. Let nothing else run on this machine.")
        self._unseen = now if unwatched is None else unwatched
        self._say("sample", sample)

    def _read(self) -> None:
        """Hear the other process, also while the arm moves."""
        try:
            while (ask := self._pipe.recv())[0] != "end":
                match ask:
                    case ("stop",):
                        self._why = "asked to stop"
                    case ("seen", _):
                        self._unseen = None
                    case ("next", motion):
                        self._nexts.put(motion)
                    case _:
                        self._asks.put(ask)
        except (EOFError, OSError):
            pass
        self._why = GONE
        self._nexts.put(None)
        self._asks.put(None)

    def _say(self, what: str, value: Any) -> None:
        with suppress(OSError):  # who is gone is noticed by the next reading
            self._pipe.send((what, value))


def _serve(
    pipe: Connection, make: Callable[..., Any], options: dict[str, Any], limits: SafetyLimits, parent: int
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to both: the other one asks for the stop
    with prioritize_thread(SHARED_PRIORITY, threads_too=True):
        try:
            arm = make(**options)
        except Exception as error:
            pipe.send(("failed", _portable(error)))
            return
        pipe.send(("done", [name for name in dir(arm) if not name.startswith("_")]))
        try:
            _Server(pipe, parent).serve(arm, GuardedArm(arm, limits))
        finally:
            getattr(arm, "close", lambda: None)()


def _portable(error: Exception) -> AntherError:
    """Return an error that every process can read: one of Anther's own kinds, whatever a driver derives from them."""
    said = str(error) or type(error).__name__
    if isinstance(error, StageFailure) and not isinstance(error, DeviceError):
        return StageFailure(error.kind, said)
    kinds = (kind for kind in (DeviceError, MissingExtra, InputError) if isinstance(error, kind))
    return next(kinds, InputError if isinstance(error, AntherError) else DeviceError)(said)
