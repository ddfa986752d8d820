"""What speaks to a Franka arm every millisecond: a process of its own, one thread, and nothing else in it.

Sources: FCI documentation (frankarobotics.github.io/docs: network requirements; robot specifications, limits of the
FR3); libfranka's include/franka/rate_limiting.h; docstrings of pylibfranka 0.21.3, which keeps Python's lock while it
waits for the robot: what shared it would be late, or make the loop late.

Franka's controller drops a command that comes more than a millisecond late, goes on with the last acceleration instead,
and after 20 of them in a row stops the arm by itself (communication_constraints_violation). So an arm whose loop dies
is braked by its own controller; one whose driver dies is braked by this loop.
"""

from __future__ import annotations

import gc
import importlib
import signal
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from anther.core.geometry import Array
from anther.robot.devices import LEAD, JointTrajectory
from anther.robot.drivers._holding import NEAR
from anther.robot.drivers._streamed import Reference, braking, prioritize_thread

CYCLE = 1e-3
"""Of the robot [s]."""
LATE = f"the next motion comes too late: not within {LEAD:g} s. Look at what else runs here"
PAUSED = "the loop that commands the arm was held up, and the robot stopped by itself"
CALLED_OFF = "the motion was called off"


class RobotState(NamedTuple):
    """What the robot tells. J = 7.

    Attributes:
        stamp: by the robot's clock [s].
        arrival: by this machine's [s].
        joints, aim: measured, and as the robot was last commanded (J,) [rad].
        force: size of the external force on the hand, by the robot's estimate [N].
        mode: of the robot, such as "Idle".
        errors: that stand, or, in the mode "Reflex", that ended the last motion.
        received: share of the last 100 commands that came in time; 0 outside of motions.
    """

    stamp: float
    arrival: float
    joints: Array
    aim: Array
    force: float
    mode: str
    errors: str
    received: float


class Path:
    """What is commanded, one cycle after the other: motions, joined, or the way to rest.

    Attributes:
        why: it brakes; empty while it does not.
    """

    smooth = 8
    """A command is the mean of so many moments of the motion. So the jerk of joints that accelerate with no more than
    the FR3's 10 rad/s^2 is at most 2 * 10 / 8 ms = 2500 rad/s^3, wherever the acceleration jumps. It may be 5000."""
    brakes = 0.8
    """Share of the acceleration with which it brakes: the robot refuses what is a little over it."""
    fades = 0.5
    """The arm stands a little off its command; a motion begins at the command, and the gap closes within this [s]."""

    def __init__(self, aim: Array, first: JointTrajectory, acceleration: Array, goes_on: bool) -> None:
        """Begin at the joints (J,) that the robot is commanded [rad]; brake with `acceleration` (J,) [rad/s^2]."""
        self.why = ""
        self._reference, self._begin, self._t = Reference(first), 0.0, 0.0
        self._off, self._acceleration = aim - first.positions[0], acceleration
        self._recent = deque([aim] * self.smooth, maxlen=self.smooth)
        self._waits, self._asked = goes_on, False

    @property
    def over(self) -> bool:
        """Whether the arm stands at the end, and has been given time to."""
        stands = self._t - self._begin >= self._reference.settled and self._t >= self.fades
        return stands and not self._waits

    def step(self, cycles: int) -> Array:
        """Return what is commanded (J,) [rad] so many cycles later."""
        for _ in range(cycles):
            if self._waits and self._t + CYCLE - self._begin > self._reference.ends:
                self.brake(LATE)
            self._t += CYCLE
            s = min(self._t / self.fades, 1.0)
            closed = s**3 * (10 - 15 * s + 6 * s**2)
            self._recent.append(self._reference.at(self._t - self._begin)[0] + (1 - closed) * self._off)
        return np.mean(self._recent, axis=0)

    def asks(self) -> bool:
        """Return whether it is time for the next motion to be told; once for each."""
        asks = self._waits and not self._asked and self._t - self._begin >= self._reference.ends - LEAD
        self._asked = self._asked or asks
        return asks

    def join(self, following: JointTrajectory | None) -> None:
        """Go on with a motion; None: nothing follows. A path that brakes takes none."""
        if self.why:
            return
        if following is None:
            self._waits = False
        else:
            self._reference.join(following)
        self._asked = False

    def brake(self, why: str) -> None:
        """Take the straight way to rest from here."""
        if self.why:
            return
        self.why, self._waits = why, False
        q, rate, _ = self._reference.at(self._t - self._begin)
        self._reference, self._begin = Reference(braking(q, rate, self.brakes * self._acceleration)), self._t


