"""Pictures of what measurements told: a camera's place on the flange, a stem's material, the dose-response."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import beta

from anther.core.geometry import Array, transform_points
from anther.history.fruit_set import Count, FruitSet
from anther.plant.bench import FreeVibration, Identification, MaterialTest, fitted_motion, tip_deflections
from anther.robot.calibration import CELLS, BoardViews, HandEye, flange_motions, image_coverage
from anther.show.style import GREEN, INK, MAGENTA

USED, OUTLIER, LEFT_OUT = "tab:blue", "tab:red", "tab:orange"
GREY, PRIOR, COUNT = "#9aa39d", "#8a8a8a", "#1f4e79"


def draw_calibration(found: HandEye, views: BoardViews, T_base_flange: Array) -> Figure:
    """Return the figure of a hand-eye calibration: residuals over the image, errors per view, rotation axes, methods.

    It was made from the views and T_base_flange (V, 4, 4).
    """
    figure = Figure(figsize=(14, 9), layout="constrained")
    grid = figure.add_gridspec(3, 3, width_ratios=(1.25, 1, 0.9))
    corners = zip(found.board_in_camera(T_base_flange), views.corners.points, views.corners.pixels, strict=True)
    away = [pixels - found.intrinsics.project(transform_points(T, points)) for T, points, pixels in corners]
    used = [r for r, kept in zip(away, found.used, strict=True) if kept]
    _draw_image(figure.add_subplot(grid[:2, 0]), found, views, away, np.linalg.norm(np.concatenate(used), axis=1))
    _draw_scatter(figure.add_subplot(grid[2, 0]), used, 2 * found.pixel_noise)
    residuals = np.stack([found.pixel_residuals, found.rotation_residuals, found.translation_residuals], axis=1)
    units = ((1, "corners [px]"), (180 / np.pi, "board's tilt [deg]"), (1e3, "board's centre [mm]"))
    for k, (unit, label) in enumerate(units):
        axes = figure.add_subplot(grid[k, 1])
        _draw_views(axes, found, unit * residuals[:, k], unit * found.left_out_errors[:, k])
        axes.set_ylabel(label)
    title = "bars: errors per view, red: outliers left out\norange: a view predicted from the others"
    figure.axes[2].set_title(title, fontsize=9)
    _draw_turns(figure.add_subplot(grid[:2, 2]), T_base_flange[found.used])
    _draw_methods(figure.add_subplot(grid[2, 2]), found)
    return figure


def _draw_image(axes: Any, found: HandEye, views: BoardViews, away: list[Array], lengths: Array) -> None:
    camera = found.intrinsics
    # a long arrow becomes 3 % of the image's width
    gain = float(f"{0.03 * camera.width / max(float(np.quantile(lengths, 0.95)), 1e-6):.1g}")
    for r, pixels, kept in zip(away, views.corners.pixels, found.used, strict=True):
        colour = USED if kept else OUTLIER
        axes.plot(*pixels.T, ".", color=colour, ms=1.5 if kept else 4, alpha=0.6)
        if kept:
            axes.quiver(*pixels.T, *(gain * r.T), color=colour, angles="xy", scale_units="xy", scale=1, width=0.0015)
    for k in range(1, CELLS[0]):
        axes.axvline(k * camera.width / CELLS[0], color="0.9", lw=0.6, zorder=0)
    for k in range(1, CELLS[1]):
        axes.axhline(k * camera.height / CELLS[1], color="0.9", lw=0.6, zorder=0)
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), xlabel="u [px]", ylabel="v [px]", aspect="equal")
    covered = f"corners cover {image_coverage(np.concatenate(views.corners.pixels), camera):.0%} of the image"
    others = "" if found.used.all() else "; red: views left out"
    axes.set_title(f"{covered}\narrows: residuals x{gain:g}{others}", fontsize=9)


def _draw_scatter(axes: Any, away: list[Array], radius: float) -> None:
    """Each corner's residual: a cloud about 0 when arm and camera agree, clusters per view when they do not."""
    flat, angle = np.concatenate(away), np.linspace(0, 2 * np.pi, 100)
    axes.scatter(*flat.T, c=np.repeat(np.arange(len(away)), [len(r) for r in away]), cmap="turbo", s=4)
    axes.plot(radius * np.cos(angle), radius * np.sin(angle), color="k", lw=0.8, label=f"2 s = {radius:.2g} px")
    reach = 1.1 * max(radius, float(np.quantile(np.abs(flat), 0.995)))
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach), xlabel="du [px]", ylabel="dv [px]", aspect="equal")
    axes.set_title("residuals of used views, a colour each", fontsize=9)
    axes.legend(fontsize=8, loc="upper right", framealpha=0.4)
    axes.grid(alpha=0.3)


