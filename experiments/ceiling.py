"""What a shake of the same grip could give if all were known of the plant: the ceiling of the shakes of `shaking.py`.

    python experiments/shaking.py --ways escalated motor --out runs/shaking
    python tools/record.py experiments/ceiling.py --rows runs/shaking

Each plant of the sweep in --rows is held where its watched trial held it and shaken along the same line, by MuJoCo's
linear equations of the true plant with the drag at 2 mm. At each frequency the amplitude is the largest that the
machine gives (`REACH`) at which none of three loads (bending of stem and branches, of pedicels, of all other organs)
is more than what all but 2.5 % of plants bear (`sim.truth.TOLERANCE`); the frequency is the one that moves the median
flower most. Slip and the load at leaf bases are not counted.

Keys of --json, each after <way>_, of escalated and motor: ceiling_<crop>_ms2 and got_<crop>_ms2, medians over plants of
the median flower's peak acceleration; share, the median of a plant's got over its ceiling; <load>_binds, the share of
plants whose ceiling that is; plants.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from grasping_trial import truth_of
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.stats import norm
from shaken_plant import ShakenPlant

from anther import sweep
from anther.commands.simulated_cell import USUAL_DISTANCE, grow
from anther.files import write_json
from anther.geometry import Array
from anther.shake._actuators import ACCELERATION, STROKE, VIBRATING_GRIPPER
from anther.shake.observables import semi_major
from anther.sim.plant import Organ
from anther.sim.truth import TOLERANCE

DRAG_AT = 2e-3  # m


class Reach(NamedTuple):
    """What a machine gives: frequencies [Hz], amplitude [m] and acceleration [m/s2] of the grip at most."""

    frequencies: Array
    amplitude: float
    acceleration: float


MOTOR, SHARE = VIBRATING_GRIPPER, 0.8
REACH = {
    # In ten trials a Sawyer could do 1.4 to 5.5 mm at 5 to 10 Hz, 2.5 to 5.8 m/s2.
    "escalated": Reach(np.geomspace(2, 20, 26), 12e-3, 4.0),
    "motor": Reach(np.geomspace(MOTOR.lowest, MOTOR.highest, 20), SHARE * STROKE, SHARE * ACCELERATION),
}
HARMED = 0.025


class Ceiling(NamedTuple):
    """Median flower's acceleration [m/s2], frequency [Hz], amplitude [m], and the load that ends it."""

    acceleration: float
    frequency: float
    amplitude: float
    binds: str


def ceiling(row: dict[str, Any]) -> Ceiling:
    """Return the best shake of a trial's grip."""
    truth = truth_of(row["truth"], row["seed"])
    plant = grow(row["species"], row["seed"], 90.0 * (row["seed"] % 4), USUAL_DISTANCE, truth)
    points, _, arc = plant.stem_centreline()
    held = points[int(np.argmin(np.abs(arc - row["grasp_arc_length_m"])))]
    grip = ShakenPlant(plant, held, row["direction"], truth=truth)
    organ = grip.mechanics.plant.organ[grip.mechanics.pieces.first]
    trunk, stalk = np.isin(organ, (Organ.STEM, Organ.BRANCH)), organ == Organ.PEDICEL
    reach = REACH[row["way"]]
    bent, omega2 = semi_major(grip.bending(reach.frequencies, DRAG_AT)), (2 * np.pi * reach.frequencies) ** 2
    loads = {
        kind: bent[:, where].max(axis=1, initial=1e-9)
        for kind, where in (("stem", trunk), ("pedicel", stalk), ("base", ~trunk & ~stalk))
    }
    bears = {k: TOLERANCE[k].median * np.exp(norm.ppf(HARMED) * TOLERANCE[k].sigma) for k in loads}
    most = np.array([bears[kind] / load for kind, load in loads.items()])
    could = np.minimum(reach.amplitude, reach.acceleration / omega2)
    amplitude = np.minimum(most.min(axis=0), could)
    per_metre = np.median(semi_major(grip.linear(reach.frequencies, DRAG_AT)), axis=1) * omega2
    best = int(np.argmax(per_metre * amplitude))
    binds = "machine" if most[:, best].min() >= could[best] else list(loads)[int(most[:, best].argmin())]
    return Ceiling(
        float(per_metre[best] * amplitude[best]), float(reach.frequencies[best]), float(amplitude[best]), binds
    )


def metrics(way: str, rows: Sequence[dict[str, Any]], found: Sequence[Ceiling]) -> dict[str, float]:
    """Return what the module's docstring names, of one way."""
    got = np.array([np.median(row["true_flower_acceleration_peak_ms2"]) for row in rows])
    could, crop = np.array([one.acceleration for one in found]), np.array([row["species"] for row in rows])
    out = {"plants": float(len(rows)), "share": float(np.median(got / could))}
    for species in sorted(set(crop)):
        out |= {
            f"{name}_{species}_ms2": float(np.median(v[crop == species]))
            for name, v in (("ceiling", could), ("got", got))
        }
    for kind in ("stem", "pedicel", "base", "machine"):
        out[f"{kind}_binds"] = float(np.mean([one.binds == kind for one in found]))
    return {f"{way}_{name}": value for name, value in out.items()}


def main() -> None:
    """Compute, print a table, write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rows", type=Path, default=Path("runs/shaking"), help="folder of a sweep of shaking.py")
    args = parser.parse_args()
    results = [job.result for job in sweep.read(args.rows) if job.result is not None]
    rows = [r for r in results if r["way"] in REACH and r.get("true_flower_acceleration_median_ms2")]
    if not rows:
        raise SystemExit(
            f"--rows: got {args.rows} without watched trials; run experiments/shaking.py --ways escalated."
        )
    console = Console()
    found = [ceiling(row) for row in track(rows, "plants", console=console)]
    table = Table("way", "plant", "got [m/s²]", "could [m/s²]", "at [Hz]", "by [mm]", "ended by")
    for row, one in zip(rows, found, strict=True):
        felt = np.median(row["true_flower_acceleration_peak_ms2"])
        sizes = (felt, one.acceleration, one.frequency, 1e3 * one.amplitude)
        table.add_row(row["way"], f"{row['species']} {row['seed']}", *(f"{size:.1f}" for size in sizes), one.binds)
    console.print(table)
    told: dict[str, float] = {}
    for way in sorted({row["way"] for row in rows}):
        own = [pair for pair in zip(rows, found, strict=True) if pair[0]["way"] == way]
        told |= metrics(way, *zip(*own, strict=True))
    console.print({name: round(value, 3) for name, value in told.items()})
    if args.json:
        write_json(args.json, told)


if __name__ == "__main__":
    main()
