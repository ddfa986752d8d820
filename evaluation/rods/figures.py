"""The figures of the rod validation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter

from evaluation.rods.table import Convergence, Findings


def draw_convergence(found: Sequence[Findings], path: Path) -> None:
    """Draw errors over the node distance, and over the time step."""
    figure, (space, time) = plt.subplots(1, 2, figsize=(11, 6.4), layout="constrained")
    _draw_curves(space, [curve for findings in found for curve in findings.in_space])
    space.set(xlabel="node distance / free length", ylabel="relative error", title="in space, second order")
    _draw_curves(time, [curve for findings in found for curve in findings.in_time])
    time.xaxis.set_minor_formatter(NullFormatter())
    time.set(xlabel="time step [s]", ylabel="largest position error [m]", title="in time")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_curves(axes: Axes, curves: Sequence[Convergence]) -> None:
    for curve in curves:
        axes.loglog(curve.steps, curve.errors, "o-", label=f"{curve.name}: slope {curve.slope:.2f}")
    first = min(curves, key=lambda curve: curve.errors[0])
    guide = 0.3 * first.errors[0] * (first.steps / first.steps[0]) ** 2
    axes.loglog(first.steps, guide, "k:", label="slope 2")
    axes.grid(True, which="both", alpha=0.2)
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.12))


def draw_energy(found: Sequence[Findings], path: Path) -> None:
    """Draw the energy error of the undamped runs over periods."""
    traces = {name: trace for findings in found for name, trace in findings.energy.items()}
    figure, panels = plt.subplots(1, len(traces), figsize=(11, 3.4), layout="constrained", squeeze=False)
    for axes, (name, (periods, change)) in zip(panels[0], traces.items(), strict=True):
        axes.plot(periods, 100 * change, lw=0.6)
        axes.axhline(0, color="k", lw=0.5)
        axes.set(xlabel="periods", ylabel="energy error [%]", title=name)
        axes.grid(True, alpha=0.2)
    figure.savefig(path, dpi=110)
    plt.close(figure)
