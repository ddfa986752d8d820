"""Picture of a response map: flower acceleration over grip height and frequency, beside the plant that is gripped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from anther.elastic_rod import Rods
from anther.geometry import Array

MAGENTA = "#c2389a"
DECADES = 3.0
"""What the colours span below the largest value; less is drawn as the darkest."""


@dataclass(frozen=True, slots=True, eq=False)
class GripResponse:
    """Steady motion of F flowers when the plant is shaken at one of G grips with one of Q frequencies.

    Attributes:
        frequencies: (Q,) [Hz].
        grips: (G,) nodes, by their distance from the root.
        distance: (G,) that distance along the plant [m].
        amplitude: (Q,) grip amplitude [m].
        direction: (Q, G, 3) shake direction.
        ratio: (Q, G, F) flower amplitude (semi-major axis of its path) over grip amplitude [-].
        resonances: (G, K) lowest natural frequencies while the grip is held [Hz].
    """

    frequencies: Array
    grips: NDArray[Any]
    distance: Array
    amplitude: Array
    direction: Array
    ratio: Array
    resonances: Array

    @property
    def acceleration(self) -> Array:
        """(Q, G, F) peak acceleration of each flower [m/s^2]."""
        return self.ratio * (self.amplitude * (2 * np.pi * self.frequencies) ** 2)[:, None, None]

    @property
    def best(self) -> tuple[int, int]:
        """(q, g) of the largest mean acceleration."""
        mean = self.acceleration.mean(axis=-1)
        q, g = np.unravel_index(int(np.argmax(mean)), mean.shape)
        return int(q), int(g)


def draw_response_map(rods: Rods, flowers: NDArray[Any], response: GripResponse, title: str) -> Figure:
    """Return a figure: the heat map with the resonances of the held plant, and the plant with its grips.

    White lines: the lowest natural frequencies while the grip is held. Cross: the best cell. In the plant a grip has
    the colour of its best frequency; magenta: the flowers; star: root.

    Args:
        rods: the plant.
        flowers: (F,) observed nodes.
        response: the map.
        title: what the colours mean.
    """
    figure = Figure(figsize=(12.5, 5.8), layout="constrained")
    FigureCanvasAgg(figure)
    varies = np.ptp(response.amplitude) > 0
    spread = np.ptp(rods.nodes, axis=0)
    side = int(np.argmax(spread[:2]))
    narrow = float(np.clip(1.1 * spread[side] / spread[2], 0.45, 1))
    rows = (0.22, 1) if varies else (1e-3, 1)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.9, narrow), height_ratios=rows)
    mean = response.acceleration.mean(axis=-1)
    norm = LogNorm(mean.max() * 10**-DECADES, mean.max(), clip=True)
    arm = figure.add_subplot(grid[0, 0]) if varies else None
    if arm is not None:
        arm.loglog(response.frequencies, 1e3 * response.amplitude, color="black", lw=1.2)
        arm.set_ylabel("grip [mm]")
        arm.tick_params(labelbottom=False)
        arm.grid(alpha=0.3)
    chart = figure.add_subplot(grid[1, 0], sharex=arm)
    mesh = _draw_map(chart, response, mean, norm)
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    plant = figure.add_subplot(grid[:, 1])
    _draw_plant(plant, side, rods, flowers, response, mesh.cmap(norm(mean.max(axis=0))))
    figure.colorbar(mesh, ax=plant, label="mean flower acceleration [m/s²]", extend="min")
    return figure


def _draw_map(chart: Any, response: GripResponse, mean: Any, norm: LogNorm) -> Any:
    hertz, height = response.frequencies, 100 * response.distance
    mesh = chart.pcolormesh(_edges(np.log(hertz), np.exp), _edges(height), mean.T, norm=norm, cmap="inferno")
    for k, resonance in enumerate(response.resonances.T):
        inside = np.where((resonance >= hertz[0]) & (resonance <= hertz[-1]), resonance, np.nan)
        label = "natural frequencies, grip held" if k == 0 else None
        chart.plot(inside, height, ".-", color="white", lw=0.9, ms=2.5, label=label)
    q, g = response.best
    chart.plot(hertz[q], height[g], "x", color="deepskyblue", ms=11, mew=2.5, label="best")
    ticks = [f for f in (0.1, 0.2, 0.5, 1, 2, 3, 5, 10, 20, 30, 50, 100, 200) if hertz[0] <= f <= hertz[-1]]
    chart.set(xscale="log", xlabel="frequency [Hz]", ylabel="grip: distance from the root along the plant [cm]")
    chart.set_xticks(ticks, [f"{f:g}" for f in ticks])
    chart.minorticks_off()
    chart.legend(loc="upper left", fontsize=8, facecolor="#555555", labelcolor="white", framealpha=0.9)
    return mesh


def _edges(centres: Any, back: Any = lambda x: x) -> Any:
    """Return the borders of cells around rising centres; a lone cell gets a unit width."""
    if len(centres) == 1:
        return back(np.array([centres[0] - 0.5, centres[0] + 0.5]))
    middle = (centres[1:] + centres[:-1]) / 2
    return back(np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]]))


def _draw_plant(plot: Any, side: int, rods: Rods, flowers: NDArray[Any], response: GripResponse, colours: Any) -> None:
    flat = rods.nodes[:, [side, 2]]
    radius = np.asarray(rods.edge_radius)[1:]
    lines: Any = np.stack([flat[rods.parent[1:]], flat[1:]], axis=1)
    plot.add_collection(LineCollection(lines, colors="#8aa58c", linewidths=0.8 + 3 * radius / radius.max()))
    plot.scatter(*flat[flowers].T, s=24, c=MAGENTA, marker="D", edgecolors="white", lw=0.4, zorder=4, label="observed")
    plot.scatter(*flat[response.grips].T, s=26, c=colours, edgecolors="black", lw=0.3, zorder=5, label="grips")
    best = flat[response.grips[response.best[1]]]
    plot.plot(*best, "x", color="deepskyblue", ms=11, mew=2.5, zorder=6, label="best grip")
    plot.plot(*flat[0], "*", ms=11, color="black", zorder=6)
    plot.set(xlabel=f"{'xy'[side]} [m]", ylabel="z [m]", aspect="equal")
    plot.locator_params(axis="x", nbins=4)
    plot.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=8, frameon=False, handletextpad=0.2)
