"""Picture of a hand-eye calibration: residuals over the image, errors per view, rotation axes, methods compared."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from anther.calibration import CELLS, BoardViews, HandEye, flange_motions, image_coverage
from anther.geometry import Array, transform_points

USED, OUTLIER, LEFT_OUT = "tab:blue", "tab:red", "tab:orange"
ARROW = 0.03
"""The arrows are magnified until a long one has this share of the image's width."""


def draw_calibration(found: HandEye, views: BoardViews, T_base_flange: Array) -> Figure:
    """Return the figure of a calibration.

    Args:
        found: its result.
        views: of the board that it was made from.
        T_base_flange: (V, 4, 4) of these views.
    """
    figure = Figure(figsize=(14, 9), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 3, width_ratios=(1.25, 1, 0.9))
    _draw_image(figure.add_subplot(grid[:2, 0]), found, views, T_base_flange)
    _draw_scatter(figure.add_subplot(grid[2, 0]), found, views, T_base_flange)
    residuals = np.stack([found.pixel_residuals, found.rotation_residuals, found.translation_residuals], axis=1)
    for k, (unit, name) in enumerate(((1, "px"), (180 / np.pi, "deg"), (1e3, "mm"))):
        axes = figure.add_subplot(grid[k, 1])
        _draw_views(axes, found, unit * residuals[:, k], unit * found.left_out_errors[:, k], name)
    _draw_axes(figure.add_subplot(grid[:2, 2]), T_base_flange[found.used])
    _draw_methods(figure.add_subplot(grid[2, 2]), found)
    return figure


def _residuals(found: HandEye, views: BoardViews, T_base_flange: Array) -> list[Array]:
    """Return per view where the corners are seen, less where they should be [px]."""
    boards = found.board_in_camera(T_base_flange)
    pairs = zip(boards, views.corners.points, views.corners.pixels, strict=True)
    return [pixels - found.intrinsics.project(transform_points(T, points)) for T, points, pixels in pairs]


def _draw_image(axes: Any, found: HandEye, views: BoardViews, T_base_flange: Array) -> None:
    away = _residuals(found, views, T_base_flange)
    camera, all_pixels = found.intrinsics, np.concatenate(views.corners.pixels)
    lengths = np.linalg.norm(np.concatenate([r for r, kept in zip(away, found.used, strict=True) if kept]), axis=1)
    gain = float(f"{ARROW * camera.width / max(float(np.quantile(lengths, 0.95)), 1e-6):.1g}")
    for r, pixels, kept in zip(away, views.corners.pixels, found.used, strict=True):
        colour = USED if kept else OUTLIER
        axes.plot(*pixels.T, ".", color=colour, ms=1.5 if kept else 4, alpha=0.6)
        if kept:
            axes.quiver(*pixels.T, *(gain * r.T), color=colour, angles="xy", scale_units="xy", scale=1, width=0.0015)
    for k in range(1, CELLS[0]):
        axes.axvline(k * camera.width / CELLS[0], color="0.9", lw=0.6, zorder=0)
    for k in range(1, CELLS[1]):
        axes.axhline(k * camera.height / CELLS[1], color="0.9", lw=0.6, zorder=0)
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), xlabel="u [px]", ylabel="v [px]")
    axes.set_aspect("equal")
    axes.set_title(
        f"corners cover {image_coverage(all_pixels, camera):.0%} of the image\narrows: residuals x{gain:g}"
        + ("" if found.used.all() else "; red: views left out"),
        fontsize=9,
    )


def _draw_scatter(axes: Any, found: HandEye, views: BoardViews, T_base_flange: Array) -> None:
    """Each corner's residual: a cloud about 0 when arm and camera agree, clusters per view when they do not."""
    away = [r for r, kept in zip(_residuals(found, views, T_base_flange), found.used, strict=True) if kept]
    view = np.repeat(np.arange(len(away)), [len(r) for r in away])
    flat = np.concatenate(away)
    axes.scatter(*flat.T, c=view, cmap="turbo", s=4)
    angle = np.linspace(0, 2 * np.pi, 100)
    radius = 2 * found.pixel_noise
    axes.plot(radius * np.cos(angle), radius * np.sin(angle), color="k", lw=0.8, label=f"2 s = {radius:.2g} px")
    reach = 1.1 * max(radius, float(np.quantile(np.abs(flat), 0.995)))
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach), xlabel="du [px]", ylabel="dv [px]")
    axes.set_aspect("equal")
    axes.set_title("residuals of used views, a colour each", fontsize=9)
    axes.legend(fontsize=8, loc="upper right", framealpha=0.4)
    axes.grid(alpha=0.3)


