"""Every limit that binds, against a truth that does not share its model.

    python experiments/limits.py

1. Strain. The same rods in Anther and in MuJoCo, linear, at 1, 2, 5, 10 and 30 Hz: the largest strain of stem, pedicels
   and the bases of petioles, peduncles and forks, and the strain at every single place (docs/reports/limits.md). A
   plant that buckles when its pieces are cut this fine is left out and the next one taken.
2. Strain of pedicels over the acceleration of the grip, with true rods.
3. What a breeze of 2, 4 and 6 m/s does to the same plants (`breezes.py`).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from breezes import WINDS, blown, breeze_metrics, breeze_table
from limit_strains import SPREAD_AT, StrainRow, strain_metrics, strain_per_acceleration, strain_rows, strain_table
from rich.console import Console
from rich.progress import track
from rich.table import Table

from anther.errors import StageFailure
from anther.files import write_json
from anther.geometry import Array
from anther.sim.pepper import grow_pepper
from anther.sim.tomato import grow_tomato

PLANTS, PIECE = 5, 0.005
"""Of each crop, and the longest rigid piece [m]."""
QUICK_PLANTS, QUICK_PIECE = 1, 0.01
CROPS = {"tomato": grow_tomato, "pepper": grow_pepper}
BANDS = ((1, 5), (5, 10), (10, 17), (17, 35))


def acceleration_table(strains: dict[str, Array]) -> Table:
    """Return quantiles of (n, Q, G, D) strains per acceleration of each crop by frequency."""
    table = Table("pedicel strain per m/s2 of the grip", "Hz", "median", "98 %", "largest")
    for crop, values in strains.items():
        for low, high in BANDS:
            here = values[:, (low <= SPREAD_AT) & (high >= SPREAD_AT)]
            shown = (np.median(here), np.quantile(here, 0.98), here.max())
            table.add_row(crop, f"{low}-{high}", *(f"{100 * value:.3f} %" for value in shown))
    return table


def acceleration_metrics(strains: dict[str, Array]) -> dict[str, float]:
    """Return median and 98 % quantile by crop."""
    out: dict[str, float] = {}
    for crop, values in strains.items():
        out[f"strain_per_ms2_{crop}_median"] = float(np.median(values))
        out[f"strain_per_ms2_{crop}_p98"] = float(np.quantile(values, 0.98))
        out[f"strain_per_ms2_{crop}_p98_worst_plant"] = float(np.quantile(values, 0.98, axis=(1, 2, 3)).max())
    return out


def main() -> None:
    """Compare, print the tables, write the metrics."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="one plant of each crop, pieces of 10 instead of 5 mm")
    parser.add_argument("--seed", type=int, default=10, help="of the first plant of each crop")
    args = parser.parse_args()
    count, piece = (QUICK_PLANTS, QUICK_PIECE) if args.quick else (PLANTS, PIECE)
    console, rows, strains = Console(), list[StrainRow](), dict[str, list[Array]]()
    breezes: dict[tuple[str, float], list[dict[str, float]]] = {(c, wind): [] for c in CROPS for wind in WINDS}
    cases = [(crop, seed) for crop in CROPS for seed in range(args.seed, args.seed + 2 * count)]
    for crop, seed in track(cases, "plants"):
        found = strains.setdefault(crop, [])
        if len(found) == count:
            continue
        try:
            rows += strain_rows(CROPS[crop](seed), piece)
        except StageFailure as buckles:
            console.print(f"{crop} {seed} is left out: {buckles}")
            continue
        found.append(strain_per_acceleration(CROPS[crop](seed), QUICK_PIECE))
        for wind in WINDS:
            breezes[crop, wind].append(blown(CROPS[crop](seed), wind))
    spread = {crop: np.array(values) for crop, values in strains.items()}
    console.print(strain_table(rows))
    console.print(acceleration_table(spread))
    console.print(breeze_table(breezes))
    if args.json:
        numbers = {"plants": sum(map(len, strains.values()))}
        write_json(
            args.json, {**numbers, **strain_metrics(rows), **acceleration_metrics(spread), **breeze_metrics(breezes)}
        )


if __name__ == "__main__":
    main()