def _draw_views(axes: Any, found: HandEye, own: Array, left_out: Array) -> None:
    number = np.arange(len(own))
    axes.bar(number, own, color=[USED if kept else OUTLIER for kept in found.used], width=0.8)
    axes.plot(number, left_out, "_", color=LEFT_OUT, ms=9, mew=2)
    top = 1.25 * float(np.concatenate([own[found.used], left_out[np.isfinite(left_out)]]).max())
    axes.set_ylim(0, top)
    for i in np.flatnonzero(own > top):
        axes.text(i, 0.97 * top, f"{own[i]:.3g}", ha="center", va="top", fontsize=7, color="white", rotation=90)
    axes.set_xticks(number, [name.rsplit(".", 1)[0][-10:] for name in found.images], rotation=90, fontsize=6)
    axes.grid(axis="y", alpha=0.3)


def _draw_turns(axes: Any, T_base_flange: Array) -> None:
    """Rotation axes between views on a half sphere, seen along its pole, areas true (Lambert's projection)."""
    motions = flange_motions(T_base_flange)
    angles = np.linalg.norm(motions.turns, axis=1)
    some = angles > 1e-9
    axis = motions.turns[some] / angles[some, None]
    axis = np.where(axis[:, 2:] < 0, -axis, axis)
    flat = axis[:, :2] * np.sqrt(1 / (1 + axis[:, 2:]))
    dots = axes.scatter(*flat.T, c=np.rad2deg(angles[some]), cmap="viridis", s=14, vmin=0)
    ring = np.linspace(0, 2 * np.pi, 200)
    for tilt in (30, 60, 90):
        radius = np.sqrt(1 - np.cos(np.deg2rad(tilt)))
        axes.plot(radius * np.cos(ring), radius * np.sin(ring), color="0.6", lw=1.2 if tilt == 90 else 0.5)
        axes.text(0, radius, f"{tilt}°", fontsize=7, color="0.4", ha="center", va="bottom")
    axes.figure.colorbar(dots, ax=axes, shrink=0.6, label="angle [deg]")
    axes.set(xlim=(-1.1, 1.1), ylim=(-1.1, 1.15), xticks=[], yticks=[], xlabel="flange x", ylabel="flange y")
    axes.set_aspect("equal")
    largest, second = np.rad2deg([motions.largest, motions.second])
    turns = f"turns up to {largest:.0f}°, across the main axis up to {second:.0f}°"
    axes.set_title(f"rotation axes between views (centre: flange z)\n{turns}", fontsize=9)


def _draw_methods(axes: Any, found: HandEye) -> None:
    rows = found.methods[::-1]
    pixels = np.array([row.left_out_pixel for row in rows])
    names = ["refined" if row.name == "result" and "refine" in found.method else row.name for row in rows]
    axes.barh(names, np.nan_to_num(pixels), color=[LEFT_OUT if row.name == "result" else "0.7" for row in rows])
    for k, row in enumerate(rows):
        errors = f"{row.left_out_pixel:.2f} px, {1e3 * row.left_out_translation:.2f} mm"
        axes.text(0, k, f" {errors}" if pixels[k] >= 0 else " three views only", va="center", fontsize=8)
    axes.set_xlabel("error of a view left out [px]")
    axes.set_title("methods", fontsize=9)


class Pluck(NamedTuple):
    """A recorded free vibration: the name of its file, T times [s], displacements [m], and what was fitted to it."""

    name: str
    times: Array
    displacement: Array
    fit: FreeVibration


