"""Picture of a dose-response: how many flowers set, over the acceleration they were given, and what was counted."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.stats import beta

from anther.fruit_set import Count, FruitSet

LINE, PRIOR, COUNT = "#c2389a", "#8a8a8a", "#1f4e79"


def draw_fruit_set(learned: FruitSet, prior: FruitSet, species: str) -> Figure:
    """Return a figure: the belief with its 90 % band over the prior's, and each count as a dot.

    A dot stands at the one visit that would have freed as much pollen as the count's visits did, its area is the number
    of flowers, its bar the 90 % interval of a share counted on so many (Jeffreys).
    """
    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    a = np.concatenate([[0.0], np.geomspace(1, 300, 60)])
    for belief, colour, label in ((prior, PRIOR, "before any count"), (learned, LINE, "believed now")):
        median, low, high = np.transpose([belief.probability(float(x)) for x in a])
        axes.fill_between(a, low, high, color=colour, alpha=0.2, lw=0)
        axes.plot(a, median, color=colour, label=label)
    for count in learned.counts:
        _draw_count(axes, learned, count)
    axes.set_xscale("symlog", linthresh=3, linscale=0.5)
    axes.set_xlim(-0.3, 300)
    ticks = (0, 3, 10, 30, 100, 300)
    axes.set_xticks(ticks, [str(t) for t in ticks])
    axes.minorticks_off()
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel("acceleration of the flowers in one visit [m/s²]; 0: no shake")
    axes.set_ylabel("share of flowers that set")
    flowers = sum(c.flowers for c in learned.counts)
    title = f"{species}: {len(learned.counts)} counts, {flowers} flowers; bands: nine in ten"
    axes.set_title(title, fontsize=10, loc="left")
    axes.legend(loc="lower right", fontsize=9)
    axes.grid(alpha=0.3)
    return figure


def _draw_count(axes: Axes, learned: FruitSet, count: Count) -> None:
    freed, exponent = min(learned.freed(count), 0.999), learned.interval("exponent")[0]
    x = learned.interval("half_dose")[0] * (freed / (1 - freed)) ** (1 / exponent)
    low, high = beta.ppf([0.05, 0.95], count.fruit + 0.5, count.flowers - count.fruit + 0.5)
    axes.plot([x, x], [low, high], color=COUNT, lw=0.8, alpha=0.5)
    axes.scatter(x, count.fruit / count.flowers, s=3 * count.flowers, color=COUNT, alpha=0.7, lw=0)
