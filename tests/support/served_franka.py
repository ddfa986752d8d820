"""An arm behind libfranka's own protocol: franka-sim's server, with an arm of ours.

franka-sim is installed without what it needs (its server wants numpy alone): `pip install --no-deps
franka-sim==1.1.7`. Its states count the steps of the world, which waits until each is told.
"""

from __future__ import annotations

import select
import threading
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any

import numpy as np
from served_controller import Timed, along, references
from served_world import World

from anther.sim import cell
from anther.sim._motor import sensed_force

NO_SERVER = "no franka-sim; run: pip install --no-deps franka-sim==1.1.7"
CYCLE = 1e-3  # s
BEHIND = 0.008  # s by which the controller is: commands come up to a few cycles late
LEAST, KEPT = 3, 40  # commands
DRIFT = 1e-3  # by so much the cycles of the server may be longer than those of the world
SILENCE = 0.02  # s without a command, after which it brakes, as hard as it may
PATIENCE = 0.5  # s of the wall in which a cycle is told; else the cell goes on without
SAME = 1e-5  # s: what rounding leaves between times that are one


def has_server() -> bool:
    return find_spec("franka_sim") is not None


class Controller:
    """Leads an arm along the joints that a server is told, or goes on with, in its cycles of a millisecond.

    Attributes: `q`, `v`, where it leads the arm.
    """

    def __init__(self, world: Timed, q: np.ndarray) -> None:
        self._world, self.q, self.v = world, q, np.zeros(7)
        self._commands, self._zero = [(0.0, q.copy())], 0.0  # by the server's clock, which began then by the world's

    def push(self, when: float, dt: float) -> np.ndarray:
        told, q = zip(*self._commands, strict=True)
        at = when - self._zero
        if len(told) < LEAST or at - told[-1] > SILENCE:
            return -self.v / dt
        aims = list(zip(told, q, np.gradient(q, told, axis=0, edge_order=2), strict=True))
        return along(self, aims, at - BEHIND, self._world.arm.acceleration)

    def command(self, cycle: int, q: Sequence[float]) -> None:
        """Take the joints (7,) that were told in a cycle of the server.

        When that was by the world's clock, the command that came soonest says: that one waited tells nothing of the
        motion.
        """
        zero, told = self._world.time - cycle * CYCLE, cycle * CYCLE
        soonest = min(self._zero + DRIFT * CYCLE, zero)
        self._zero = soonest if zero - soonest < SILENCE else zero
        before = [command for command in self._commands if command[0] < told - 0.5 * CYCLE]
        self._commands = [*before[-KEPT:], (told, np.array(q, dtype=float))]

    def rest(self) -> None:
        """Brake: the server's motion is over."""
        self._commands = self._commands[-1:]


class FrankaServer(Controller):
    """Serves an arm: what the server takes for its physics. `references` and `tell` are called for every cycle.

    Attributes: `batch`, `told_every`, in steps of the world.
    """

    batch = told_every = 1
    enable_vis = False

    def __init__(self, host: str, world: Timed, shared: World, q: np.ndarray) -> None:
        super().__init__(world, q)
        self._over, self._turn, self._told = threading.Event(), threading.Condition(), 0.0
        self._snapshot: dict[str, Any] = {}
        self.tell()
        # The thread that tells states goes by the world's steps. While it waits for commands to be taken in, the world
        # stands, so those sleeps are of the wall; SAME, lest rounding make it wait for a cycle that is over.
        _set_clock("state_stream", lambda: world.time, self._wait)
        _set_clock("motion_session", lambda: world.time + SAME, time.sleep)
        _set_clock("set_commands", shared.clock, shared.sleep)
        self._server = _server(self)(
            host=host, physics_sim=self, enable_gripper=False, enforce_comm_constraints=True, enforce_motion_limits=True
        )
        threading.Thread(target=self._server.start, daemon=True).start()

    def seen(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return where the arm is: joints and rates (7,), and the force on its hand (3,) [N]."""
        return self.q, self.v, np.zeros(3)

    def close(self) -> None:
        self._over.set()
        self._server.stop()

    def references(self, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return joints, rates and accelerations (steps, 7) of the next steps of the world."""
        self._keep_up()
        return references(self, self._world, steps)

    def tell(self) -> None:
        """Put down what the server is to say of the arm."""
        q, v, force = self.seen()
        arm = self._world.arm
        self._snapshot = {
            "q": q,
            "dq": v,
            "ddq": np.zeros(7),
            "q_d": self._commands[-1][1],
            "dq_d": v,
            "ddq_d": np.zeros(7),
            "tau_J": np.zeros(7),
            "O_T_EE": arm.forward(q).T.flatten(),
            "O_dP_EE": np.zeros(3),
            "O_J_EE": arm.jacobian(q),
            "O_F_ext_hat_K": [*force, 0.0, 0.0, 0.0],
            "self_collision": None,
        }

    # What the server asks of its physics.

    def initialize_simulation(self) -> None: ...

    def start(self) -> None:
        self._over.wait()

    def stop(self) -> None: ...

    def set_control_mode(self, mode: Any) -> None: ...

    def update_torques(self, torques: Any) -> None: ...

    def update_joint_velocities(self, velocities: Any) -> None:
        raise NotImplementedError("the served arm is told joints")

    def update_joint_positions(self, positions: Any) -> None: ...  # `command` was told them, and when

    def get_robot_state(self) -> dict[str, Any]:
        return self._snapshot

    def _wait(self, seconds: float) -> None:
        """Let the world go on for so long [s]."""
        with self._turn:
            self._told = self._world.time + seconds
            self._turn.notify_all()
            while self._world.time < self._told - SAME and not self._over.is_set():
                self._turn.wait(0.1)

    def _keep_up(self) -> None:
        """Wait until the server has told the world's present cycle, and has taken in what it was commanded."""
        server, until = self._server, time.monotonic() + PATIENCE
        with self._turn:
            self._turn.notify_all()
            while server.transmitting_state and time.monotonic() < until:
                told = self._world.time < self._told - SAME
                if told and not server._commands_in_flight and not _unread(server.udp_socket):
                    return
                self._turn.wait(2e-4)


class ServedFranka(FrankaServer):
    """MuJoCo's arm, served."""

    def __init__(self, host: str, world: cell.Cell, shared: World) -> None:
        self._cell = world
        super().__init__(host, world, shared, world.joints)

    def seen(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        place = self._cell
        return place.joints, place.data.qvel[place._arm_dofs].copy(), sensed_force(place)


def _set_clock(module: str, clock: Callable[[], float], sleep: Callable[[float], None]) -> None:
    """Let a module of the server go by a clock [s]."""
    words = dict.fromkeys(("time", "perf_counter", "monotonic"), clock)
    vars(import_module(f"franka_sim.server.{module}"))["time"] = SimpleNamespace(sleep=sleep, **words)


def _unread(socket: Any) -> bool:
    try:
        return socket is not None and bool(select.select([socket], [], [], 0)[0])
    except (OSError, ValueError):  # it was closed meanwhile
        return False


def _server(arm: FrankaServer) -> Any:
    """Return the server's class, which says in which cycle a command belongs, and when a motion is over."""
    base = import_module("franka_sim.franka_sim_server").FrankaSimServer

    class Server(base):  # type: ignore[misc,valid-type]
        def _dispatch_control_command(self, command: dict[str, Any], **words: Any) -> None:
            arm.command(command["message_id"], command["q_c"])
            super()._dispatch_control_command(command, **words)

        def _switch_to_hold_position(self) -> None:
            arm.rest()
            super()._switch_to_hold_position()

    return Server
