"""Serves an arm without a body behind franka-sim's server, and writes down where it was.

    python tests/support/franka_sim_server.py FOLDER HOST

The arm is where its controller leads it. FOLDER gets the log and the world that all share.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

from served_franka import CYCLE, FrankaServer
from served_world import World

from anther.robot.arm.arms import find_arm
from anther.robot.arm.model import ArmModel

RATE = 0.25  # of the wall's clock: a busy machine serves a thousand cycles in four seconds


@dataclass
class Nowhere:
    """A world with nothing in it but the time [s]."""

    arm: ArmModel
    time: float = 0.0
    timestep: float = CYCLE


def main(folder: Path, host: str) -> None:
    world, shared = Nowhere(find_arm("fr3")), World(folder / "world", count=7)
    shared.step(world.time, world.arm.neutral, RATE)
    arm, due = FrankaServer(host, world, shared, world.arm.neutral), time.monotonic()
    with (folder / "log").open("w") as log:
        while True:
            arm.references(1)
            world.time += CYCLE
            arm.tell()
            shared.step(world.time, arm.q, RATE)
            log.write(" ".join(map(str, (time.monotonic(), world.time, *arm.q))) + "\n")
            log.flush()
            due = max(due + CYCLE / RATE, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
