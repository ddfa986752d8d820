"""The protocol of `grasping.py` with each arm: ten plants from four sides, 30 views, from noisy images to the shake.

    python -m evaluation.trials.arms --arms ur5e fr3 xarm7 --quick --jobs 2

Every trial ends in one JSON and one small picture in --out and is not run again. Keys of --json, each with _ARM behind:
trials, success (how many held the main stem and harmed nothing) with success_low and success_high (Wilson's 95 %
interval of its share), what `grasping_table.effects` tells, and the medians of MEDIANS.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np
from rich.console import RenderableType

from anther.core.choices import ArmName
from evaluation.harness import CROPS, finish, options, run_cases
from evaluation.perception.skeletons import TEN
from evaluation.statistics import interval
from evaluation.tables import markdown
from evaluation.trials.grasping import VIEWPOINTS
from evaluation.trials.grasping_table import EFFECTS, Row, effect_cells, effects, failures
from evaluation.trials.grasping_trial import Case, asked, crashed, one_trial

CALLED = {"fr3": "panda"}
"""What the keys of --json call an arm: Franka's is Panda there, though the one that is simulated is Research 3."""
MEDIANS = {
    "shake_amplitude_m": ("amplitude of the shake [mm]", 1e3, "{:.2f}"),
    "shake_frequency_hz": ("its frequency [Hz]", 1.0, "{:.1f}"),
    "capture_s": ("taking the views [s]", 1.0, "{:.0f}"),
    "reach_s": ("reaching the grasp [s]", 1.0, "{:.0f}"),
}
"""Of a trial: the head of its column, the column's scale, how it is written."""


def metrics(arm: str, rows: Sequence[Row]) -> dict[str, float]:
    """Return the flat table of one arm's trials."""
    ours = [row["ours"] for row in rows]
    won, _ = wins(rows, arm, "")
    found = dict(zip(("success_low", "success_high"), interval(won, len(ours)), strict=True))
    found |= {"trials": len(ours), "success": won, **effects(ours)}
    for key in MEDIANS:
        values = [one[key] for one in ({**row, **row["ours"]} for row in rows) if one.get(key) is not None]
        found |= {key: float(np.median(values))} if values else {}
    return {f"{key}_{CALLED.get(arm, arm)}": value for key, value in found.items()}


def report(arms: Sequence[str], rows: Sequence[Row], table: dict[str, float]) -> list[RenderableType]:
    """Return a line an arm, and every failure."""
    lines = []
    for arm in arms:
        end = f"_{CALLED.get(arm, arm)}"
        own = {key.removesuffix(end): value for key, value in table.items() if key.endswith(end)}
        held = [f"{won}/{trials}" for won, trials in (wins(rows, arm, species) for species in ("", *CROPS))]
        between = f"{own['success_low']:.0%} to {own['success_high']:.0%}"
        medians = [how.format(scale * own[key]) if key in own else "" for key, (_, scale, how) in MEDIANS.items()]
        lines.append((f"`{arm}`", held[0], between, *held[1:], *effect_cells(own, list(EFFECTS)[:3]), *medians))
    heads = ["arm", "held and unharmed", "95 % interval", *CROPS, *(words for words, _ in list(EFFECTS.values())[:3])]
    heads += [head for head, *_ in MEDIANS.values()]
    return [
        "The same trials with each arm; from the median flower on medians over trials.",
        markdown(heads, lines),
        *failures(rows),
    ]


def wins(rows: Sequence[Row], arm: str, species: str) -> tuple[int, int]:
    """Return how many trials of an arm succeeded, and how many there were; of every species with ""."""
    some = [row for row in rows if row["arm"] == arm and row["species"].startswith(species)]
    return sum(bool(row["ours"]["success"]) for row in some), len(some)


def main() -> None:
    """Run what is not there yet, print the tables, write --json."""
    arms = {"--arms": (get_args(ArmName), "of the trials", get_args(ArmName))}
    quick, seed = "one plant of each species from two sides", (0, "added to the seeds of all plants")
    args = options(__doc__, quick=quick, seed=seed, jobs="trials", out="runs/arms", own=arms)
    plants, sides = ([TEN[0], TEN[2]], VIEWPOINTS[:2]) if args.quick else (TEN, VIEWPOINTS)
    cases = [Case(s, k + args.seed, side, arm=arm) for arm in args.arms for s, k in plants for side in sides]
    rows = run_cases(one_trial, asked(cases, rule=False), args.out, args.jobs, crashed)
    table: dict[str, float] = {}
    for arm in args.arms:
        table |= metrics(arm, [row for row in rows if row["arm"] == arm])
    finish(args, table, *report(args.arms, rows, table))


if __name__ == "__main__":
    main()
