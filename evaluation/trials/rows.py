"""One visit of one stem in each of many simulated rows: is it held, do its flowers move, what else is touched.

    python -m evaluation.trials.rows --rows 20 --jobs 2

Every row is drawn (`anther.sim.grow_row`), and its plants' truth is wide (`anther.sim.truth.WIDE`). The robot is told
the hook, and of a pepper the foot, by the map alone, a few centimetres off. A camera on the cart takes the views a stem
ahead; where the cart then stands, the side camera shows. The judge is `anther.sim.judge`; besides, the pull of the
stem's string is followed. Every trial ends in one JSON in --out and is not run again; those of the campaign, which
takes more than a day's hours, are in docs/results/long/done/rows.jsonl (--done). Keys of --json:

held_row         share of rows: the asked stem was held through the shake, nothing else was held, pushed or touched
moved_row        share of these whose median flower felt 5 m/s2 or more
lost_row         share of the flowers of these stems whose stalk stayed bent; lost_row_expected: what was expected of it
neighbour_harm   share of rows: a neighbour, a string, a post, pipe or gutter was touched, or the stem's string let go
cycle_s          median of the visits that shook [s], while the cart stands: the sum of its parts, thought_s,
                 approach_s, shake_s, retreat_s, stow_s: the way back to where the arm waits, which is not simulated, is
                 taken to last as long as the way there; the first visit of a process, which loads what was compiled,
                 does not count; from stem to stem it drives for another 2 s (`anther.sim.STEM_TO_STEM`, a guess)
ahead_s          median of what is thought of a stem before the cart stands before it [s]: while the one before is
                 worked on, so that it takes no time of its own while it is less than cycle_s

held_row_tomato and so on are of one crop; _low and _high are 95 % intervals. held_row_helios, moved_row_helios and
neighbour_harm_helios are of tomatoes of a second generator (`helios_row`), which count in nothing else; left out where
pyhelios3d is not installed. same_stem_week1 and same_stem_week2 are those of `evaluation.house.row_map` as last run.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import RenderableType

from anther.core import StageFailure
from anther.plant import Crop
from anther.plant.limits import MOVED
from anther.pollination import ShakePlan, visit_row_stem
from anther.pollination.execution import EARLY
from anther.pollination.row import AHEAD
from anther.sim import build_row, grow_row, mapped_others, mapped_string
from anther.sim.cell import BENCH, NEIGHBOUR, POT, CellLog
from anther.sim.judge import LETS_GO, string_pull
from evaluation.harness import CROPS, Row, by_turns, failed, finish, options, run_cases
from evaluation.numbers import metrics_of
from evaluation.statistics import bootstrap, interval, median
from evaluation.tables import by_number, by_part, markdown
from evaluation.trials.grasping_pictures import portrait
from evaluation.trials.grasping_trial import COMPUTE, PICTURE, is_first, notes, overlap, performed, timed, truth_of
from evaluation.trials.helios_row import grow_helios_row
from evaluation.trials.shaking import Brief

FIRST, DEVELOPMENT = 6177, 3
"""Rows from the first seed on are in no other table; on those from the second on the visit was made."""
PARTS = ("thought_s", "approach_s", "shake_s", "retreat_s", "stow_s")
ACCELERATION = "true_flower_acceleration_median_ms2"


@dataclass(frozen=True, slots=True)
class Case:
    """One visit in one row, under one truth: "wide", "nominal", or a group of `sim.truth.WIDE` alone."""

    species: Crop
    seed: int
    truth: str = "wide"
    generator: Literal["own", "helios"] = "own"


def one(row: Row, folder: Path) -> Row:
    """Return what became of a case, for a sweep; what the camera saw, with the grasp, is drawn into the folder."""
    case, first = Case(**row), is_first()
    grown = grow_helios_row(case.seed) if case.generator == "helios" else grow_row(case.species, case.seed)
    run = Brief(folder)
    try:
        cell = build_row(grown, truth=truth_of(case.truth, case.seed))
    except StageFailure as failure:
        return {"success": False, "failure": failure.kind, "message": str(failure)}
    (hook, foot), others = mapped_string(grown, cell.world.arm), mapped_others(grown, cell.world.arm)
    found, done = performed(
        cell, lambda: visit_row_stem(timed(cell, run), case.species, hook, run, foot=foot, others=others)
    )
    log = cell.world.log()
    found |= touched(log) | {"string_pull": string_pull(cell.world, log), "plants": len(grown.plants)}
    found |= {"notes": notes(run), "first": first}
    if done is not None:
        found |= {"thought_s": thought(found, run), "approach_s": approach(found.get("phases_s", {}))}
        found["ahead_s"] = sum(map(run.took, AHEAD))
        found["expected_lost_share"] = expected_lost(done.shake)
        found["flowers_seen"], found["flowers_there"] = (
            len(run.results["flowers"].positions),
            len(cell.plant.flower_segment),
        )
    if "capture" in run.results:
        views = run.results["capture"]
        if "cloud" in run.results:  # its poses are where the cart stands
            views = replace(views, T_world_cam=run.results["cloud"].T_world_cam)
        portrait(views, done.shake.grasp if done else None, folder / PICTURE)
    return asdict(case) | found


def thought(row: Row, run: Brief) -> float:
    """Return what thought took while arm and cart waited [s]. What is thought on the arm's way counts as approach."""
    seconds = sum(run.took(name) for name in COMPUTE if name not in AHEAD)
    return max(seconds - overlap(row.get("phases_s", {}), run), 0.0)


