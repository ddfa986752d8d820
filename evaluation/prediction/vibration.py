r"""Do the models tell how far a flower swings? The paper's R2 and R3, with a plant whose mechanics no model knows.

    python -m evaluation.prediction.vibration --random 4 --jobs 2 --figures docs/pictures

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
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, StrMethodFormatter

from anther.plant import Crop
from evaluation.harness import CROPS, finish, lost, options, plants_named, run_cases, save
from evaluation.prediction.vibration_plant import FAST_FREQUENCIES, HEIGHTS, PAPER_FREQUENCIES, Case, one_plant
from evaluation.prediction.vibration_table import BANDS, Row, location, metrics, report, score, shakes_in

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


SHOWN = {"paper": "the paper's model", "prior": "Anther, crop prior", "probe": "Anther, after one probe shake"}
COLOURS = {"paper": "#b04a3f", "prior": "#7a8fa6", "probe": "#2f7d4f", "true": "#222222"}


def draw(rows: Sequence[Row], folder: Path) -> None:
    """Write the pictures of the first two plants, and of all plants if there are more."""
    save(amplitudes(rows[:2]), folder / "vibration_amplitude.png", 100)
    save(locations(rows[:2]), folder / "vibration_location.png", 100)
    if len(rows) > 2:
        save(errors(rows), folder / "vibration_errors.png", 100)


def amplitudes(rows: Sequence[Row]) -> Figure:
    """Return predicted against true flower amplitude, one panel a plant and model, in the authors' band and above."""
    figure = Figure(figsize=(10.5, 3.5 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), len(SHOWN), squeeze=False)
    for line, row in zip(panels, rows, strict=True):
        for axes, (model, title) in zip(line, SHOWN.items(), strict=True):
            for band, mark in (("paper", "o"), ("fast", "^")):
                k = shakes_in(row, band).rows
                true, said = (1e3 * np.array(v)[k].ravel() for v in (row["true_m"], row["predicted_m"][model]))
                label = "0.7–1.9 Hz" if band == "paper" else "3–10 Hz"
                alpha = 0.55 if band == "paper" else 0.25
                axes.plot(true, said, mark, ms=3.5, mew=0, alpha=alpha, color=COLOURS[model], label=label)
            found = score(row, model, "paper")
            assert found is not None
            _square(axes, 1e3 * np.array(row["true_m"])[shakes_in(row, "paper").rows])
            axes.set_title(
                f"{row['species']} {row['seed']}: {title}\nr {found.amplitude_r:.2f}, error {found.error:.0%}, "
                f"bias {found.bias:+.0%}",
                fontsize=9,
            )
            axes.set_xlabel("flower amplitude in MuJoCo [mm]")
        line[0].set_ylabel("predicted [mm]")
        line[0].legend(fontsize=8, loc="lower right")
    return figure


def locations(rows: Sequence[Row]) -> Figure:
    """Return the flowers' mean amplitude against the height of the grip, one panel a plant and frequency."""
    band = [f for f in dict.fromkeys(s["frequency_hz"] for s in rows[0]["shakes"]) if f < BANDS["fast"][1]]
    figure = Figure(figsize=(1.9 * len(band), 2.7 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), len(band), squeeze=False)
    for line, row in zip(panels, rows, strict=True):
        for axes, f in zip(line, band, strict=True):
            k = location(row, f)
            size = row["shakes"][int(k[0])]["amplitude_m"]
            for name, style in (("true", "o-"), ("paper", "s--"), ("prior", "v--"), ("probe", "^--")):
                values = np.array(row["true_m"] if name == "true" else row["predicted_m"][name])[k].mean(axis=1)
                label = "MuJoCo" if name == "true" else SHOWN[name]
                axes.plot(HEIGHTS, values / size, style, ms=3.5, lw=1, color=COLOURS[name], label=label)
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
            axes.set_title(f"{row['species']} {row['seed']}, {f:g} Hz", fontsize=8)
            axes.tick_params(which="both", labelsize=7)
        line[0].set_ylabel("flowers / grip", fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("held at (share of stem)", fontsize=8)
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
    return figure


def errors(rows: Sequence[Row]) -> Figure:
    """Return every plant's mean error in the authors' band, model by model, and for each cause."""
    kinds = {
        "paper": "the paper's",
        "paper as scripted": "the paper's,\nas scripted",
        "prior": "Anther,\ncrop prior",
        "probe": "Anther,\nprobed",
        "true material": "scan,\ntrue material",
        "true plant": "true plant",
    }
    figure = Figure(figsize=(10, 4), layout="constrained")
    axes = figure.subplots()
    rng = np.random.default_rng(0)
    for x, model in enumerate(kinds):
        values = np.array([s.error for row in rows if (s := score(row, model, "paper"))])
        jitter = rng.uniform(-0.18, 0.18, len(values))
        axes.plot(x + jitter, 100 * values, "o", ms=4, mew=0, alpha=0.6, color=COLOURS.get(model, "#888888"))
        axes.plot([x - 0.25, x + 0.25], 2 * [100 * float(np.median(values))], color="k", lw=1.5)
    axes.axhline(15, color="#2f7d4f", lw=0.8, ls=":")
    axes.set_yscale("log")
    axes.set_xticks(range(len(kinds)), list(kinds.values()), fontsize=8)
    axes.set_ylabel("mean |predicted / true − 1|, below 2 Hz [%]")
    axes.set_title(f"{len(rows)} plants (bar: median; dotted: target of 15 %)", fontsize=9)
    return figure


def _square(axes: Any, values: Any) -> None:
    low, high = 0.8 * float(np.min(values)), 1.25 * float(np.max(values))
    axes.plot([low / 30, high], [low / 30, high], color="k", lw=0.8)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(low / 10, high)
    axes.set_ylim(low / 10, high)
    axes.set_aspect("equal")


def main() -> None:
    """Do what is not there yet, print the tables, write --json and the figures."""
    figures = "vibration_amplitude.png and others"
    seed = (0, "of the thorough plants; added to those of the random ones")
    own = {
        "--random": (30, "how many random plants"),
        "--thorough": (False, "two more plants, or those of --plants, of more shakes"),
        "--plants": ((), "these instead, such as tomato-10 pepper-11"),
    }
    args = options(__doc__, quick="one plant", seed=seed, jobs="plants", out="runs/vibration", figures=figures, own=own)
    done = run_cases(one_plant, map(asdict, chosen(args)), args.out, args.jobs, lost)
    rows, without = ([row for row in done if ("lost" in row) == gone] for gone in (False, True))
    numbers = metrics(rows) | {"plants_lost": len(without)}
    finish(args, numbers, *report(rows), *(f"Left out: {row['lost']}" for row in without))
    if args.figures:
        draw(rows, args.figures)


if __name__ == "__main__":
    main()
