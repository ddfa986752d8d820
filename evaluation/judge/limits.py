"""Every limit that binds, against a truth that does not share its model.

    python -m evaluation.judge.limits --plants 2 --jobs 2

1. Strain. The same rods in Anther and in MuJoCo, linear, at 1, 2, 5, 10 and 30 Hz: the largest strain of stem, pedicels
   and the bases of petioles, peduncles and forks, and the strain at every single place (docs/reports/limits.md). A
   plant that buckles when its pieces are cut this fine is left out.
2. What a breeze of 2, 4 and 6 m/s does to the same plants (`breezes.py`).

Plants go through a sweep in --out: what is done is not done again.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from anther.core import StageFailure
from anther.sim import grow_pepper, grow_tomato
from evaluation.harness import finish, lost, options, run_cases
from evaluation.judge.breezes import WINDS, blown, breeze_metrics, breeze_table
from evaluation.judge.limit_strains import StrainRow, strain_metrics, strain_rows, strain_table
from evaluation.tables import written

PIECE, QUICK_PIECE = 0.005, 0.01
"""Longest rigid piece [m]."""
GROW = {"tomato": grow_tomato, "pepper": grow_pepper}


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what is compared on a plant (species, seed, piece), or why it is left out."""
    del folder
    crop, seed = row["species"], row["seed"]
    try:
        strains = strain_rows(GROW[crop](seed), row["piece"])
    except StageFailure as buckles:
        return {"lost": f"{crop} {seed} is left out: {buckles}"}
    return {
        "strains": [list(strain) for strain in strains],
        "breezes": {f"{wind:g}": blown(GROW[crop](seed), wind) for wind in WINDS},
    }


def _numbers(kept: dict[str, float | None]) -> dict[str, float]:
    """Return what a sweep kept of a breeze: it keeps NaN as None."""
    return {what: float("nan") if value is None else value for what, value in kept.items()}


def report(found: dict[str, float]) -> list[RenderableType]:
    """Return the tables."""
    all_of = "median strain_error_median:.1%, 90 % within strain_error_p90:.1%, worst strain_error_max:.1%."
    slow = re.sub(r"(strain_\w+):", r"\1_to_5hz:", all_of)
    return [
        "Errors of the largest strain of a kind on a plant, and of the strain at single places:",
        strain_table(found),
        written(f"All kinds, plants and frequencies: {all_of} Up to 5 Hz: {slow}", found),
        "What a breeze does, medians over the plants:",
        breeze_table(found),
    ]


def main() -> None:
    """Compare, print the tables, write the metrics."""
    quick, seed = "one plant of each crop, pieces of 10 instead of 5 mm", (10, "of the first plant of each crop")
    own = {"--plants": (5, "of each crop")}
    args = options(__doc__, quick=quick, seed=seed, jobs="plants", out="runs/limits", own=own)
    count, piece = (1, QUICK_PIECE) if args.quick else (args.plants, PIECE)
    cases = [{"species": crop, "seed": args.seed + k, "piece": piece} for crop in GROW for k in range(count)]
    done = run_cases(one_plant, cases, args.out, args.jobs, lost)
    found = [row for row in done if "lost" not in row]
    rows = [StrainRow(*strain[:-1], np.array(strain[-1])) for row in found for strain in row["strains"]]
    by_crop = {crop: [row for row in found if row["species"] == crop] for crop in GROW}
    breezes = {
        (crop, wind): [_numbers(row["breezes"][f"{wind:g}"]) for row in mine]
        for crop, mine in by_crop.items()
        for wind in WINDS
        if mine
    }
    named = ", ".join(f"{row['species']} {row['seed']}" for row in found) + "."
    without = [row["lost"] for row in done if "lost" in row]
    numbers = {"plants": len(found), **strain_metrics(rows), **breeze_metrics(breezes)}
    finish(args, numbers, named, *without, *report(numbers))


if __name__ == "__main__":
    main()
