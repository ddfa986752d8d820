"""Picture of a shake that was watched: what was commanded, what the flowers felt, and how close the limits were."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from anther.execution import Step
from anther.pictures.report import GREEN, INK, MAGENTA, ORANGE


def draw_steps(steps: Sequence[Step], start: float, target: float | None = None) -> Figure:
    """Return a figure of three panels over time: amplitude of each tone, flowers, share of the closest limit.

    Args:
        steps: of one shake, one or more.
        start: when it began [s], on the clock of the steps.
        target: what the flowers should feel [m/s2].
    """
    figure = Figure(figsize=(10, 5.4), layout="constrained")
    tones, flowers, limits = figure.subplots(3, 1, sharex=True)
    _draw_tones(tones, steps, start)
    middle = [(step.begin + step.end) / 2 - start for step in steps]
    flowers.plot(middle, [_most(step) for step in steps], "^-", color=MAGENTA, lw=1, label="most of any flower")
    flowers.plot(middle, [step.median for step in steps], "o-", color=ORANGE, label="median of those measured")
    if target is not None:
        flowers.axhline(target, color=GREEN, ls="--", lw=1.2, label="target")
    flowers.set(ylabel="flowers\n[m/s²]", ylim=(0, None))
    shares = [100 * step.used for step in steps]
    limits.bar(middle, shares, [step.end - step.begin for step in steps], color=GREEN, alpha=0.55)
    for x, share, step in zip(middle, shares, steps, strict=True):
        limits.text(x, share + 3, step.binds.removeprefix("the "), ha="center", fontsize=7, rotation=20)
    limits.axhline(100, color=INK, lw=1)
    limits.set(ylabel="of the closest\nlimit [%]", xlabel="time since the shake began [s]")
    limits.set_ylim(0, 1.35 * max(100, *shares))
    limits.set_xlim(0, None)
    for axes in (tones, flowers):
        axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    return figure


def _draw_tones(axes: Any, steps: Sequence[Step], start: float) -> None:
    """Draw each tone's amplitude: thick where the pads were steady, thin where it changed."""
    frequencies = sorted({f for step in steps for f in step.frequencies})
    colours = mpl.colormaps["viridis"](np.linspace(0, 0.85, len(frequencies)))
    for frequency, colour in zip(frequencies, colours, strict=True):
        times, sizes = [0.0], [0.0]
        for step in steps:
            size = 1e3 * dict(zip(step.frequencies, step.amplitudes, strict=True)).get(frequency, 0.0)
            span = [step.begin - start, step.end - start]
            times, sizes = [*times, *span], [*sizes, size, size]
            if size:
                axes.plot(span, [size, size], color=colour, lw=4, solid_capstyle="butt")
        axes.plot(times, sizes, color=colour, lw=1, label=f"{frequency:.3g} Hz")
    axes.set(ylabel="commanded\n[mm]", ylim=(0, None))


def _most(step: Step) -> float:
    seen = [a for a in step.flowers if np.isfinite(a)]
    return max(seen, default=float("nan"))
