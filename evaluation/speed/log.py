"""Does the log of a trial disturb the arm's commands? How evenly they come, with and without it.

    python -m evaluation.speed.log [--quick]

A fake Sawyer behind a ROS 1 master notes when each command arrives: 100 a second, of a joint swing at 1.9 Hz. The
driver runs as in a trial (`apart`: in a process of its own) or in the process that writes the log (`beside`). That one
also gets 30 frames of 480 x 480 pixels a second from a side camera. The log's disk is a file (`file`), takes 0.2 s for
every write (`slow`), is full after 100 kB (`full`), or hangs after that (`hangs`). Rounds with and
without a log alternate, so that whatever else the machine does meets both.

jitter: by how much a command's distance to the one before is off the period, over all rounds: its median, its 99th and
99.9th percentile, the most, and how many of a thousand are more than 5 ms off. The ratio is of the mean jitter, with
the log over without.
"""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing
from io import FileIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from fake_robot import LIMITS, FakeCamera, fake_robot
from fake_ros_master import FakeMaster
from fake_sawyer import FakeSawyer, swing

import anther
from anther.core import Array
from anther.perception import Capture
from anther.robot import ArmSample, Frame, Robot
from anther.robot.arm import sawyer
from anther.robot.drivers import sawyer_ros1
from anther.robot.drivers.apart import ArmApart
from anther.robot.drivers.intera import types
from anther.robot.drivers.ros1 import Node
from anther.robot.drivers.sawyer_ros1 import Sawyer
from anther.show import Log
from evaluation.harness import HIDDEN, finish, options, progress
from evaluation.tables import markdown, number

PERIOD, AMPLITUDE = 0.01, 0.03  # s, rad of every joint: 0.36 rad/s
FRAMES = 30.0  # a second
ROOM = 100_000  # bytes
SAMPLE = Path(anther.__file__).parent / "cli" / "sample_data" / "capture"
DISK = {
    "none": "no log",
    "file": "a file",
    "slow": "0.2 s a write",
    "full": "full after 100 kB",
    "hangs": "hangs after 100 kB",
}
WHERE = {"apart": "a process of its own", "beside": "in the log's process"}
SHOWN = {
    "p50_ms": "jitter, median (ms)",
    "p99_ms": "99 % within (ms)",
    "most_ms": "most (ms)",
    "off_5_ms_per_1000": "more than 5 ms off (of 1000)",
    "mean_ratio": "mean jitter over that without a log",
    "messages": "messages written",
    "dropped": "messages dropped",
}


class Disk(FileIO):
    """A disk that is slow, full or hangs after `ROOM` bytes."""

    def __init__(self, path: Path, kind: str) -> None:
        super().__init__(path, "wb")
        self._kind, self._taken = kind, 0

    def write(self, data: Any) -> int:
        if self._kind == "slow":
            time.sleep(0.2)
        elif self._taken > ROOM and self._kind == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        elif self._taken > ROOM and self._kind == "hangs":
            threading.Event().wait()
        done = super().write(data)
        self._taken += done
        return done


class Watching(FakeCamera):
    """A side camera that is looked at by whoever watches the arm."""

    def __init__(self) -> None:
        super().__init__()
        views = Capture.load(SAMPLE).rgb
        assert views is not None
        self._seen = [cv2.resize(view, (480, 480)) for view in views[:4]]

    def read(self) -> Frame:
        self.reads += 1
        return Frame(time.monotonic(), self._seen[self.reads % 4], np.zeros((1, 1), np.float32))


def driver(master: str) -> Sawyer:
    """Return the arm's driver, which does not give up where a busy machine makes it late: that is what is measured."""
    Sawyer._longest_silence = sawyer_ros1.STALE = 1.0
    return Sawyer(Node(master, "/anther", types()), mode="trajectory")


