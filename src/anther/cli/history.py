"""List the trial history, export it as CSV or Parquet, or add what was recorded elsewhere: a run, another history."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from anther.cli.run_folder import add_run
from anther.core.errors import FailureKind, bad_input
from anther.history import (
    Outcome,
    count_trials,
    each_trial,
    export,
    merge,
    read_outcomes,
    read_trials,
    shown,
    starting_material,
)  # fmt: skip
from anther.plant.visit import Result, Visit


@dataclass(frozen=True)
class Args:
    """Attributes: which history, which of its trials, and what to do with them."""

    history: Annotated[str, tyro.conf.Positional] = "runs/history.sqlite"
    """A SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE."""
    species: str | None = None
    """Only this crop."""
    plant: str | None = None
    """Only the plant with this label."""
    since: date | None = None
    """Only trials of this day and later, UTC (YYYY-MM-DD)."""
    until: date | None = None
    """Only trials of this day and earlier, UTC."""
    result: str | None = None
    """Only 'pollinated', 'held' (flowers hardly moved, or not measured), 'failed', or a kind of failure: 'slipped'."""
    last: int = 40
    """List at most so many, the last ones. An export always has all."""
    export: Path | None = None
    """Write a table instead of listing: a name that ends in .csv or .parquet."""
    table: Literal["visits", "flowers", "outcomes"] = "visits"
    """Which table to export: a line a visit, a line a flower and visit, or the counts of fruit set."""
    add: tuple[Path, ...] = ()
    """Run folders whose trial is not in the history yet, because it could not be reached."""
    merge: tuple[Path, ...] = ()
    """Histories of robots that were offline: what the history lacks of them is added. Doing it again adds nothing."""


def run(args: Args) -> None:
    """Add, export or list."""
    kinds = (*get_args(Result), *get_args(FailureKind))
    if args.result is not None and args.result not in kinds:
        raise bad_input("result", given=f"'{args.result}'", allowed=", ".join(kinds), do="Choose one.")
    if args.add or args.merge:
        return _add(args)
    which = {name: getattr(args, name) for name in ("species", "plant", "since", "until", "result")}
    first, last = args.since or date.min, args.until or date.max
    outcomes = read_outcomes(args.history, species=args.species, plant=args.plant)
    outcomes = [outcome for outcome in outcomes if first <= outcome.date <= last]
    if args.export is None:
        return _list(args, which, outcomes)
    count = export(args.export, args.table, each_trial(args.history, **which), outcomes)
    return print(f"{args.export}: {count} {args.table}")


def _add(args: Args) -> None:
    for folder in args.add:
        number = add_run(folder, args.history)
        print(f"{folder}: " + ("is in the history already" if number is None else f"visit {number}"))
    for source in args.merge:
        merged = merge(source, args.history)
        print(f"{source}: {merged.new} visits, counts and notes added, {merged.known} were there already")


def _list(args: Args, which: dict[str, Any], outcomes: Sequence[Outcome]) -> None:
    console = Console(markup=False)  # labels are the user's own: "[/bed]" is no markup
    trials = read_trials(args.history, **which, last=max(args.last, 0))
    count = count_trials(args.history, **which)
    if not count and not outcomes:
        return console.print(f"{shown(args.history)}: no trial or outcome, or none that fits.")
    if trials:
        console.print(_trials(trials))
    if count > len(trials):
        console.print(f"... and {count - len(trials)} earlier (--last).")
    if outcomes:
        console.print(_outcomes(outcomes[-args.last :]))
    for species in sorted({t.species for t in trials}):
        console.print(_believed(args, species), highlight=False)
    return None


def _trials(trials: Sequence[Visit]) -> Table:
    names = ("visit", "time (UTC)", "crop", "plant", "result", "grasp [cm]", "shake", "flowers [mm]", "E after [MPa]")
    table = Table(*names, "run", title="trials", title_justify="left")
    for t in trials:
        grasp, shake = t.grasp, t.shake
        held = "" if grasp is None or grasp.arc_length is None else f"{100 * grasp.arc_length:.1f}"
        shaken = "" if shake is None else f"{1000 * shake.amplitude:.2f} mm, {shake.frequency:.1f} Hz"
        stiff = "" if t.material is None or not t.flowers_measured else f"{t.material.youngs / 1e6:.0f}"
        first = (str(t.id), f"{t.time:%Y-%m-%d %H:%M}", t.species, t.plant, t.result_words)
        table.add_row(*first, held, shaken, _motion(t), stiff, t.run or "")
    return table


def _motion(trial: Visit) -> str:
    """Return predicted -> measured medians over the measured flowers."""
    motions = {name: np.array(values, dtype=float) for name, values in trial.motions().items()}
    seen = np.isfinite(motions["measured_amplitude"])
    if not seen.any():
        return f"{trial.flowers} not measured" if trial.flowers else ""
    predicted, measured = (1000 * np.median(motions[f"{how}_amplitude"][seen]) for how in ("predicted", "measured"))
    return f"{predicted:.2f} -> {measured:.2f} ({seen.sum()} of {trial.flowers})"


def _outcomes(outcomes: Sequence[Outcome]) -> Table:
    table = Table("date", "crop", "plant", "visit", "flowers", "fruit", "note", title="outcomes", title_justify="left")
    for o in outcomes:
        visit = "all before" if o.visit is None else str(o.visit)
        table.add_row(f"{o.date}", o.species, o.plant, visit, str(o.flowers), str(o.fruit), o.note)
    return table


def _believed(args: Args, species: str) -> str:
    """Return what the next trial would begin with."""
    plant = "a plant not shaken before" if args.plant is None else args.plant
    belief = starting_material(species, plant, args.history)
    m = belief.material
    low, high = (m.youngs * math.exp(s * 1.645 * m.youngs_spread) / 1e6 for s in (-1, 1))
    stiffness = f"E {m.youngs / 1e6:.0f} MPa (nine in ten: {low:.0f} to {high:.0f})"
    return f"{species}, {plant}: {stiffness}, damping ratio {m.damping_ratio:.3f}: {belief.reason}."
