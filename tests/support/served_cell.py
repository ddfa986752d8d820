"""MuJoCo's cell served as machines: a Sawyer over ROS 1 or a Franka over libfranka's protocol, a Robotiq over Modbus,
cameras that `cells/served.py` shows as RealSense. As a program it serves one plant until its input ends, and judges
what was done to it.

    python tests/support/served_cell.py FOLDER MASTER SPECIES SEED [--truth wide] [--arm fr3]

MASTER is the ROS master's address, or that at which the Franka answers. FOLDER gets the cell file that
`anther trial --cell` takes, and the world that all share.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from fake_robotiq import FakeRobotiq
from fake_sawyer import FakeSawyer
from made_realsense import UNIT
from served_controller import Aim, along, catching_up, references
from served_franka import ServedFranka
from served_world import World

from anther.core.choices import ArmName, Crop
from anther.robot.arm.arms import simulated_arm
from anther.robot.arm.model import ArmModel
from anther.robot.arm.sawyer import SAWYER
from anther.sim import cell
from anther.sim._motor import sensed_force
from anther.sim.capture import camera_errors, perturbed_hand_eye
from anther.sim.judge import judge
from anther.sim.robot import robot_of
from anther.sim.simulated_cell import grow, layout, usual_distance
from anther.sim.truth import NOMINAL, Truth, draw

FILES: dict[ArmName, str] = {"sawyer": "sawyer_ros1.toml", "fr3": "franka.toml"}
CELLS = Path(__file__).parent / "cells"
RENDERED = 0.05  # of the wall's time: in which one core renders 30 frames a second and decides in 0.3 s
BEHIND = 0.025  # s by which a Sawyer's controller is: it goes between commands 10 ms apart, which may come that late
FORCE = 20.0  # N: the least a Robotiq 2F-85 can be set to
STROKE = 0.085  # m, of a 2F-85; the fingers of this cell open `SAWYER.tool.stroke`


@dataclass(frozen=True)
class Plant:
    """Which plant is served."""

    species: Crop
    seed: int
    truth: str
    arm: ArmName = "sawyer"

    @property
    def model(self) -> ArmModel:
        return simulated_arm(self.arm)

    @property
    def distance(self) -> float:
        return usual_distance(self.model)

    def drawn(self) -> Truth:
        return draw(self.seed) if self.truth == "wide" else NOMINAL

    def world(self) -> cell.Cell:
        truth = self.drawn()
        params, arm = cell.Params(grip_force=FORCE), self.model
        return cell.Cell(grow(self.species, self.seed, 0.0, self.distance, truth), arm.waiting, params, truth, arm)


class ServedSawyer(FakeSawyer):
    """The fake Sawyer's topics, with MuJoCo's arm behind them. It has no thread: `references` and `tell` are called.

    Its controller goes from command to command, each at the time that it says by the cell's clock
    (`cells/served.py`), and catches up where one came late.
    """

    batch, told_every = 2, 10  # steps of the world, of 1 ms

    def __init__(self, master: str, world: cell.Cell) -> None:
        self._world, self._commands = world, list[tuple[int, Aim]]()
        super().__init__(master, joints=world.joints, clock=lambda: world.time)

    def _run(self) -> None:
        pass

    def close(self) -> None:
        self.node.close()

    def references(self, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return joints, rates and accelerations (steps, 7) of the next steps of the world."""
        return references(self, self._world, steps)

    def push(self, when: float, dt: float) -> np.ndarray:
        commands = self._commands  # another thread may put new ones into its place
        if not commands or not self.enabled:
            return -self.v / dt
        mode, (told, q, _) = commands[-1]
        if mode == 1:
            return catching_up(q - self.q, -self.v, SAWYER.acceleration, self.ratio * SAWYER.velocity)
        if when - told > self.timeout:
            return -self.v / dt
        return along(self, [aim for of, aim in commands if of == mode], when - BEHIND, SAWYER.acceleration)

    def tell(self) -> None:
        """Publish what its encoders read, and the force at its flange."""
        reference, self.q = self.q, self._world.joints
        self.force = float(np.linalg.norm(sensed_force(self._world)))
        self._tell()
        self.q = reference

    def _command(self, message: Any) -> None:
        order = [message.names.index(name) for name in SAWYER.joints]
        rate = message.velocity[order] if message.mode == 4 else np.zeros(7)
        told = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self._commands = [*self._commands[-4:], (message.mode, (told, message.position[order], rate))]

    def _enable(self, message: Any) -> None:
        super()._enable(message)
        self._commands = []


