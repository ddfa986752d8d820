"""Picture of a shake plan: the response map with the choice, how close each limit is, what each flower should do."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from anther.pictures.report import GREEN, INK, MAGENTA, draw_response_map
from anther.vibration import ShakePlan


def draw_plan(plan: ShakePlan) -> Figure:
    """Return a figure of three panels."""
    figure = Figure(figsize=(11, 7.2), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1, 1.2))
    draw_response_map(figure, figure.add_subplot(grid[0, :]), plan)
    _draw_limits(figure.add_subplot(grid[1, 0]), plan)
    _draw_flowers(figure.add_subplot(grid[1, 1]), plan)
    figure.suptitle(
        f"{1e3 * plan.amplitude:.2g} mm at {plan.frequency:.3g} Hz, {plan.duration:.2g} s, held "
        f"{100 * plan.grasp.arc_length:.0f} cm up the stem",
        x=0.01,
        ha="left",
    )
    return figure


def _draw_limits(axes: Any, plan: ShakePlan) -> None:
    names = [name.split(" [")[0] for name, *_ in plan.limits][::-1]
    shares = [100 * share for *_, share in plan.limits][::-1]
    axes.barh(names, shares, color=[MAGENTA if share > 90 else GREEN for share in shares])
    axes.axvline(100, color=INK, lw=1)
    axes.set(xlabel="used of what is allowed [%]", xlim=(0, 108))


def _draw_flowers(axes: Any, plan: ShakePlan) -> None:
    order = np.argsort(-plan.predicted_acceleration)
    middle, span = plan.predicted_acceleration[order], plan.predicted_acceleration_interval[order]
    error = np.abs(span.T - middle)
    index = np.arange(len(middle))
    axes.errorbar(index, middle, error, fmt="o", color=GREEN, ecolor=INK, capsize=3, lw=1)
    axes.set(xlabel="flower, by its acceleration", ylabel="predicted peak\nacceleration [m/s²]", ylim=(0, None))
    axes.set_xticks(index, [str(k + 1) for k in order])
