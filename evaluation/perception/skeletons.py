"""Skeletons of simulated plants against their truth, through the whole noisy capture, one parameter set (paper R1).

Ten plants (two tomatoes, eight peppers, as in the paper) and 100 further ones (50 of each species), none of which was
looked at while parameters were chosen. Each is seen in 30 views that the Sawyer reaches, 1280 x 720, with the depth
noise of a D455, arm pose noise (0.2 deg, 1.5 mm per axis) and a hand-eye error (0.2 deg, 1 mm). Plants go through a
sweep in --out: what is done is not run again. `skeleton_truth.py` says how a plant is judged.

Keys of the --json file: those of `skeleton_truth.pooled` for all plants together, and with the prefixes tomato_,
pepper_, ten_ (the ten plants), hundred_ for parts; seconds_median (perception alone), failed (share of plants without
a result).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from anther.core import AntherError
from anther.core.files import write_json
from anther.perception import Capture, cloud, flowers, masks, skeleton, stem
from anther.plant import Crop
from anther.robot.arm.views import Params as ViewParams
from anther.sim import CaptureTruth, SimPlant, grow, layout, photograph, views_at
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import FOLDER, run_cases
from evaluation.perception.skeleton_figures import draw_ten
from evaluation.perception.skeleton_truth import Score, pooled, score, visible_flowers
from evaluation.tables import markdown

VIEWS = 30
TEN: list[tuple[Crop, int]] = [*(("tomato", k) for k in range(2)), *(("pepper", k) for k in range(8))]
HUNDRED: list[tuple[Crop, int]] = [(species, 1000 + k) for k in range(50) for species in ("tomato", "pepper")]

SHOWN = {
    "plants": ("plants", "", ".0f"),
    "failed": ("without a result", "0", ".0%"),
    "stem_error_median_mm": ("main stem's error, median, mm", "≤ 1.5", ".2f"),
    "stem_error_p95_mm": ("the same, 95th percentile, mm", "≤ 5", ".1f"),
    "stem_covered": ("share of the true stem that is found", "", ".1%"),
    "radius_error": ("stem radius, median absolute error", "≤ 15 %", ".1%"),
    "radius_bias": ("stem radius, bias", "", "+.1%"),
    "radius_within_15_percent": ("plants whose median radius is within 15 %", "", ".0%"),
    "recall_5mm": ("recall of stem, branches, petioles at 5 mm", "≥ 90 %", ".1%"),
    "precision_5mm": ("precision of stem and branches at 5 mm", "≥ 95 %", ".1%"),
    "junction_f1": ("junctions at 10 mm, F1", "≥ 0.8", ".2f"),
    "junction_recall": ("junctions, recall", "", ".1%"),
    "junction_precision": ("junctions, precision", "", ".1%"),
    "flower_recall": ("visible flowers that are found, within 15 mm", "≥ 85 %", ".1%"),
    "flower_precision": ("found flowers that are real", "", ".1%"),
    "tree_share": ("skeletons that are one rooted tree", "100 %", ".0%"),
    "root_error_median_mm": ("root's error, median, mm", "", ".1f"),
    "root_error_max_mm": ("root's error, greatest, mm", "", ".1f"),
}
"""What the table shows: its words, the target where there is one, and how it is written."""


def take(species: Crop, seed: int, views: int = VIEWS) -> tuple[SimPlant, Capture, CaptureTruth]:
    """Grow a plant in the cell and see it as `anther trial` does."""
    planned = views_at(USUAL_DISTANCE, ViewParams(count=views))
    plant = grow(species, seed, 0.0, USUAL_DISTANCE)
    return plant, *photograph(plant, planned.joints, seed)


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return one plant's score as plain lists, for a sweep."""
    species, seed = row["species"], row["seed"]
    plant, capture, truth = take(species, seed)
    begin = time.perf_counter()
    try:
        labels = masks.segment(capture, layout(USUAL_DISTANCE).workspace)
        points = cloud.fuse(capture, labels, layout(USUAL_DISTANCE).workspace)
        tree = skeleton.skeletonize(points)
        main = stem.find_stem(tree, flowers_at=flowers.flower_centres(points))
        found = flowers.find_flowers(points, tree, main)
    except AntherError as error:
        return {"failure": str(error)}
    seconds = time.perf_counter() - begin
    result = score(plant, visible_flowers(plant, truth, capture.intrinsics), tree, main, found)
    if (species, seed) in TEN:
        keep(folder, points, tree, main)
    return {**as_lists(result), "seconds": seconds, "notes": [*points.notes, *tree.notes]}


