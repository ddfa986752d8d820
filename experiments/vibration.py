r"""Do the models tell how far a flower swings? The paper's R2 and R3, with a plant whose mechanics no model knows.

    python tools/record.py experiments/vibration.py --jobs 2 --figures docs/pictures \
        --page docs/reports/vibration_accuracy.md

A tomato and a pepper (0), and thirty random plants (seeds from 2000 on), are held at five heights of the main stem and
shaken along x in MuJoCo (`shaken_plant`): 4 to 12 mm at the authors' frequencies (0.7 to 1.9 Hz), less where the
arm cannot (3, 5, 10, 30 Hz). The same plants are scanned with 30 noisy views, and three models say what the flowers
should do: (a) the paper's, (b) Anther's with what is known of the crop, (c) Anther's after one probe shake, measured in
the side camera's noisy frames. Further models, with the plant's own geometry or material, tell where the error comes
from. Predictions are linear; docs/reports/vibration_accuracy.md says how far that is from the nonlinear solver.

Plants go through a sweep in --out: what is done is not done again. `vibration_table.py` says what the keys of --json
are.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from grasping_page import insert
from rich.console import Console
from rich.markdown import Markdown
from swept import swept
from vibration_figures import draw
from vibration_plant import FAST_FREQUENCIES, PAPER_FREQUENCIES, Case, one_plant
from vibration_table import metrics, report

from anther.files import write_json
from anther.shake import Crop

FIRST_RANDOM = 2000


def chosen(args: argparse.Namespace) -> list[Case]:
    """Return the plants: two shaken thoroughly, the random ones with fewer shakes."""
    if args.plants:
        pairs: list[tuple[Crop, int]] = [_plant(word) for word in args.plants]
        return [Case(species, seed) if not args.quick else brief(species, seed) for species, seed in pairs]
    both: tuple[Crop, Crop] = ("tomato", "pepper")
    two = [Case(species, args.seed) if not args.quick else brief(species, args.seed) for species in both]
    count = 0 if args.quick else args.random
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
    """Do what is not there yet, print the tables, write --json, the figures and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="the two plants only, with fewer shakes")
    parser.add_argument("--seed", type=int, default=0, help="of the two plants; added to those of the random ones")
    parser.add_argument("--random", type=int, default=30, help="how many random plants")
    parser.add_argument("--plants", nargs="*", help="these instead, such as tomato-10 pepper-11")
    parser.add_argument("--jobs", type=int, default=1, help="plants at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/vibration"), help="where finished plants are kept")
    parser.add_argument("--figures", type=Path, help="write vibration_amplitude.png and others into this folder")
    parser.add_argument("--page", type=Path, help="write the tables into this docs page")
    args = parser.parse_args()
    console, cases = Console(), chosen(args)
    told = map(asdict, cases)
    rows = swept(one_plant, told, args.out, args.jobs, lambda reason: {"lost": f"crashed: {reason}"})
    lost = [row["lost"] for row in rows if "lost" in row]
    rows = [row for row in rows if "lost" not in row]
    text = "\n\n".join([report(rows), *(f"Left out: {why}" for why in lost)])
    console.print(Markdown(text))
    if args.json:
        write_json(args.json, metrics(rows) | {"plants_lost": len(lost)})
    if args.page:
        insert(args.page, text)
    if args.figures:
        draw(rows, args.figures)


if __name__ == "__main__":
    main()
