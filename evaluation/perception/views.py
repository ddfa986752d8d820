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

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from anther.core import AntherError
from anther.core.files import read_json, write_json
from anther.perception import Capture, Cloud, Flowers, Skeleton, Stem, flowers, masks, skeleton, stem
from anther.perception import cloud as clouds
from anther.plant import Crop
from anther.robot import Viewpoints
from anther.robot.arm.views import capture_time, reachable_views
from anther.sim import SimPlant, grow, layout, photograph
from anther.sim.simulated_cell import PRESETS, USUAL_DISTANCE
from evaluation.perception.skeleton_truth import pooled, score, visible_flowers
from evaluation.perception.view_figure import draw
from evaluation.tables import markdown

POOL = 60
COUNTS = {"fixed": (5, 8, 12, 20, 30), "narrow": (8, 10, 12)}
SPECIES: tuple[Crop, ...] = ("tomato", "pepper")
METRICS = {
    "stem_error_median_mm": "stem error, median [mm]",
    "stem_error_p95_mm": "stem error, p95 [mm]",
    "stem_covered": "true stem found",
    "radius_error": "radius error",
    "recall_5mm": "recall at 5 mm",
    "precision_5mm": "precision at 5 mm",
    "junction_f1": "junction F1",
    "flower_recall": "flower recall",
    "capture_s": "capture [s]",
    "perception_s": "perception [s]",
}
PLACE = layout(USUAL_DISTANCE)


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """All views of one plant that may be chosen, in the order of the fixed choice, and which flowers they show."""

    plant: SimPlant
    capture: Capture
    visible: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What perception made of some views, and the processor time it took [s]."""

    cloud: Cloud
    tree: Skeleton
    main: Stem
    found: Flowers
    seconds: float


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


def perceive(capture: Capture) -> Seen:
    """Run masks, cloud, skeleton, stem and flowers."""
    begin = time.process_time()
    labels = masks.segment(capture, PLACE.workspace)
    cloud = clouds.fuse(capture, labels, PLACE.workspace)
    tree = skeleton.skeletonize(cloud)
    main = stem.find_stem(tree, flowers_at=flowers.flower_centres(cloud))
    found = flowers.find_flowers(cloud, tree, main)
    return Seen(cloud, tree, main, found, time.process_time() - begin)


def judged(pool: Pool, seen: Seen) -> dict[str, float]:
    """Return the metrics of one reconstruction."""
    table = pooled([score(pool.plant, pool.visible, seen.tree, seen.main, seen.found)])
    kept = {name: float(table[name]) for name in METRICS if name in table}
    return {**kept, "perception_s": seen.seconds}


def prefixes(name: str, pool: Pool, order: list[int], counts: tuple[int, ...]) -> dict[str, dict[str, Any]]:
    """Judge the first views of an order, for every count."""
    return {
        f"{name}_{n}": {**judged(pool, perceive(pool.capture.select(order[:n]))), "views": order[:n]} for n in counts
    }


def one_plant(species: Crop, seed: int, viewpoints: Viewpoints, counts: dict[str, Any], out: Path) -> Any:
    """Return the rows of one plant, from --out when it was run before; "views" are numbers of viewpoints."""
    file = out / f"{species}-{seed}.json"
    if not file.exists():
        fixed, narrow = directions(viewpoints)
        chosen = [*fixed, *(i for i in narrow if i not in fixed)]
        pool = take_pool(grow(species, seed, 0.0, USUAL_DISTANCE), seed, viewpoints, chosen)
        rows = prefixes("fixed", pool, list(range(POOL)), counts["fixed"])
        rows |= prefixes("narrow", pool, [chosen.index(i) for i in narrow], counts["narrow"])
        for row in rows.values():
            row["views"] = [chosen[i] for i in row["views"]]
        write_json(file, rows)
    return read_json(file)


def _capture_seconds(viewpoints: Viewpoints, chosen: list[int]) -> float:
    return capture_time(viewpoints.visit(chosen))


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


def show(table: dict[str, float], choices: list[str], console: Console) -> None:
    """Print one row a choice: the means over the plants, and their spread."""
    console.print(f"Means over {table['plants']} plants ± standard deviation between them.", highlight=False)
    heads = (title.replace(" [", ", ").replace("]", "") for title in METRICS.values())
    shown = markdown(["views", *heads])
    for choice in choices:
        shown.add_row(choice.replace("_", " "), *(_with_spread(table, f"{choice}_{name}") for name in METRICS))
    console.print(shown)


def _with_spread(table: dict[str, float], key: str) -> str:
    if key not in table:
        return "–"
    spread = "" if key.endswith("capture_s") else f" ± {table[f'{key}_sd']:.2f}"
    return f"{table[key]:.2f}{spread}"


def main() -> None:
    """Run the plants that are not there yet, print the table, write --json and --figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--quick", action="store_true", help="one plant of each species, 8 views")
    parser.add_argument("--each", type=int, default=4, help="plants of each species")
    parser.add_argument("--seed", type=int, default=0, help="added to the seeds of all plants")
    parser.add_argument("--out", type=Path, default=Path("runs/views"), help="where finished plants are kept")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    console = Console()
    counts = dict.fromkeys(COUNTS, (8,)) if args.quick else COUNTS
    viewpoints = reachable_views(PLACE.region, PLACE.solids)
    rows = []
    plants: list[tuple[Crop, int]] = [
        (species, k) for k in range(1 if args.quick else args.each) for species in SPECIES
    ]
    first = viewpoints.spread(3)
    perceive(take_pool(grow("tomato", 10, 0.0, USUAL_DISTANCE), 10, viewpoints, first).capture)  # compiles the kernels
    for species, seed in track(plants, "plants", console=console):
        try:
            rows.append(one_plant(species, seed + args.seed, viewpoints, counts, args.out))
        except AntherError as error:
            console.print(f"{species} {seed}: {error}")
    for name in rows[0]:
        seconds = _capture_seconds(viewpoints, rows[0][name]["views"])
        for row in rows:
            row[name]["capture_s"] = seconds
    table = metrics(rows)
    show(table, list(rows[0]), console)
    if args.json:
        write_json(args.json, table)
    if args.figure:
        draw(rows, METRICS).savefig(args.figure, dpi=90)


if __name__ == "__main__":
    main()