def keep(folder: Path, points: cloud.Cloud, tree: skeleton.Skeleton, main: stem.Stem) -> None:
    """Save what the picture of the ten plants shows."""
    points.save(folder / "cloud.ply")
    tree.save(folder / "skeleton.npz")
    main.save(folder / "stem.npz")


def as_lists(result: Score) -> dict[str, Any]:
    """Return the fields of a score as JSON can hold them."""
    fields = {name: getattr(result, name) for name in Score.__slots__}
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in fields.items()}


def as_score(stored: dict[str, Any]) -> Score:
    """Return what `as_lists` was given."""
    fields: dict[str, Any] = {name: stored[name] for name in Score.__slots__}
    for name, value in fields.items():
        fields[name] = np.array(value) if isinstance(value, list) else value
    return Score(**fields)


def metrics(rows: dict[tuple[str, int], dict[str, Any]]) -> dict[str, float]:
    """Return the flat table of all plants and of its parts."""
    parts = {
        "": list(rows),
        "tomato_": [which for which in rows if which[0] == "tomato"],
        "pepper_": [which for which in rows if which[0] == "pepper"],
        "ten_": [which for which in rows if which in TEN],
        "hundred_": [which for which in rows if which not in TEN],
    }
    table: dict[str, float] = {}
    for prefix, members in parts.items():
        scores = [as_score(rows[which]) for which in members if "failure" not in rows[which]]
        if scores:
            table |= {prefix + name: float(value) for name, value in pooled(scores).items()}
            table[prefix + "failed"] = 1 - len(scores) / len(members)
    table["seconds_median"] = float(np.median([row["seconds"] for row in rows.values() if "seconds" in row]))
    return table


def show(table: dict[str, float], console: Console) -> None:
    """Print the parts side by side."""
    shown = markdown(["", "target", "all", "tomato", "pepper", "the paper's ten", "further plants"])
    for name, (words, target, form) in SHOWN.items():
        values = [table.get(prefix + name) for prefix in ("", "tomato_", "pepper_", "ten_", "hundred_")]
        shown.add_row(words, target, *("" if value is None else f"{value:{form}}" for value in values))
    console.print(shown)
    console.print(f"Perception of one plant takes {table['seconds_median']:.1f} s (median, beside other plants).")


def is_poor(row: dict[str, Any]) -> bool:
    """Return whether a plant is worth being named."""
    return "failure" in row or bool(np.quantile(row["stem_error"], 0.95) > 0.005) or row["stem_covered"] < 0.8


def fault(row: dict[str, Any]) -> str:
    """Return what is wrong with a plant."""
    if "failure" in row:
        return str(row["failure"])
    beyond = 1e3 * np.quantile(row["stem_error"], 0.95)
    return f"95th percentile {beyond:.1f} mm, {row['stem_covered']:.0%} of the true stem found"


def main() -> None:
    """Run what is not there yet, print the table, list the worst plants, write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="two plants of each species")
    parser.add_argument("--seed", type=int, default=0, help="added to the seeds of all plants")
    parser.add_argument("--further", type=int, default=100, help="how many of the hundred further plants")
    parser.add_argument("--jobs", type=int, default=1, help="plants at a time; each uses two threads")
    parser.add_argument("--out", type=Path, default=Path("runs/skeletons"), help="where finished plants are kept")
    parser.add_argument("--figures", type=Path, help="write skeletons.png into this folder")
    args = parser.parse_args()
    console = Console()
    chosen = [*TEN[:4:2], *HUNDRED[:2]] if args.quick else [*TEN, *HUNDRED[: args.further]]
    chosen = [(species, seed + args.seed) for species, seed in chosen]
    cases = [{"species": species, "seed": seed} for species, seed in chosen]
    rows = dict(
        zip(chosen, run_cases(one_plant, cases, args.out, args.jobs, lambda why: {"failure": why}), strict=True)
    )
    table = metrics(rows)
    show(table, console)
    if worst := [which for which, row in rows.items() if is_poor(row)]:
        console.print(
            "Plants without a result, with a 95th percentile beyond 5 mm, or less than 80 % of the true stem:"
        )
    for species, seed in worst:
        console.print(f"{species} {seed}: {fault(rows[species, seed])}.", highlight=False)
    if args.json:
        write_json(args.json, table)
    if args.figures:
        there: list[tuple[Crop, int]] = [which for which in TEN if which in rows and "failure" not in rows[which]]
        ten: list[tuple[Crop, int, Path]] = [(*which, Path(rows[which][FOLDER])) for which in there]
        draw_ten(ten).savefig(args.figures / "skeletons.png", dpi=90)


if __name__ == "__main__":
    main()