class ServedRobotiq(FakeRobotiq):
    """The fake Robotiq's registers, with MuJoCo's fingers behind them: they close until they press with `FORCE`.

    Attributes: `command`, the opening that the fingers are sent to [m].
    """

    def __init__(self, world: cell.Cell) -> None:
        self._world, self.command, self._met, self._heard, self._closing = world, world.opening, 3, 0, False
        super().__init__()
        self.active = True

    def step(self, seconds: float) -> None:
        """Go on with the motion that was commanded."""
        world, count = self._world, STROKE / (self.highest - self.lowest)
        way, here = SAWYER.tool.speed * seconds, world.opening
        goal = min(STROKE - count * (self._goal - self.lowest), SAWYER.tool.stroke)
        if len(self.writes) > self._heard:
            self._heard, self._met, self._closing = len(self.writes), 0, goal < here
        if not self._word & 8 or self._met:
            return
        if self.command != goal and (self._closing == (goal < self.command)):
            self.command += min(max(goal - self.command, -way), way)
        elif abs(here - goal) <= 0.5 * count or not self._closing:
            self._met = 3 if abs(here - goal) < count else 0
        elif here > goal and world.grip_force < 0.9 * FORCE:
            self.command = max(self.command - 0.1 * way, 0.0)
        else:
            self._met = 2

    def _move(self) -> None:
        self.count = self.lowest + (STROKE - self._world.opening) * (self.highest - self.lowest) / STROKE

    def _status(self) -> list[int]:
        bits = 1 | self._word & 8 | 3 << 4 | self._met << 6
        return [bits << 8, self.fault << 8 | self._goal, round(self.count) << 8]


def show(plant: Plant, which: str, path: str, pipe: Connection) -> None:
    """Render what one camera sees of the shared world, as often as somebody asks: a process of its own."""
    threading.Thread(target=_end_with, args=(pipe,), daemon=True).start()
    place, world, truth = plant.world(), World(path), plant.drawn()
    T_side = layout(plant.distance).T_world_side_camera
    robot = robot_of(place, errors=camera_errors(truth), T_world_side_camera=T_side, seed=plant.seed)
    camera: Any = robot.side_camera if which == "side" else robot.wrist_camera
    if which == "wrist":
        rng = np.random.default_rng([plant.seed, 1])
        T_flange_cam = perturbed_hand_eye(SAWYER.tool.T_flange_cam, rng, factor=truth.hand_eye_error)
        camera.pose = lambda: place.flange_pose() @ T_flange_cam
    listener = Listener(("127.0.0.1", 0))
    pipe.send(listener.address)
    while True:
        with listener.accept() as client:
            client.send(camera.intrinsics)
            try:
                while True:
                    client.recv()
                    place.data.time, place.data.qpos[:] = world.clock(), world.qpos()
                    mujoco.mj_kinematics(place.model, place.data)
                    frame = camera.read()
                    steps = np.rint(frame.depth / UNIT)
                    far = steps > np.iinfo(np.uint16).max
                    client.send((frame.time, np.where(far, 0, steps).astype(np.uint16), frame.rgb))
            except (EOFError, OSError):
                pass


def _end_with(pipe: Connection) -> None:
    """End this process when whoever began it is gone."""
    with suppress(EOFError, OSError):
        pipe.recv()
    os._exit(0)


