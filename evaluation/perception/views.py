"""Number of views against quality: evenly spread views, and the narrow views of the preset `fast`.

Some plants of each species, seeds 0 up. Of each, a pool of reachable views is taken once (1280 x 720, D455
depth noise, arm and hand-eye errors), and all choices are made from it:
- fixed: n views, each the farthest in direction from those before it, as `anther trial` takes them;
- narrow: the same among the directions that `anther trial --preset fast` allows.
`skeleton_truth.py` says how plants are judged; visible flowers are those that any view of the pool shows. Finished
plants are kept in --out and not run again.

Keys of the --json file: CHOICE_COUNT_METRIC, the mean over the plants, and with _sd the standard deviation between
plants. capture_s: motion by the planner's trajectories and stops; perception_s: processor time of masks to flowers.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType

from anther.core import AntherError
from anther.perception import Capture
from anther.robot.arm.views import Viewpoints, capture_time, reachable_views
from anther.sim import SimPlant, grow, layout, photograph
from anther.sim.simulated_cell import PRESETS, USUAL_DISTANCE
from evaluation.harness import CROPS, finish, lost, options, run_cases
from evaluation.perception.simulated import perceive
from evaluation.perception.skeleton_truth import pooled, score, visible_flowers
from evaluation.tables import by_part

POOL = 60
COUNTS = {"fixed": (5, 8, 12, 20, 30), "narrow": (8, 10, 12)}
METRICS = {
    "stem_error_median_mm": "stem error, median, mm",
    "stem_error_p95_mm": "stem error, p95, mm",
    "stem_covered": "true stem found",
    "radius_error": "radius error",
    "recall_5mm": "recall at 5 mm",
    "precision_5mm": "precision at 5 mm",
    "junction_f1": "junction F1",
    "flower_recall": "flower recall",
    "capture_s": "capture, s",
    "perception_s": "perception, s",
}


PLACE = layout(USUAL_DISTANCE)


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """All views of one plant that may be chosen, in the order of the fixed choice, and which flowers they show."""

    plant: SimPlant
    capture: Capture
    visible: NDArray[np.bool_]


def take_pool(plant: SimPlant, seed: int, viewpoints: Viewpoints, chosen: list[int]) -> Pool:
    """Render views of the plant with the errors that `anther trial` has."""
    joints = np.array([viewpoints.branches[i][0] for i in chosen])
    capture, truth = photograph(plant, joints, seed)
    return Pool(plant, capture, visible_flowers(plant, truth, capture.intrinsics))


def directions(viewpoints: Viewpoints) -> tuple[list[int], list[int]]:
    """Return the viewpoints in the order of the fixed and of the narrow choice."""
    fast = PRESETS["fast"]
    narrow = reachable_views(PLACE.region, PLACE.solids, fast)
    grid = list(zip(viewpoints.azimuth, viewpoints.elevation, strict=True))
    chosen = narrow.spread(max(COUNTS["narrow"]), fast.first)
    return viewpoints.spread(POOL), [grid.index((narrow.azimuth[i], narrow.elevation[i])) for i in chosen]


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the rows of one plant (species, seed, counts), for a sweep; "views" are numbers of viewpoints."""
    del folder
    viewpoints = reachable_views(PLACE.region, PLACE.solids)
    fixed, narrow = directions(viewpoints)
    chosen = [*fixed, *(i for i in narrow if i not in fixed)]
    pool = take_pool(grow(row["species"], row["seed"], 0.0, USUAL_DISTANCE), row["seed"], viewpoints, chosen)
    orders = {"fixed": list(range(POOL)), "narrow": [chosen.index(i) for i in narrow]}
    perceive(pool.capture.select([0, 1, 2]))  # compiles the kernels
    try:
        return {
            f"{choice}_{n}": judged(pool, order[:n]) | {"views": [chosen[i] for i in order[:n]]}
            for choice, order in orders.items()
            for n in row["counts"][choice]
        }
    except AntherError as error:
        return {"lost": str(error)}


def judged(pool: Pool, views: list[int]) -> dict[str, float]:
    """Return the metrics of the reconstruction from some views of a pool."""
    seen = perceive(pool.capture.select(views))
    table = pooled([score(pool.plant, pool.visible, seen.tree, seen.main, seen.found)])
    return {name: float(table[name]) for name in METRICS if name in table} | {"perception_s": seen.seconds}


def metrics(plants: list[dict[str, dict[str, Any]]]) -> dict[str, float]:
    """Return means and standard deviations over the plants."""
    table: dict[str, float] = {}
    for choice in plants[0]:
        for name in METRICS:
            values = [rows[choice][name] for rows in plants if name in rows.get(choice, {})]
            if values:
                table[f"{choice}_{name}"] = float(np.mean(values))
                table[f"{choice}_{name}_sd"] = float(np.std(values))
    return {**table, "plants": len(plants)}


def report(table: dict[str, float], choices: list[str]) -> list[RenderableType]:
    """Return one row a choice: the means over the plants, and their spread."""
    numbers = {head: f"*_{name}:.2f ± *_{name}_sd:.2f" for name, head in METRICS.items()}
    numbers[METRICS["capture_s"]] = "*_capture_s:.2f"
    names = {choice: choice.replace("_", " ") for choice in choices}
    said = f"Means over {table['plants']} plants ± standard deviation between them."
    return [said, by_part(table, "views", names, numbers)]


def main() -> None:
    """Run the plants that are not there yet, print the table, write --json."""
    quick, seed = "one plant of each species, 8 views", (0, "added to the seeds of all plants")
    own = {"--each": (4, "plants of each species")}
    args = options(__doc__, quick=quick, seed=seed, jobs="plants", out="runs/views", own=own)
    counts = dict.fromkeys(COUNTS, (8,)) if args.quick else COUNTS
    cases = [
        {"species": species, "seed": k + args.seed, "counts": counts}
        for k in range(1 if args.quick else args.each)
        for species in CROPS
    ]
    done = run_cases(one_plant, cases, args.out, args.jobs, lost)
    without = [f"{row['species']} {row['seed']}: {row['lost']}" for row in done if "lost" in row]
    rows = [{name: v for name, v in row.items() if isinstance(v, dict) and "views" in v} for row in done]
    rows = [row for row in rows if row]
    viewpoints = reachable_views(PLACE.region, PLACE.solids)
    for name in rows[0]:
        seconds = capture_time(viewpoints.visit(rows[0][name]["views"]))
        for row in rows:
            row[name]["capture_s"] = seconds
    table = metrics(rows)
    finish(args, table, *without, *report(table, list(rows[0])))


if __name__ == "__main__":
    main()
