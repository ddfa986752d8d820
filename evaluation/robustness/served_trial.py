"""For `through_ros.py`: a trial of `anther trial --cell` whose machines are MuJoCo's cell behind their real protocols.

For a Sawyer ROS' own master where it is installed, a small one elsewhere; a Franka answers at an address of its own on
the loopback, as libfranka's port is always the same. A process serves the plant (`tests/support/served_cell.py`), and
`anther trial` runs as a person would run it. Who serves judges, by truth.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from fake_ros_master import FakeMaster, debian_roscore, has_roscore

from anther.pollination import ShakePlan, Trial

TESTS = Path(__file__).parents[2] / "tests" / "support"
LONGEST = 1800.0  # s of a trial
KEPT = ("failure", "message", "shake_duration_s", "shake_ended_by", "plan_alone_because", "seconds", "log_error")


@contextmanager
def master() -> Iterator[str]:
    """Run a ROS master; gives its address."""
    if has_roscore():
        with debian_roscore() as uri:
            yield uri
        return
    small = FakeMaster()
    yield small.uri
    small.stop()


@contextmanager
def robot(row: dict[str, Any]) -> Iterator[str]:
    """Give the address at which the arm of a trial is asked for."""
    if row.get("arm", "sawyer") == "sawyer":
        with master() as uri:
            yield uri
    else:
        yield f"127.0.{1 + (row['species'] == 'pepper')}.{1 + row['seed'] % 250}"


def served(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what became of a trial: {"species", "seed", "truth", "preset"} and, but for a Sawyer, "arm" -> its row.

    "held", "unharmed" and "peaks" [m/s2] are who served's, by truth; "said" is what Anther says of the hold.
    """
    words = [row["species"], str(row["seed"]), "--truth", row["truth"], "--arm", row.get("arm", "sawyer")]
    with robot(row) as address, _serving([str(folder / "cell"), address, *words]) as server:
        assert server.stdin is not None
        assert server.stdout is not None
        cell, began = server.stdout.readline().strip(), time.monotonic()
        code = _anther(row, cell, folder)
        wall = time.monotonic() - began
        asked = _shake(folder / "run")
        server.stdin.write(json.dumps(asked) + "\n")
        server.stdin.flush()
        verdict = json.loads(server.stdout.readline() or "{}")
    summary = (
        json.loads((folder / "run" / "trial.json").read_text()) if (folder / "run" / "trial.json").exists() else {}
    )
    kept = {name: summary.get(name) for name in KEPT}
    return {"code": code, "wall_s": wall, "said": bool(summary.get("held")), **kept, **verdict}


def _anther(row: dict[str, Any], cell: str, folder: Path) -> int:
    words = ["trial", "--cell", cell, "--plant", row["species"], "--label", f"served {row['seed']}"]
    words += ["--preset", row["preset"], "--out", str(folder / "run"), "--history", str(folder / "history.sqlite")]
    paths = os.pathsep.join(filter(None, [str(TESTS / "cells"), os.environ.get("PYTHONPATH")]))
    environment = os.environ | {"PYTHONPATH": paths}
    with (folder / "said.txt").open("w") as said:
        run = [sys.executable, "-m", "anther.cli", *words]
        return subprocess.run(run, env=environment, stdout=said, stderr=said, timeout=LONGEST, check=False).returncode


@contextmanager
def _serving(words: list[str]) -> Iterator[subprocess.Popen[str]]:
    run = [sys.executable, str(TESTS / "served_cell.py"), *words]
    with subprocess.Popen(run, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def _shake(run: Path) -> dict[str, Any]:
    """Return what is to be judged: times on the cell's clock."""
    nothing: dict[str, Any] = {"shake": None, "frequency": 1.0, "steady": None}
    if not (run / "09_trial.npz").exists():
        return nothing
    trial = Trial.load(run / "09_trial.npz")
    if not len(trial.shake_times):
        return nothing
    shake = ShakePlan.load(run / "09_executed_shake.json")
    times = [float(trial.shake_times[0]), float(trial.shake_times[-1])]
    return {"shake": times, "frequency": shake.frequency, "steady": list(trial.steady)}