class Served:
    """The machines of one plant, served while `go_on` is called.

    Attributes: `file`, the cell file; `place`, MuJoCo's world.
    """

    def __init__(self, plant: Plant, folder: Path, master: str, rate: float = 0.5) -> None:
        """Begin to serve; rate: how fast the cell's time goes at most, by the wall's."""
        folder.mkdir(parents=True, exist_ok=True)
        self.place, self._rate = plant.world(), rate
        self._shared = World(folder / "world", count=self.place.model.nq)
        self._share()
        self._arm: ServedSawyer | ServedFranka = (
            ServedSawyer(master, self.place)
            if plant.arm == "sawyer"
            else ServedFranka(master, self.place, self._shared)
        )
        self._gripper = ServedRobotiq(self.place)
        self._renderers, self._pipes = [], dict[str, Connection]()
        for which in ("wrist", "side"):
            ours, theirs = get_context("spawn").Pipe()
            words = (plant, which, str(folder / "world"), theirs)
            process = get_context("spawn").Process(target=show, args=words, daemon=True)
            process.start()
            self._renderers.append(process)
            theirs.close()
            self._pipes[which] = ours
        told = {
            "MASTER": master,
            "ROBOT": master,
            "GRIPPER": f"tcp://127.0.0.1:{self._gripper.port}",
            "WORLD": str(folder / "world"),
        }
        told |= {which.upper(): pipe.recv()[1] for which, pipe in self._pipes.items()}
        text = (CELLS / FILES[plant.arm]).read_text()
        for word, value in told.items():
            text = text.replace(f'"{word}"', json.dumps(value))
        self.file = folder / "cell.toml"
        self.file.write_text(text)
        self._due = time.monotonic()

    def close(self) -> None:
        for process in self._renderers:
            process.kill()
        self._arm.close()
        self._gripper.close()

    def go_on(self) -> None:
        """Advance the world by a batch of steps, no faster than its rate."""
        place, dt, batch = self.place, self.place.timestep, self._arm.batch
        q, v, a = self._arm.references(batch)
        openings = np.empty(batch)
        for i in range(batch):
            self._gripper.step(dt)
            openings[i] = self._gripper.command
        place.run(q, v, openings, a)
        self._share()
        if round(place.time / dt) % self._arm.told_every < batch:
            self._arm.tell()
        self._due += batch * dt / self._now
        time.sleep(max(self._due - time.monotonic(), 0.0))
        self._due = max(self._due, time.monotonic())  # what was lost is not made up for

    @property
    def _now(self) -> float:
        return min(self._rate, RENDERED) if self._shared.recorded else self._rate

    def _share(self) -> None:
        self._shared.step(self.place.time, self.place.data.qpos, self._now)


def serve(served: Served, ask: Callable[[], dict[str, Any] | None]) -> dict[str, Any] | None:
    """Serve until somebody says which shake is to be judged; return what was said."""
    said: list[dict[str, Any] | None] = []
    threading.Thread(target=lambda: said.append(ask()), daemon=True).start()
    while not said:
        served.go_on()
    return said[0]


def main() -> None:
    """Serve, then judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("master")
    parser.add_argument("species", choices=("tomato", "pepper"))
    parser.add_argument("seed", type=int)
    parser.add_argument("--truth", choices=("nominal", "wide"), default="nominal")
    parser.add_argument("--arm", choices=tuple(FILES), default="sawyer")
    args = parser.parse_args()
    plant = Plant(args.species, args.seed, args.truth, args.arm)
    with closing(Served(plant, args.folder, args.master)) as served:
        print(served.file, flush=True)
        asked = serve(served, lambda: json.loads(sys.stdin.readline() or "null"))
        if asked is not None:
            verdict = judge(served.place, asked["shake"], asked["frequency"], asked["steady"])
            peaks = verdict.flower_acceleration_peak.tolist()
            told = {"held": verdict.held, "unharmed": verdict.unharmed, "reason": verdict.reason, "peaks": peaks}
            print(json.dumps(told | {"harm": verdict.harm.probability, "robot_s": served.place.time}), flush=True)


if __name__ == "__main__":
    main()
