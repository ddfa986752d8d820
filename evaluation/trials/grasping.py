"""The paper's protocol (R4, R5): ten plants, each from four sides, from noisy images to a physical grasp and shake.

    python -m evaluation.trials.grasping --presets full --jobs 2

Two tomatoes and eight peppers, turned by 0, 90, 180 and 270 degrees: 40 trials with 30 views and 40 with the preset
`fast`; --further N adds that many unseen plants (as many of either species) with 30 views. Each is a whole `anther
trial` but for the side camera: images with the depth noise of a D455, arm pose noise and hand-eye error, perception,
ranked grasps, shake plan, and the execution in a MuJoCo cell, whose judge says from contacts what was grasped and what
became of it. From the perception of every trial with 30 views the paper's own grasp (P12-P14) is then carried out in a
fresh cell, one try, judged alike.

Every trial ends in one JSON and one small picture in --out and is not run again. `grasping_table.py` says what the keys
of the --json file are.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from evaluation.harness import FOLDER, by_turns, finish, options, plants_named, run_cases
from evaluation.perception.skeletons import TEN
from evaluation.trials.grasping_pictures import sheet
from evaluation.trials.grasping_table import metrics, report
from evaluation.trials.grasping_trial import PICTURE, Case, asked, crashed, one_trial

VIEWPOINTS = (0, 90, 180, 270)  # degrees
PRESETS = ("full", "fast")
FURTHER = by_turns(100, 1054)
"""Of those before (1000-1053), which an earlier run took, the failures said what to mend."""


def chosen(args: argparse.Namespace) -> list[Case]:
    """Return the trials that are asked for."""
    if args.quick:
        ten, further, sides, presets = [TEN[0], TEN[2]], [], VIEWPOINTS[:2], PRESETS[:1]
    else:
        ten, further, sides, presets = TEN, FURTHER[: args.further], args.viewpoints, args.presets
    if args.plants:
        ten, further = plants_named(args.plants), []
    cases = [Case(*plant, side, preset) for preset in presets for plant in ten for side in sides]
    cases += [Case(*plant, side) for plant in further for side in sides]
    return [Case(case.species, case.seed + args.seed, case.viewpoint, case.preset) for case in cases]


def tiles(cases: Sequence[Case], rows: Sequence[dict[str, Any]]) -> list[tuple[Path, str, bool]]:
    """Return picture, words and success of each trial, for `sheet`."""
    said = [
        f"{c.species[0]}{c.seed} {c.viewpoint} {row['ours']['failure'] or ''}"
        for c, row in zip(cases, rows, strict=True)
    ]
    files = [Path(row[FOLDER]) / PICTURE for row in rows]
    return list(zip(files, said, (row["ours"]["success"] for row in rows), strict=True))


def draw(cases: Sequence[Case], rows: Sequence[dict[str, Any]], figures: Path) -> None:
    """Write the contact sheet of the ten plants with 30 views."""
    shown = zip(cases, tiles(cases, rows), strict=True)
    ten = [tile for case, tile in shown if case.preset == "full" and case.seed < 1000]
    if ten:
        sheet(ten, 8, figures / "grasping.png")


def main() -> None:
    """Run what is not there yet, print the tables, write --json and the picture."""
    own = {
        "--further": (0, "how many of the hundred further plants"),
        "--presets": (PRESETS, "of the ten plants", PRESETS),
        "--viewpoints": (VIEWPOINTS, "degrees"),
        "--plants": ((), "these instead of the ten, such as tomato-10 pepper-11"),
        "--without-paper": (False, "leave out the paper's own grasp"),
    }
    quick, seed = "one plant of each species from two sides, 30 views", (0, "added to the seeds of all plants")
    args = options(__doc__, quick=quick, seed=seed, jobs="trials", out="runs/grasping", figures="grasping.png", own=own)
    cases = chosen(args)
    rows = run_cases(one_trial, asked(cases, rule=not args.without_paper), args.out, args.jobs, crashed)
    table = metrics(rows)
    finish(args, table, *report(rows, table))
    if args.figures:
        draw(cases, rows, args.figures)


if __name__ == "__main__":
    main()
