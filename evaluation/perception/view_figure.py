"""Picture of evaluation/perception/views.py: quality against the number of views, and against the seconds they take."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

SHOWN = ("stem_error_median_mm", "stem_error_p95_mm", "recall_5mm", "flower_recall")
CHOICES = {"fixed": ("evenly spread", "C0", "o-"), "narrow": ("evenly spread within 75°", "C2", "^-")}

Rows = list[dict[str, dict[str, Any]]]


def draw(rows: Rows, titles: dict[str, str]) -> Figure:
    """Return a column per metric: means over the plants, and bars of one standard error."""
    figure = Figure(figsize=(14, 6.5), layout="constrained")
    plots = figure.subplots(2, len(SHOWN), sharey="col")
    for metric, column in zip(SHOWN, plots.T, strict=True):
        for choice in CHOICES:
            _line(column[0], rows, choice, metric, by_time=False)
            _line(column[1], rows, choice, metric, by_time=True)
        column[0].set(title=titles[metric], xlabel="views")
        column[1].set(title=titles[metric], xlabel="capture: motion and stops [s]")
    for plot in plots.flat:
        plot.grid(alpha=0.3)
        plot.set_xlim(left=0)
        plot.set_ylim(0, 1.05 if "recall" in plot.get_title() else None)
    plots[0, 2].legend(loc="lower right")
    return figure


def _line(plot: Axes, rows: Rows, choice: str, metric: str, *, by_time: bool) -> None:
    """Draw one choice's values over its counts or seconds."""
    label, colour, style = CHOICES[choice]
    names = [name for name in rows[0] if name.rsplit("_", 1)[0] == choice]
    values = [[row[name][metric] for row in rows if metric in row[name]] for name in names]
    counts = [int(name.rsplit("_", 1)[1]) for name in names]
    seconds = [np.mean([row[name]["capture_s"] for row in rows if "capture_s" in row[name]]) for name in names]
    error = [np.std(v) / np.sqrt(len(v)) for v in values]
    plot.errorbar(
        seconds if by_time else counts,
        [np.mean(v) for v in values],
        error,
        fmt=style,
        color=colour,
        label=label,
        capsize=2,
        markersize=5,
    )
