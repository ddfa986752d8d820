"""From 30 views to a grasp-ready skeleton and a planned shake: wall time a stage, and memory.

A simulated plant in 30 views, 1280 x 720, as `anther trial` takes them: reading of their folder, masks (colour and
geometry, no networks), cloud (registration and fusion), supports, skeleton, stem, flowers, ranked grasps without the
arm. All in one new process on at most two threads, after one run that loads the compiled code; the best of the repeats
counts. Peak memory is the greatest resident set of that process while it works, views and libraries included (read from
/proc, so on Linux). Afterwards a shake is planned and predicted as in a trial.

Keys of the --json file, of the slower plant: views_to_grasp_s, all of it; total_s, without the reading;
after_last_view_s, of a live visit, whose views are written and looked at as they come: what is left after the last;
<stage>_s, peak_gb, registration_rms_mm (RMS displacement of the true plant points, see
evaluation/perception/registration.py), first_total_s (with compiled code being loaded), plants; beside the total plan_s
(`plan_shake`) and prediction_s (`foresee`).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

from anther.core import Array, Box, transform_points
from anther.perception import Capture, cloud, find_supports, flowers, masks, skeleton, stem
from anther.perception.capture import CaptureWriter
from anther.perception.incoming import FirstLook, IncomingViews
from anther.plant import PEPPER, TOMATO, Crop, Material
from anther.pollination import Grasp, Params, Seen, foresee, grasp, model_plant, plan_shake
from anther.pollination.escalation import watch_points
from anther.pollination.pipeline import SLACK
from anther.sim import Organ
from evaluation.harness import CROPS, HIDDEN, finish, options, progress
from evaluation.perception.simulated import BOX, take
from evaluation.tables import by_number

VIEWS = 30
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "2"}
STAGES = ("reading", "masks", "cloud", "supports", "skeleton", "stem", "flowers", "grasps")
MATERIALS = {"tomato": TOMATO, "pepper": PEPPER}


def measure(species: Crop, seed: int, views: int, repeats: int) -> dict[str, float]:
    """Return one plant's times and memory; runs in a process of its own."""
    runs, after, found, ranked, capture = [], [], None, list[Grasp](), None
    with TemporaryDirectory() as name:
        with ProcessPoolExecutor(1, get_context("spawn")) as aside:  # the rendering's memory does not count
            true_poses, points = aside.submit(write_views, species, seed, views, Path(name) / "read").result()
        for _ in range(repeats + 1):
            del capture  # two would be in memory at once
            begin = time.perf_counter()
            capture = Capture.load(Path(name) / "read")
            reading = time.perf_counter() - begin
            seconds, found, ranked = perceive(capture, BOX)
            runs.append({"reading": reading} | seconds)
            after.append(after_last(capture, Path(name) / "written"))
    assert found is not None
    peak, best = _peak_gb(), min(runs[1:], key=lambda run: sum(run.values()))
    gaps = [
        transform_points(found, p) - transform_points(true, p)
        for found, true, p in zip(found.cloud.T_world_cam, true_poses, points, strict=True)
    ]
    return {
        "views_to_grasp_s": sum(best.values()),
        "total_s": sum(best.values()) - best["reading"],
        "after_last_view_s": min(after[1:]),
        **{f"{stage}_s": best[stage] for stage in STAGES},
        "first_total_s": sum(runs[0].values()),
        "registration_rms_mm": 1e3 * float(np.sqrt(3 * np.mean(np.concatenate(gaps) ** 2))),
        "peak_gb": peak,
        **plan(found, ranked, MATERIALS[species], repeats),
    }


def after_last(capture: Capture, folder: Path) -> float:
    """Return the wall time [s] from the last view until the grasps are ranked, the others having come one by one."""
    *early, last = (capture.view(number) for number in range(capture.views))
    with CaptureWriter(folder) as writer, IncomingViews(BOX) as incoming:
        for view in early:
            writer.add(view)
            incoming.add(view)
        time.sleep(0.1 * capture.views)  # an arm takes longer
        begin = time.perf_counter()
        writer.add(last)
        incoming.add(last)
        writer.finish(capture)
        look = incoming.first_look(capture.views)
    perceive(capture, BOX, look)
    return time.perf_counter() - begin