def _draw_views(axes: Any, found: HandEye, own: Array, left_out: Array, unit: str) -> None:
    number = np.arange(len(own))
    axes.bar(number, own, color=[USED if kept else OUTLIER for kept in found.used], width=0.8)
    axes.plot(number, left_out, "_", color=LEFT_OUT, ms=9, mew=2)
    shown = np.concatenate([own[found.used], left_out[np.isfinite(left_out)]])
    top = 1.25 * float(shown.max())
    axes.set_ylim(0, top)
    for i in np.flatnonzero(own > top):
        axes.text(i, 0.97 * top, f"{own[i]:.3g}", ha="center", va="top", fontsize=7, color="white", rotation=90)
    axes.set_ylabel({"px": "corners [px]", "deg": "board's tilt [deg]", "mm": "board's centre [mm]"}[unit])
    axes.set_xticks(number, [name.rsplit(".", 1)[0][-10:] for name in found.images], rotation=90, fontsize=6)
    axes.grid(axis="y", alpha=0.3)
    if unit == "px":
        axes.set_title(
            "bars: errors per view, red: outliers left out\norange: a view predicted from the others", fontsize=9
        )


def _draw_axes(axes: Any, T_base_flange: Array) -> None:
    """Rotation axes between views on a half sphere, seen along its pole, areas true (Lambert's projection)."""
    motions = flange_motions(T_base_flange)
    angles = np.linalg.norm(motions.turns, axis=1)
    some = angles > 1e-9
    axis = motions.turns[some] / angles[some, None]
    axis = np.where(axis[:, 2:] < 0, -axis, axis)
    flat = axis[:, :2] * np.sqrt(1 / (1 + axis[:, 2:]))
    dots = axes.scatter(*flat.T, c=np.rad2deg(angles[some]), cmap="viridis", s=14, vmin=0)
    ring = np.linspace(0, 2 * np.pi, 200)
    for tilt in np.deg2rad([30, 60, 90]):
        radius = np.sqrt(1 - np.cos(tilt))
        axes.plot(radius * np.cos(ring), radius * np.sin(ring), color="0.6", lw=1.2 if tilt > 1.5 else 0.5)
        axes.text(0, radius, f"{np.rad2deg(tilt):.0f}°", fontsize=7, color="0.4", ha="center", va="bottom")
    axes.figure.colorbar(dots, ax=axes, shrink=0.6, label="angle [deg]")
    axes.set(xlim=(-1.1, 1.1), ylim=(-1.1, 1.15), xticks=[], yticks=[], xlabel="flange x", ylabel="flange y")
    axes.set_aspect("equal")
    axes.set_title(
        f"rotation axes between views (centre: flange z)\nturns up to {np.rad2deg(motions.largest):.0f}°, "
        f"across the main axis up to {np.rad2deg(motions.second):.0f}°",
        fontsize=9,
    )


def _draw_methods(axes: Any, found: HandEye) -> None:
    rows = found.methods[::-1]
    pixels = np.array([row.left_out_pixel for row in rows])
    names = ["refined" if row.name == "result" and "refine" in found.method else row.name for row in rows]
    axes.barh(names, np.nan_to_num(pixels), color=[LEFT_OUT if row.name == "result" else "0.7" for row in rows])
    for k, row in enumerate(rows):
        text = (
            f"{row.left_out_pixel:.2f} px, {1e3 * row.left_out_translation:.2f} mm"
            if pixels[k] >= 0
            else "three views only"
        )
        axes.text(0, k, f" {text}", va="center", fontsize=8)
    axes.set_xlabel("error of a view left out [px]")
    axes.set_title("methods", fontsize=9)
