r"""Do the models tell how far a flower swings? The paper's R2 and R3, with a plant whose mechanics no model knows.

    python -m evaluation.prediction.vibration --random 4 --jobs 2 --figures docs/pictures

Random tomatoes and peppers (seeds from 2000 on) are held at five heights of the main stem and shaken along x in MuJoCo
(`shaken_plant`): 4 to 12 mm at the authors' frequencies (0.7 to 1.9 Hz), less where the arm cannot (3, 5, 10, 30 Hz).
With --thorough a tomato and a pepper (0) go first, of more amplitudes and stepped through time below 2 Hz. The same
plants are scanned with 30 noisy views, and three models say what the flowers should do: (a) the paper's, (b) Anther's
with what is known of the crop, (c) Anther's after one probe shake, measured in the side camera's noisy frames. Further
models, with the plant's own geometry or material, tell where the error comes from. Predictions are linear.

Plants go through a sweep in --out: what is done is not done again. `vibration_table.py` says what the keys of --json
are.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from anther.core.files import write_json
from anther.plant import Crop
from evaluation.harness import swept
from evaluation.prediction.vibration_figures import draw
from evaluation.prediction.vibration_plant import FAST_FREQUENCIES, PAPER_FREQUENCIES, Case, one_plant
from evaluation.prediction.vibration_table import metrics, report

FIRST_RANDOM = 2000


def chosen(args: argparse.Namespace) -> list[Case]:
    """Return the plants: two shaken thoroughly if asked for, the random ones with fewer shakes."""
    if args.plants:
        pairs: list[tuple[Crop, int]] = [_plant(word) for word in args.plants]
        return [Case(*pair) if args.thorough else brief(*pair) for pair in pairs]
    both: tuple[Crop, Crop] = ("tomato", "pepper")
    two = [Case(species, args.seed) for species in both] if args.thorough else []
    count = 1 if args.quick else args.random
    return two + [brief(both[k % 2], FIRST_RANDOM + args.seed + k) for k in range(count)]


def brief(species: Crop, seed: int) -> Case:
    """Return a plant whose truth is linear, with fewer amplitudes."""
    return Case(species, seed, PAPER_FREQUENCIES + FAST_FREQUENCIES, (4e-3, 8e-3, 12e-3), stepped_below=0.0)


def _plant(word: str) -> tuple[Crop, int]:
    species, _, seed = word.partition("-")
    if species not in ("tomato", "pepper") or not seed.isdigit():
        raise SystemExit(f"--plants: got {word}; allowed: tomato-SEED or pepper-SEED, such as pepper-10.")
    return ("tomato" if species == "tomato" else "pepper"), int(seed)


def main() -> None:
    """Do what is not there yet, print the tables, write --json and the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="one plant")
    parser.add_argument("--seed", type=int, default=0, help="of the thorough plants; added to those of the random ones")
    parser.add_argument("--random", type=int, default=30, help="how many random plants")
    parser.add_argument("--thorough", action="store_true", help="two more plants, or those of --plants, of more shakes")
    parser.add_argument("--plants", nargs="*", help="these instead, such as tomato-10 pepper-11")
    parser.add_argument("--jobs", type=int, default=1, help="plants at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/vibration"), help="where finished plants are kept")
    parser.add_argument("--figures", type=Path, help="write vibration_amplitude.png and others into this folder")
    args = parser.parse_args()
    console, cases = Console(), chosen(args)
    told = map(asdict, cases)
    rows = swept(one_plant, told, args.out, args.jobs, lambda reason: {"lost": f"crashed: {reason}"})
    lost = [row["lost"] for row in rows if "lost" in row]
    rows = [row for row in rows if "lost" not in row]
    for part in report(rows):
        console.print(part)
    for why in lost:
        console.print(f"Left out: {why}")
    if args.json:
        write_json(args.json, metrics(rows) | {"plants_lost": len(lost)})
    if args.figures:
        draw(rows, args.figures)


if __name__ == "__main__":
    main()
