"""Where an arm is in space: balls on its links, gripper, fingers and wrist camera, for checks against boxes."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from anther.arm.model import ArmModel, Capsule, Solid
from anther.geometry import Array

SPACING = 0.02  # m between balls, so that a box larger than that cannot slip between them


def outline(arm: ArmModel, q: ArrayLike) -> Array:
    """Return balls (..., S, 4) for joints (..., J) [rad]: centre in the base frame and radius [m].

    A link is its capsules' axes in balls of their radius; gripper, open fingers and camera are points on their boxes.
    They fill the shapes that `collision` plans with and never stand out of them. Base and riders are left out.
    """
    poses = arm.link_poses(q)
    parts = []
    for i, balls in enumerate(_balls(arm)):
        pose = poses[..., i, None, :, :]
        centres = (pose[..., :3, :3] @ balls[:, :3, None])[..., 0] + pose[..., :3, 3]
        radii = np.broadcast_to(balls[:, 3:], (*centres.shape[:-1], 1))
        parts.append(np.concatenate([centres, radii], axis=-1))
    return np.concatenate(parts, axis=-2)


def of_capsule(capsule: Capsule) -> Array:
    """Return balls (S, 4) of its radius along a capsule's axis: centre and radius [m]."""
    start, end = np.array(capsule.start), np.array(capsule.end)
    count = int(np.ceil(np.linalg.norm(end - start) / SPACING)) + 1
    centres = start + np.linspace(0, 1, count)[:, None] * (end - start)
    return np.column_stack([centres, np.full(count, capsule.radius)])


def of_solid(solid: Solid) -> Array:
    """Return points (S, 4) of radius 0 all over the surface of a box."""
    centre, half = np.array(solid.center), np.array(solid.half)
    axes = [np.linspace(-h, h, int(np.ceil(2 * h / SPACING)) + 1) for h in half]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    on_surface = np.isclose(np.abs(grid), half).any(axis=1)
    return np.column_stack([centre + grid[on_surface], np.zeros(on_surface.sum())])


@cache
def _balls(arm: ArmModel) -> tuple[Array, ...]:
    """Return the balls (S, 4) of each link and the tool, in their own frames."""
    tool = np.concatenate([of_solid(s) for s in arm.tool.solids(arm.tool.stroke)])
    return (*(np.concatenate([of_capsule(c) for c in link.capsules]) for link in arm.links), tool)