class Loop:
    """Serves one driver at the other end of a pipe: read, move, next, seen, brake, recover; what it says is a pair."""

    shown = 8
    """Every so many cycles a state is shown: 125 a second."""
    unseen = 0.1
    """States that nobody looked at for so long end a motion [s]."""

    def __init__(
        self, pipe: Connection, sdk: Any, robot: Any, acceleration: Array, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Take the pipe, the module pylibfranka, its Robot, and the acceleration (J,) to brake with [rad/s^2]."""
        self._pipe, self._sdk, self._robot, self._clock = pipe, sdk, robot, clock
        self._acceleration, self._gone, self._seen = acceleration, False, 0.0
        self._errors = (RuntimeError, sdk.FrankaException)
        self._flags = [name for name in dir(sdk.Errors) if not name.startswith("_")]

    def serve(self) -> None:
        """Do what is asked until nobody is left to ask. States are read all the time: one that waits grows old."""
        lost = ""
        while not self._gone:
            try:
                state = None if lost else self._read_state(self._robot.read_once())
            except self._errors as error:
                state, lost = None, words(error)
            while not self._gone and (lost or self._pipe.poll()):
                match self._receive():
                    case ("read" | "move" | "recover", *_) if state is None:
                        self._say("failed", lost)
                    case ("read",):
                        self._say("state", state)
                    case ("move", first, goes_on):
                        self._say(*self._move(first, goes_on))
                        break
                    case ("recover",):
                        self._say(*self._recover())
                        break
                    case _:  # brake, next or seen, and the motion is over
                        pass

    def _move(self, first: JointTrajectory, goes_on: bool) -> tuple[str, Any]:
        """Return how a motion ended: done, and why it was braked; or failed, and why."""
        try:
            aim = np.array(self._robot.read_once().q_d)
            far = float(np.abs(first.positions[0] - aim).max())
            if far > NEAR:
                return "done", f"the motion begins {far:.3g} rad from where the arm is; allowed: {NEAR:g}. Plan anew"
            path = Path(aim, first, self._acceleration, goes_on)
            self._run(self._robot.start_joint_position_control(self._sdk.ControllerMode.JointImpedance), path)
        except self._errors as error:
            return "failed", words(error)
        return "done", path.why

    def _run(self, control: Any, path: Path) -> None:
        cycles, self._seen, over = 0, self._clock(), False
        # After so many cycles without a command the robot has stopped by itself: send nothing that goes on.
        lost = 20
        while not over:
            state, passed = control.readOnce()
            steps, now = round(passed.to_sec() / CYCLE), self._clock()
            if steps > lost:
                raise RuntimeError(PAUSED)
            command = self._sdk.JointPositions(path.step(steps).tolist())
            if self._clock() - now > lost * CYCLE:
                raise RuntimeError(PAUSED)
            over = command.motion_finished = path.over
            control.writeOnce(command)
            if cycles % self.shown == 0 or over:
                self._say("state", self._read_state(state))
            cycles += 1
            if path.asks():
                self._say("more", None)
            while not self._gone and self._pipe.poll():
                self._take(path)
            if self._gone:
                path.brake(CALLED_OFF)
            elif self._clock() - self._seen > self.unseen:
                idle = f"nobody looked at the arm's readings for {self.unseen:g} s"
                path.brake(f"{idle}. Let nothing else run on this machine")

    def _take(self, path: Path) -> None:
        match self._receive():
            case ("seen",):
                self._seen = self._clock()
            case ("next", following):
                path.join(following)
            case ("brake",):
                path.brake(CALLED_OFF)
            case _:
                pass

    def _recover(self) -> tuple[str, str]:
        try:
            self._robot.automatic_error_recovery()
        except self._errors as error:
            return "failed", words(error)
        return "done", ""

    def _read_state(self, state: Any) -> RobotState:
        mode = state.robot_mode.name
        errors = state.last_motion_errors if mode == "Reflex" else state.current_errors
        return RobotState(
            stamp=state.time.to_sec(),
            arrival=self._clock(),
            joints=np.array(state.q, dtype=float),
            aim=np.array(state.q_d, dtype=float),
            force=float(np.linalg.norm(state.O_F_ext_hat_K[:3])),
            mode=mode,
            errors=", ".join(name for name in self._flags if getattr(errors, name)),
            received=state.control_command_success_rate,
        )

    def _receive(self) -> tuple[Any, ...]:
        try:
            return self._pipe.recv()
        except (EOFError, OSError):
            self._gone = True
            return ("gone",)

    def _say(self, what: str, value: Any) -> None:
        try:
            self._pipe.send((what, value))
        except OSError:
            self._gone = True


def words(error: Exception) -> str:
    """Return what libfranka says, in one line."""
    return " ".join(str(error).split()).removeprefix("libfranka: ").removeprefix("libfranka robot: ").rstrip(".!")


def connect(sdk: Any, host: str, realtime: bool) -> tuple[Any, str]:
    """Return a Robot, or None and why there is none."""
    config = sdk.RealtimeConfig.kEnforce if realtime else sdk.RealtimeConfig.kIgnore
    try:
        robot = sdk.Robot(host, config)
        robot.read_once()
    except sdk.RealtimeException as error:
        do = "Install a kernel with PREEMPT_RT; to try without one, realtime = false under [arm]"
        return None, f"{words(error)}. {do}"
    except (RuntimeError, sdk.FrankaException) as error:
        do = "Check the address and the cable, and that FCI is activated in Desk"
        return None, f"no Franka arm answers at {host}: {words(error)}. {do}"
    return robot, ""


def main(clock: Callable[[], float] = time.monotonic) -> None:
    """Serve the driver behind the inherited file descriptor that is named on the command line; clock: [s], its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the driver too: it asks for the stop
    pipe = Connection(int(sys.argv[1]))
    host, acceleration, realtime = pipe.recv()
    sdk = importlib.import_module("pylibfranka")
    robot, why = connect(sdk, host, realtime)
    with suppress(OSError):
        pipe.send(("failed", why) if why else ("ready", ""))
    if robot is not None:
        gc.freeze()
        gc.disable()  # nothing here makes cycles, and collecting takes milliseconds
        with prioritize_thread():
            Loop(pipe, sdk, robot, acceleration, clock).serve()
