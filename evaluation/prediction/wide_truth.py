"""What Anther's promises are worth where the truth is not what any stage believes.

    python -m evaluation.prediction.wide_truth --seed 970 --jobs 2

Every plant's truth is drawn from `anther.sim.truth.WIDE`: stiffness, damping, sections, masses, drag, wind, pads, arm
and cameras, which no stage reads. Two parts, each a --part of its own:

prediction   plants are scanned, held, probed at a few tones before a noisy camera, and every flower and strain is then
             predicted, there and at other grips, with a 90 % interval (`wide_plant.py`)
grasping     whole trials with the preset `fast`, judged as held, unharmed and flowers moved, and what their shakes did
             to flowers and plants (`wide_grasping.py`)

With --perturbed and --perturbed-trials both are also run with a nominal truth, and with one group of assumptions at a
time drawn wide, ranked by what it changes: the assumption at the top is the one that would ruin the result.

Plants and trials go through sweeps in --out (docs/sweep.md): what is done is not run again.

Keys of --json: those of `wide_table.metrics` and `wide_grasping.metrics` for everything drawn (the latter as
grasp_<key>), grasp_400_wide, second_judge_error_max, and for one group at a time <key>__<group>.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from rich.console import RenderableType

from anther.core.files import read_json
from anther.sim import WIDE
from evaluation.harness import by_turns, finish, lost, options, run_cases
from evaluation.prediction import wide_table
from evaluation.prediction.wide_plant import Case, one_plant
from evaluation.trials import wide_grasping
from evaluation.trials.grasping_table import failures
from evaluation.trials.grasping_trial import asked, crashed, one_trial

PARTS = ("prediction", "grasping")
FIRST = 9000
"""Plants of the predictions from this seed on are in no other table, those from `DEVELOPMENT` on set the spreads."""
DEVELOPMENT = 500
PREDICTED = {
    "error_other_tomato": "error at other grips, tomatoes",
    "error_other_pepper": "peppers",
    "error_held_seen": "at the held grip",
    "coverage_90": "truths inside their 90 % interval",
    "measured_share": "flowers measured",
}
GRASPED = {
    "harm_probability_mean": "probability of harm",
    "success": "held and unharmed",
    "flower_acceleration_median_ms2": "median flower [m/s²]",
    "moved_share": "flowers moved (5 m/s²)",
}
"""Keys of both parts that are told for one group at a time, and how."""


def predictions(args: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Return the metrics of the predictions by truth."""
    first = (DEVELOPMENT if args.development else FIRST) + args.seed
    out = {}
    for truth, plants in _truths(args.plants, args.perturbed):
        cases = [asdict(Case(*plant, truth)) for plant in by_turns(plants, first)]
        rows = run_cases(one_plant, cases, args.out / "prediction", args.jobs, lost)
        out[truth] = wide_table.metrics(rows)
    return out


def grasps(args: argparse.Namespace) -> tuple[dict[str, dict[str, float]], list[wide_grasping.Row]]:
    """Return the metrics of the trials by truth, and the trials where everything was drawn."""
    out, drawn = {}, []
    groups = wide_grasping.GROUPS if args.perturbed_trials else ()
    for truth, trials in (("wide", args.trials), *((g, args.perturbed_trials) for g in ("nominal", *groups))):
        if not trials:
            continue
        cases = wide_grasping.cases(trials, args.seed, "fast", truth)
        rows = run_cases(one_trial, asked(cases, rule=False), args.out / "grasping", args.jobs, crashed)
        out[truth] = wide_grasping.metrics(rows)
        drawn += rows if truth == "wide" else []
    return out, drawn


def _truths(plants: int, perturbed: int) -> list[tuple[str, int]]:
    return [("wide", plants), *((name, perturbed) for name in ("nominal", *WIDE) if perturbed)]


def flat(predicted: dict[str, dict[str, float]], grasped: dict[str, dict[str, float]]) -> dict[str, float]:
    """Return all metrics as one flat table."""
    out: dict[str, float] = dict(predicted.get("wide", {}))
    if "wide" in grasped:
        out |= {f"grasp_{key}": value for key, value in grasped["wide"].items()}
        out["grasp_400_wide"] = grasped["wide"]["success"]
    for by_truth, names in ((predicted, PREDICTED), (grasped, GRASPED)):
        for truth in set(by_truth) - {"wide"}:
            out |= {f"{key}__{truth.replace(' ', '_')}": by_truth[truth].get(key, float("nan")) for key in names}
    judged = Path("docs/results/second_judge.json")
    if judged.is_file():
        out["second_judge_error_max"] = read_json(judged)["metrics"]["second_judge_error_max"]
    return out


def report(
    predicted: dict[str, dict[str, float]], grasped: dict[str, dict[str, float]], trials: list[wide_grasping.Row]
) -> list[RenderableType]:
    """Return the tables."""
    parts: list[RenderableType] = []
    if "wide" in predicted:
        parts += wide_table.told(predicted["wide"])
    if len(predicted) > 1:
        parts += ["Predictions with one group drawn, the worst first.", wide_table.ranking(predicted, PREDICTED)]
    if "wide" in grasped:
        parts += wide_grasping.told(grasped["wide"], trials)
    if len(grasped) > 1:
        parts += ["Trials with one group drawn, the worst first.", wide_table.ranking(grasped, GRASPED)]
    return [*parts, *(failures(trials) if trials else [])]


def main() -> None:
    """Run what is not there yet, print the tables, write --json."""
    own = {
        "--part": (PARTS, "of the experiment", PARTS),
        "--plants": (6, "predicted with everything drawn"),
        "--perturbed": (0, "predicted with one group drawn"),
        "--trials": (16, "with everything drawn"),
        "--perturbed-trials": (0, "with one group drawn"),
        "--development": (False, "predict the plants that set the spreads"),
    }
    seed = (0, "added to the seeds of all plants")
    args = options(__doc__, quick="two plants and two trials", seed=seed, jobs="cases", out="runs/wide", own=own)
    if args.quick:
        args.plants, args.perturbed, args.trials, args.perturbed_trials = 2, 0, 2, 0
    predicted = predictions(args) if "prediction" in args.part else {}
    grasped, trials = grasps(args) if "grasping" in args.part else ({}, [])
    finish(args, flat(predicted, grasped), *report(predicted, grasped, trials))


if __name__ == "__main__":
    main()
