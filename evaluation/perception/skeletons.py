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

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import RenderableType

from anther.core import AntherError
from anther.perception import Cloud, Skeleton, Stem
from anther.plant import Crop
from anther.show.pictures.plant import draw_side
from anther.sim import grow
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import FOLDER, by_turns, finish, options, run_cases, save
from evaluation.perception.simulated import TEN, perceive, take
from evaluation.perception.skeleton_truth import AXIS, Score, pooled, score, visible_flowers
from evaluation.tables import by_number

HUNDRED = by_turns(100, 1000)

SHOWN = {
    "plants": "*plants:.0f",
    "without a result (0)": "*failed:.0%",
    "main stem's error, median, mm (≤ 1.5)": "*stem_error_median_mm:.2f",
    "the same, 95th percentile, mm (≤ 5)": "*stem_error_p95_mm:.1f",
    "share of the true stem that is found": "*stem_covered:.1%",
    "stem radius, median absolute error (≤ 15 %)": "*radius_error:.1%",
    "stem radius, bias": "*radius_bias:+.1%",
    "plants whose median radius is within 15 %": "*radius_within_15_percent:.0%",
    "recall of stem, branches, petioles at 5 mm (≥ 90 %)": "*recall_5mm:.1%",
    "precision of stem and branches at 5 mm (≥ 95 %)": "*precision_5mm:.1%",
    "junctions at 10 mm, F1 (≥ 0.8)": "*junction_f1:.2f",
    "junctions, recall": "*junction_recall:.1%",
    "junctions, precision": "*junction_precision:.1%",
    "visible flowers that are found, within 15 mm (≥ 85 %)": "*flower_recall:.1%",
    "found flowers that are real": "*flower_precision:.1%",
    "skeletons that are one rooted tree (100 %)": "*tree_share:.0%",
    "root's error, median, mm": "*root_error_median_mm:.1f",
    "root's error, greatest, mm": "*root_error_max_mm:.1f",
}
"""What the table shows: its words, the target where there is one, and the number."""


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return one plant's score as plain lists, for a sweep; what the picture of the ten plants shows is saved."""
    plant, capture, truth = take(row["species"], row["seed"])
    try:
        seen = perceive(capture)
    except AntherError as error:
        return {"failure": str(error)}
    result = score(plant, visible_flowers(plant, truth, capture.intrinsics), seen.tree, seen.main, seen.found)
    if (row["species"], row["seed"]) in TEN:
        for file, part in (("cloud.ply", seen.cloud), ("skeleton.npz", seen.tree), ("stem.npz", seen.main)):
            part.save(folder / file)
    return {**as_lists(result), "seconds": seen.wall, "notes": [*seen.cloud.notes, *seen.tree.notes]}


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


def is_poor(row: dict[str, Any]) -> bool:
    """Return whether a plant is worth being named."""
    return "failure" in row or bool(np.quantile(row["stem_error"], 0.95) > 0.005) or row["stem_covered"] < 0.8


def fault(row: dict[str, Any]) -> str:
    """Return what is wrong with a plant."""
    if "failure" in row:
        return str(row["failure"])
    beyond = 1e3 * np.quantile(row["stem_error"], 0.95)
    return f"95th percentile {beyond:.1f} mm, {row['stem_covered']:.0%} of the true stem found"


FRONT = (1, 2, 0)
"""Across, up, depth: the plant as the arm sees it from its base."""


def draw_ten(plants: list[tuple[Crop, int, Path]]) -> Figure:
    """Return the plants (species, seed, folder with what was found) side by side: cloud, skeleton by organ, main stem;
    true stem and branches dashed."""
    figure = Figure(figsize=(15, 7.5), layout="constrained")
    plots = figure.subplots(2, (len(plants) + 1) // 2, sharey=True)
    for (species, seed, folder), plot in zip(plants, plots.flat, strict=False):
        cloud, skeleton = Cloud.load(folder / "cloud.ply"), Skeleton.load(folder / "skeleton.npz")
        draw_side(plot, FRONT, cloud, skeleton, Stem.load(folder / "stem.npz"))
        plant = grow(species, seed, 0.0, USUAL_DISTANCE)
        for k in np.flatnonzero(np.isin(plant.organ, AXIS)):
            line = np.stack([plant.start[k], plant.end[k]])[:, FRONT[:2]]
            plot.plot(*line.T, color="black", lw=0.8, ls=(0, (2, 2)), zorder=8)
        plot.set(title=f"{species} {seed}", aspect="equal")
        plot.tick_params(labelsize=7)
    return figure


def report(table: dict[str, float], rows: dict[tuple[Crop, int], dict[str, Any]]) -> Iterator[RenderableType]:
    """Yield the parts side by side, and the plants that are poor."""
    parts = {
        "": "all",
        "tomato_": "tomato",
        "pepper_": "pepper",
        "ten_": "the paper's ten",
        "hundred_": "further plants",
    }
    yield by_number(table, "(target)", parts, SHOWN)
    yield f"Perception of one plant takes {table['seconds_median']:.1f} s (median, beside other plants)."
    if worst := [which for which, row in rows.items() if is_poor(row)]:
        yield "Plants without a result, with a 95th percentile beyond 5 mm, or less than 80 % of the true stem:"
        yield from (f"{species} {seed}: {fault(rows[species, seed])}." for species, seed in worst)


def main() -> None:
    """Run what is not there yet, print the table, list the worst plants, write --json."""
    quick, seed, figures = "two plants of each species", (0, "added to the seeds of all plants"), "skeletons.png"
    own = {"--further": (100, "how many of the hundred further plants")}
    args = options(__doc__, quick=quick, seed=seed, jobs="plants", out="runs/skeletons", figures=figures, own=own)
    chosen = [*TEN[:4:2], *HUNDRED[:2]] if args.quick else [*TEN, *HUNDRED[: args.further]]
    chosen = [(species, seed + args.seed) for species, seed in chosen]
    cases = [{"species": species, "seed": seed} for species, seed in chosen]
    done = run_cases(one_plant, cases, args.out, args.jobs, lambda why: {"failure": why})
    rows = dict(zip(chosen, done, strict=True))
    table = metrics(rows)
    finish(args, table, *report(table, rows))
    if args.figures:
        there = [which for which in TEN if which in rows and "failure" not in rows[which]]
        ten = [(*which, Path(rows[which][FOLDER])) for which in there]
        save(draw_ten(ten), args.figures / "skeletons.png", 90)


if __name__ == "__main__":
    main()