def perceive(capture: Capture, box: Box, look: FirstLook | None = None) -> tuple[dict[str, float], Seen, list[Grasp]]:
    """Return the wall time of each stage [s], what it made of the views, and the ranked grasps."""
    seconds: dict[str, float] = {}
    look = look or FirstLook()

    def timed(stage: str, work: Callable[[], Any]) -> Any:
        begin = time.perf_counter()
        result = work()
        seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - begin
        return result

    labels = timed("masks", lambda: masks.segment(capture, box, observations=look.observations))
    fused = timed("cloud", lambda: cloud.fuse(capture, labels, box, surfaces=look.surfaces))
    points = timed("supports", lambda: find_supports(fused))
    tree = timed("skeleton", lambda: skeleton.skeletonize(points))
    centres = timed("flowers", lambda: flowers.flower_centres(points))
    main_stem = timed("stem", lambda: stem.find_stem(tree, flowers_at=centres))
    found = timed("flowers", lambda: flowers.find_flowers(points, tree, main_stem, centres=centres))
    ranked = timed("grasps", lambda: grasp.plan_grasps(main_stem, tree, points))
    return seconds, Seen(labels, points, tree, main_stem, found), ranked


def plan(found: Seen, ranked: list[Grasp], material: Material, repeats: int) -> dict[str, float]:
    """Return the wall time of a shake's plan and of its prediction before it is raised [s], without the arm's reach."""
    rods = model_plant(found, material, Params())
    offered = [one for one in ranked if one.score >= ranked[0].score - SLACK]
    shake = plan_shake(rods, offered)
    points = watch_points(rods)
    return {
        "plan_s": _best(lambda: plan_shake(rods, offered), repeats),
        "prediction_s": _best(lambda: foresee(rods, shake.grasp.point, shake.tones.frequencies, points), repeats),
    }


def _best(work: Callable[[], object], repeats: int) -> float:
    """Return the shortest wall time of some repeats after one that loads what is compiled [s]."""
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times[1:])


def write_views(species: Crop, seed: int, views: int, folder: Path) -> tuple[Array, list[Array]]:
    """Write the capture of a simulated plant; return the true poses, and true plant points per view in its camera."""
    _, capture, truth = take(species, seed, views)
    capture.save(folder)
    pairs = zip(truth.depth, truth.organ, strict=True)
    return truth.T_world_cam, [capture.intrinsics.back_project(d, o <= Organ.FLOWER)[::7] for d, o in pairs]


def _peak_gb() -> float:
    """Return the greatest resident set so far [GB]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e6


def in_new_process(species: str, seed: int, views: int, repeats: int) -> dict[str, float]:
    """Measure one plant in a process of its own."""
    words = ["-m", "evaluation.speed.perception", "--one", species]
    words += ["--seed", str(seed), "--views", str(views), "--repeats", str(repeats)]
    command = [sys.executable, *words]
    done = subprocess.run(command, env={**os.environ, **ONE_THREAD}, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def report(rows: dict[str, dict[str, float]]) -> Table:
    """Return the times and the memory of the plants."""
    found = {f"{crop}_{key}": value for crop, row in rows.items() for key, value in row.items()}
    found |= {
        f"{crop}_{s}_share": row[f"{s}_s"] / row["views_to_grasp_s"] for crop, row in rows.items() for s in STAGES
    }
    numbers = {f"{stage}, s, share": f"*_{stage}_s:.2f, *_{stage}_share:.0%" for stage in STAGES}
    numbers |= {
        "all, s (≤ 2)": "*_views_to_grasp_s:.2f",
        "after the last view of a live visit, s (≤ 0.7)": "*_after_last_view_s:.2f",
        "the first run of a process, s": "*_first_total_s:.2f",
        "a shake's plan, s (≤ 0.7)": "*_plan_s:.2f",
        "its prediction before it is raised, s (≤ 0.3)": "*_prediction_s:.2f",
        "peak memory, GB (≤ 0.8)": "*_peak_gb:.2f",
        "registration's error, RMS, mm": "*_registration_rms_mm:.2f",
    }
    return by_number(found, "of one plant (target)", {crop: crop for crop in rows}, numbers)


def main() -> None:
    """Measure the plants one after another in fresh processes, print the table, write --json."""
    own = {
        "--views": (VIEWS, "of a plant"),
        "--repeats": (3, "of which the best counts"),
        "--one": (str, HIDDEN, CROPS),
    }
    args = options(__doc__, quick="one plant, one repeat", seed=(10, "of the plants"), own=own)
    if args.one:
        print(json.dumps(measure(args.one, args.seed, args.views, args.repeats)))
        return
    repeats = 1 if args.quick else args.repeats
    crops = progress(CROPS[: 1 if args.quick else 2], "plants")
    rows = {crop: in_new_process(crop, args.seed, args.views, repeats) for crop in crops}
    table = max(rows.values(), key=lambda row: row["views_to_grasp_s"])
    table = table | {key: max(row[key] for row in rows.values()) for key in ("peak_gb", "registration_rms_mm")}
    finish(args, {**table, "plants": len(rows)}, report(rows))


if __name__ == "__main__":
    main()
