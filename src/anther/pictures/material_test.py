"""The picture of a material test: plucks with their fit, density samples, E by method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from anther.geometry import Array
from anther.identification import (
    FreeVibration,
    Identification,
    MaterialTest,
    fitted_motion,
    tip_deflections,
)

GREEN, MAGENTA, INK = "#2f7d4f", "#c2389a", "#1d2a22"


@dataclass(frozen=True, slots=True, eq=False)
class Pluck:
    """A recorded free vibration. T samples.

    Attributes:
        name: of its file.
        times: (T,) [s].
        displacement: (T,) [m].
        fit: what was fitted to it.
    """

    name: str
    times: Array
    displacement: Array
    fit: FreeVibration


def draw_material_test(test: MaterialTest, found: Identification, plucks: Sequence[Pluck] = ()) -> Figure:
    """Return a figure with one panel for each thing that was measured."""
    panels: list[Callable[[Any], None]] = []
    if found.samples is not None:
        panels.append(partial(_draw_density, test, found))
    if found.estimates:
        panels.append(partial(_draw_youngs, found))
    if len(test.tip_mass):
        panels.append(partial(_draw_deflection, test, found))
    rows = int(bool(plucks)) + int(bool(panels))
    figure = Figure(figsize=(max(7.0, 3.6 * len(panels)), 3.2 * max(rows, 1)), layout="constrained")
    grid = figure.add_gridspec(max(rows, 1), max(len(panels), 1))
    if plucks:
        _draw_plucks(plucks, figure.add_subplot(grid[0, :]))
    for place, panel in enumerate(panels):
        panel(figure.add_subplot(grid[rows - 1, place]))
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_plucks(plucks: Sequence[Pluck], axes: Any) -> None:
    """Draw every pluck below the one before, in its own offset, with its fit."""
    height = 2.2 * max(float(np.ptp(p.displacement)) for p in plucks) * 500
    for row, pluck in enumerate(plucks):
        fine = np.linspace(pluck.times[0], pluck.times[-1], 4000)
        fitted = fitted_motion(pluck.fit, pluck.times, pluck.displacement, fine)
        base = -row * height - 1e3 * float(fitted.mean())
        seconds = pluck.times - pluck.times[0]
        axes.plot(seconds, 1e3 * pluck.displacement + base, ".", color="#9aa39d", ms=3)
        axes.plot(fine - fine[0], 1e3 * fitted + base, color=MAGENTA, lw=1.2)
        f = pluck.fit
        frequency = f"{f.frequency:.3f} ± {f.frequency_error:.1g} Hz"
        text = f"{pluck.name}: {frequency}, damping ratio {f.damping_ratio:.4f} ± {f.damping_error:.1g}"
        axes.text(seconds[-1], base + 1e3 * float(fitted.mean()) + 0.3 * height, text, ha="right", fontsize=8)
    axes.set(xlabel="time [s]", ylabel="displacement [mm]", title="Free vibration (grey) and fit")


def _draw_density(test: MaterialTest, found: Identification, axes: Any) -> None:
    each = test.sample_mass / (np.pi * test.sample_radius**2 * test.sample_length)
    axes.plot(np.arange(1, len(each) + 1), each, "o", color=GREEN, label="sample")
    value, error = found.density.value, found.density.standard_error
    axes.axhline(value, color=INK, lw=1, label="mean")
    axes.axhspan(
        value - error, value + error, color=INK, alpha=0.12, lw=0, label="± standard error,\ncalliper included"
    )
    axes.set(xlabel="sample", ylabel="density [kg/m³]", title=f"Density {value:.0f} ± {error:.0f} kg/m³")
    axes.set_xticks(np.arange(1, len(each) + 1, max(1, len(each) // 6)))
    axes.legend(fontsize=7, loc="best")


def _draw_youngs(found: Identification, axes: Any) -> None:
    shown = list(found.estimates)
    if found.youngs is not None and len(shown) == 2:
        shown.append(found.youngs)
    names = [*(e.name for e in found.estimates), "together"][: len(shown)]
    value = np.array([e.value for e in shown]) / 1e6
    error = np.array([e.relative_error for e in shown])
    at = np.arange(len(shown))
    axes.errorbar(
        at, value, [value - value * np.exp(-error), value * np.exp(error) - value], fmt="o", color=MAGENTA, capsize=4
    )
    axes.set_xticks(at, names, fontsize=8)
    axes.set(ylabel="Young's modulus [MPa]", title="E, ± one standard error", xlim=(-0.6, len(at) - 0.4))
    axes.set_ylim(0, 1.15 * axes.dataLim.y1)


def _draw_deflection(test: MaterialTest, found: Identification, axes: Any) -> None:
    assert test.stem is not None
    load = np.linspace(0, 1.05 * test.tip_mass.max(), 12)
    for estimate, line in zip(found.estimates[::-1], ("-", "--"), strict=False):
        sunk = tip_deflections(test.stem, estimate.value, found.density.value, load)
        colour = MAGENTA if line == "-" else GREEN
        axes.plot(1e3 * load, 1e3 * sunk, line, color=colour, lw=1.4, label=f"E from {estimate.name}")
    error = 1e3 * test.errors.deflection
    axes.errorbar(1e3 * test.tip_mass, 1e3 * test.deflection, error, fmt="o", color=INK, ms=4, capsize=2)
    axes.set(xlabel="mass on the tip [g]", ylabel="deflection [mm]", title="Deflection, held horizontal")
    axes.legend(fontsize=7)
