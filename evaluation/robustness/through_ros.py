"""Anther through the machines' own protocols: whole trials, evenness of the commands, and a driver that is killed.

    python -m evaluation.robustness.through_ros --trials 20 --jobs 2      the whole trials, in hours
    python -m evaluation.robustness.through_ros --trials 0                the fake Sawyer alone, in minutes

**Trials**: `anther trial --cell` grasps and shakes plants of MuJoCo's cell, which is served as machines
(`tests/support/served_cell.py`): a Sawyer behind a ROS 1 master or, with --arm fr3, a Franka behind franka-sim's
server; a Robotiq over Modbus TCP; cameras of the RealSense SDK. The cell's time goes slower than the wall's, and a
trial has one core. A success was held and unharmed by truth, and ended by itself. Each is kept in --out and is
not run again.

**A fake Sawyer**: the driver runs in a process of its own, which also writes a trial's log, and follows a joint swing
at 1.9 Hz, as a shake does, in trajectory mode at 100 commands a second. The fake notes when each command arrives. Then,
with as many busy processes beside it as there are cores, the same again; and KILLS times the driver is killed (SIGKILL)
in full motion.

It is the real protocol on one machine's loopback: neither a network nor an arm is in it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from fake_robot import LIMITS, FakeCamera, fake_robot
from fake_ros_master import FakeMaster
from fake_sawyer import FakeSawyer, swing

from anther.core import Array
from anther.core.choices import ArmName
from anther.plant.limits import moved
from anther.robot import Robot
from anther.robot.arm.sawyer import SAWYER, TOOL
from anther.robot.drivers.intera import types
from anther.robot.drivers.ros1 import Node
from anther.robot.drivers.sawyer_ros1 import Sawyer
from anther.show import Log
from evaluation.harness import HIDDEN, finish, options, run_cases
from evaluation.robustness.served_trial import served
from evaluation.tables import measured

FIRST = 9800
"""The first of the plants, tomatoes and peppers in turn; in no other table."""
AMPLITUDE = 0.05  # rad of every joint: 0.6 rad/s
STILL = 0.01  # rad/s
PERIOD = 0.01  # s
WORDS = {
    "trials": "trials",
    "success_20": "held, unharmed and ended by themselves",
    "held": "held",
    "moved": "flowers moved enough",
    "robot_s": "robot time of a trial, median (s)",
    "commands": "commands whose arrival was timed",
    "jitter_alone_p999_ms": "99.9 % of them off their period by less than (ms)",
    "jitter_p999_ms": "the same beside as many busy processes as cores (ms)",
    "jitter_largest_ms": "the farthest off, of both (ms)",
    "kills": "times the driver was killed in full motion",
    "stop_median_ms": "arm stands after, median (ms)",
    "stop_ms": "arm stands after, at most (ms)",
}


def drive(master: str, seconds: float) -> None:
    """Follow the swing, logged: the driver's own process."""
    with ExitStack() as stack:
        arm = stack.enter_context(closing(Sawyer(Node(master, "/anther", types()), mode="trajectory")))
        log = Log(Path(stack.enter_context(TemporaryDirectory())) / "log.mcap")
        robot = Robot(arm, fake_robot().gripper, FakeCamera())
        robot = log.tap(robot, LIMITS, TOOL.T_flange_cam, time.monotonic)
        print("ready", flush=True)
        robot.arm.follow(swing(seconds, AMPLITUDE))
        log.close()


