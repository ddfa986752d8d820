"""Drivers of a served cell (`served_cell.py`): Anther's own, going by the cell's clock.

The cameras' frames come over a socket and are handed to the SDK's `software_device`, which the driver then reads.
"""

from __future__ import annotations

import sys
import threading
from multiprocessing.connection import Client
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[1]))
from made_realsense import SoftwareCamera
from served_world import World

from anther.core.geometry import Intrinsics
from anther.robot.arm.model import ArmModel
from anther.robot.devices import Frame
from anther.robot.drivers import _franka_loop, free_running, realsense
from anther.robot.drivers._streamed import Reference
from anther.robot.drivers.franka import Franka, open_franka
from anther.robot.drivers.intera import types
from anther.robot.drivers.robotiq import Robotiq2F, open_line
from anther.robot.drivers.ros1 import Node
from anther.robot.drivers.sawyer_ros1 import Sawyer

IDLE = 1.0
"""Between two frames that nobody waits for [s]: rendering costs more than a camera does."""
free_running.STALLED = realsense.STALLED = 30.0  # s of the wall: the cell is slower


def arm(master: str, *, world: str, speed_ratio: float) -> Sawyer:
    time = World(world)
    node = Node(master, "/anther", types())
    return TimedSawyer(node, mode="trajectory", speed_ratio=speed_ratio, clock=time.clock, sleep=time.sleep)


class TimedSawyer(Sawyer):
    """A command says by the cell's clock for when it is: the served controller goes by that."""

    _motion: Reference | None = None
    _begun, _when = 0.0, None

    def _aim(self, reference: Reference, t: float) -> None:
        if reference is not self._motion:
            self._motion, self._begun = reference, self._clock() - t
        self._when = self._begun + t
        super()._aim(reference, t)
        self._when = None

    def _message(self, *aims: Any) -> Any:
        message, when = super()._message(*aims), self._clock() if self._when is None else self._when
        message.header.stamp = self._make("builtin_interfaces/msg/Time", int(when), int(when % 1 * 1e9))
        return message


def franka(host: str, *, world: str, arm_model: ArmModel) -> Franka:
    time, what = World(world), {"names": arm_model.joints, "acceleration": arm_model.acceleration}
    begins = f"import served; served.franka_loop({world!r})"
    return open_franka(host, **what, realtime=False, begins=begins, clock=time.clock, sleep=time.sleep)


def franka_loop(world: str) -> None:
    """Be the process with a Franka's loop."""
    _franka_loop.main(World(world).clock)


def gripper(port: str, *, world: str, counts: tuple[int, int]) -> Robotiq2F:
    time = World(world)
    return Robotiq2F(open_line(port), counts=counts, clock=time.clock, sleep=time.sleep)


class ServedCamera(free_running.FreeRunningCamera):
    """A RealSense of the SDK's own making that shows what a served cell renders.

    While nobody wants them it gives fewer frames, to spare the machine.
    """

    def __init__(self, port: int, *, world: str, rate: float = 30.0) -> None:
        self._world, self._rate, self._over = World(world), rate, threading.Event()
        self._records, self._waiting = False, 0
        self._line: Any = Client(("127.0.0.1", port))
        self._eye = _software(self._line.recv())
        source = realsense.RealSense(clock=self._world.clock, devices=lambda: [self._eye.device])
        threading.Thread(target=self._feed, daemon=True).start()
        super().__init__(source, warm_up=1)

    @property
    def rates(self) -> tuple[float, ...]:
        return tuple(self._rate / n for n in (1, 2, 3, 4, 6))  # what it gives while nobody records tells nothing

    def start(self, rate: float) -> None:
        self._world.recorded = self._records = True
        super().start(rate)

    def stop(self) -> list[Frame]:
        self._world.recorded = self._records = False
        return super().stop()

    def close(self) -> None:
        self._over.set()
        super().close()

    def _feed(self) -> None:
        number, last = 0, -1.0
        while not self._over.is_set():
            wanted = self._records or self._waiting > 0 or number < 5
            period = 1 / self._rate if wanted else IDLE
            due = last + period
            self._world.sleep(min(max(due - self._world.clock(), 0.0), 1 / self._rate))
            now = self._world.clock()
            if now < due:
                continue
            gap, last, number = now - last, due if now < due + period else now, number + 1
            self._line.send("next")
            time, depth, rgb = self._line.recv()
            self._eye.deliver(number, time, depth, rgb, rate=0.9 / max(gap, period))


def _software(camera: Intrinsics) -> SoftwareCamera:
    seen = {"width": camera.width, "height": camera.height, "fx": camera.fx, "fy": camera.fy}
    seen |= {"ppx": camera.cx, "ppy": camera.cy}
    words: dict[str, Any] = {"depth": seen, "colour": seen, "lens": (0.0,) * 5, "turn": 0.0, "shift": (0.0,) * 3}
    return SoftwareCamera(realsense.load_sdk(), **words)
