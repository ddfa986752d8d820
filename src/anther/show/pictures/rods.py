"""Pictures of a plant as rods: what one shake does to it, and how its flowers answer every shake."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.pollination.grip_map import GripMap
from anther.rods import Rods, Trajectory
from anther.show.style import MAGENTA

GRIP, FLOWER, REST = "tab:blue", "tab:red", "#23402b"
BEST, PALE = "deepskyblue", "#8aa58c"


def draw_shake(rods: Rods, grip: int, flower: int, direction: Array, trajectory: Trajectory, period: float) -> Figure:
    """Return a figure of a shaken plant: over its last period [s], and the nodes grip and flower in time and frequency.

    The plant is seen across the shake's direction (3,).
    """
    figure = Figure(figsize=(12, 6.2), layout="constrained")
    side = int(np.argmax(np.abs(direction[:2])))
    spread = np.ptp(trajectory.positions[0], axis=0)
    grid = figure.add_gridspec(2, 2, width_ratios=(float(np.clip(1.5 * spread[side] / spread[2], 0.6, 1.2)), 1.3))
    nodes = ((flower, FLOWER, "flower"), (grip, GRIP, "grip"))
    _draw_period(figure.add_subplot(grid[:, 0]), rods, nodes, [side, 2], trajectory, period)
    time, spectrum = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    for node, colour, name in nodes:
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


def _draw_period(axes: Any, rods: Rods, nodes: Any, seen: list[int], trajectory: Trajectory, period: float) -> None:
    """Draw the plant at rest and at phases of the last period, coloured from early to late."""
    rest, end = trajectory.positions[0], trajectory.times[-1]
    last = np.flatnonzero(trajectory.times >= end - period * (1 + 1e-9))
    moved = trajectory.positions[last] - rest
    largest = float(np.abs(moved).max())
    # motion too small to see is magnified until it spans a share of the plant
    gain = 1.0 if largest == 0 else max(1.0, float(f"{0.08 * np.ptp(rest, axis=0).max() / largest:.1g}"))
    phases = np.unique(np.linspace(0, len(last) - 1, 13).round().astype(int))
    for k, phase in enumerate(phases):
        shade = mpl.colormaps["plasma"](0.9 * k / len(phases))
        _draw_rods(axes, rods, (rest + gain * moved[phase])[:, seen], shade, 0.9)
    radius = np.asarray(rods.edge_radius)[1:]
    _draw_rods(axes, rods, rest[:, seen], REST, 0.5 + 2 * radius / radius.max())
    for node, colour, name in nodes:
        axes.plot(*(rest[node] + gain * moved[:, node])[:, seen].T, color=colour, lw=2, zorder=5)
        axes.plot(*rest[node, seen], "o", color=colour, mec="white", zorder=6, label=f"{name} and its path")
    scale = "" if gain == 1 else f"motion drawn x{gain:g}"
    axes.set(xlabel=f"{'xy'[seen[0]]} [m]", ylabel="z [m]", aspect="equal")
    axes.set_title(f"the last period, dark to light\ngreen: at rest. {scale}", fontsize=9)
    axes.autoscale_view()
    axes.locator_params(axis="x", nbins=4)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, fontsize=8, frameon=False)


def _draw_rods(axes: Any, rods: Rods, flat: Array, colour: Any, width: Any) -> None:
    edges: Any = np.stack([flat[rods.parent[1:]], flat[1:]], axis=1)
    axes.add_collection(LineCollection(edges, colors=colour, linewidths=width, capstyle="round"))


def draw_grip_response(rods: Rods, flowers: NDArray[Any], response: GripMap, title: str) -> Figure:
    """Return a figure: the heat map with the resonances of the held plant, and the plant with its grips.

    White lines: the lowest natural frequencies while the grip is held. Hatched: beyond a limit that Anther keeps.
    Cross: the best of the other cells. In the plant a grip has the colour of its best frequency;
    magenta: the flowers' nodes (F,); star: root.
    """
    figure = Figure(figsize=(12.5, 5.8), layout="constrained")
    varies = np.ptp(response.amplitude) > 0
    spread = np.ptp(rods.nodes, axis=0)
    side = int(np.argmax(spread[:2]))
    narrow = float(np.clip(1.1 * spread[side] / spread[2], 0.45, 1))
    rows = (0.22, 1) if varies else (1e-3, 1)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.9, narrow), height_ratios=rows)
    mean = response.acceleration.mean(axis=-1)
    norm = LogNorm(mean.max() / 1000, mean.max(), clip=True)
    arm = figure.add_subplot(grid[0, 0]) if varies else None
    if arm is not None:
        arm.loglog(response.frequencies, 1e3 * response.amplitude, color="black", lw=1.2)
        arm.set_ylabel("grip [mm]")
        arm.tick_params(labelbottom=False)
        arm.grid(alpha=0.3)
    mesh = _draw_map(figure.add_subplot(grid[1, 0], sharex=arm), response, mean, norm)
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    plant = figure.add_subplot(grid[:, 1])
    _draw_grips(plant, [side, 2], rods, flowers, response, mesh.cmap(norm(mean.max(axis=0))))
    figure.colorbar(mesh, ax=plant, label="mean flower acceleration [m/s²]", extend="min")
    return figure


def _draw_map(chart: Any, response: GripMap, mean: Any, norm: LogNorm) -> Any:
    hertz, height = response.frequencies, 100 * response.distance
    mesh = chart.pcolormesh(np.exp(_borders(np.log(hertz))), _borders(height), mean.T, norm=norm, cmap="inferno")
    for k, resonance in enumerate(response.resonances.T):
        inside = np.where((resonance >= hertz[0]) & (resonance <= hertz[-1]), resonance, np.nan)
        label = "natural frequencies, grip held" if k == 0 else None
        chart.plot(inside, height, ".-", color="white", lw=0.9, ms=2.5, label=label)
    beyond = ~response.allowed.T
    if beyond.any():
        edges = np.exp(_borders(np.log(hertz))), _borders(height)
        grey = np.ma.masked_array(np.ones(beyond.shape), ~beyond)
        chart.pcolor(*edges, grey, cmap="gray", vmin=0, vmax=2, alpha=0.45, hatch="//", edgecolor="#333333", lw=0)
        chart.fill_between([], [], facecolor="#808080", hatch="//", edgecolor="#333333", label="beyond a limit")
    if response.best is not None:
        q, g = response.best
        chart.plot(hertz[q], height[g], "x", color=BEST, ms=11, mew=2.5, label="best within the limits")
    ticks = [f for f in (0.1, 0.2, 0.5, 1, 2, 3, 5, 10, 20, 30, 50, 100, 200) if hertz[0] <= f <= hertz[-1]]
    chart.set(xscale="log", xlabel="frequency [Hz]", ylabel="grip: distance from the root along the plant [cm]")
    chart.set_xticks(ticks, [f"{f:g}" for f in ticks])
    chart.minorticks_off()
    chart.legend(loc="upper left", fontsize=8, facecolor="#555555", labelcolor="white", framealpha=0.9)
    return mesh


def _borders(centres: Array) -> Array:
    """Return the borders of cells around rising centres; a lone cell gets a unit width."""
    if len(centres) == 1:
        return centres[0] + np.array([-0.5, 0.5])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])


def _draw_grips(plot: Any, seen: list[int], rods: Rods, flowers: NDArray[Any], response: GripMap, colours: Any) -> None:
    flat = rods.nodes[:, seen]
    radius = np.asarray(rods.edge_radius)[1:]
    _draw_rods(plot, rods, flat, PALE, 0.8 + 3 * radius / radius.max())
    plot.scatter(*flat[flowers].T, s=24, c=MAGENTA, marker="D", edgecolors="white", lw=0.4, zorder=4, label="observed")
    plot.scatter(*flat[response.grips].T, s=26, c=colours, edgecolors="black", lw=0.3, zorder=5, label="grips")
    if response.best is not None:
        best = flat[response.grips[response.best[1]]]
        plot.plot(*best, "x", color=BEST, ms=11, mew=2.5, zorder=6, label="best grip")
    plot.plot(*flat[0], "*", ms=11, color="black", zorder=6)
    plot.set(xlabel=f"{'xy'[seen[0]]} [m]", ylabel="z [m]", aspect="equal")
    plot.locator_params(axis="x", nbins=4)
    plot.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=8, frameon=False, handletextpad=0.2)
