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

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from anther.core import Array, StageFailure
from anther.core.files import write_json
from anther.sim import grow_pepper, grow_tomato
from evaluation.harness import run_cases
from evaluation.judge.breezes import WINDS, blown, breeze_metrics, breeze_table
from evaluation.judge.limit_strains import (
    SPREAD_AT,
    StrainRow,
    strain_metrics,
    strain_per_acceleration,
    strain_rows,
    strain_table,
)
from evaluation.tables import markdown

PIECE, QUICK_PIECE = 0.005, 0.01
"""Longest rigid piece [m]."""
CROPS = {"tomato": grow_tomato, "pepper": grow_pepper}
BANDS = ((1, 5), (5, 10), (10, 17), (17, 35))


def one_plant(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what is compared on a plant (species, seed, piece), or why it is left out."""
    del folder
    crop, seed = row["species"], row["seed"]
    try:
        strains = strain_rows(CROPS[crop](seed), row["piece"])
    except StageFailure as buckles:
        return {"lost": f"{crop} {seed} is left out: {buckles}"}
    return {
        "strains": [list(strain) for strain in strains],
        "spread": strain_per_acceleration(CROPS[crop](seed), QUICK_PIECE),
        "breezes": {f"{wind:g}": blown(CROPS[crop](seed), wind) for wind in WINDS},
    }


def acceleration_table(strains: dict[str, Array]) -> Table:
    """Return quantiles of (n, Q, G, D) strains per acceleration of each crop by frequency."""
    table = markdown(["crop", "Hz", "median", "98 %", "largest"])
    for crop, values in strains.items():
        for low, high in BANDS:
            here = values[:, (low <= SPREAD_AT) & (high >= SPREAD_AT)]
            shown = (np.median(here), np.quantile(here, 0.98), here.max())
            table.add_row(crop, f"{low}–{high}", *(f"{100 * value:.3f} %" for value in shown))
    return table


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


def show(console: Console, rows: list[StrainRow], spread: dict[str, Array], breezes: Any) -> None:
    """Print the tables."""
    numbers = strain_metrics(rows)
    console.print("Errors of the largest strain of a kind on a plant, and of the strain at single places:")
    console.print(strain_table(rows))
    console.print(
        f"All kinds, plants and frequencies: median {numbers['strain_error_median']:.1%}, 90 % within "
        f"{numbers['strain_error_p90']:.1%}, worst {numbers['strain_error_max']:.1%}. Up to 5 Hz: median "
        f"{numbers['strain_error_median_to_5hz']:.1%}, 90 % within {numbers['strain_error_p90_to_5hz']:.1%}, worst "
        f"{numbers['strain_error_max_to_5hz']:.1%}."
    )
    console.print("The largest pedicel strain for 1 m/s² of the grip, beyond 10 Hz as if at 10 Hz:")
    console.print(acceleration_table(spread))
    console.print("What a breeze does, medians over the plants; of the worst pedicel the range:")
    console.print(breeze_table(breezes))


def main() -> None:
    """Compare, print the tables, write the metrics."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="one plant of each crop, pieces of 10 instead of 5 mm")
    parser.add_argument("--plants", type=int, default=5, help="of each crop")
    parser.add_argument("--seed", type=int, default=10, help="of the first plant of each crop")
    parser.add_argument("--jobs", type=int, default=1, help="plants at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/limits"), help="where finished plants are kept")
    args = parser.parse_args()
    count, piece = (1, QUICK_PIECE) if args.quick else (args.plants, PIECE)
    cases = [{"species": crop, "seed": args.seed + k, "piece": piece} for crop in CROPS for k in range(count)]
    done = run_cases(one_plant, cases, args.out, args.jobs, lambda reason: {"lost": f"crashed: {reason}"})
    found, console = [row for row in done if "lost" not in row], Console()
    rows = [StrainRow(*strain[:-1], np.array(strain[-1])) for row in found for strain in row["strains"]]
    crops = [crop for crop in CROPS if any(row["species"] == crop for row in found)]
    spread = {crop: np.array([row["spread"] for row in found if row["species"] == crop]) for crop in crops}
    breezes = {
        (crop, wind): [_numbers(row["breezes"][f"{wind:g}"]) for row in found if row["species"] == crop]
        for crop in crops
        for wind in WINDS
    }
    console.print(", ".join(f"{row['species']} {row['seed']}" for row in found) + ".")
    for row in done:
        if "lost" in row:
            console.print(row["lost"])
    show(console, rows, spread, breezes)
    if args.json:
        numbers = {"plants": len(found), **strain_metrics(rows), **acceleration_metrics(spread)}
        write_json(args.json, {**numbers, **breeze_metrics(breezes)})


if __name__ == "__main__":
    main()
