"""From 30 views to a grasp-ready skeleton: wall time a stage, and memory.

A simulated plant in 30 views, 1280 x 720, as `anther trial` takes them: masks (colour and geometry, no networks), cloud
(registration and fusion), skeleton, stem, flowers, ranked grasps without the arm. All in one new process on at most
two threads, after one run that loads the compiled code; the best of the repeats counts. Peak memory is the greatest
resident set of that process while it works, views and libraries included (read from /proc, so on Linux).

Keys of the --json file, of the slower plant: total_s, <stage>_s, peak_gb, registration_rms_mm (RMS displacement of the
true plant points, see evaluation/perception/registration.py), first_total_s (with compiled code being loaded), plants.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import track

from anther.core import Array, Box, transform_points
from anther.core.files import replacing, write_json
from anther.perception import Capture, cloud, flowers, masks, skeleton, stem
from anther.plant import Crop
from anther.pollination import grasp
from anther.robot.arm.views import Params as ViewParams
from anther.sim import Organ, grow, layout, photograph, views_at
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.tables import markdown

VIEWS = 30
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "2"}
STAGES = ("masks", "cloud", "skeleton", "stem", "flowers", "grasps")
TARGET_S, STRETCH_S, MEMORY_GB = 5.0, 2.0, 2.0


def measure(species: Crop, seed: int, repeats: int) -> dict[str, float]:
    """Return one plant's times and memory; runs in a process of its own."""
    box = layout(USUAL_DISTANCE).workspace
    capture, true_poses, points = take(species, seed)
    Path("/proc/self/clear_refs").write_text("5")  # the rendering's memory does not count
    runs, cloud_poses = [], capture.T_world_cam
    for _ in range(repeats + 1):
        seconds, cloud_poses = perceive(capture, box)
        runs.append(seconds)
    best = min(runs[1:], key=lambda run: sum(run.values()))
    gaps = [
        transform_points(found, p) - transform_points(true, p)
        for found, true, p in zip(cloud_poses, true_poses, points, strict=True)
    ]
    return {
        "total_s": sum(best.values()),
        **{f"{stage}_s": best[stage] for stage in STAGES},
        "first_total_s": sum(runs[0].values()),
        "registration_rms_mm": 1e3 * float(np.sqrt(3 * np.mean(np.concatenate(gaps) ** 2))),
        "peak_gb": _peak_gb(),
    }


def perceive(capture: Capture, box: Box) -> tuple[dict[str, float], Array]:
    """Return the wall time of each stage [s] and the registered poses."""
    seconds: dict[str, float] = {}

    def timed(stage: str, work: Callable[[], Any]) -> Any:
        begin = time.perf_counter()
        result = work()
        seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - begin
        return result

    labels = timed("masks", lambda: masks.segment(capture, box))
    points = timed("cloud", lambda: cloud.fuse(capture, labels, box))
    tree = timed("skeleton", lambda: skeleton.skeletonize(points))
    centres = timed("flowers", lambda: flowers.flower_centres(points))
    main_stem = timed("stem", lambda: stem.find_stem(tree, flowers_at=centres))
    timed("flowers", lambda: flowers.find_flowers(points, tree, main_stem, centres=centres))
    timed("grasps", lambda: grasp.plan_grasps(main_stem, tree, points))
    return seconds, points.T_world_cam


def take(species: Crop, seed: int) -> tuple[Capture, Array, list[Array]]:
    """Return the capture of a simulated plant, the true poses, and true plant points per view in its camera frame."""
    joints = views_at(USUAL_DISTANCE, ViewParams(count=VIEWS)).joints
    capture, truth = photograph(grow(species, seed, 0.0, USUAL_DISTANCE), joints, seed)
    pairs = zip(truth.depth, truth.organ, strict=True)
    return (capture, truth.T_world_cam, [capture.intrinsics.back_project(d, o <= Organ.FLOWER)[::7] for d, o in pairs])


def _peak_gb() -> float:
    """Return the greatest resident set since the mark was cleared [GB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e6


def main() -> None:
    """Measure the plants one after another in fresh processes, print the table, write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--figure", type=Path, help="draw the bars into this file")
    parser.add_argument("--quick", action="store_true", help="one plant, one repeat")
    parser.add_argument("--seed", type=int, default=10, help="of the plants")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--one", choices=("tomato", "pepper"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        print(json.dumps(measure(args.one, args.seed, args.repeats)))
        return
    species = ("tomato",) if args.quick else ("tomato", "pepper")
    repeats = 1 if args.quick else args.repeats
    rows = {name: _in_new_process(name, args.seed, repeats) for name in track(species, "plants")}
    table = max(rows.values(), key=lambda row: row["total_s"])
    table |= {key: max(row[key] for row in rows.values()) for key in ("peak_gb", "registration_rms_mm")}
    _report(rows, table, args.json, args.figure)


def _in_new_process(species: str, seed: int, repeats: int) -> dict[str, float]:
    command = [
        sys.executable,
        "-m",
        "evaluation.speed.perception",
        "--one",
        species,
        "--seed",
        str(seed),
        "--repeats",
        str(repeats),
    ]
    done = subprocess.run(command, env={**os.environ, **ONE_THREAD}, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def _report(
    rows: dict[str, dict[str, float]], table: dict[str, float], json_file: Path | None, figure: Path | None
) -> None:
    shown = markdown(["of one plant, 30 views", "target", *rows])
    for stage in STAGES:
        times = (f"{row[f'{stage}_s']:.2f}, {row[f'{stage}_s'] / row['total_s']:.0%}" for row in rows.values())
        shown.add_row(f"{stage}, s, share", "", *times)
    for words, target, key in (
        ("all, s", f"≤ {TARGET_S:g}", "total_s"),
        ("the first run of a process, s", "", "first_total_s"),
        ("peak memory, GB", f"≤ {MEMORY_GB:g}", "peak_gb"),
        ("registration's error, RMS, mm", "", "registration_rms_mm"),
    ):
        shown.add_row(words, target, *(f"{row[key]:.2f}" for row in rows.values()))
    Console().print(shown)
    if figure:
        _draw(rows, figure)
    if json_file:
        write_json(json_file, {**table, "plants": len(rows)})


def _draw(rows: dict[str, dict[str, float]], file: Path) -> None:
    picture = Figure(figsize=(8, 1 + 0.6 * len(rows)), layout="constrained")
    plot = picture.subplots()
    for stage in STAGES:
        left = [sum(row[f"{s}_s"] for s in STAGES[: STAGES.index(stage)]) for row in rows.values()]
        bars = plot.barh(list(rows), [row[f"{stage}_s"] for row in rows.values()], left=left, label=stage)
        shares = [row[f"{stage}_s"] / row["total_s"] for row in rows.values()]
        plot.bar_label(bars, [f"{share:.0%}" if share > 0.04 else "" for share in shares], label_type="center")
    plot.axvline(TARGET_S, color="0.4", linestyle=":")
    plot.axvline(STRETCH_S, color="0.4", linestyle=":")
    plot.set_xlabel("wall time on two cores [s]; dotted: target and stretch goal")
    plot.legend(ncols=len(STAGES), loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    with replacing(file) as temporary:
        picture.savefig(temporary, dpi=130, format="png")


if __name__ == "__main__":
    main()
