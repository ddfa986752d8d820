"""Skeletons, main stems and grasps on real plants: against people's labels, against published graphs, beside peers.

Labelled clouds (read from --data): 93 scans of tomato seedlings (trackplant3d_tomato1a), a 26-day tomato
(salk_tomato_D26), a maize (gavriel_maize). Clouds with a published skeleton graph: two tomatoes and a maize of
Pheno4D. One parameter set for all. Beside Anther, in the same run: plain Lee thinning with the paper's tree, stem and
grasp rule and none of Anther's steps, at two resolutions; and pc-skeletor with the same rules, when --pc-skeletor names
a Python that has it. docs/real_plants.md shows the results and says what each number means.

Keys of the --json file, without a prefix Anther's, then with plain_, plain_fine_ and pc_skeletor_:
trackplant_grasp_on_stem and all_grasp_on_stem (share of plants whose grasp is on the stem system), stem_on_label (share
of the main stem's length on it, mean over plants), stem_on_label_95 (share of plants with 95 % or more), stem_reach,
covered, stem_distance_median_mm, single_trees, tips_per_leaf, seconds_median (processor time), no_answer, plants; and
<scan>_precision_<1v|3v>, <scan>_recall_<1v|3v> against the published graphs.
"""

from __future__ import annotations

import argparse
import contextlib
import os
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from real.answers import Answer, Method, Seen, anther, asked
from real.contraction import PcSkeletor
from real.judge import Outcome, Tolerance, agreement, judge
from real.pictures import draw_below, draw_methods, draw_references, draw_seen, save
from real.plain_thinning import FINE, plain_thinning
from real.plants import LABELLED, UNLABELLED, Labelled, labelled_plants, references
from rich.console import Console
from rich.progress import track
from rich.table import Table

from anther.files import write_json
from anther.formats.clouds import read_cloud

DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[2] / "shared" / "data"))
ENOUGH = 0.95
"""Share of the main stem that must lie on the stem system."""
SHOWN = ("167_tomato1_control1_plant1_D00", "213_tomato1_drought_plant1_D02", "259_tomato1_heat_plant2_D05", *LABELLED)
"""Plants drawn with all methods: the first, middle and last seedling, and the other two; by place, not by result."""
MOST_BELOW = 2

Outcomes = dict[str, list[Outcome]]


def run(plants: list[Labelled], methods: dict[str, Method], console: Console, figures: Path | None) -> Outcomes:
    """Return every method's outcomes on the labelled plants; draw some of the plants."""
    outcomes: Outcomes = {name: [] for name in ("anther", *methods)}
    shown: list[tuple[Labelled, dict[str, Answer | str]]] = []
    below: list[tuple[Labelled, Seen]] = []
    for plant in track(plants, "labelled plants", console=console):
        seen = anther(plant.cloud)
        tolerance = Tolerance(seen.skeleton.nodes[seen.stem.node_ids], seen.skeleton.radius[seen.stem.node_ids])
        answers = {"anther": seen.answer, **{name: asked(method, plant.cloud) for name, method in methods.items()}}
        for name, answer in answers.items():
            outcomes[name].append(judge(plant, answer, tolerance))
        if plant.name in SHOWN:
            shown.append((plant, answers))
        if outcomes["anther"][-1].stem_share < ENOUGH:
            below.append((plant, seen))
    if figures is not None:
        save(draw_methods(shown), figures / "real_plants_methods.png")
        if below:
            save(draw_below(below[:MOST_BELOW]), figures / "real_plants_below.png")
    return outcomes


def against_references(folder: Path, figures: Path | None) -> dict[str, float]:
    """Return precision and recall against the published graphs; draw both."""
    seen = [(plant, anther(plant.cloud)) for plant in references(folder)]
    if figures is not None:
        save(draw_references(seen), figures / "real_plants_references.png")
    return {f"{plant.name}_{name}": value for plant, s in seen for name, value in agreement(plant, s.answer).items()}


