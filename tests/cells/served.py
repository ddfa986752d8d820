"""Drivers of a served cell (`served_cell.py`): Anther's own, going by the cell's clock.

The cameras' frames come over a socket and are handed to the SDK's `software_device`, which the driver then reads.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import threading
from multiprocessing import Pipe
from multiprocessing.connection import Client, Connection
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[1]))
from made_realsense import SoftwareCamera
from served_world import World

from anther.arm.model import ArmModel
from anther.devices import DeviceError, Frame
from anther.drivers import free_running, realsense
from anther.drivers._franka_loop import Loop, connect
from anther.drivers._priority import served_first
from anther.drivers.franka import Franka
from anther.drivers.intera import types
from anther.drivers.robotiq import Robotiq2F, open_line
from anther.drivers.ros1 import Node
from anther.drivers.sawyer_ros1 import Sawyer
from anther.geometry import Intrinsics

IDLE = 1.0
"""Between two frames that nobody waits for [s]: rendering costs more than a camera does."""
free_running.STALLED = realsense.STALLED = 30.0  # s of the wall: the cell is slower


def arm(master: str, *, world: str, speed_ratio: float) -> Sawyer:
    time = World(world)
    node = Node(master, "/anther", types())
    return Sawyer(node, mode="trajectory", speed_ratio=speed_ratio, clock=time.clock, sleep=time.sleep)


def franka(host: str, *, world: str, arm_model: ArmModel) -> Franka:
    """As `drivers.franka.open_franka`, but for the clock of driver and loop."""
    time, (here, there) = World(world), Pipe()
    words = [sys.executable, "-c", "import served; served.command()", str(there.fileno()), host, world]
    where = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    loop = subprocess.Popen(words, pass_fds=(there.fileno(),), env=where, stdin=subprocess.DEVNULL)
    there.close()
    here.send(arm_model.acceleration)
    why = here.recv()
    if why:
        raise DeviceError(why)
    return Franka(here, names=arm_model.joints, clock=time.clock, sleep=time.sleep, gone=loop.wait)


def command() -> None:
    """Be the process with the loop."""
    number, host, world = sys.argv[1:]
    pipe, sdk = Connection(int(number)), importlib.import_module("pylibfranka")
    acceleration = pipe.recv()
    robot, why = connect(sdk, host, realtime=False)
    pipe.send(why)
    if robot is not None:
        with served_first():
            Loop(pipe, sdk, robot, acceleration, World(world).clock).serve()


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
        return tuple(self._rate / n for n in free_running.PARTS)  # what it gives while nobody records tells nothing

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
