"""The figure of experiments/learning.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

COLOURS = {"facts": "#8a8f8c", "crop": "#2f7d4f", "plant": "#d9772b"}
LABELS = {"facts": "facts only", "crop": "taught by the plants before", "plant": "second visit, own first shake"}


def draw(done: Mapping[str, Sequence[Sequence[Any]]]) -> Figure:
    """Return a row of three panels a crop: prediction error, what is delivered, and the gain that is learned."""
    figure = Figure(figsize=(12, 3.3 * len(done)), layout="constrained")
    FigureCanvasAgg(figure)
    for panels, (crop, rows) in zip(figure.subplots(len(done), 3, squeeze=False), done.items(), strict=True):
        order = np.arange(1, len(rows) + 1)
        for k, arm in enumerate(COLOURS):
            visits = [row[k] for row in rows]
            _series(panels[0], order, [_error(v) for v in visits], arm)
            _series(panels[1], order, [100 * v.freed if v.true else np.nan for v in visits], arm)
        _gain(panels[2], order, [row[1] for row in rows])
        panels[0].set(ylabel="|ln(true / predicted)| of a flower", title=f"{crop}: prediction error", ylim=(0, None))
        panels[1].set(ylabel="flowers that set because of it [%]", title="dose delivered", ylim=(0, None))
        panels[2].set(yscale="log", ylabel="true / modelled amplitude", title="belief about the gain (band: 90 %)")
        panels[2].set_yticks([0.25, 0.5, 1, 2, 4], ["1/4", "1/2", "1", "2", "4"])
        panels[2].minorticks_off()
        for axes in panels:
            axes.set_xlabel("plant")
            axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].legend(frameon=False, fontsize=8)
    return figure


def _series(axes: Any, order: Any, values: list[float], arm: str) -> None:
    """Draw each plant, and the mean of it and the four before."""
    mean = [
        np.nanmean(values[max(i - 4, 0) : i + 1]) if np.isfinite(values[: i + 1]).any() else np.nan
        for i in range(len(values))
    ]
    axes.plot(order, values, ".", color=COLOURS[arm], ms=5, alpha=0.6)
    axes.plot(order, mean, color=COLOURS[arm], lw=1.6, label=LABELS[arm])


def _error(visit: Any) -> float:
    if not visit.true:
        return float("nan")
    return float(np.mean(np.abs(np.log(np.array(visit.true) / np.array(visit.predicted)))))


def _gain(axes: Any, order: Any, visits: Sequence[Any]) -> None:
    """Draw the belief before each plant, and what the plant then turned out to have."""
    before = np.array([v.before["response_gain"] for v in visits])
    spread = np.array([v.before["response_spread"] for v in visits])
    axes.fill_between(order, before * np.exp(-1.645 * spread), before * np.exp(1.645 * spread), color="#cfe3d6", lw=0)
    axes.plot(order, before, color=COLOURS["crop"], lw=1.6)
    for x, v in zip(order, visits, strict=True):
        if v.true:
            ratio = np.exp(np.mean(np.log(np.array(v.true) / np.array(v.predicted)))) * v.before["response_gain"]
            axes.plot(x, ratio, "o", mfc="none", color="#1d2a22", ms=4)
