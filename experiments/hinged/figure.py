"""The figure of hinged_plant.py: the plants, and how both codes' responses converge."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from hinged.plants import ComplexArray, Plant, cut

mpl.use("Agg")
import matplotlib.pyplot as plt

COLOURS = ("tab:blue", "tab:orange", "tab:green")


def draw(
    path: Path, plants: list[Plant], errors: dict[str, dict[str, dict[int, NDArray[Any]]]], hertz: tuple[float, ...]
) -> None:
    """Draw the plants above and their convergence below.

    Args:
        path: PNG to write.
        plants: one column each.
        errors: of each plant, under "rods" and "hinges", by edges per 0.5 m, the worst tip's error (Q,).
        hertz: (Q,) frequencies.
    """
    figure = plt.figure(figsize=(11, 7.2), layout="constrained")
    grid = figure.add_gridspec(2, len(plants), height_ratios=(1, 1.1))
    for k, plant in enumerate(plants):
        _draw_plant(figure.add_subplot(grid[0, k], projection="3d"), plant)
        axes = figure.add_subplot(grid[1, k])
        _draw_convergence(axes, errors[plant.name], hertz)
        if k == 0:
            axes.set_ylabel("error of the worst tip (of its amplitude)")
            axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_plant(axes: Any, plant: Plant) -> None:
    tree = cut(plant, 40)
    for j in range(1, len(tree.nodes)):
        x, y, z = tree.nodes[[tree.parent[j], j]].T
        axes.plot(x, y, z, color="tab:green", lw=1e3 * tree.radius[j])
    grip, way = tree.nodes[tree.grip], 0.07 * plant.axis
    axes.quiver(*(grip - way), *(2 * way), color="tab:red", lw=1.5, arrow_length_ratio=0.2)
    axes.scatter(*tree.nodes[tree.tips].T, color="k", s=12)
    axes.set(xlim=(-0.16, 0.16), ylim=(-0.16, 0.16), zlim=(0, 0.5), xticks=[], yticks=[], zticks=[0, 0.25, 0.5])
    axes.set_box_aspect((0.32, 0.32, 0.5), zoom=1.02)
    axes.view_init(elev=12, azim=-70)
    axes.set_title(plant.name.replace("_", " "), y=1.03)


def _draw_convergence(axes: Any, errors: dict[str, dict[int, NDArray[Any]]], hertz: tuple[float, ...]) -> None:
    for style, (code, by_mesh) in zip(("o-", "s--"), errors.items(), strict=True):
        meshes = np.array(sorted(by_mesh))
        for q, (f, colour) in enumerate(zip(hertz, COLOURS, strict=True)):
            values = [by_mesh[int(n)][q] for n in meshes]
            axes.loglog(meshes, values, style, color=colour, ms=4, lw=1.2, label=f"{code}, {f:g} Hz")
    axes.axhline(0.03, color="0.4", lw=0.8, ls=":")
    axes.set(xlabel="edges per 0.5 m", ylim=(1e-5, 3))
    axes.set_xticks([10, 20, 40, 80, 160, 320], ["10", "20", "40", "80", "160", "320"])
    axes.minorticks_off()
    axes.grid(alpha=0.3)


def worst_error(response: ComplexArray, truth: ComplexArray) -> NDArray[Any]:
    """Return (Q,) the largest |difference| / |truth| over the tips of responses (Q, T, 3)."""
    return np.max(np.linalg.norm(response - truth, axis=2) / np.linalg.norm(truth, axis=2), axis=1)
