"""Ten trials: tomato and pepper, seeds 0 to 4, the whole pipeline: verdicts, predicted, measured and true motion.

    python experiments/trials.py --json docs/results/trials.json

Each trial is one `anther trial` in its own process; they go through a sweep in --out: what is done is not run again.
In the --json file success_SPECIES is the share held and unharmed, and `grasping_table.effects` says what became of the
flowers.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from grasping_page import EFFECTS, effect_cells
from grasping_table import as_counted, effects
from rich.console import Console
from rich.table import Table
from swept import failed, swept

from anther.files import read_json, write_json

SHOWN = ("harm_probability_mean", "flower_acceleration_median_ms2", "flower_acceleration_least_ms2")
"""Of `EFFECTS`, for a line a trial."""


def one_trial(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Run one trial as a command in a process of its own; return its trial.json with the stage times, for a sweep."""
    run = folder / "run"
    words = ["trial", "--plant", row["species"], "--seed", str(row["seed"]), "--viewpoint", "0", "--out", str(run)]
    words += ["--history", str(folder / "history.sqlite"), "--material", "facts"]
    done = subprocess.run([sys.executable, "-m", "anther.cli", *words], capture_output=True, text=True, check=False)
    (folder / "log").write_text(done.stdout + done.stderr)
    if not (run / "trial.json").exists():
        said = done.stderr.strip().splitlines()[-1:]
        return {"success": False, "failure": "crashed", "message": said, "seconds": {}}
    return {**as_counted(read_json(run / "trial.json")), "seconds": read_json(run / "timing.json")}


def one_row(trial: dict[str, Any]) -> dict[str, float | None]:
    """Return what the table keeps of one trial."""
    amplitudes = {
        f"{kind}_amplitude_mm": trial.get(f"{kind}_flower_amplitude_median_m")
        for kind in ("predicted", "measured", "true")
    }
    return {
        "success": float(trial["success"]),
        "shake_mm": 1000 * trial.get("shake_amplitude_m", np.nan),
        "shake_hz": trial.get("shake_frequency_hz"),
        **{name: None if value is None else 1000 * value for name, value in amplitudes.items()},
        "seconds": sum(trial["seconds"].values()),
    }


def ratio(trial: dict[str, Any], above: str, below: str) -> float:
    """Ratio of two medians in a trial; NaN where either is missing."""
    a, b = trial.get(above), trial.get(below)
    return float(a) / float(b) if a and b else float("nan")


def show(rows: list[tuple[str, int, dict[str, Any]]]) -> None:
    """Print one line a trial."""
    table = Table(
        "plant", "seed", "result", "organ", "grasp [cm]", "shake", "predicted [mm]", "measured [mm]", "true [mm]", "s",
        *(EFFECTS[key][0] for key in SHOWN),
    )  # fmt: skip
    for species, seed, t in rows:
        amplitude, hertz = t.get("shake_amplitude_m"), t.get("shake_frequency_hz")
        table.add_row(
            species,
            str(seed),
            ("success" if t.get("all_three", True) else "hardly moved") if t["success"] else str(t["failure"]),
            str(t.get("organ_grasped") or ""),
            _scaled(t.get("grasp_arc_length_m"), 100, 1),
            "" if amplitude is None else f"{1000 * amplitude:.2f} mm, {hertz:.1f} Hz",
            *(
                _scaled(t.get(f"{kind}_flower_amplitude_median_m"), 1000, 2)
                for kind in ("predicted", "measured", "true")
            ),
            f"{sum(t['seconds'].values()):.0f}",
            *effect_cells(effects([t]), SHOWN),
        )
    Console().print(table)


def _scaled(value: float | None, factor: float, digits: int) -> str:
    return "" if value is None else f"{factor * value:.{digits}f}"


def main() -> None:
    """Run the trials and write a flat table of metrics."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="two seeds of each species instead of five")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/trials"))
    args = parser.parse_args()
    seeds = range(args.seed, args.seed + (2 if args.quick else 5))
    cases = [{"species": species, "seed": seed} for species in ("tomato", "pepper") for seed in seeds]
    done = swept(one_trial, cases, args.out, args.jobs, lambda why: failed(why) | {"seconds": {}})
    rows = [(row["species"], row["seed"], row) for row in done]
    show(rows)
    metrics = {
        f"success_{species}": sum(t["success"] for s, _, t in rows if s == species) / len(seeds)
        for species in ("tomato", "pepper")
    }
    true_ratio = [ratio(t, "true_flower_amplitude_median_m", "predicted_flower_amplitude_median_m") for *_, t in rows]
    seen_ratio = [ratio(t, "measured_flower_amplitude_median_m", "true_flower_amplitude_median_m") for *_, t in rows]
    metrics |= effects([t for *_, t in rows]) | {
        "trials": len(rows),
        "true_over_predicted_amplitude_median": float(np.nanmedian(true_ratio)),
        "measured_over_true_amplitude_median": float(np.nanmedian(seen_ratio)),
        "seconds_median": float(np.median([sum(t["seconds"].values()) for *_, t in rows])),
    }
    for species, seed, t in rows:
        metrics |= {f"{species}_{seed}_{name}": value for name, value in one_row(t).items()}
    print(json.dumps(metrics, indent=2))
    if args.json:
        write_json(args.json, metrics)


if __name__ == "__main__":
    main()
