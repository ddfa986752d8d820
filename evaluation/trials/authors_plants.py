"""Do plan and its --map and --simulate take the paper's own plants with no option but the crop?

Each skeleton of --data is given to the three as a person would, in a process of its own.

Keys of the --json file: plants; planned, mapped and shaken (share of them); of each plant <name>_stem_share (how much
of its height the main stem rises), <name>_grips (how many are mapped), <name>_planned_m_s2 (the mean flower's peak
acceleration), <name>_first_hz (lowest natural frequency) and <name>_amplitude_ratio (flower over grip in the shake).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import MARKDOWN
from rich.console import Console
from rich.progress import track
from rich.table import Table

from anther.core.files import read_object, write_json
from anther.plant import main_stem, read_source

DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[3] / "shared" / "data"))
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


def one_plant(path: Path, folder: Path, console: Console) -> tuple[dict[str, float], list[str]]:
    """Return a plant's numbers, and its row of the table."""
    refused = {name: asked(options, path, folder) for name, options in MODES.items()}
    for name, why in refused.items():
        if why:
            console.print(f"{path.stem}: {name}: {why}", highlight=False)
    _, skeleton = read_source(path, crop="pepper" if _crop(path) == "pepper" else "tomato")
    stem = main_stem(skeleton)
    found = {
        "planned": float(not refused["plan"]),
        "mapped": float(not refused["map"]),
        "shaken": float(not refused["simulation"]),
        "stem_share": float(np.ptp(skeleton.nodes[stem.node_ids, 2]) / np.ptp(skeleton.nodes[:, 2])),
    }
    cells = [
        path.stem,
        f"{1e3 * np.ptp(skeleton.nodes[stem.node_ids, 2]):.0f} mm, {found['stem_share']:.0%} of the height",
    ]
    if plan := _told(folder / "shake_plan.json", refused["plan"]):
        found["planned_m_s2"] = float(np.mean(plan["predicted_acceleration"]))
        at, hertz = plan["grasp"]["arc_length"], plan["frequency"]
        cells += [f"{1e3 * plan['amplitude']:.2g} mm at {hertz:.3g} Hz, {1e2 * at:.0f} cm up"]
        cells += [f"{found['planned_m_s2']:.2g} m/s²"]
    else:
        cells += ["refused", ""]
    if found_map := _told(folder / "response_map.json", refused["map"]):
        found |= {"grips": found_map["grips"], "first_hz": found_map["natural_frequencies_hz"][0]}
        cells += [f"{found['grips']:.0f}", f"{found['first_hz']:.2f} Hz"]
    else:
        cells += ["refused", ""]
    if motion := _told(folder / "shake.json", refused["simulation"]):
        found["amplitude_ratio"] = motion["amplitude_ratio"]
    cells += [f"{1e3 * motion['flower_amplitude_m']:.1f} mm" if motion else "refused"]
    return found, cells


def _told(path: Path, refused: str) -> dict[str, Any]:
    return {} if refused else read_object(path)


def main() -> None:
    """Ask the commands, print and write what they did."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA / "skeletons", help="folder of the skeletons")
    parser.add_argument("--out", type=Path, default=Path("runs/authors_plants"), help="where the commands write")
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--quick", action="store_true", help="the smallest plant only")
    args = parser.parse_args()
    console = Console()
    paths = sorted(args.data.glob("*.txt"), key=lambda path: path.stat().st_size)[: 1 if args.quick else None]
    plants = {path.stem: one_plant(path, args.out / path.stem, console) for path in track(paths, console=console)}
    table = Table(*HEADS, box=MARKDOWN)
    for _, (_, cells) in sorted(plants.items()):
        table.add_row(*cells)
    console.print(table)
    numbers = {f"{name}_{key}": value for name, (row, _) in plants.items() for key, value in row.items()}
    shares = ("planned", "mapped", "shaken")
    found = {key: float(np.mean([row[key] for row, _ in plants.values()])) for key in shares}
    if args.json:
        kept = {key: value for key, value in numbers.items() if not key.endswith(shares)}
        write_json(args.json, {"plants": len(plants), **found, **kept})


if __name__ == "__main__":
    main()
