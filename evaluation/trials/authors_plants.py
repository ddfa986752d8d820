"""Do plan and its --map and --simulate take the paper's own plants with no option but the crop?

Each skeleton of --data is given to the three as a person would, in a process of its own.

Keys of the --json file: plants; planned, mapped and shaken (share of them); of each plant <name>_stem_share (how much
of its height the main stem rises), <name>_grips (how many are mapped), <name>_planned_m_s2 (the mean flower's peak
acceleration), <name>_first_hz (lowest natural frequency) and <name>_amplitude_ratio (flower over grip in the shake).
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from anther.core.files import read_object
from anther.plant import read_source
from anther.plant.imported import main_stem
from evaluation.harness import finish, options, progress
from evaluation.tables import markdown

HEADS = (
    "plant",
    "the main stem rises",
    "`anther plan`: amplitude, frequency, place",
    "by the plan the mean flower feels",
    "`anther plan --map`: grips mapped",
    "lowest natural frequency",
    "`anther plan --simulate`, 4 mm at 1.3 Hz: the flower moves",
)

MODES: dict[str, list[str]] = {"plan": [], "map": ["--map"], "simulation": ["--simulate"]}


def asked(options: list[str], path: Path, folder: Path) -> str:
    """Run `anther plan` on a skeleton; return what it said against it, "" if nothing."""
    words = ["plan", str(path), *options, "--species", _crop(path), "--out", str(folder), "--overwrite"]
    run = [sys.executable, "-m", "anther.cli", *words]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["nothing said"])[-1]


def _crop(path: Path) -> str:
    return "pepper" if path.stem.startswith("pepper") else "tomato"


def one_plant(path: Path, folder: Path) -> tuple[dict[str, float], list[str]]:
    """Return a plant's numbers, and its row of the table."""
    refused = {name: asked(options, path, folder) for name, options in MODES.items()}
    for name, why in refused.items():
        if why:
            print(f"{path.stem}: {name}: {why}")
    plan, mapped, motion = (
        {} if refused[name] else read_object(folder / f"{file}.json")
        for name, file in (("plan", "shake_plan"), ("map", "response_map"), ("simulation", "shake"))
    )
    _, skeleton = read_source(path, crop="pepper" if _crop(path) == "pepper" else "tomato")
    heights = skeleton.nodes[:, 2]
    rises = float(np.ptp(heights[main_stem(skeleton).node_ids]))
    found = {"planned": float(bool(plan)), "mapped": float(bool(mapped)), "shaken": float(bool(motion))}
    found["stem_share"] = rises / float(np.ptp(heights))
    cells = [path.stem, f"{1e3 * rises:.0f} mm, {found['stem_share']:.0%} of the height", *["refused", ""] * 2]
    if plan:
        found["planned_m_s2"] = float(np.mean(plan["predicted_acceleration"]))
        size, hertz, up = 1e3 * plan["amplitude"], plan["frequency"], 1e2 * plan["grasp"]["arc_length"]
        cells[2:4] = [f"{size:.2g} mm at {hertz:.3g} Hz, {up:.0f} cm up", f"{found['planned_m_s2']:.2g} m/s²"]
    if mapped:
        found |= {"grips": mapped["grips"], "first_hz": mapped["natural_frequencies_hz"][0]}
        cells[4:6] = [f"{found['grips']:.0f}", f"{found['first_hz']:.2f} Hz"]
    if motion:
        found["amplitude_ratio"] = motion["amplitude_ratio"]
    return found, [*cells, f"{1e3 * motion['flower_amplitude_m']:.1f} mm" if motion else "refused"]


def main() -> None:
    """Ask the commands, print and write what they did."""
    args = options(__doc__, quick="the smallest plant only", data="skeletons", out="runs/authors_plants")
    paths = sorted(args.data.glob("*.txt"), key=lambda path: path.stat().st_size)[: 1 if args.quick else None]
    plants = {path.stem: one_plant(path, args.out / path.stem) for path in progress(paths, "plants")}
    shares = ("planned", "mapped", "shaken")
    found = {key: float(np.mean([row[key] for row, _ in plants.values()])) for key in shares}
    kept = {f"{name}_{k}": v for name, (row, _) in plants.items() for k, v in row.items() if k not in shares}
    table = markdown(HEADS, [cells for _, (_, cells) in sorted(plants.items())])
    finish(args, {"plants": len(plants), **found, **kept}, table)


if __name__ == "__main__":
    main()
