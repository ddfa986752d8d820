"""For `protocol_faults.py`: a Sawyer, a Robotiq and two cameras behind their own protocols, and what can befall them.

There is no world: joints go where they are told, and the pads close on something of `THICK`. The cameras are the SDK's
own `software_device`, which lives in Anther's process and gives frames while a file says that it is plugged in.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from fake_robotiq import FakeRobotiq
from fake_ros_master import FakeMaster
from fake_sawyer import FakeSawyer
from made_realsense import SoftwareCamera, colours, depth_steps

from anther.robot.arm.sawyer import SAWYER
from anther.robot.drivers import realsense
from anther.robot.drivers.free_running import FreeRunningCamera
from evaluation.robustness.faulty_machines import PUSH

TEMPLATE = Path(__file__).parents[2] / "tests" / "support" / "cells" / "sawyer.toml"
THICK = 0.008
"""Of the stem between the pads [m]."""
STROKE = 0.085  # m, of a Robotiq 2F-85
LOSS = 0.05  # of the messages
LATE = 0.2  # s
FRAMES = 30.0  # Hz
TURN = 1e-4
"""The machines' threads take turns every so often [s]: with Python's 5 ms a command waited up to 25 ms to be heard."""
MOVES, WAITS = 0.05, 3.0  # rad/s of a joint that moves; s that are waited for one


class Lossy(FakeSawyer):
    """A fake Sawyer of whose messages, and of whose commands, a share `lost` never arrives.

    Attributes:
        ways: (time, age) [s] of each command when it was taken, by its own stamp.
    """

    def __init__(self, master: str, joints: np.ndarray) -> None:
        self.lost, self._rng, self.ways = 0.0, np.random.default_rng(0), list[tuple[float, float]]()
        super().__init__(master, rate=100.0, joints=joints)
        says = self._joints.publish
        self._joints.publish = lambda message: None if self._rng.random() < self.lost else says(message)

    def _command(self, message: Any) -> None:
        told, now = message.header.stamp, time.time()
        self.ways.append((self.clock(), now - told.sec - 1e-9 * told.nanosec))
        if self._rng.random() >= self.lost:
            super()._command(message)


class Machines:
    """The machines of one cell.

    Attributes:
        file: the cell file.
        robot, gripper: the fakes; `robot` is another one after its node died.
    """

    def __init__(self, folder: Path, joints: np.ndarray) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        sys.setswitchinterval(TURN)
        self.file, self._folder, self._master = folder / "cell.toml", folder, FakeMaster()
        self.robot, self.gripper = Lossy(self._master.uri, joints), FakeRobotiq()
        self.gripper.active = True
        share = (self.gripper.highest - self.gripper.lowest) / STROKE
        self.gripper.thick = round(self.gripper.highest - share * THICK)
        self.gripper.count = float(self.gripper.lowest)
        self._past: list[tuple[float, np.ndarray]] = []
        for which in ("wrist", "side"):
            self.plug(which, True)
        self._write()

    def plug(self, which: str, there: bool) -> None:
        """Plug a camera in, or pull it out."""
        (self._folder / which).write_text("1" if there else "0")

    def freeze(self, which: str) -> None:
        """Let a camera show one picture again and again."""
        (self._folder / which).write_text("frozen")

    @property
    def opening(self) -> float:
        """Between the pads [m]."""
        way = self.gripper.highest - self.gripper.count
        return STROKE * way / (self.gripper.highest - self.gripper.lowest)

    def log(self) -> tuple[np.ndarray, np.ndarray]:
        """Return times (T,) [s] and joints (T, 7) [rad] of all that the arm did."""
        rows = [*self._past, *self.robot.log]
        return np.array([t for t, _ in rows]), np.array([q for _, q in rows])

    def strike(self, kind: str) -> None:
        """Let something befall them."""
        robot, gripper = self.robot, self.gripper
        acts: dict[str, Callable[[], Any]] = {
            "the robot's node dies": robot.close,
            "the master dies": self._master.stop,
            "readings 200 ms late": lambda: setattr(robot, "lag", LATE),
            "5 % of messages lost": lambda: setattr(robot, "lost", LOSS),
            "the robot's clock jumps": lambda: setattr(robot, "ahead", robot.ahead - 1.0),
            "joints not a number": lambda: setattr(robot, "offset", np.full(7, np.nan)),
            "joints renamed": lambda: setattr(robot, "names", [f"left_j{i}" for i in range(9)]),
            "a joint missing": lambda: setattr(robot, "names", ["head_pan", *SAWYER.joints[:-1], "torso_t0"]),
            "joints in another order": lambda: setattr(robot, "names", sorted(robot.names, reverse=True)),
            "joints silent": lambda: setattr(robot, "mute", True),
            "stale with noise": lambda: setattr(robot, "frozen", robot.q.copy()),
            "one joint stale": self._freeze_one,
            "gripper silent": lambda: setattr(gripper, "mute", True),
            "gripper jams": lambda: setattr(gripper, "stuck", True),
            "gripper says that it holds": lambda: setattr(gripper, "met", 2),
            "gripper feels nothing": lambda: setattr(gripper, "met", 3),
            "gripper reports a fault": lambda: setattr(gripper, "fault", 0x0C),
            "side camera unplugged": lambda: self.plug("side", False),
            "wrist camera unplugged": lambda: self.plug("wrist", False),
            "side camera frozen": lambda: self.freeze("side"),
            "stop button": lambda: setattr(robot, "pressed", True),
            "cuff held": lambda: setattr(robot, "cuff", True),
            "robot feels a collision": lambda: setattr(robot, "collided", True),
            "robot reports an error": lambda: setattr(robot, "error", True),
            "robot switched off": lambda: setattr(robot, "enabled", False),
            "pushed": lambda: setattr(robot, "force", PUSH),
            "arm force stuck": lambda: setattr(robot, "dead", True),
            "arm force not a number": lambda: setattr(robot, "force", np.nan),
            "arm force silent": lambda: setattr(robot, "numb", True),
        }
        acts[kind]()

    def _freeze_one(self) -> None:
        """Freeze what is told of the joint that moves most, once one moves."""
        robot, until = self.robot, time.monotonic() + WAITS
        while np.abs(robot.v).max() < MOVES and time.monotonic() < until:
            time.sleep(0.005)
        robot.frozen = np.where(np.arange(7) == np.abs(robot.v).argmax(), robot.q, np.nan)

    def repair(self) -> None:
        """Put everything right, as a person would; a robot that was stopped must still be enabled."""
        robot = self.robot
        if robot._over or not self._alive():
            for end in (robot.close, self._master.stop):
                with suppress(Exception):  # one of them is gone
                    end()
            self._past += robot.log
            self._master = FakeMaster()
            self.robot = robot = Lossy(self._master.uri, robot.q.copy())
            self._write()
        robot.lag = robot.lost = 0.0
        robot.frozen = np.full(7, np.nan)
        robot.offset, robot.names = np.zeros(7), ["head_pan", *reversed(SAWYER.joints), "torso_t0"]
        robot.pressed = robot.cuff = robot.collided = robot.mute = False
        robot.dead = robot.numb = False
        robot.force, self.gripper.fault, self.gripper.met = 1.0, 0, None
        self.gripper.mute = self.gripper.stuck = False
        for which in ("wrist", "side"):
            self.plug(which, True)

    def close(self) -> None:
        """Switch everything off."""
        with suppress(Exception):
            self.robot.close()
        with suppress(Exception):
            self.gripper.close()
        with suppress(Exception):
            self._master.stop()

    def _alive(self) -> bool:
        return bool(self._master._server.socket.fileno() >= 0)

    def _write(self) -> None:
        text = TEMPLATE.read_text().replace("speed_ratio = 0.3", "speed_ratio = 1.0")
        told = {"MASTER": self._master.uri, "GRIPPER": f"tcp://127.0.0.1:{self.gripper.port}"}
        for word, value in told.items():
            text = text.replace(f'"{word}"', json.dumps(value))
        for which in ("wrist", "side"):
            plug = f'driver = "{__name__}:PluggedCamera"\nplug = {json.dumps(str(self._folder / which))}'
            text = text.replace('driver = "fake_robot:FakeCamera"', plug, 1)
        self.file.write_text(text.replace('driver = "robotiq-2f"', 'driver = "robotiq-2f"\ncounts = [3, 228]'))


class PluggedCamera(FreeRunningCamera):
    """A RealSense of the SDK's own making that gives made-up frames while a file says that it is plugged in, and the
    same picture in each while it says that it is frozen."""

    def __init__(self, plug: str) -> None:
        self._plug, self._over = Path(plug), threading.Event()
        self._eye = SoftwareCamera(realsense.load_sdk())
        source = realsense.RealSense(devices=lambda: [self._eye.device] if self._in else [])
        threading.Thread(target=self._feed, daemon=True).start()
        super().__init__(source, warm_up=2)

    @property
    def _in(self) -> bool:
        return self._plug.read_text() != "0"

    def close(self) -> None:
        """End."""
        self._over.set()
        super().close()

    def _feed(self) -> None:
        number = 0
        value = self._eye.rs.frame_metadata_value
        while not self._over.wait(1 / FRAMES):
            number += 1
            if not self._in:
                continue
            for sensor in self._eye.sensors:
                sensor.set_metadata(value.frame_timestamp, round(1e6 * number / FRAMES))
                sensor.set_metadata(value.sensor_timestamp, round(1e6 * number / FRAMES))
            shown = 0 if self._plug.read_text() == "frozen" else number % 8
            with suppress(RuntimeError):  # while it is closed
                stamp = time.time() - 0.002
                self._eye.deliver(number, stamp, depth_steps(shown), colours(shown), late=0.001, domain="global_time")
