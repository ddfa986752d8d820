"""One picture of a plant: cloud, skeleton, main stem, flowers and grasp, from several sides."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from anther.core.geometry import Array
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.skeleton import Skeleton
from anther.perception.stem import BRANCH, LEAF, STEM, TRUSS, Stem
from anther.pollination.grasp import Grasp

STEM_COLOR, BRANCH_COLOR, GRASP_COLOR, FLOWER_COLOR, LEAF_COLOR = "#7a3b12", "#1f6fb2", "#c2389a", "#e0a100", "#9db89f"
ORGAN_COLORS = {STEM: STEM_COLOR, BRANCH: BRANCH_COLOR, TRUSS: "#d05a00", LEAF: "#2e8540"}

_SIDES = {"front (x, z)": (0, 2, 1), "side (y, z)": (1, 2, 0), "top (x, y)": (0, 1, 2)}
_MOST_POINTS = 40_000


def draw_plant(
    cloud: Cloud, skeleton: Skeleton, stem: Stem, grasp: Grasp | None = None, *, flowers: Flowers | None = None
) -> Figure:
    """Return a figure of the plant from the front, the side, the top, and close up around the grasp.

    Lengths are drawn to scale, axes in metres. Grey-green or photographed colours: cloud; brown: main stem, with dots
    where something leaves it; blue: branches; orange: trusses; green: leaves; magenta: the gripper's approach and its
    closing line; yellow: flowers; star: root.
    """
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    views = [*_SIDES.items(), *([("at the grasp", _facing(grasp))] if grasp is not None else [])]
    sizes = [max(float(np.ptp(cloud.points[:, axes[0]])), 1e-6) for _, axes in _SIDES.items()]
    for (title, axes), plot in zip(views, np.atleast_1d(figure.subplots(1, len(views))), strict=True):
        draw_side(plot, axes, cloud, skeleton, stem)
        if flowers is not None and len(flowers.positions):
            plot.scatter(*flowers.positions[:, axes[:2]].T, s=45, c=FLOWER_COLOR, edgecolors="black", lw=0.6, zorder=6)
        if grasp is not None:
            draw_grasp(plot, axes, grasp, 0.12 * max(sizes))
        plot.set(title=title, aspect="equal")
        plot.tick_params(labelsize=7)
    if grasp is not None:
        _close_up(figure.axes[-1], grasp, skeleton, stem)
    return figure


def _facing(grasp: Grasp) -> tuple[int, int, int]:
    """Return the side view in which the grasp's approach is seen from its side."""
    along_x = abs(grasp.approach[0]) >= abs(grasp.approach[1])
    return (0, 2, 1) if along_x else (1, 2, 0)


def draw_side(plot: Axes, axes: tuple[int, int, int], cloud: Cloud, skeleton: Skeleton, stem: Stem) -> None:
    across, up, depth = axes
    some = np.random.default_rng(0).permutation(len(cloud.points))[:_MOST_POINTS]
    some = some[np.argsort(cloud.points[some, depth])]
    color = LEAF_COLOR if cloud.colors is None else cloud.colors[some] / 255
    plot.scatter(*cloud.points[some][:, [across, up]].T, s=0.4, c=color, lw=0, alpha=0.6, rasterized=True)
    flat = skeleton.nodes[:, [across, up]]
    lines: Any = flat[skeleton.edges]
    colors = [ORGAN_COLORS[int(organ)] for organ in stem.organ[1:]]
    plot.add_collection(LineCollection(lines, colors=colors, linewidths=1.0, zorder=3))
    plot.plot(*flat[stem.node_ids].T, color=STEM_COLOR, lw=2.6, zorder=4)
    plot.plot(*flat[stem.node_ids[stem.attachments]].T, "o", ms=3, mfc="white", mec=STEM_COLOR, mew=0.8, zorder=5)
    plot.plot(*flat[0], "*", ms=11, color="black", zorder=6)


def draw_grasp(plot: Axes, axes: tuple[int, int, int], grasp: Grasp, length: float) -> None:
    keep = list(axes[:2])
    start, end = (grasp.point - grasp.approach * length)[keep], grasp.point[keep]
    arrow = {"arrowstyle": "-|>", "color": GRASP_COLOR, "lw": 2.2, "shrinkA": 0, "shrinkB": 0}
    plot.annotate("", xy=(end[0], end[1]), xytext=(start[0], start[1]), arrowprops=arrow, zorder=7)
    fingers: Array = np.array(grasp.T_world_flange[:3, 1])
    ends = np.stack([grasp.point - fingers * 0.3 * length, grasp.point + fingers * 0.3 * length])[:, keep]
    plot.plot(*ends.T, color=GRASP_COLOR, lw=3.5, solid_capstyle="butt", zorder=7)


def _close_up(plot: Axes, grasp: Grasp, skeleton: Skeleton, stem: Stem) -> None:
    across, up, _ = _facing(grasp)
    half = max(12 * grasp.stem_diameter, 0.12 * float(stem.arc_length[-1]), 1e-4)
    centre = grasp.point
    plot.set_xlim(centre[across] - half, centre[across] + half)
    plot.set_ylim(centre[up] - half, centre[up] + half)
    flat = skeleton.nodes[stem.node_ids][:, [across, up]]
    radius = skeleton.radius[stem.node_ids]
    step = np.gradient(flat, axis=0)
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.maximum(np.linalg.norm(step, axis=1), 1e-12)[:, None]
    for sign in (-1, 1):
        plot.plot(*(flat + sign * normal * radius[:, None]).T, color=STEM_COLOR, lw=1, ls="--", zorder=4)
    plot.set_title(f"at the grasp: {grasp.stem_diameter * 1e3:.1f} mm (dashed)")
