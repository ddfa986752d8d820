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
from evaluation.harness import finish, options, run_cases
from evaluation.perception.skeletons import TEN
from evaluation.statistics import interval
from evaluation.tables import by_part
from evaluation.trials.grasping import VIEWPOINTS
from evaluation.trials.grasping_table import Row, effects, failures, told_effects
from evaluation.trials.grasping_trial import Case, asked, crashed, one_trial

CALLED = {"fr3": "panda"}
"""What the keys of --json call an arm: Franka's is Panda there, though the one that is simulated is Research 3."""
MEDIANS = ("shake_amplitude_m", "shake_frequency_hz", "capture_s", "reach_s")
"""Numbers of a trial."""


def metrics(arm: str, rows: Sequence[Row]) -> dict[str, float]:
    """Return the flat table of one arm's trials."""
    ours = [row["ours"] for row in rows]
    won = sum(bool(one["success"]) for one in ours)
    found = dict(zip(("success_low", "success_high"), interval(won, len(ours)), strict=True))
    found |= {"trials": len(ours), "success": won, **effects(ours)}
    for key in MEDIANS:
        values = [one[key] for one in ({**row, **row["ours"]} for row in rows) if one.get(key) is not None]
        found |= {key: float(np.median(values))} if values else {}
    return {f"{key}_{CALLED.get(arm, arm)}": value for key, value in found.items()}


def report(arms: Sequence[str], rows: Sequence[Row], table: dict[str, float]) -> list[RenderableType]:
    """Return a line an arm, and every failure."""
    effects_told = list(told_effects("{}_*").items())[:3]
    numbers = {
        "held and unharmed": "success_*:.0f/trials_*:.0f",
        "95 % interval": "success_low_*:.0% to success_high_*:.0%",
        **dict(effects_told),
        "amplitude of the shake [m]": "shake_amplitude_m_*:.2g",
        "its frequency [Hz]": "shake_frequency_hz_*:.1f",
        "taking the views [s]": "capture_s_*:.0f",
        "reaching the grasp [s]": "reach_s_*:.0f",
    }
    called = {CALLED.get(arm, arm): f"`{arm}`" for arm in arms}
    said = "The same trials with each arm; from the median flower on medians over trials."
    return [said, by_part(table, "arm", called, numbers), *failures(rows)]


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
