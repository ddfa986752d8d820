r"""Do the models tell how far a flower swings? The paper's R2 and R3, with a plant whose mechanics no model knows.

    python -m evaluation.prediction.vibration --random 4 --jobs 2

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

from anther.plant import Crop
from evaluation.harness import CROPS, finish, lost, options, plants_named, run_cases
from evaluation.prediction.vibration_plant import FAST_FREQUENCIES, PAPER_FREQUENCIES, Case, one_plant
from evaluation.prediction.vibration_table import metrics, report

FIRST_RANDOM = 2000


def chosen(args: argparse.Namespace) -> list[Case]:
    """Return the plants: two shaken thoroughly if asked for, the random ones with fewer shakes."""
    if args.plants:
        pairs = plants_named(args.plants)
        return [Case(*pair) if args.thorough else brief(*pair) for pair in pairs]
    two = [Case(species, args.seed) for species in CROPS] if args.thorough else []
    count = 1 if args.quick else args.random
    return two + [brief(CROPS[k % 2], FIRST_RANDOM + args.seed + k) for k in range(count)]


def brief(species: Crop, seed: int) -> Case:
    """Return a plant whose truth is linear, with fewer amplitudes."""
    return Case(species, seed, PAPER_FREQUENCIES + FAST_FREQUENCIES, (4e-3, 8e-3, 12e-3), stepped_below=0.0)


def main() -> None:
    """Do what is not there yet, print the tables, write --json."""
    seed = (0, "of the thorough plants; added to those of the random ones")
    own = {
        "--random": (30, "how many random plants"),
        "--thorough": (False, "two more plants, or those of --plants, of more shakes"),
        "--plants": ((), "these instead, such as tomato-10 pepper-11"),
    }
    args = options(__doc__, quick="one plant", seed=seed, jobs="plants", out="runs/vibration", own=own)
    done = run_cases(one_plant, map(asdict, chosen(args)), args.out, args.jobs, lost)
    rows, without = ([row for row in done if ("lost" in row) == gone] for gone in (False, True))
    numbers = metrics(rows) | {"plants_lost": len(without)}
    finish(args, numbers, *report(numbers), *(f"Left out: {row['lost']}" for row in without))


if __name__ == "__main__":
    main()
