"""How long the program takes to start and to do one plant, as a person waits for it."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from pathlib import Path

from rich.progress import track

CLOUD = "sorghum_kinect_fused.npz"
"""A plant of 50 thousand points."""
RUNS = 7


def started(folder: Path) -> dict[str, float]:
    """Return the wall time [s] of `anther --help` and of `anther skeletonize`, the best of some runs in processes of
    their own after one that may compile, and the processor time of both [s], which other programs disturb less."""
    asked = {"help": ["--help"], "skeletonize": ["skeletonize", str(folder / CLOUD)]}
    found: dict[str, float] = {}
    for name, words in asked.items():
        _once(words)
        runs = [_once(words) for _ in track(range(RUNS), f"start of {name}")]
        found |= {f"{name}_wall_s": min(wall for wall, _ in runs), f"{name}_cpu_s": min(cpu for _, cpu in runs)}
    return found


def _once(words: list[str]) -> tuple[float, float]:
    """Run a command; return its wall time and its processor time [s]."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, "-m", "anther.cli", *words], check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
