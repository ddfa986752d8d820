"""What a person waits for: the download, kernels compiled at a first use, commands, views to grasp, plan and visit.

    python -m evaluation.speed [--dismech CHECKOUT] [--visits 4]

Keys of the --json file; processes are new where nothing else is said, and a warm one finds its kernels compiled:

- core_mb: files of what `pip install` alone brings, without what Python compiles of them.
- compile_s, signatures: processor time and number of all kernels, compiled ahead.
- first_<command>_s (wall), first_<command>_compile_s, first_<command>_signatures: nothing was compiled before.
- <command>_warm_s (wall) and <command>_warm_cpu_s, from start to end: medians.
- views_to_grasp_s: from 30 views on disk to ranked grasps; after_last_view_s: the same of a live visit, whose views are
  written while the arm goes on; plan_s: `plan_shake` of what a trial offers it; prediction_s: `foresee`, before
  a shake is raised; peak_gb: of the process until it has its grasps. Wall on two threads, best of three in one process
  after one that loads the kernels, of the slower plant (see perception.py).
- capture_s: of a trial's views, motions as planned.
- batch_ratio: processor time at the commit BEFORE over that now of many small vibrations (peers/run_batch.py), paired,
  the median of three rounds. The commit's source is taken from this repository.
- over_dismech: PyDiSMech's processor time over ours, 86 nodes without twist, paired, the median; without --dismech from
  docs/results/long/rods.json.
- visit_protocol_s: median seconds on the robot's clock of whole trials through the Sawyer's protocol
  (robustness/through_ros.py), --visits of them, 15 minutes each; without them from docs/results/long/through_ros.json.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from dataclasses import replace
from functools import partial
from importlib.metadata import distribution
from pathlib import Path
from typing import NamedTuple

import numpy as np
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import anther
from anther.cli.sample_data import write_samples
from anther.robot.arm.views import capture_time
from anther.sim import views_at
from anther.sim.simulated_cell import PRESETS, USUAL_DISTANCE
from evaluation.harness import CROPS, finish, options, progress
from evaluation.numbers import metrics_of
from evaluation.robustness import through_ros
from evaluation.speed import perception
from evaluation.speed.networks import reference_network, tall_plant, tips
from evaluation.speed.peers import Case, run_batch, run_dismech
from evaluation.speed.rods import peer_rows
from evaluation.tables import markdown

BEFORE = "4e1aafc"
"""The commit to whose speed that of now is compared."""
ROOMS = "anther.elastic_rod", "anther.rods"
"""What the rods' package was called then, and is called now."""
RUN = """
import sys, time; from anther.cli.main import main; code = main()
from anther.core.compiling import COMPILED
print("used", COMPILED.kernels, COMPILED.seconds, time.process_time()); sys.exit(code)
"""


class Used(NamedTuple):
    """What one command took: from start to end, its kernels, and their and its processor time [s]."""

    wall: float
    kernels: int
    compiling: float
    processor: float


def use(compiled: Path, *words: str | Path) -> Used:
    """Run `anther` with these words in a new process, its compiled code in a folder of its own.

    Raises:
        CalledProcessError: the command fails.
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(compiled)}
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", RUN, *map(str, words)], env=environment, capture_output=True, text=True, check=True
    )
    wall = time.perf_counter() - begin
    kernels, *seconds = done.stdout.rpartition("used ")[2].split()
    return Used(wall, int(kernels), *map(float, seconds))


def commands(repeats: int) -> dict[str, float]:
    """Return what compiling ahead, first and warm commands take."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_samples(folder)
        asked = {
            "skeletonize": ("skeletonize", folder / "plant.ply", "--overwrite", "--out", folder / "tree"),
            "plan": ("plan", folder / "skeleton.swc", "--overwrite", "--out", folder / "plan"),
        }
        first = {
            which: use(folder / f"compiled_{which}", *words) for which, words in progress(asked.items(), "first uses")
        }
        ahead = use(folder / "compiled", "doctor", "--compile")
        warm = {
            which: [use(folder / "compiled", *words) for _ in progress(range(repeats), f"warm {which}")]
            for which, words in asked.items()
        }
    metrics: dict[str, float] = {"compile_s": ahead.compiling, "signatures": ahead.kernels}
    for which, used in first.items():
        metrics |= {f"first_{which}_s": used.wall, f"first_{which}_compile_s": used.compiling}
        metrics[f"first_{which}_signatures"] = used.kernels
    for which, several in warm.items():
        metrics[f"{which}_warm_s"] = float(np.median([used.wall for used in several]))
        metrics[f"{which}_warm_cpu_s"] = float(np.median([used.processor for used in several]))
        metrics[f"{which}_warm_signatures"] = max(used.kernels for used in several)
    return metrics


