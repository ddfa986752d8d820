"""What looks wrong with views and cloud: blind views, a plant cut off or left out, masks that hold the ground.

Every check returns a sentence for the user, or nothing. V views, H x W pixels, N points.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.errors import StageFailure
from anther.geometry import Array, Box

RANGE = (0.05, 10.0)
"""Readings outside are no plant's [m]: a D455 measures from 0.3 m, a D405 from 0.09 m (facts: perception)."""
BLIND = 0.3
"""A view is blind when fewer pixels read a depth than this share of what the median view has."""
NEAR, COVERED = 0.4, 0.15
"""Something nearer than this share of the plant's distance blocks a view when it covers this share of the image."""
EDGE, CUT = 0.004, 0.005
"""A plant is cut off when this share of its points lies so near the workspace's faces [m]."""
ONE_SIDE, FEW = 100.0, 4
"""Views within so narrow an arc about the plant see it from one side [degrees]; fewer than so many are few."""
SECOND, SECOND_SIZE = 0.03, 0.08
"""What is left out is worth a word when it has this share of all points and this diagonal [m]."""
SLAB, GROUND_POINTS, GROUND_AREA = 0.01, 0.25, 0.2
"""A layer this thick [m] is ground when it holds this share of the points and of the workspace's area."""


def view_doubts(depth: NDArray[Any], labels: NDArray[Any]) -> tuple[str, ...]:
    """Return which views are blind or blocked, by number.

    Args:
        depth: (V, H, W) [m].
        labels: (V, H, W) of the masks; 0 is not plant.
    """
    thin = depth[:, ::4, ::4]
    usable = (thin > RANGE[0]) & (thin < RANGE[1])
    seen = usable.mean(axis=(1, 2))
    plant = thin[usable & (labels[:, ::4, ::4] > 0)]
    close = NEAR * float(np.median(plant)) if len(plant) else 0.0
    near = ((thin > 0) & (thin < close)).mean(axis=(1, 2))
    blind = [
        f"view {v}: the depth image is blind ({seen[v]:.0%} of it reads {RANGE[0]:g} to {RANGE[1]:g} m)"
        for v in np.flatnonzero(seen < BLIND * np.median(seen))
    ]
    blocked = [
        f"view {v}: something nearer than {close:.2f} m covers {near[v]:.0%} of the image"
        for v in np.flatnonzero(near > COVERED)
    ]
    return (*blind, *blocked)


def coverage_doubts(centre: Array, T_world_cam: Array) -> tuple[str, ...]:
    """Return whether the cameras (V, 4, 4) are few, or on one side only of the plant's centre (3,) [m]."""
    if len(T_world_cam) < FEW:
        return (f"only {len(T_world_cam)} views show the plant: how deep its organs are is half guessed",)
    away = T_world_cam[:, :2, 3] - centre[:2]
    azimuth = np.sort(np.degrees(np.arctan2(away[:, 1], away[:, 0])))
    arc = 360 - float(np.diff(azimuth, append=azimuth[0] + 360).max())
    if arc >= ONE_SIDE:
        return ()
    return (
        f"the views see the plant from one side only, over {arc:.0f} degrees: how deep its organs are is half guessed",
    )


def refuse_ground(points: Array, box: Box) -> None:
    """Refuse points (N, 3) [m] most of which are bench or soil.

    Raises:
        StageFailure: `no_plant_found`, when a level layer holds GROUND_POINTS of the points and spreads over
            GROUND_AREA of the workspace.
    """
    level = np.floor((points[:, 2] - box.lower[2]) / SLAB).astype(np.int64)
    fullest = int(np.argmax(np.bincount(level)))
    within = points[level == fullest]
    cells = np.unique(np.floor(within[:, :2] / SLAB), axis=0)
    area = len(cells) * SLAB**2 / float(np.prod((box.upper - box.lower)[:2]))
    if len(within) >= GROUND_POINTS * len(points) and area >= GROUND_AREA:
        raise StageFailure(
            "no_plant_found",
            f"cloud: {len(within) / len(points):.0%} of what the masks call plant is one level surface over {area:.0%} "
            f"of the workspace, at z = {within[:, 2].mean():.3f} m: bench or soil. Are the masks inverted?",
        )


def cloud_doubts(points: Array, kept: NDArray[np.bool_], box: Box) -> tuple[str, ...]:
    """Return whether the workspace cuts the plant, and what else stands in it.

    Args:
        points: (N, 3) fused points in the workspace [m].
        kept: (N,) which of them are the plant.
        box: the workspace [m].
    """
    return (*_cut(points[kept], box), *_left_out(points, kept))


def _cut(plant: Array, box: Box) -> tuple[str, ...]:
    faces = np.stack([plant - box.lower, box.upper - plant])
    at_edge = (faces < EDGE).mean(axis=1)
    side, axis = np.unravel_index(int(np.argmax(at_edge)), at_edge.shape)
    if at_edge.max() < CUT:
        return ()
    limit = (box.lower, box.upper)[side][axis]
    return (
        f"{at_edge.max():.1%} of the plant's points lie at the workspace's edge {'xyz'[axis]} = {limit:.2f} m: "
        "the plant is cut off there; move it or enlarge the workspace",
    )


def _left_out(points: Array, kept: NDArray[np.bool_]) -> tuple[str, ...]:
    rest = points[~kept]
    if len(rest) < SECOND * len(points):
        return ()
    centre = np.median(rest, axis=0)
    size = float(np.linalg.norm(np.subtract(*np.quantile(rest, [0.9, 0.1], axis=0))))
    if size < SECOND_SIZE:
        return ()
    return (
        f"{len(rest) / len(points):.0%} of the points hang together less with the plant and were left out, around "
        f"x, y, z = {centre[0]:.2f}, {centre[1]:.2f}, {centre[2]:.2f} m: a second plant?",
    )
