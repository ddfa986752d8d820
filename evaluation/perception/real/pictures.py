"""Pictures of real plants: points faint, skeleton by organ, main stem thick, grasp marked, to scale."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from PIL import Image

from anther.core import Array
from anther.perception import Cloud, Stem
from anther.perception.stem import ORGAN_NAMES, STEM
from anther.show.scene import ORGAN_COLORS
from anther.show.style import BRANCH_COLOR, GRASP_COLOR, STEM_COLOR
from evaluation.perception.real.answers import Answer, Seen
from evaluation.perception.real.plants import Reference

mpl.use("Agg")
import matplotlib.pyplot as plt

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PUBLISHED_COLOUR = "#d62728"
STEM_LABEL, LEAF_LABEL = "#a8875f", "#a5cdaa"
MOST_POINTS = 25_000
FRONT, SIDE = (0, 2), (1, 2)
DPI, COLOURS = 110, 96
mpl.rcParams["figure.dpi"] = DPI

Sides = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Shown:
    """A plant with what every method said of it; is_stem (N,) where its points are labelled."""

    name: str
    cloud: Cloud
    answers: dict[str, Answer | str]
    is_stem: NDArray[np.bool_] | None = None


def draw_methods(plants: list[Shown]) -> Figure:
    """Return one row a plant, one column a method: its skeleton, main stem and grasp, or why there is none."""
    methods = list(plants[0].answers)
    figure, axes = plt.subplots(len(plants), len(methods), figsize=(3 * len(methods), 3 * len(plants)), squeeze=False)
    for row, plant in zip(axes, plants, strict=True):
        sides = _broad_side(plant.cloud.points)
        colours = None if plant.is_stem is None else np.where(plant.is_stem, STEM_LABEL, LEAF_LABEL)
        for plot, (method, answer) in zip(row, plant.answers.items(), strict=True):
            _points(plot, plant.cloud, sides, colours)
            if isinstance(answer, str):
                plot.text(0.5, 0.5, answer, transform=plot.transAxes, ha="center", wrap=True, fontsize=7)
            else:
                _graph(plot, answer.nodes, answer.edges, sides, color=BRANCH_COLOR, lw=0.7)
                _graph(plot, answer.nodes, answer.stem, sides, color=STEM_COLOR, lw=2.4)
                plot.plot(*answer.grasp[list(sides)], "o", ms=9, mfc="none", mec=GRASP_COLOR, mew=2)
            _finish(plot, plant.cloud, sides, f"{method.replace('_', ' ')}: {plant.name}")
    figure.tight_layout()
    return figure


def draw_references(plants: list[tuple[Reference, Seen]]) -> Figure:
    """Return Anther's skeletons beside the published graphs, front and side."""
    figure, axes = plt.subplots(2, len(plants), figsize=(5 * len(plants), 11), squeeze=False)
    for column, (plant, seen) in zip(axes.T, plants, strict=True):
        for plot, sides in zip(column, (FRONT, SIDE), strict=True):
            _points(plot, plant.cloud, sides, None)
            _organs(plot, seen, sides)
            _graph(plot, plant.nodes, plant.edges, sides, color=PUBLISHED_COLOUR, lw=1.6, ls="--")
            plot.plot(*plant.nodes[:, list(sides)].T, "o", ms=4, color=PUBLISHED_COLOUR)
            _finish(plot, plant.cloud, sides, plant.name)
    published = Line2D([], [], color=PUBLISHED_COLOUR, ls="--", marker="o", label="published graph")
    figure.legend(handles=[*_legend(plants[0][1].stem), published], loc="lower center", ncols=8, frameon=False)
    figure.tight_layout(rect=(0, 0.03, 1, 1))
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a picture of few colours, which is a small file, and forget the figure."""
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())  # pyright: ignore[reportAttributeAccessIssue]
    Image.fromarray(pixels).convert("RGB").quantize(COLOURS).save(path, optimize=True)
    plt.close(figure)


def _broad_side(points: Array) -> Sides:
    """Return the side view in which the plant is broader."""
    return FRONT if np.ptp(points[:, 0]) >= np.ptp(points[:, 1]) else SIDE


def _points(plot: Axes, cloud: Cloud, sides: Sides, colours: NDArray[Any] | None, size: float = 1.2) -> None:
    some = np.random.default_rng(0).permutation(len(cloud.points))[:MOST_POINTS]
    if colours is None:
        colours = np.full(len(cloud.points), "#8f9c8f") if cloud.colors is None else cloud.colors / 255
    at = cloud.points[some][:, list(sides)]
    plot.scatter(*at.T, s=size, c=colours[some], lw=0, alpha=0.5, rasterized=True)


def _graph(plot: Axes, nodes: Array, edges: NDArray[Any], sides: Sides, **style: Any) -> None:
    lines: Any = nodes[:, list(sides)][edges]
    collection = LineCollection(lines, capstyle="round", **style)
    plot.add_collection(collection)


def _organs(plot: Axes, seen: Seen, sides: Sides) -> None:
    """Draw the skeleton by organ (an edge has that of its lower end), junctions on the stem, and the grasp."""
    nodes, edges = seen.skeleton.nodes, seen.skeleton.edges
    organ = seen.stem.organ[edges[:, 1]]
    for kind, colour in ORGAN_COLORS.items():
        width = 3.0 if kind == STEM else 1.3
        _graph(plot, nodes, edges[organ == kind], sides, color=colour, lw=width, zorder=4 if kind == STEM else 3)
    plot.plot(*nodes[0, list(sides)], "*", ms=12, color="black", zorder=6)
    joints = nodes[seen.stem.node_ids[seen.stem.attachments]]
    plot.plot(*joints[:, list(sides)].T, "o", ms=3.5, mfc="white", mec=STEM_COLOR, zorder=5)
    tip, length = seen.grasp.point, 0.09 * np.ptp(seen.cloud.points, axis=0).max()
    start = (tip - length * seen.grasp.approach)[list(sides)]
    arrow = {"arrowstyle": "-|>", "color": GRASP_COLOR, "lw": 2.2, "shrinkA": 0, "shrinkB": 0}
    plot.annotate("", xy=tuple(tip[list(sides)]), xytext=tuple(start), arrowprops=arrow, zorder=7)
    plot.plot(*tip[list(sides)], "o", ms=9, mfc="none", mec=GRASP_COLOR, mew=2, zorder=7)


def _finish(plot: Axes, cloud: Cloud, sides: Sides, title: str) -> None:
    low, high = np.quantile(cloud.points[:, list(sides)], [0.0005, 0.9995], axis=0)
    margin = 0.06 * (high - low).max()
    plot.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - 2 * margin, high[1] + margin), aspect="equal")
    plot.set_title(title, fontsize=8)
    plot.set_axis_off()
    _scale_bar(plot, float((high - low).max()))


def _scale_bar(plot: Axes, extent: float) -> None:
    """Draw a bar of a round length, about a fifth of the extent [m], at the lower left; an old bar goes."""
    for old in [artist for artist in (*plot.lines, *plot.texts) if artist.get_gid() == "scale"]:
        old.remove()
    length = max(x for x in (m * 10.0**e for e in range(-4, 2) for m in (1, 2, 5)) if x <= extent / 4)
    x, y = plot.get_xlim()[0], plot.get_ylim()[0]
    plot.plot([x, x + length], [y, y], color="black", lw=3, solid_capstyle="butt", gid="scale", clip_on=False)
    unit, per_metre = ("mm", 1e3) if length < 0.1 else ("cm", 1e2) if length < 1 else ("m", 1)
    text = f"{length * per_metre:g} {unit}"
    plot.text(x, y, text, va="bottom", fontsize=8, gid="scale")


def _legend(stem: Stem) -> list[Line2D]:
    there = [kind for kind in ORGAN_COLORS if np.any(stem.organ == kind)]
    lines = [Line2D([], [], color=ORGAN_COLORS[k], lw=3 if k == STEM else 1.3, label=ORGAN_NAMES[k]) for k in there]
    grasp = Line2D([], [], marker="o", ls="", mfc="none", mec=GRASP_COLOR, mew=2, ms=9, label="grasp, approach")
    return [*lines, grasp, Line2D([], [], marker="*", ls="", color="black", ms=11, label="root")]