def drive(master: str, where: str, disk: str, seconds: float) -> None:
    """Follow the swing with such a log, as a trial does; print what became of the log. The driver's own process."""
    with tempfile.TemporaryDirectory() as folder, closing(arm_of(master, where)) as arm:
        camera = Watching()
        robot, book = Robot(arm, fake_robot().gripper, FakeCamera(), camera), None
        if disk != "none":
            book = Log(Path(folder) / "log.mcap", opened=lambda path: Disk(path, disk))
            robot = book.tap(robot, LIMITS, sawyer.T_FLANGE_CAM, time.monotonic)
        assert robot.side_camera is not None
        looks, seen = [0.0], robot.side_camera.read

        def watch(sample: ArmSample) -> None:
            if sample.time - looks[0] >= 1 / FRAMES:
                looks[0] = sample.time
                seen()

        print("ready", flush=True)
        robot.arm.follow(swing(seconds, AMPLITUDE), watch)
        kept = None if book is None else book.close()
        print(json.dumps({} if kept is None else {"messages": kept.messages, "dropped": kept.dropped}), flush=True)
    os._exit(0)  # a disk that hangs is left hanging


def arm_of(master: str, where: str) -> Any:
    """Return the arm, in a process of its own or in this one."""
    return ArmApart(driver, {"master": master}, LIMITS) if where == "apart" else driver(master)


def measure(where: str, disk: str, seconds: float) -> tuple[Array, dict[str, float]] | None:
    """Return the jitter of one swing's commands (N,) [s], and what became of the log; None if the driver gave up."""
    master = FakeMaster()
    try:
        with closing(FakeSawyer(master.uri, joints=sawyer.NEUTRAL)) as robot:
            words = ["-m", "evaluation.speed.log", "--drive", master.uri, where, disk, "--seconds", str(seconds)]
            done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)
            if done.returncode != 0:
                print(f"{where}, {disk}: {done.stderr.strip().splitlines()[-1]}", file=sys.stderr)
                return None
            return np.abs(np.diff(robot.heard) - PERIOD), json.loads(done.stdout.splitlines()[-1])
    finally:
        master.stop()


def summed(rounds: list[tuple[Array, dict[str, float]]]) -> dict[str, float]:
    """Return the numbers of a case's rounds; none if the driver gave up in all of them."""
    if not rounds:
        return {}
    off = 1e3 * np.concatenate([jitter for jitter, _ in rounds])
    kept = {name: float(sum(log[name] for _, log in rounds)) for name in rounds[0][1]}
    shares = {f"p{q:g}_ms".replace(".", ""): float(np.percentile(off, q)) for q in (50, 99, 99.9)}
    row = {"mean_ms": float(off.mean()), **shares, "most_ms": float(off.max())}
    return row | {"off_5_ms_per_1000": 1e3 * float(np.mean(off > 5)), "commands": len(off)} | kept


def main() -> None:
    """Measure, print a table, write --json."""
    own = {
        "--rounds": (8, "of each case"),
        "--seconds": (8.0, "of each swing"),
        "--where": (tuple(WHERE), "the driver runs", tuple(WHERE)),
        "--drive": {"nargs": 3, "help": HIDDEN},
    }
    args = options(__doc__, quick="two short rounds of each case", seed=(0, "of the order of the rounds"), own=own)
    if args.drive:
        drive(*args.drive, args.seconds)
    rng, rounds = np.random.default_rng(args.seed), 2 if args.quick else args.rounds
    seconds = 4.0 if args.quick else args.seconds
    todo = [(where, disk) for where in args.where for disk in DISK]
    found: dict[tuple[str, str], list[Any]] = {case: [] for case in todo}
    for k in progress([n for _ in range(rounds) for n in rng.permutation(len(todo))], "swings"):
        found[todo[k]].append(measure(*todo[k], seconds))
    gave_up = sum(rows.count(None) for rows in found.values())
    metrics: dict[str, float] = {"drivers_that_gave_up": gave_up}
    rows, lines = {case: summed([one for one in tried if one is not None]) for case, tried in found.items()}, []
    for (where, disk), row in rows.items():
        row |= {"mean_ratio": row.get("mean_ms", np.nan) / rows[where, "none"].get("mean_ms", np.nan)}
        metrics |= {f"{where}_{disk}_{name}": value for name, value in row.items()}
        lines.append((WHERE[where], DISK[disk], *(number(row[name]) if name in row else "" for name in SHOWN)))
    swings = sum(map(len, found.values()))
    words = [f"The driver gave up in {gave_up} of {swings} swings, which are left out."] if gave_up else []
    finish(args, metrics, markdown(("driver", "log's disk", *SHOWN.values()), lines), *words)


if __name__ == "__main__":
    main()