def draw_material_test(test: MaterialTest, found: Identification, plucks: Sequence[Pluck] = ()) -> Figure:
    """Return a figure with one panel for each thing that was measured."""
    wanted = (found.samples is not None, bool(found.estimates), len(test.tip_mass) > 0)
    panels = [
        draw for draw, there in zip((_draw_density, _draw_youngs, _draw_deflection), wanted, strict=True) if there
    ]
    rows, columns = max(bool(plucks) + bool(panels), 1), max(len(panels), 1)
    figure = Figure(figsize=(max(7.0, 3.6 * len(panels)), 3.2 * rows), layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    if plucks:
        _draw_plucks(plucks, figure.add_subplot(grid[0, :]))
    for column, draw in enumerate(panels):
        draw(figure.add_subplot(grid[rows - 1, column]), test, found)
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_plucks(plucks: Sequence[Pluck], axes: Any) -> None:
    """Draw every pluck below the one before, in its own offset, with its fit."""
    height = 2.2 * max(float(np.ptp(p.displacement)) for p in plucks) * 500
    for row, (name, times, displacement, f) in enumerate(plucks):
        fine = np.linspace(times[0], times[-1], 4000)
        fitted = fitted_motion(f, times, displacement, fine)
        base = -row * height - 1e3 * float(fitted.mean())
        axes.plot(times - times[0], 1e3 * displacement + base, ".", color=GREY, ms=3)
        axes.plot(fine - fine[0], 1e3 * fitted + base, color=MAGENTA, lw=1.2)
        damping = f"damping ratio {f.damping_ratio:.4f} ± {f.damping_error:.1g}"
        text = f"{name}: {f.frequency:.3f} ± {f.frequency_error:.1g} Hz, {damping}"
        axes.text(times[-1] - times[0], (0.3 - row) * height, text, ha="right", fontsize=8)
    axes.set(xlabel="time [s]", ylabel="displacement [mm]", title="Free vibration (grey) and fit")


def _draw_density(axes: Any, test: MaterialTest, found: Identification) -> None:
    each = test.sample_mass / (np.pi * test.sample_radius**2 * test.sample_length)
    axes.plot(np.arange(1, len(each) + 1), each, "o", color=GREEN, label="sample")
    value, error = found.density.value, found.density.standard_error
    axes.axhline(value, color=INK, lw=1, label="mean")
    label = "± standard error,\ncalliper included"
    axes.axhspan(value - error, value + error, color=INK, alpha=0.12, lw=0, label=label)
    axes.set(xlabel="sample", ylabel="density [kg/m³]", title=f"Density {value:.0f} ± {error:.0f} kg/m³")
    axes.set_xticks(np.arange(1, len(each) + 1, max(1, len(each) // 6)))
    axes.legend(fontsize=7, loc="best")


def _draw_youngs(axes: Any, test: MaterialTest, found: Identification) -> None:
    shown = {estimate.name: estimate for estimate in found.estimates}
    if found.youngs is not None and len(shown) == 2:
        shown["together"] = found.youngs
    value = np.array([e.value for e in shown.values()]) / 1e6
    error = np.array([e.relative_error for e in shown.values()])
    at, span = np.arange(len(shown)), [value - value * np.exp(-error), value * np.exp(error) - value]
    axes.errorbar(at, value, span, fmt="o", color=MAGENTA, capsize=4)
    axes.set_xticks(at, list(shown), fontsize=8)
    axes.set(ylabel="Young's modulus [MPa]", title="E, ± one standard error", xlim=(-0.6, len(at) - 0.4))
    axes.set_ylim(0, 1.15 * axes.dataLim.y1)


def _draw_deflection(axes: Any, test: MaterialTest, found: Identification) -> None:
    assert test.stem is not None
    load = np.linspace(0, 1.05 * test.tip_mass.max(), 12)
    for estimate, line, colour in zip(found.estimates[::-1], ("-", "--"), (MAGENTA, GREEN), strict=False):
        sunk = tip_deflections(test.stem, estimate.value, found.density.value, load)
        axes.plot(1e3 * load, 1e3 * sunk, line, color=colour, lw=1.4, label=f"E from {estimate.name}")
    error = 1e3 * test.errors.deflection
    axes.errorbar(1e3 * test.tip_mass, 1e3 * test.deflection, error, fmt="o", color=INK, ms=4, capsize=2)
    axes.set(xlabel="mass on the tip [g]", ylabel="deflection [mm]", title="Deflection, held horizontal")
    axes.legend(fontsize=7)


def draw_fruit_set(learned: FruitSet, prior: FruitSet, species: str) -> Figure:
    """Return a figure: the belief in the dose-response with its 90 % band over the prior's, and each count as a dot.

    A dot stands at the one visit that would have freed as much pollen as the count's visits did, its area is the number
    of flowers, its bar the 90 % interval of a share counted on so many (Jeffreys).
    """
    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    axes = figure.add_subplot()
    a = np.concatenate([[0.0], np.geomspace(1, 300, 60)])
    for belief, colour, label in ((prior, PRIOR, "before any count"), (learned, MAGENTA, "believed now")):
        median, low, high = np.transpose([belief.probability(float(x)) for x in a])
        axes.fill_between(a, low, high, color=colour, alpha=0.2, lw=0)
        axes.plot(a, median, color=colour, label=label)
    for count in learned.counts:
        _draw_count(axes, learned, count)
    axes.set_xscale("symlog", linthresh=3, linscale=0.5)
    ticks = (0, 3, 10, 30, 100, 300)
    axes.set_xticks(ticks, [str(t) for t in ticks])
    axes.minorticks_off()
    axes.set(xlim=(-0.3, 300), xlabel="acceleration of the flowers in one visit [m/s²]; 0: no shake")
    axes.set(ylim=(-0.02, 1.02), ylabel="share of flowers that set")
    flowers = sum(c.flowers for c in learned.counts)
    title = f"{species}: {len(learned.counts)} counts, {flowers} flowers; bands: nine in ten"
    axes.set_title(title, fontsize=10, loc="left")
    axes.legend(loc="lower right", fontsize=9)
    axes.grid(alpha=0.3)
    return figure


def _draw_count(axes: Any, learned: FruitSet, count: Count) -> None:
    freed, exponent = min(learned.freed(count), 0.999), learned.interval("exponent")[0]
    x = learned.interval("half_dose")[0] * (freed / (1 - freed)) ** (1 / exponent)
    low, high = beta.ppf([0.05, 0.95], count.fruit + 0.5, count.flowers - count.fruit + 0.5)
    axes.plot([x, x], [low, high], color=COUNT, lw=0.8, alpha=0.5)
    axes.scatter(x, count.fruit / count.flowers, s=3 * count.flowers, color=COUNT, alpha=0.7, lw=0)
