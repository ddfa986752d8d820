"""Every limit that binds, against a truth that does not share its model.

    python -m evaluation.judge.limits --plants 2 --jobs 2

1. Strain. The same rods in Anther and in MuJoCo, linear, at 1, 2, 5, 10 and 30 Hz: the largest strain of stem, pedicels
   and the bases of petioles, peduncles and forks, and the strain at every single place (docs/reports/limits.md). A
   plant that buckles when its pieces are cut this fine is left out.
2. Strain of pedicels over the acceleration of the grip, with true rods.
3. What a breeze of 2, 4 and 6 m/s does to the same plants (`breezes.py`).

Plants go through a sweep in --out: what is done is not done again.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.table import Table

from anther.core import Array, StageFailure
from anther.sim import grow_pepper, grow_tomato
from evaluation.harness import finish, lost, options, run_cases
from evaluation.judge.breezes import WINDS, blown, breeze_metrics, breeze_table
from evaluation.judge.limit_strains import (
    SPREAD_AT,
    StrainRow,
    strain_metrics,
    strain_per_acceleration,
    strain_rows,
    strain_table,
)
from evaluation.tables import markdown, written

PIECE, QUICK_PIECE = 0.005, 0.01
"""Longest rigid piece [m]."""
GROW = {"tomato": grow_tomato, "pepper": grow_pepper}
BANDS = ((1, 5), (5, 10), (10, 17), (17, 35))


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
        "spread": strain_per_acceleration(GROW[crop](seed), QUICK_PIECE),
        "breezes": {f"{wind:g}": blown(GROW[crop](seed), wind) for wind in WINDS},
    }


def acceleration_table(strains: dict[str, Array]) -> Table:
    """Return quantiles of (n, Q, G, D) strains per acceleration of each crop by frequency."""
    lines = []
    for crop, values in strains.items():
        for low, high in BANDS:
            here = values[:, (low <= SPREAD_AT) & (high >= SPREAD_AT)]
            shown = (np.median(here), np.quantile(here, 0.98), here.max())
            lines.append((crop, f"{low}–{high}", *(f"{100 * value:.3f} %" for value in shown)))
    return markdown(("crop", "Hz", "median", "98 %", "largest"), lines)


def acceleration_metrics(strains: dict[str, Array]) -> dict[str, float]:
    """Return median and 98 % quantile by crop."""
    out: dict[str, float] = {}
    for crop, values in strains.items():
        out[f"strain_per_ms2_{crop}_median"] = float(np.median(values))
        out[f"strain_per_ms2_{crop}_p98"] = float(np.quantile(values, 0.98))
        out[f"strain_per_ms2_{crop}_p98_worst_plant"] = float(np.quantile(values, 0.98, axis=(1, 2, 3)).max())
    return out


def _numbers(kept: dict[str, float | None]) -> dict[str, float]:
    """Return what a sweep kept of a breeze: it keeps NaN as None."""
    return {what: float("nan") if value is None else value for what, value in kept.items()}


def report(rows: list[StrainRow], spread: dict[str, Array], found: dict[str, float]) -> list[RenderableType]:
    """Return the tables."""
    all_of = "median strain_error_median:.1%, 90 % within strain_error_p90:.1%, worst strain_error_max:.1%."
    slow = re.sub(r"(strain_\w+):", r"\1_to_5hz:", all_of)
    return [
        "Errors of the largest strain of a kind on a plant, and of the strain at single places:",
        strain_table(rows),
        written(f"All kinds, plants and frequencies: {all_of} Up to 5 Hz: {slow}", found),
        "The largest pedicel strain for 1 m/s² of the grip, beyond 10 Hz as if at 10 Hz:",
        acceleration_table(spread),
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
    spread = {crop: np.array([row["spread"] for row in mine]) for crop, mine in by_crop.items() if mine}
    breezes = {
        (crop, wind): [_numbers(row["breezes"][f"{wind:g}"]) for row in by_crop[crop]]
        for crop in spread
        for wind in WINDS
    }
    named = ", ".join(f"{row['species']} {row['seed']}" for row in found) + "."
    without = [row["lost"] for row in done if "lost" in row]
    numbers = {"plants": len(found), **strain_metrics(rows), **acceleration_metrics(spread), **breeze_metrics(breezes)}
    finish(args, numbers, named, *without, *report(rows, spread, numbers))


if __name__ == "__main__":
    main()
