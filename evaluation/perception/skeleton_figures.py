"""Picture of evaluation/perception/skeletons.py: the ten plants with their skeletons over the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from anther.perception import Cloud, Skeleton, Stem
from anther.plant import Crop
from anther.show import scene
from anther.show.pictures.plant import draw_side
from anther.sim import SimPlant, grow
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.perception.skeleton_truth import AXIS

FRONT = (1, 2, 0)
"""Across, up, depth: the plant as the arm sees it from its base."""


def draw_ten(plants: list[tuple[Crop, int, Path]]) -> Figure:
    """Return the plants (species, seed, folder with what was found) side by side: cloud, skeleton by organ, main stem;
    true stem and branches dashed."""
    figure = Figure(figsize=(15, 7.5), layout="constrained")
    plots = figure.subplots(2, (len(plants) + 1) // 2, sharey=True)
    for (species, seed, folder), plot in zip(plants, plots.flat, strict=False):
        cloud, skeleton = Cloud.load(folder / "cloud.ply"), Skeleton.load(folder / "skeleton.npz")
        draw_side(plot, FRONT, [*scene.cloud(cloud), *scene.organs(skeleton, Stem.load(folder / "stem.npz"))])
        _draw_truth(plot, grow(species, seed, 0.0, USUAL_DISTANCE))
        plot.set(title=f"{species} {seed}", aspect="equal")
        plot.tick_params(labelsize=7)
    return figure


def _draw_truth(plot: Any, plant: SimPlant) -> None:
    for k in np.flatnonzero(np.isin(plant.organ, AXIS)):
        line = np.stack([plant.start[k], plant.end[k]])[:, FRONT[:2]]
        plot.plot(*line.T, color="black", lw=0.8, ls=(0, (2, 2)), zorder=8)