@contextmanager
def driver(master: str, seconds: float) -> Iterator[subprocess.Popen[str]]:
    """Run `drive` in a process of its own."""
    words = [sys.executable, "-m", "evaluation.robustness.through_ros", "--drive", master, "--seconds", str(seconds)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield process


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep so many cores busy."""
    with ExitStack() as stack:
        for _ in range(count):
            process = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(process.kill)
        yield


def jitter(robot: FakeSawyer, master: str, seconds: float) -> Array:
    """Return by how much each command's distance to the one before was off the period (N,) [s]."""
    robot.heard.clear()
    with driver(master, seconds) as process:
        if process.wait() != 0:
            raise SystemExit("the driver stopped on the way: see above.")
    return np.abs(np.diff(robot.heard) - PERIOD)


def stop_time(robot: FakeSawyer, master: str, after: float) -> float:
    """Kill the driver so long after the motion began [s]; return how long the arm still moved [s]."""
    robot.q, robot.v = SAWYER.neutral.copy(), np.zeros(7)
    with driver(master, 20.0) as process:
        began = time.monotonic()
        while time.monotonic() - began < 0.5 + after or np.abs(robot.v).max() < 0.2:
            time.sleep(0.002)
        process.kill()
        killed = time.monotonic()
        time.sleep(0.6)
    times, speed = robot.speed()
    return max(float(times[speed > STILL].max()) - killed, 0.0)


def measure(kills: int, seconds: float) -> dict[str, Any]:
    """Return the flat table of metrics."""
    rng = np.random.default_rng(0)
    master = FakeMaster()
    with closing(FakeSawyer(master.uri, rate=100.0)) as robot:
        alone = jitter(robot, master.uri, seconds)
        with busy(os.cpu_count() or 1):
            beside = jitter(robot, master.uri, seconds)
        stops = [stop_time(robot, master.uri, float(rng.uniform(0, 1))) for _ in range(kills)]
    master.stop()
    return {
        "commands": len(alone) + len(beside) + 2,
        "jitter_alone_p999_ms": 1e3 * float(np.quantile(alone, 0.999)),
        "jitter_p999_ms": 1e3 * float(np.quantile(beside, 0.999)),
        "jitter_largest_ms": 1e3 * float(max(alone.max(), beside.max())),
        "kills": kills,
        "stop_median_ms": 1e3 * float(np.median(stops)),
        "stop_ms": 1e3 * max(stops),
    }


def trials(count: int, truth: str, arm: ArmName, jobs: int, out: Path) -> dict[str, Any]:
    """Return the flat table of `count` trials through the served cell."""
    asked = [
        {"species": ("tomato", "pepper")[i % 2], "seed": FIRST + i // 2, "truth": truth, "preset": "full"}
        | ({} if arm == "sawyer" else {"arm": arm})
        for i in range(count)
    ]
    rows = run_cases(served, asked, out, jobs, lambda reason: {"held": False, "unharmed": False, "message": reason})
    for row in rows:
        said = "held" if row["held"] else row.get("message") or row.get("reason")
        print(f"{row['species']} {row['seed']}: {said}", file=sys.stderr)
    done = [row for row in rows if row.get("robot_s")]
    return {
        "trials": count,
        "success_20": sum(bool(row["held"] and row["unharmed"] and not row.get("failure")) for row in rows),
        "held": sum(bool(row["held"]) for row in rows),
        "moved": sum(bool(moved(row.get("peaks", ()))) for row in rows),
        "robot_s": float(np.median([row["robot_s"] for row in done])) if done else float("nan"),
    }


def main() -> None:
    """Measure, and write a flat table of metrics."""
    own = {
        "--trials": (20, "through the served cell"),
        "--arm": ("sawyer", "fr3: trials alone, by libfranka", ("sawyer", "fr3")),
        "--truth": ("nominal", "of the plants", ("nominal", "wide")),
        "--kills": (20, "of the driver"),
        "--seconds": (60.0, "of each swing whose commands are timed"),
        "--drive": (str, HIDDEN),
    }
    quick = "2 trials, 3 kills and 5 s instead of 20, 20 and 60 s"
    args = options(__doc__, quick=quick, jobs="trials", out="runs/through_ros", own=own)
    if args.drive:
        drive(args.drive, args.seconds)
        return
    count = 2 if args.quick else args.trials
    metrics = trials(count, args.truth, args.arm, args.jobs, args.out) if count else {}
    if args.arm == "sawyer":
        metrics |= measure(3, 5.0) if args.quick else measure(args.kills, args.seconds)
    finish(args, metrics, measured(metrics, WORDS))


if __name__ == "__main__":
    main()
