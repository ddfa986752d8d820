"""What the counts of fruit set teach of the dose-response, with its uncertainty, and what they do not."""

from __future__ import annotations

import json
from typing import Any

from rich.console import Console
from rich.table import Table

from anther.cli.args.fruit_set import Args
from anther.cli.output import free
from anther.core.errors import bad_input
from anther.history import read_outcomes, read_trials
from anther.history.fruit_set import NAMES, PRIORS, FruitSet, counts_of, fit


def run(args: Args) -> None:
    """Fit and print; draw when asked to."""
    if args.figure is not None:
        free(args.figure, overwrite=args.overwrite)
    if args.figure is not None and args.figure.suffix.lower() != ".png":
        raise bad_input("figure", given=str(args.figure), allowed="a name that ends in .png", do="Name it so.")
    outcomes = read_outcomes(args.history, species=args.species)
    counts, left_out = counts_of(read_trials(args.history, species=args.species), outcomes)
    learned = fit(counts, PRIORS.get(args.species, PRIORS["pepper"]))
    result = summary(learned) | {"species": args.species, "caveats": [*left_out, *learned.caveats()]}
    if args.figure is not None:
        from anther.show.pictures import save_figure
        from anther.show.pictures.estimates import draw_fruit_set

        save_figure(draw_fruit_set(learned, fit([], learned.prior), args.species), args.figure)
    if args.json:
        print(json.dumps(result, indent=2))
    else:
        _print(result)


def summary(learned: FruitSet) -> dict[str, Any]:
    """Return what is believed, each as [median, 5 %, 95 %], beside the prior."""
    before, accelerations = fit([], learned.prior), (0.0, 10.0, 25.0, 50.0, 100.0, 200.0)  # up to a bee's buzz
    return {
        "counts": len(learned.counts),
        "flowers": sum(c.flowers for c in learned.counts),
        "fruit": sum(c.fruit for c in learned.counts),
        "controls": sum(not c.shakes for c in learned.counts),
        **{name: learned.interval(name) for name in NAMES},
        **{f"{name}_prior": before.interval(name) for name in NAMES},
        **{f"{name}_learned": learned.learned(name) for name in NAMES[:4]},
        "probability": {f"{a:g}": learned.probability(a) for a in accelerations},
        "added": {f"{a:g}": learned.added(a) for a in accelerations},
        "probability_prior": {f"{a:g}": before.probability(a) for a in accelerations},
    }


def _print(result: dict[str, Any]) -> None:
    console = Console(highlight=False, markup=False)
    told = f"{result['counts']} counts ({result['controls']} without a shake), {result['flowers']} flowers"
    console.print(f"{result['species']}: {told}, {result['fruit']} fruit")
    table = Table("", "believed (nine in ten)", "before any count", "narrowed by")
    for name, label, scale, unit in (
        ("unshaken", "sets without a shake", 100, " %"),
        ("gain", "of the rest, sets when all pollen is freed", 100, " %"),
        ("half_dose", "acceleration that frees half of it", 1, " m/s²"),
        ("exponent", "how steeply it grows with that, 1 to 2", 1, ""),
        ("likeness", "likeness of flowers counted together", 1, ""),
    ):
        texts = [_interval(result[key], scale, unit) for key in (name, f"{name}_prior")]
        learned = result.get(f"{name}_learned")
        table.add_row(label, *texts, "" if learned is None else f"{learned:.0%}")
    console.print(table)
    table = Table("one visit shakes the flowers by", "sets (nine in ten)", "the visit adds", "sets, before any count")
    for a, believed in result["probability"].items():
        prior = result["probability_prior"][a]
        texts = [_interval(values, 100, " %") for values in (believed, result["added"][a], prior)]
        table.add_row(f"{a} m/s²", *texts)
    console.print(table)
    for note in result["caveats"]:
        console.print(f"- {note}")


def _interval(values: tuple[float, float, float], scale: float, unit: str) -> str:
    median, low, high = (f"{scale * v:.2g}" if 0 < scale * v < 1 else f"{scale * v:.0f}" for v in values)
    return f"{median}{unit} ({low} to {high})"