def draw_unlabelled(folder: Path, figures: Path) -> None:
    """Draw the plants nobody has labelled."""
    for name in UNLABELLED:
        seen = anther(read_cloud(folder / f"{name}.npz"))
        save(draw_seen(seen, name), figures / f"real_plants_{name}.png")


def metrics(outcomes: Outcomes) -> dict[str, float]:
    """Return the numbers of the results contract; a method without an answer has missed everything."""
    found: dict[str, float] = {}
    for method, of_plants in outcomes.items():
        prefix = "" if method == "anther" else f"{method}_"
        found |= {prefix + name: value for name, value in _of_method(of_plants).items()}
    return found


def _of_method(outcomes: list[Outcome]) -> dict[str, float]:
    return {
        "trackplant_grasp_on_stem": _mean([o.grasp_on_stem for o in outcomes if "tomato1" in o.plant]),
        "all_grasp_on_stem": _mean([o.grasp_on_stem for o in outcomes]),
        "stem_on_label": _mean([o.stem_share for o in outcomes]),
        "stem_on_label_95": _mean([o.stem_share >= ENOUGH for o in outcomes]),
        "stem_reach": _mean([o.stem_reach for o in outcomes]),
        "covered": _mean([o.covered for o in outcomes]),
        "stem_distance_median_mm": float(np.nanmedian([o.distance for o in outcomes])) * 1e3,
        "single_trees": _mean([o.is_tree for o in outcomes]),
        "tips_per_leaf": float(np.nanmedian([o.tips_per_leaf for o in outcomes])),
        "seconds_median": float(np.nanmedian([o.seconds for o in outcomes])),
        "no_answer": sum(o.failure is not None for o in outcomes),
        "plants": len(outcomes),
    }


def main() -> None:
    """Run, print a table, list what went wrong, write --json and the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA / "clouds", help="folder of the clouds")
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--figures", type=Path, help="write the pictures into this folder")
    parser.add_argument("--pc-skeletor", type=Path, metavar="PYTHON", help="a Python that has pc-skeletor")
    parser.add_argument("--quick", action="store_true", help="every eighth seedling only")
    parser.add_argument("--seed", type=int, default=0, help="for uniformity; nothing here is random")
    args = parser.parse_args()
    console = Console()
    methods: dict[str, Method] = {"plain": plain_thinning, "plain_fine": partial(plain_thinning, resolution=FINE)}
    with contextlib.ExitStack() as stack:
        if args.pc_skeletor:
            methods["pc_skeletor"] = stack.enter_context(contextlib.closing(PcSkeletor(args.pc_skeletor)))
        outcomes = run(list(labelled_plants(args.data, 8 if args.quick else 1)), methods, console, args.figures)
    agreements = against_references(args.data, args.figures)
    if args.figures:
        draw_unlabelled(args.data, args.figures)
    _print(console, outcomes, agreements)
    if args.json:
        write_json(args.json, metrics(outcomes) | agreements)


def _print(console: Console, outcomes: Outcomes, agreements: dict[str, float]) -> None:
    table = Table("metric", *outcomes)
    rows = {method: _of_method(of_plants) for method, of_plants in outcomes.items()}
    for name in rows["anther"]:
        table.add_row(name, *(f"{row[name]:.4g}" for row in rows.values()))
    console.print(table)
    for name, value in agreements.items():
        console.print(f"{name}: {value:.2f}", highlight=False)
    for o in outcomes["anther"]:
        if not o.grasp_on_stem or o.stem_share < ENOUGH:
            grasp = "" if o.grasp_on_stem else "grasp off the stem; "
            console.print(f"{o.plant}: {grasp}{o.stem_share:.0%} of the main stem on stem points", highlight=False)
    for method, of_plants in outcomes.items():
        for reason, count in Counter(o.failure for o in of_plants if o.failure).items():
            console.print(f"{method}: no answer on {count} plants: {reason}", highlight=False)


def _mean(values: list[Any]) -> float:
    return float(np.mean(values)) if values else float("nan")


if __name__ == "__main__":
    main()