def expected_lost(plan: ShakePlan) -> float | None:
    """Return the share of flowers that the robot expected to lose by the shake that it carried out."""
    weighed = plan.weighed
    return None if weighed is None else float(np.interp(plan.amplitude, weighed.amplitude, weighed.lost))


def approach(phases: dict[str, float]) -> float:
    """Return how long the arm was on its way from the last view until it shook [s]; NaN if it did not."""
    names = list(phases)
    return sum(phases[name] for name in names[: names.index("shake")]) if "shake" in names else float("nan")


def touched(log: CellLog) -> dict[str, float]:
    """Return the largest force of the robot on a neighbour or a string, and on a post, pipe or gutter [N]; 0: none."""

    def most(*others: int) -> float:
        return float(log.contact_force[np.isin(log.contact_other, others)].max(initial=0.0))

    return {"neighbour_force": most(NEIGHBOUR), "part_force": most(POT, BENCH)}


def harmful(row: Row) -> bool:
    """Whether a visit touched or pulled what it must not."""
    touches = max(row.get("neighbour_force") or 0.0, row.get("part_force") or 0.0) > 0
    return touches or (row.get("string_pull") or 0.0) > LETS_GO


def held(row: Row) -> bool:
    """Whether the asked stem was held, nothing else held or pulled; a string beside it is no organ."""
    return bool(row.get("held")) and not row.get("true_held_beside") and not harmful(row)


def moved(row: Row) -> bool:
    """Whether the median flower felt enough."""
    return (row.get(ACCELERATION) or 0.0) >= MOVED


def lost(rows: Sequence[Row], expected: bool = False) -> float:
    """Return the share of all flowers of some rows that were lost, or that the robot expected to lose; NaN of none."""
    key, peaks = "expected_lost_share" if expected else "flowers_lost", "true_flower_acceleration_peak_ms2"
    told = [(row[key], len(row[peaks])) for row in rows if row.get(key) is not None and row.get(peaks)]
    gone = sum(share * count if expected else share for share, count in told)
    return float(gone / sum(count for _, count in told)) if told else float("nan")


def cycle(row: Row) -> float:
    """Return how long a visit that shook took [s]; NaN of others."""
    return float(sum(part_of(row, part) or np.nan for part in PARTS))


def part_of(row: Row, part: str) -> float | None:
    """Return how long a part of a visit took [s]; None where there was none."""
    if part != "stow_s":
        return row.get(part)
    phases = row.get("phases_s") or {}
    return max((phases[name] for name in (EARLY, "reach") if name in phases), default=None)


