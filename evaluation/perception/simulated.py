"""Simulated plants as `anther trial` sees them, and what perception makes of them."""

from __future__ import annotations

import time
from dataclasses import dataclass

from anther.perception import Capture, Cloud, Flowers, Skeleton, Stem, flowers, masks, skeletonize, stem
from anther.perception import fuse as fused
from anther.plant import Crop
from anther.robot.arm.views import Params as ViewParams
from anther.sim import CaptureTruth, SimPlant, grow, layout, photograph, views_at
from anther.sim.simulated_cell import USUAL_DISTANCE

TEN: list[tuple[Crop, int]] = [*(("tomato", k) for k in range(2)), *(("pepper", k) for k in range(8))]
"""As many as in the paper; nobody looked at them while parameters were chosen."""
DEVELOPMENT: list[tuple[Crop, int]] = [*(("tomato", 10 + k) for k in range(4)), *(("pepper", 10 + k) for k in range(6))]
"""Ten others, on which parameters were chosen."""
BOX = layout(USUAL_DISTANCE).workspace


def take(species: Crop, seed: int, views: int = 30) -> tuple[SimPlant, Capture, CaptureTruth]:
    """Grow a plant in the cell and see it as `anther trial` does."""
    joints = views_at(USUAL_DISTANCE, ViewParams(count=views)).joints
    plant = grow(species, seed, 0.0, USUAL_DISTANCE)
    return plant, *photograph(plant, joints, seed)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What perception made of some views, and the processor time and the wall time it took [s]."""

    cloud: Cloud
    tree: Skeleton
    main: Stem
    found: Flowers
    seconds: float
    wall: float


def perceive(capture: Capture) -> Seen:
    """Run masks, cloud, skeleton, stem and flowers."""
    begin, wall = time.process_time(), time.perf_counter()
    cloud = fused(capture, masks.segment(capture, BOX), BOX)
    found = find(cloud)
    return Seen(cloud, *found, time.process_time() - begin, time.perf_counter() - wall)


def find(cloud: Cloud) -> tuple[Skeleton, Stem, Flowers]:
    """Return skeleton, stem and flowers of a cloud."""
    tree = skeletonize(cloud)
    main = stem.find_stem(tree, flowers_at=flowers.flower_centres(cloud))
    return tree, main, flowers.find_flowers(cloud, tree, main)
