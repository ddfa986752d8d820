"""Picture of a simulated shake: the plant over one period, and the motion of grip and flower in time and frequency."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

from anther.devices import Frame
from anther.elastic_rod import Rods, Trajectory
from anther.files import written
from anther.geometry import Array

SECONDS, WIDTH, COLOURS, SLOWER = 1.5, 320, 96, 2.0
"""Of the film's last frames, its width [px], colours, and times slower than it was."""


def save_film(path: Path, frames: Sequence[Frame]) -> None:
    """Write the end of a recording as an animated GIF; nothing where fewer than two frames were kept.

    Args:
        path: of the file.
        frames: in order of time.

    Raises:
        InputError: the file cannot be written.
    """
    last = [frame for frame in frames if frame.time >= frames[-1].time - SECONDS]
    if len(last) < 2:
        return
    height = round(WIDTH * last[0].rgb.shape[0] / last[0].rgb.shape[1])
    pictures = [Image.fromarray(frame.rgb).resize((WIDTH, height)) for frame in last]
    palette = pictures[0].quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE)
    shown = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    apart = 1000 * SLOWER * (last[-1].time - last[0].time) / (len(last) - 1)
    with written(path, "a folder that can be written"):
        shown[0].save(path, save_all=True, append_images=shown[1:], duration=round(apart), loop=0, optimize=True)


GRIP, FLOWER, REST = "tab:blue", "tab:red", "#23402b"
PHASES = 12
REACH = 0.08
"""Motion too small to see is magnified until it spans this share of the plant."""


def draw_shake(rods: Rods, grip: int, flower: int, direction: Array, trajectory: Trajectory, period: float) -> Figure:
    """Return a figure of a shaken plant, seen across the shake.

    Args:
        rods: the plant.
        grip: its gripped node.
        flower: the node whose motion is shown.
        direction: (3,) of the shake.
        trajectory: what the plant did.
        period: of the shake [s]; the plant is drawn over the last one.
    """
    figure = Figure(figsize=(12, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    side = int(np.argmax(np.abs(direction[:2])))
    spread = np.ptp(trajectory.positions[0], axis=0)
    grid = figure.add_gridspec(2, 2, width_ratios=(float(np.clip(1.5 * spread[side] / spread[2], 0.6, 1.2)), 1.3))
    _draw_plant(figure.add_subplot(grid[:, 0]), rods, grip, flower, side, trajectory, period)
    time, spectrum = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    for node, colour, name in ((flower, FLOWER, "flower"), (grip, GRIP, "grip")):
        along = 1e3 * trajectory.displacement(node) @ direction
        time.plot(trajectory.times, along, color=colour, label=name, lw=1)
        window = np.blackman(len(along))
        height = 2 * np.abs(np.fft.rfft((along - along.mean()) * window, 8 * len(along))) / window.sum()
        hertz = np.fft.rfftfreq(8 * len(along), trajectory.times[1])
        spectrum.semilogy(hertz, height, color=colour, label=name, lw=1)
    time.set(xlabel="time [s]", ylabel="displacement along the shake [mm]")
    spectrum.set(xlabel="frequency [Hz]", ylabel="amplitude [mm]", xlim=(0, max(10, 2.5 / period)))
    spectrum.set_ylim(bottom=1e-4 * max(1e-9, spectrum.dataLim.y1))
    for axes in (time, spectrum):
        axes.grid(alpha=0.3)
        axes.legend(loc="upper right")
    return figure


def _draw_plant(
    axes: Any, rods: Rods, grip: int, flower: int, side: int, trajectory: Trajectory, period: float
) -> None:
    """Draw the plant at rest and at phases of the last period, coloured from early to late."""
    rest, end = trajectory.positions[0], trajectory.times[-1]
    last = np.flatnonzero(trajectory.times >= end - period * (1 + 1e-9))
    frames = np.unique(last[np.linspace(0, len(last) - 1, PHASES + 1).round().astype(int)])
    moved = trajectory.positions[last] - rest
    largest = float(np.abs(moved).max())
    gain = 1.0 if largest == 0 else max(1.0, float(f"{REACH * np.ptp(rest, axis=0).max() / largest:.1g}"))
    widths = 0.5 + 2 * np.asarray(rods.edge_radius)[1:] / np.asarray(rods.edge_radius)[1:].max()
    for k, frame in enumerate(frames):
        shade = mpl.colormaps["plasma"](0.9 * k / len(frames))
        _lines(axes, rods, (rest + gain * (trajectory.positions[frame] - rest))[:, [side, 2]], shade, 0.9)
    _lines(axes, rods, rest[:, [side, 2]], REST, widths)
    for node, colour, name in ((flower, FLOWER, "flower"), (grip, GRIP, "grip")):
        path = (rest[node] + gain * (trajectory.positions[last, node] - rest[node]))[:, [side, 2]]
        axes.plot(*path.T, color=colour, lw=2, zorder=5)
        axes.plot(*rest[node, [side, 2]], "o", color=colour, mec="white", zorder=6, label=f"{name} and its path")
    scale = "" if gain == 1 else f"motion drawn x{gain:g}"
    axes.set(xlabel=f"{'xy'[side]} [m]", ylabel="z [m]")
    axes.set_title(f"the last period, dark to light\ngreen: at rest. {scale}", fontsize=9)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.locator_params(axis="x", nbins=4)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, fontsize=8, frameon=False)


def _lines(axes: Any, rods: Rods, flat: Array, colour: Any, width: Any) -> None:
    edges: Any = np.stack([flat[rods.parent[1:]], flat[1:]], axis=1)
    axes.add_collection(LineCollection(edges, colors=colour, linewidths=width, capstyle="round"))