def core_mb() -> float:
    """Return the size of what one installs without extras, without what Python compiles of it [MB]."""
    found, wanted = set[tuple[str, str]](), [("anther", "")]
    while wanted:
        this, extra = wanted.pop()
        if (this, extra) in found:
            continue
        found.add((this, extra))
        for need in map(Requirement, distribution(this).requires or ()):
            if need.marker is None or need.marker.evaluate({"extra": extra}):
                wanted += [(canonicalize_name(need.name), part) for part in ("", *need.extras)]
    files = [file for name in {name for name, _ in found} for file in distribution(name).files or ()]
    paths = [Path(str(file.locate())) for file in files if file.suffix != ".pyc"]
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


def views(plants: int, repeats: int) -> dict[str, float]:
    """Return what a plant's views take, from the disk to the shake's prediction; of several the slowest."""
    rows = [
        perception.in_new_process(crop, 10, perception.VIEWS, repeats) for crop in progress(CROPS[:plants], "plants")
    ]
    keys = ("views_to_grasp_s", "after_last_view_s", "plan_s", "prediction_s", "peak_gb")
    return {key: max(row[key] for row in rows) for key in keys}


def batch_ratio(plants: int, rounds: int) -> float:
    """Return the time of a batch of small vibrations at the commit `BEFORE` over that of now."""
    rods = tall_plant()
    with tempfile.TemporaryDirectory() as folder:
        packed = subprocess.run(["git", "archive", BEFORE, "src"], stdout=subprocess.PIPE, check=True).stdout
        subprocess.run(["tar", "-x", "-C", folder], input=packed, check=True)
        sources = (Path(folder) / "src", Path(anther.__file__).parents[1])
        pairs = [
            [run_batch(source, room, rods, tips(rods), plants) for source, room in zip(sources, ROOMS, strict=True)]
            for _ in progress(range(rounds), "batches")
        ]
    return float(np.median([before / now for before, now in pairs]))


def over_dismech(checkout: Path | None, rounds: int) -> float:
    """Return PyDiSMech's time of a simulated second over ours, as rods.py measures it or as it was measured last."""
    key = "dismech_86_s_per_sim_s_ratio_median"
    if checkout is None:
        return metrics_of("long/rods")[key]
    case = Case(replace(reference_network(), discretisation="paper", bend_over_twist=0.0))
    rows = peer_rows("dismech_86", "PyDiSMech, 86 nodes", partial(run_dismech, checkout), case, rounds)
    return {name: value for row in rows for name, value in row.metrics.items()}[key]


def visit_s(count: int, out: Path, jobs: int) -> float:
    """Return the robot's seconds of a visit through its protocols, of so many trials or as it was measured last."""
    if count:
        return through_ros.trials(count, "nominal", "sawyer", jobs, out)["robot_s"]
    return metrics_of("long/through_ros")["robot_s"]


def measure(args: Namespace) -> dict[str, float]:
    """Return all of it."""
    few = args.quick
    metrics = {"core_mb": core_mb()} | commands(3 if few else 9) | views(1 if few else 2, 1 if few else 3)
    metrics["capture_s"] = capture_time(views_at(USUAL_DISTANCE, PRESETS["fast"]))
    metrics["batch_ratio"] = batch_ratio(50 if few else 1000, 1 if few else 3)
    metrics["over_dismech"] = over_dismech(args.dismech, 1 if few else 3)
    metrics["visit_protocol_s"] = visit_s(args.visits, args.out, args.jobs)
    return metrics


def main() -> None:
    """Measure and print."""
    own = {
        "--dismech": (Path, "a checkout of dismech-python, to be run as well"),
        "--visits": (0, "whole trials through the Sawyer's protocol, to be run as well"),
    }
    quick = "three warm repetitions instead of nine, one plant, one round, a small batch"
    args = options(__doc__, quick=quick, jobs="visits", out="runs/visits", own=own)
    metrics = measure(args)
    kept = [
        f"{key}: as measured last, {path}."
        for key, path, asked in (
            ("over_dismech", "docs/results/long/rods.json", args.dismech),
            ("visit_protocol_s", "docs/results/long/through_ros.json", args.visits),
        )
        if not asked
    ]
    table = markdown(("what", "value"), [(name, f"{value:.4g}") for name, value in metrics.items()])
    finish(args, metrics, table, *kept)


if __name__ == "__main__":
    main()