def metrics(rows: Sequence[Row]) -> dict[str, float]:
    """Return the table's numbers; see the module."""
    helios = [row for row in rows if row.get("generator") == "helios"]
    rows = [row for row in rows if row.get("generator") != "helios"]
    table: dict[str, float] = {"rows": float(len(rows)), "rows_helios": float(len(helios))}
    crops = {f"_{crop}": [row for row in rows if row["species"] == crop] for crop in CROPS}
    for end, mine in ({"": rows} | crops | {"_helios": helios}).items():
        taken = [row for row in mine if held(row)]
        counts = {
            "held_row": (len(taken), len(mine)),
            "moved_row": (sum(map(moved, taken)), len(taken)),
            "neighbour_harm": (sum(map(harmful, mine)), len(mine)),
        }
        for name, (good, count) in counts.items():
            low, high = interval(good, count) if count else (float("nan"), float("nan"))
            share = good / count if count else float("nan")
            table |= {f"{name}{end}": share, f"{name}{end}_low": low, f"{name}{end}_high": high}
        table |= {f"lost_row{end}": lost(taken), f"lost_row_expected{end}": lost(taken, expected=True)}
    shook = [row for row in rows if np.isfinite(cycle(row)) and not row.get("first")]
    cycles = np.array([cycle(row) for row in shook])
    low, high = bootstrap(cycles)
    table |= {"cycle_s": median(cycles), "cycle_s_low": low, "cycle_s_high": high}
    return table | {part: median(part_of(row, part) for row in shook) for part in (*PARTS, "ahead_s")}


def report(rows: Sequence[Row], found: dict[str, float]) -> list[RenderableType]:
    """Return tables of what was held, what the cycle took, and what became of each row."""
    words = {"held_row": "stem held, nothing else", "moved_row": "of these median flower ≥ 5 m/s²",
             "neighbour_harm": "something else touched, or string off"}  # fmt: skip
    crops = {"": f"{found['rows']:.0f} rows (95 % interval)"} | {f"_{crop}": crop for crop in CROPS}
    crops |= {"_helios": f"{found['rows_helios']:.0f} of Helios"} if found["rows_helios"] else {}
    shares = {text: f"{key}*:.0% ({key}*_low:.0% to {key}*_high:.0%)" for key, text in words.items()}
    parts = {part: part[:-2] for part in (*PARTS, "cycle_s")} | {"ahead_s": "thought ahead, meanwhile"}
    name = {"own": "", "helios": "Helios's "}
    each = [
        (f"{name[row.get('generator', 'own')]}{row['species']} {row['seed']}", "yes" if held(row) else "no",
         f"{row.get(ACCELERATION) or 0:.1f}",
         f"{row.get('neighbour_force') or 0:.1f}", f"{row.get('part_force') or 0:.1f}",
         f"{row.get('string_pull') or 0:.2f}", str(row.get("message") or row.get("failure") or ""))
        for row in rows
    ]  # fmt: skip
    shares["flowers lost"] = "lost_row*:.1%"
    shares["as was expected"] = "lost_row_expected*:.1%"
    return [
        by_number(found, "", crops, shares),
        by_part(found, "part of a visit", parts, {"median [s]": "*:.1f"}),
        markdown(
            (
                "row",
                "held",
                "median flower [m/s²]",
                "neighbours [N]",
                "parts [N]",
                "string's pull [-]",
                "what happened",
            ),
            each,
        ),
    ]


def main() -> None:
    """Run what is missing and print the tables."""
    own = {
        "--rows": (20, "half tomatoes, half peppers"),
        "--helios": (10, "rows of Helios's tomatoes besides"),
        "--truth": ("wide", "or nominal, or one group alone"),
        "--development": (False, "the rows on which the visit was made"),
    }
    seed = (0, "added to all seeds")
    quick = "two rows, and one of Helios's"
    args = options(__doc__, quick=quick, seed=seed, jobs="trials", out="runs/rows", done=True, own=own)
    first = (DEVELOPMENT if args.development else FIRST) + args.seed
    cases = [
        {"species": crop, "seed": k, "truth": args.truth} for crop, k in by_turns(2 if args.quick else args.rows, first)
    ]
    if importlib.util.find_spec("pyhelios") is not None:
        of_helios = range(first, first + (1 if args.quick else args.helios))
        cases += [asdict(Case("tomato", k, args.truth, "helios")) for k in of_helios]
    rows = run_cases(one, cases, args.out, args.jobs, failed, args.done)
    recognised = metrics_of("row_map")
    found = metrics(rows) | {key: recognised[key] for key in ("same_stem_week1", "same_stem_week2")}
    finish(args, found, *report(rows, found))


if __name__ == "__main__":
    main()
