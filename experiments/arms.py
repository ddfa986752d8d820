"""Trials with each arm: how often the main stem was held, the plant unharmed and the flowers moved.

    python experiments/arms.py --json docs/results/arms.json

Each trial is one `anther trial --preset fast` in its own process; they go through a sweep in --out: what is done is not
run again. In the --json file success_ARM is the share held and unharmed, moved_ARM the share whose flowers moved too.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import numpy as np
from grasping_table import as_counted
from rich.console import Console
from rich.table import Table
from swept import failed, swept

from anther.arm.arms import Name
from anther.files import read_json, write_json

SHAKE, FELT = "shake_amplitude_m", "true_flower_acceleration_median_ms2"
KEPT = ((SHAKE, "shake_median_mm", 1e3), (FELT, "flower_acceleration_median_ms2", 1.0))
"""Of a trial's summary: key, what its median is called, scale."""


def one_trial(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Run one trial as a command in a process of its own; return its trial.json with the stage times, for a sweep."""
    run = folder / "run"
    words = ["trial", "--arm", row["arm"], "--plant", row["species"], "--seed", str(row["seed"]), "--preset", "fast"]
    words += ["--out", str(run), "--history", str(folder / "history.sqlite"), "--material", "facts"]
    done = subprocess.run([sys.executable, "-m", "anther.cli", *words], capture_output=True, text=True, check=False)
    (folder / "log").write_text(done.stdout + done.stderr)
    if not (run / "trial.json").exists():
        said = done.stderr.strip().splitlines()[-1:]
        return {"success": False, "failure": "crashed", "message": said}
    return as_counted(read_json(run / "trial.json"))


def counted(trials: list[dict[str, Any]], name: str) -> dict[str, float]:
    """Return what the --json file keeps of one arm's trials."""
    found: dict[str, float] = {f"trials_{name}": len(trials)}
    for key, share in (("success", "success"), ("all_three", "moved")):
        found[f"{share}_{name}"] = float(np.mean([bool(trial.get(key)) for trial in trials]))
    for key, median, scale in KEPT:
        values = [scale * trial[key] for trial in trials if trial.get(key) is not None]
        found |= {f"{median}_{name}": float(np.median(values))} if values else {}
    return found


def show(rows: list[dict[str, Any]]) -> None:
    """Print one line a trial."""
    table = Table("arm", "plant", "seed", "result", "harm", "shake [mm]", "flowers felt [m/s2]", "views and job [s]")
    for row in rows:
        result = ("success" if row.get("all_three") else "hardly moved") if row["success"] else str(row["failure"])
        told = ("harm_probability", SHAKE, FELT)
        harm, shake, felt = (float("nan") if row.get(key) is None else row[key] for key in told)
        times = [row.get(f"simulated_{part}_seconds") or float("nan") for part in ("capture", "execution")]
        words = [
            row["arm"],
            row["species"],
            str(row["seed"]),
            result,
            f"{harm:.1%}",
            f"{1e3 * shake:.2f}",
            f"{felt:.1f}",
        ]
        table.add_row(*words, " + ".join(f"{seconds:.0f}" for seconds in times))
    Console().print(table)


def main() -> None:
    """Run the trials, show a table, write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="one seed of each species instead of five")
    parser.add_argument("--seed", type=int, default=0, help="the first plant")
    parser.add_argument("--arms", nargs="+", choices=get_args(Name), default=list(get_args(Name)))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/arms"))
    args = parser.parse_args()
    seeds = range(args.seed, args.seed + (1 if args.quick else 5))
    rows = [
        {"arm": arm, "species": species, "seed": seed}
        for arm in args.arms
        for species in ("tomato", "pepper")
        for seed in seeds
    ]
    done = swept(one_trial, rows, args.out, args.jobs, failed)
    show(done)
    metrics: dict[str, float] = {}
    for arm in args.arms:
        metrics |= counted([row for row in done if row["arm"] == arm], arm)
    print(json.dumps(metrics, indent=2))
    if args.json:
        write_json(args.json, metrics)


if __name__ == "__main__":
    main()
