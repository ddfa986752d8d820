"""The figures of docs/reports/rod_validation.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter

from rod_cases.authors_plants import AuthorsPlant
from rod_cases.table import Convergence, Findings


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


def draw_authors_plants(plants: Sequence[AuthorsPlant], path: Path) -> None:
    """Draw, for each plant, the amplitude from the peer's to ours, and over Young's modulus at sound thicknesses."""
    figure, panels = plt.subplots(
        len(plants), 2, figsize=(13, 4.4 * len(plants)), layout="constrained", squeeze=False, width_ratios=(1.25, 1)
    )
    for (steps, moduli), plant in zip(panels, plants, strict=True):
        _draw_stages(steps, plant)
        _draw_moduli(moduli, plant)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_stages(axes: Axes, plant: AuthorsPlant) -> None:
    names = [stage.name for stage in plant.stages]
    sizes = np.array([1e3 * stage.amplitude for stage in plant.stages])
    colours = [
        "tab:red" if k == 0 else "tab:orange" if k < names.index(_ours(plant)) else "tab:green"
        for k in range(len(names))
    ]
    axes.barh(names, np.nan_to_num(sizes), color=colours)
    for k, size in enumerate(sizes):
        axes.text(
            np.nan_to_num(size) + 0.05, k, f"{size:.2f}" if np.isfinite(size) else "no result", va="center", fontsize=8
        )
    axes.axvline(1e3 * plant.setup["amp"], color="k", ls=":", label="shake at the grip")
    axes.invert_yaxis()
    axes.tick_params(axis="y", labelsize=8)
    axes.set(xlabel="flower amplitude [mm]", title=f"{plant.name}: authors' settings, r = 30 mm")
    axes.margins(x=0.12)
    axes.legend(fontsize=8, loc="upper right")


def _ours(plant: AuthorsPlant) -> str:
    return next(stage.name for stage in plant.stages if stage.name.startswith("our"))


def _draw_moduli(axes: Axes, plant: AuthorsPlant) -> None:
    for k, thin in enumerate(plant.thin):
        colour, name = f"C{k}", f"r = {1e3 * thin.radius:g} mm, stands from {thin.least_youngs / 1e6:.0f} MPa"
        axes.semilogx(thin.moduli / 1e6, 1e3 * thin.linear, color=colour, label=name)
        axes.axvspan(thin.least_youngs / 1e6 * 0.985, thin.least_youngs / 1e6 * 1.015, color=colour, alpha=0.5)
        if thin.simulated:
            youngs, _, amplitude = np.array(thin.simulated).T
            axes.plot(youngs / 1e6, 1e3 * amplitude, "o", color=colour)
    axes.axvline(plant.setup["E"] / 1e6, color="k", lw=1, label=f"authors' E = {plant.setup['E'] / 1e6:g} MPa: buckles")
    axes.axhline(1e3 * plant.stages[0].amplitude, color="tab:red", ls="--", label="peer, r = 30 mm")
    top = 2.0e3 * max(stage.amplitude for stage in plant.stages if np.isfinite(stage.amplitude))
    axes.set(xlabel="Young's modulus [MPa]", ylabel="flower amplitude [mm]", ylim=(0, top))
    axes.set_title(f"{plant.name}: real thickness (line: linear, dot: simulated)", fontsize=10)
    axes.grid(True, which="both", alpha=0.2)
    axes.legend(fontsize=8)
