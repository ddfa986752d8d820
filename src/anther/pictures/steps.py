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
    """Return a figure of three panels over time: amplitude of each tone, flowers, share of each limit that was closest.

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
    _draw_limits(limits, steps, start)
    limits.set(xlabel="time since the shake began [s]", xlim=(0, None))
    for axes in (tones, flowers, limits):
        axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    return figure


def _draw_tones(axes: Any, steps: Sequence[Step], start: float) -> None:
    """Draw each tone's amplitude: thick where the pads were steady, thin where it changed."""
    frequencies = sorted({f for step in steps for f in step.frequencies})
    colours = mpl.colormaps["viridis"](np.linspace(0, 0.85, len(frequencies)))
    times = [0.0, *(t - start for step in steps for t in (step.begin, step.end))]
    for frequency, colour in zip(frequencies, colours, strict=True):
        each = [1e3 * dict(zip(step.frequencies, step.amplitudes, strict=True)).get(frequency, 0.0) for step in steps]
        sizes = np.array([0.0, *np.repeat(each, 2)])
        moves = np.convolve(sizes > 0, np.ones(3), "same") > 0  # no line along the axis while it rests
        axes.plot(times, np.where(moves, sizes, np.nan), color=colour, lw=1, label=f"{frequency:.3g} Hz")
        for k in np.flatnonzero(each):
            axes.plot(times[2 * k + 1 : 2 * k + 3], [each[k]] * 2, color=colour, lw=4, solid_capstyle="butt")
    axes.set(ylabel="commanded\n[mm]", ylim=(0, None))


def _draw_limits(axes: Any, steps: Sequence[Step], start: float) -> None:
    """Draw for each step how much of the closest limit was used; the colour says which it is."""
    names = list(dict.fromkeys(step.binds for step in steps))
    for name, colour in zip(names, mpl.colormaps["Set2"].colors * len(names), strict=False):  # type: ignore[attr-defined]
        near = [step for step in steps if step.binds == name]
        begins, spans = [step.begin - start for step in near], [step.end - step.begin for step in near]
        axes.bar(begins, [100 * step.used for step in near], spans, align="edge", color=colour, label=name or "none")
    axes.axhline(100, color=INK, lw=1)
    axes.set(ylabel="of the closest\nlimit [%]", ylim=(0, None))


def _most(step: Step) -> float:
    seen = [a for a in step.flowers if np.isfinite(a)]
    return max(seen, default=float("nan"))
