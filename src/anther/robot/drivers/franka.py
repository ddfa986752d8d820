"""A Franka arm (FR3) through libfranka, as a `devices.Arm`. It has met no metal (docs/real_robot.md).

Sources: docstrings of pylibfranka 0.21.3; libfranka's documentation of robot modes and errors.

What must not be late runs in `franka_loop`, a process that this one starts: it has each motion before it begins, and
brakes when nobody looks at what it shows. franky, the other library, follows joints of others by torques only, or
times a path itself: neither is the shake that was planned.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from anther.core.errors import MissingExtra, bad_input
from anther.core.geometry import Array
from anther.robot.devices import ArmRecord, ArmSample, DeviceError, JointTrajectory, More, Watch
from anther.robot.drivers._franka_loop import Loop, RobotState
from anther.robot.drivers._readings import STALE, RobotClock, check_finite_joints, check_fresh
from anther.robot.drivers._streamed import Coming, prioritize_thread, shorten_thread_turns

ANSWER = 2.0
"""The loop answers within this [s]; libfranka gives a network up before."""
BEGINS = "from anther.robot.drivers._franka_loop import main; main()"
GONE = "the loop that commands the arm is gone; the robot stops by itself. Look at it, and start anew"
MODES = {
    "Idle": "",
    "Move": "another program moves it: end that one",
    "Guiding": "somebody guides it by hand: let it go, and wait",
    "UserStopped": "its user stop is pressed: look why, release it, then anther cell enable",
    "Reflex": "it stopped by itself ({errors}): look what it touched, then anther cell enable",
    "AutomaticErrorRecovery": "it recovers from an error: wait",
    "Other": "its joints are locked, or Desk has it: unlock them and activate FCI in Desk",
}
"""franka::RobotMode -> why it cannot be moved then."""


class Franka:
    """An arm whose joint positions are streamed by a `franka_loop.Loop` at the other end of a pipe."""

    _joint_count = 7

    def __init__(
        self,
        pipe: Connection,
        *,
        names: Sequence[str],
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        gone: Callable[[], Any] = lambda: None,
    ) -> None:
        """Hear the robot. Nothing moves.

        Args:
            pipe: to the loop, which is connected.
            names: (J,) of the joints, from the base.
            clock, sleep: [s]; the clock that readings are told on, and the loop's.
            gone: waits until the loop has ended.

        Raises:
            InputError: the arm model has other than seven joints.
            DeviceError: the robot is not heard.
        """
        self._pipe, self._clock, self._sleep, self._gone = pipe, clock, sleep, gone
        self._robot, self._moves, self._closed = RobotClock(), False, False
        try:
            if len(names) != self._joint_count:
                given, do = f"{len(names)} joints", 'Name the robot\'s model, such as "fr3", under [arm].'
                raise bad_input("arm model", given=given, allowed=f"{self._joint_count}", do=do)
            for _ in range(Loop.shown):  # the first states may have waited: the quickest sets the clock
                self._read()
                self._sleep(0.005)
            self.joints()
        except BaseException:
            self.close()
            raise

    def joints(self) -> Array:
        """Return the measured joint angles (J,) [rad]; refuse those that stay stale, or are no numbers."""
        return self._read_fresh().joints

    def follow(self, trajectory: JointTrajectory, watch: Watch | None = None, more: More | None = None) -> ArmRecord:
        """Follow a trajectory as `anther.robot.devices.Arm` says; the loop goes on while `more` is thought about."""
        samples, coming = list[ArmSample](), Coming(more)
        try:
            self._check_start(trajectory)
            with shorten_thread_turns(), prioritize_thread():
                self._say("move", trajectory, more is not None)
                self._moves = True
                self._until_it_ends(watch, coming, samples)
        except BaseException:
            self.hold()
            raise
        finally:
            coming.close()
        return ArmRecord.of(samples)

    def hold(self) -> None:
        """Brake if it moves; the robot then holds the arm. At rest nothing is to be done."""
        if not self._moves:
            return
        with suppress(DeviceError):  # what went wrong first is what is reported
            self._say("brake")
            until = self._clock() + ANSWER
            while self._moves and self._clock() < until:
                answer = self._receive(ANSWER)
                self._moves = answer is not None and answer[0] not in ("done", "failed")
        self._moves = False

    def cannot(self) -> str:
        """Return why the arm cannot be moved now; empty if it can."""
        return _reason(self._read())

    def describe(self) -> list[str]:
        """Return in words what is heard of the robot."""
        state = self._read_fresh()
        why, off = _reason(state), 1e3 * float(np.abs(state.joints - state.aim).max())
        return [
            f"mode {state.mode}; the newest joints are {1e3 * self._age(state):.0f} ms old, "
            f"{off:.1f} mrad off the order",
            f"commands: 1000 a second; force {state.force:.1f} N",
            f"cannot move: {why}" if why else "ready to move",
        ]

    def enable(self) -> None:
        """Recover from a reflex. The arm holds where it is. The user stop is released, and joints unlocked, by hand."""
        state = self._read()
        if state.mode == "Reflex" or (state.mode == "Idle" and state.errors):
            self._ask("recover")
        elif state.mode != "Idle":
            raise DeviceError(f"the arm cannot be enabled: {_reason(state)}.")
        seconds = 5.0
        until = self._clock() + seconds
        while why := self.cannot():
            if self._clock() > until:
                raise DeviceError(f"the robot is not ready within {seconds:g} s: {why}.")
            self._sleep(0.01)

    def close(self) -> None:
        """End the loop; a moving arm is braked."""
        if not self._closed:
            self._closed = True
            self.hold()
            self._pipe.close()
            self._gone()

    def _check_start(self, trajectory: JointTrajectory) -> None:
        state = self._read_fresh()
        if why := _reason(state):
            raise DeviceError(f"the arm cannot move: {why}.")
        if trajectory.positions.shape[1] != self._joint_count:
            raise DeviceError(
                f"the motion is one of {trajectory.positions.shape[1]} joints; allowed: {self._joint_count}."
            )

    def _until_it_ends(self, watch: Watch | None, coming: Coming[JointTrajectory], samples: list[ArmSample]) -> None:
        """Show the readings to `watch`, and pass on what comes next."""
        while True:
            if coming.there:
                self._say("next", coming.take())
            match self._receive(STALE if samples else ANSWER):
                case ("state", state):
                    self._take(state, watch, samples)
                case ("more", _):
                    coming.ask()
                case ("done", why):
                    self._moves = False
                    if why:
                        raise DeviceError(f"{why}.")
                    return
                case ("failed", said):
                    self._moves = False
                    raise DeviceError(f"the arm was stopped: {self._why(said)}.")
                case _:
                    old = f"the newest joints are {1e3 * STALE:.0f} ms old, or older; allowed: {1e3 * STALE:.0f} ms"
                    raise DeviceError(f"{old}. Check network and robot; then start anew.")

    def _take(self, state: RobotState, watch: Watch | None, samples: list[ArmSample]) -> None:
        self._robot.receive(state.stamp, state.arrival)
        when = state.stamp + self._robot.offset
        self._check(state)
        if not samples or when > samples[-1].time:
            samples.append(ArmSample(when, state.aim, state.joints, state.force))
            if watch:
                watch(samples[-1])
        self._say("seen")

    def _why(self, said: str) -> str:
        """Return why the robot ended a motion: its own mode, or what libfranka said."""
        with suppress(DeviceError):
            return _reason(self._read()) or said
        return said

    def _read(self) -> RobotState:
        state = self._ask("read")
        self._robot.receive(state.stamp, state.arrival)
        return state

    def _read_fresh(self) -> RobotState:
        until = self._clock() + 0.5  # at rest nothing moves meanwhile
        while self._age(state := self._read()) > STALE and self._clock() < until:
            pass
        return self._check(state)

    def _age(self, state: RobotState) -> float:
        return self._clock() - state.stamp - self._robot.offset

    def _check(self, state: RobotState) -> RobotState:
        check_fresh(self._age(state))
        check_finite_joints(state.joints)
        return state

    def _ask(self, *what: Any) -> Any:
        """Return what the loop answers."""
        self._say(*what)
        answer = self._receive(ANSWER)
        if answer is None:
            raise DeviceError(f"the robot says nothing for {ANSWER:g} s. Check network and robot; then start anew.")
        if answer[0] == "failed":
            raise DeviceError(f"the robot: {answer[1]}. Check network and robot; then start anew.")
        return answer[1]

    def _say(self, *what: Any) -> None:
        try:
            self._pipe.send(what)
        except OSError as error:
            raise DeviceError(f"{GONE}.") from error

    def _receive(self, seconds: float) -> tuple[str, Any] | None:
        """Return what the loop says within so many seconds; None: nothing."""
        until = self._clock() + seconds
        try:
            while not self._pipe.poll(STALE / 5):
                if self._clock() > until:
                    return None
            return self._pipe.recv()
        except (EOFError, OSError) as error:
            raise DeviceError(f"{GONE}.") from error


def open_franka(
    host: str,
    *,
    names: Sequence[str],
    acceleration: Array,
    realtime: bool = True,
    begins: str = BEGINS,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Franka:
    """Return the arm at an address, with a loop in a process of its own.

    Args:
        host: of the robot, such as "192.168.1.30".
        names: (7,) of the joints, from the base.
        acceleration: (7,) with which it brakes [rad/s^2].
        realtime: ask for a real-time kernel, as libfranka does by default.
        begins: what the loop's process runs: `_franka_loop.main`, with this clock.
        clock, sleep: [s]; the clock that readings are told on.

    Raises:
        MissingExtra: pylibfranka is not installed.
        DeviceError: the robot does not answer, or there is no such kernel.
    """
    try:
        importlib.import_module("pylibfranka")
    except ImportError as error:
        raise MissingExtra(f"arm: no pylibfranka ({error}). Install it with: pip install 'anther[franka]'.") from error
    here, there = Pipe()
    words = [sys.executable, "-c", begins, str(there.fileno())]
    where = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    loop = subprocess.Popen(
        words, pass_fds=(there.fileno(),), env=where, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    there.close()
    try:
        here.send((host, np.asarray(acceleration, dtype=float), realtime))
        what, why = here.recv() if here.poll(60.0) else ("failed", "the loop does not begin within 60 s")
    except (EOFError, OSError):
        what, why = "failed", GONE
    if what == "failed":
        here.close()
        _wait(loop)
        raise DeviceError(f"{why}.")
    return Franka(here, names=names, clock=clock, sleep=sleep, gone=lambda: _wait(loop))


def _wait(loop: subprocess.Popen[bytes]) -> None:
    """Wait until the loop, which has nobody left to serve, has ended."""
    try:
        loop.wait(ANSWER)
    except subprocess.TimeoutExpired:
        loop.kill()
        loop.wait()


def _reason(state: RobotState) -> str:
    why = MODES.get(state.mode, f"it is in the mode {state.mode}: look at Desk")
    if not why and state.errors:
        return MODES["Reflex"].format(errors=state.errors)
    return why.format(errors=state.errors or "no error told")
