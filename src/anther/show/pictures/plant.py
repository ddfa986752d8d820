"""One picture of a plant: cloud, skeleton, main stem, flowers, gripper and grasp, from several sides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator
from scipy.spatial import ConvexHull

from anther.core.geometry import Array
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.pollination.grasp import Grasp
from anther.show import scene
from anther.show.scene import Layer
from anther.show.style import STEM_COLOR, rgb

Sides = tuple[int, int, int]
"""Which world axes go across, up, and into the picture."""
_SIDES: dict[str, Sides] = {"front": (0, 2, 1), "side": (1, 2, 0), "top": (0, 1, 2)}
_DRAWN = (
    "cloud", "supports", *(name for name, _, _ in scene.ORGANS.values()), "skeleton", "flowers", "gripper", "grasp",
)  # fmt: skip
"""Layers of these pictures, the later ones above; the arm would make the plant small."""


def draw_plant(
    cloud: Cloud, skeleton: Skeleton, stem: Stem, grasp: Grasp | None = None, *, flowers: Flowers | None = None
) -> Figure:
    """Return a figure of the plant from the front, the side, the top, and close up around the grasp."""
    layers = [*scene.cloud(cloud), *scene.organs(skeleton, stem)]
    layers += [] if flowers is None else [scene.flowers(flowers)]
    layers += [] if grasp is None else [scene.grasps("grasp", [grasp])]
    return draw_layers(layers, grasp)


def draw_layers(layers: Sequence[Layer], grasp: Grasp | None = None, *, narrow: bool = False) -> Figure:
    """Return a figure of a scene's plant from three sides, and close up around the grasp if there is one.

    Lengths are drawn to scale, axes in metres; the legend says which colour is what. The cloud has its photographed
    colours if there are any. Narrow: for a phone, two by two.
    """
    shown = sorted((x for x in layers if x.shown and x.name in _DRAWN), key=lambda x: _DRAWN.index(x.name))
    views = [*_SIDES.items(), *([("at the grasp", facing(grasp))] if grasp is not None else [])]
    figure = Figure(figsize=(3.6, 6.2) if narrow else (13, 4.7), layout="compressed")
    plots = figure.subplots(2, 2) if narrow else figure.subplots(1, len(views))
    for plot in plots.flat[len(views) :]:
        plot.set_axis_off()
    for (title, axes), plot in zip(views, plots.flat, strict=False):
        draw_side(plot, axes, shown)
        plot.set_title(title)
    if grasp is not None:
        _close_up(plots.flat[len(views) - 1], grasp)
    handles = [Line2D([], [], color=x.colour, lw=4, label=x.name) for x in shown]
    figure.legend(handles=handles, loc="outside lower center", ncols=3 if narrow else len(handles), frameon=False)
    return figure


def facing(grasp: Grasp) -> Sides:
    """Return the side view in which the grasp's approach is seen from its side."""
    return _SIDES["front" if abs(grasp.approach[0]) >= abs(grasp.approach[1]) else "side"]


def draw_side(plot: Axes, axes: Sides, layers: Sequence[Layer]) -> None:
    """Draw layers as they are seen along an axis, to scale."""
    for order, layer in enumerate(layers):
        _draw(plot, axes, layer, order)
    across, up, _ = axes
    plot.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]", aspect="equal")
    plot.autoscale_view()
    for axis in (plot.xaxis, plot.yaxis):
        axis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))


def _draw(plot: Axes, axes: Sides, layer: Layer, order: int) -> None:
    flat, style = list(axes[:2]), {"color": layer.colour, "zorder": order + 2.0}
    if layer.points is not None:
        _draw_points(plot, axes, layer)
    for solid in layer.solids:
        corners = np.asarray(solid.vertices)[:, flat]
        hull = corners[ConvexHull(corners).vertices]
        plot.add_patch(Polygon(hull, alpha=0.4, lw=0.8, ec=(*(c / 255 for c in rgb(layer.colour)), 1), **style))
    if layer.lines is not None:
        lines: Any = layer.lines[:, :, flat]
        plot.add_collection(LineCollection(lines, linewidths=0.3 + 420.0 * layer.width, capstyle="round", **style))
    if layer.balls is not None:
        plot.scatter(*layer.balls[:, flat].T, s=32, edgecolors="black", lw=0.5, **style)
    for start, end in () if layer.arrows is None else layer.arrows[:, :, flat]:
        arrow = {"arrowstyle": "-|>", "color": layer.colour, "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
        plot.annotate("", xy=end, xytext=start, arrowprops=arrow, zorder=style["zorder"])


def _draw_points(plot: Axes, axes: Sides, layer: Layer) -> None:
    """Draw points as an image, the nearest last: Matplotlib takes half a second for so many of any colour."""
    points: Array = layer.points  # type: ignore[assignment]
    order, flat = np.argsort(points[:, axes[2]]), points[:, axes[:2]]
    low, edge = flat.min(axis=0), max(float(np.ptp(flat, axis=0).max()), 1e-9) / 400  # of a pixel: as fine as shown
    across, up = ((flat[order] - low) / edge).astype(np.int64).T
    image = np.zeros((up.max() + 1, across.max() + 1, 4), dtype=np.uint8)
    image[up, across, :3] = rgb(layer.colour) if layer.colours is None else layer.colours[order]
    image[up, across, 3] = 160
    (right, top), (left, bottom) = low + edge * np.array(image.shape[1::-1]), low
    drawn = plot.imshow(image, extent=(left, right, bottom, top), origin="lower", interpolation="nearest")
    drawn.sticky_edges.x[:], drawn.sticky_edges.y[:] = [], []


def _close_up(plot: Axes, grasp: Grasp) -> None:
    """Look at the surroundings of a grasp, with the stem's thickness as it was measured there."""
    flat = list(facing(grasp)[:2])
    half = max(12 * grasp.stem_diameter, 0.05)
    centre, along = grasp.point[flat], grasp.tangent[flat]
    plot.set(xlim=centre[0] + np.array([-half, half]), ylim=centre[1] + np.array([-half, half]))
    aside = grasp.stem_diameter / 2 * np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
    for sign in (-1, 1):
        ends = centre + sign * aside + 2 * grasp.stem_diameter * np.array([[-1], [1]]) * along
        plot.plot(*ends.T, color=STEM_COLOR, lw=1, ls="--", zorder=20)
    plot.set_title(f"at the grasp:\n{1e3 * grasp.stem_diameter:.1f} mm (dashed)", fontsize=9)
