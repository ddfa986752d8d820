"""List the trial history, export it as CSV or Parquet, or add what was recorded elsewhere: a run, another history."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import date
from typing import Any, get_args

import numpy as np
from rich.box import HEAVY_HEAD, SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from anther.cli.args.history import Args
from anther.cli.output import free
from anther.cli.run_folder import add_run
from anther.core.errors import FailureKind, bad_input
from anther.history import (
    Outcome,
    count_trials,
    each_trial,
    export,
    hide_password,
    merge,
    read_outcomes,
    read_trials,
    starting_material,
)  # fmt: skip
from anther.plant.visit import Result, Visit


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
    free(args.export, overwrite=args.overwrite)
    count = export(args.export, args.table, each_trial(args.history, **which), outcomes)
    return print(f"{args.export}: {count} {args.table}")


def _add(args: Args) -> None:
    for folder in args.add:
        number = add_run(folder, args.history)
        print(f"{folder}: " + ("is in the history already" if number is None else f"visit {number}"))
    for source in args.merge:
        merged = merge(source, args.history)
        what = "visits, counts, notes, sides and shifts"
        print(f"{source}: {merged.new} {what} added, {merged.known} were there already")


def _list(args: Args, which: dict[str, Any], outcomes: Sequence[Outcome]) -> None:
    console = Console(markup=False)  # labels are the user's own: "[/bed]" is no markup
    trials = read_trials(args.history, **which, last=max(args.last, 0))
    count = count_trials(args.history, **which)
    if not count and not outcomes:
        return console.print(f"{hide_password(args.history)}: no trial or outcome, or none that fits.")
    if trials:
        console.print(_trials(trials, console.width))
    if count > len(trials):
        console.print(f"... and {count - len(trials)} earlier (--last).")
    if outcomes:
        console.print(_outcomes(outcomes[-args.last :]))
    for species in sorted({t.species for t in trials}):
        console.print(_belief_line(args, species), highlight=False)
    return None


def _trials(trials: Sequence[Visit], width: int) -> Table:
    """Return the table of trials; in a narrow terminal with the columns that tell how each went."""
    wide = 140  # characters that all columns take
    columns = COLUMNS if width >= wide else {name: COLUMNS[name] for name in NARROW}
    more = (
        ""
        if width >= wide
        else f"; from {wide} columns on: {', '.join(name for name in COLUMNS if name not in NARROW)}"
    )
    box = HEAVY_HEAD if width >= wide else SIMPLE_HEAD
    table = Table(*columns, title=f"trials{more}", title_justify="left", box=box)
    for trial in trials:
        table.add_row(*(cell(trial) for cell in columns.values()))
    return table


def _grasp_cell(trial: Visit) -> str:
    return "" if trial.grasp is None or trial.grasp.arc_length is None else f"{100 * trial.grasp.arc_length:.1f}"


def _shake_cell(trial: Visit) -> str:
    return "" if trial.shake is None else f"{1000 * trial.shake.amplitude:.2f} mm, {trial.shake.frequency:.1f} Hz"


def _stiff(trial: Visit) -> str:
    return "" if trial.material is None or not trial.flowers_measured else f"{trial.material.youngs / 1e6:.0f}"


def _motion(trial: Visit) -> str:
    """Return predicted -> measured medians over the measured flowers."""
    motions = {name: np.array(values, dtype=float) for name, values in trial.motions().items()}
    seen = np.isfinite(motions["measured_amplitude"])
    if not seen.any():
        return f"{trial.flowers} not measured" if trial.flowers else ""
    predicted, measured = (1000 * np.median(motions[f"{how}_amplitude"][seen]) for how in ("predicted", "measured"))
    return f"{predicted:.2f} -> {measured:.2f} ({seen.sum()} of {trial.flowers})"


COLUMNS: dict[str, Callable[[Visit], str]] = {
    "visit": lambda trial: str(trial.id),
    "time (UTC)": lambda trial: f"{trial.time:%Y-%m-%d %H:%M}",
    "crop": lambda trial: trial.species,
    "plant": lambda trial: trial.plant,
    "result": lambda trial: trial.result_words,
    "grasp [cm]": _grasp_cell,
    "shake": _shake_cell,
    "flowers [mm]": _motion,
    "E after [MPa]": _stiff,
    "run": lambda trial: trial.run or "",
}
NARROW = ("visit", "time (UTC)", "plant", "result", "shake")


def _outcomes(outcomes: Sequence[Outcome]) -> Table:
    table = Table("date", "crop", "plant", "visit", "flowers", "fruit", "note", title="outcomes", title_justify="left")
    for o in outcomes:
        visit = "all before" if o.visit is None else str(o.visit)
        table.add_row(f"{o.date}", o.species, o.plant, visit, str(o.flowers), str(o.fruit), o.note)
    return table


def _belief_line(args: Args, species: str) -> str:
    """Return what the next trial would begin with."""
    plant = "a plant not shaken before" if args.plant is None else args.plant
    belief = starting_material(species, plant, args.history)
    m = belief.material
    low, high = (m.youngs * math.exp(s * 1.645 * m.youngs_spread) / 1e6 for s in (-1, 1))
    stiffness = f"E {m.youngs / 1e6:.0f} MPa (nine in ten: {low:.0f} to {high:.0f})"
    return f"{species}, {plant}: {stiffness}, damping ratio {m.damping_ratio:.3f}: {belief.reason}."
