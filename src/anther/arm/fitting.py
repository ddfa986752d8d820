"""Capsules around the shapes of links, and which links need not be checked against each other. P points."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial import ConvexHull
from scipy.stats import qmc

from anther.arm.model import BASE, CAMERA, GRIPPER, ArmModel, Capsule
from anther.arm.outline import of_capsule, of_solid
from anther.geometry import Array

MOST = 3  # capsules a link
GAIN = 0.8  # share of the volume before, below which one more capsule is worth it
SHORTEST = 0.002  # m, axis of a capsule
ROUNDS = 80  # of moving a circle's centre towards the farthest point: it is then within some percent of the smallest
POSTURES = 256  # looked at for links that touch
OFTEN = 0.3  # share of the postures in which links one apart touch, from which on that says nothing


def capsules_around(points: Array) -> tuple[Capsule, ...]:
    """Return one to `MOST` capsules that together hold all points (P, 3) [m], all in the same frame."""
    best = (_capsule(points),)
    for count in range(2, MOST + 1):
        which = kmeans2(points, count, minit="++", rng=np.random.default_rng(0))[1]
        parts = [points[which == k] for k in range(count)]
        if min(map(len, parts)) < 4:
            break
        tried = tuple(map(_capsule, parts))
        if _volume(tried) < GAIN * _volume(best):
            best = tried
    return best


def neighbours(arm: ArmModel, margin: float) -> tuple[tuple[str, str], ...]:
    """Return the pairs of parts that are not to be checked: joined ones, and those whose shapes say nothing.

    The latter touch where the arm is ready or waits, or, links one apart, in more than `OFTEN` of all postures.

    Args:
        arm: its own `neighbours` are not looked at.
        margin: that planning adds around links [m].
    """
    names = [BASE, *(link.name for link in arm.links), GRIPPER, CAMERA]
    tool = len(names) - 2
    joined = {*zip(names[:tool], names[1:tool], strict=False), (GRIPPER, CAMERA)}
    joined |= {(names[i], part) for i in (tool - 2, tool - 1) for part in (GRIPPER, CAMERA)}
    samples = qmc.scale(qmc.Sobol(arm.count, scramble=False).random(POSTURES), arm.lower, arm.upper)
    q = np.concatenate([[arm.ready, arm.waiting], samples])
    balls = _balls(arm, q, margin)
    for i, j in combinations(range(len(names)), 2):
        pair = names[i], names[j]
        if pair not in joined:
            touch = np.array([_touch(a, b) for a, b in zip(balls[i], balls[j], strict=True)])
            if touch[:2].any() or (min(j, tool) - i == 2 and touch.mean() > OFTEN):
                joined.add(pair)
    return tuple(sorted(joined))


def _balls(arm: ArmModel, q: Array, margin: float) -> list[Array]:
    """Return balls (Q, S, 4) of base, links, gripper and camera at joints (Q, J): centre and radius [m]."""
    base = [of_capsule(c) for c in arm.base_capsules] + [of_solid(s) for s in arm.base_solids]
    wider = np.array([0, 0, 0, margin])
    links = [np.concatenate([of_capsule(c) for c in link.capsules]) + wider for link in arm.links]
    gripper, camera = (arm.tool.body, *arm.tool.fingers(arm.tool.stroke)), arm.tool.camera
    tools = [np.concatenate([of_solid(s) for s in solids]) for solids in (gripper, camera)]
    poses = arm.link_poses(q)
    out = [np.tile(np.concatenate(base), (len(q), 1, 1)) if base else np.zeros((len(q), 0, 4))]
    for i, shape in enumerate([*links, *tools]):
        T = poses[:, min(i, arm.count)]
        centres = shape[:, :3] @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
        out.append(np.concatenate([centres, np.broadcast_to(shape[:, 3:], (*centres.shape[:2], 1))], axis=2))
    return out


def _touch(a: Array, b: Array) -> bool:
    gap = np.linalg.norm(a[:, None, :3] - b[None, :, :3], axis=2) - a[:, None, 3] - b[None, :, 3]
    return bool((gap < 0).any())


def _capsule(points: Array) -> Capsule:
    """Return the smallest capsule of those along the points' and the frame's main axes."""
    points = points[ConvexHull(points).vertices]
    axes = np.concatenate([np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2], np.eye(3)])
    return min((_along(points, axis) for axis in axes), key=lambda capsule: _volume([capsule]))


def _along(points: Array, axis: Array) -> Capsule:
    """Return the capsule around the points whose axis has this direction (3,)."""
    flat = points - np.outer(points @ axis, axis)
    centre = (flat.min(axis=0) + flat.max(axis=0)) / 2
    for k in range(ROUNDS):  # Badoiu and Clarkson 2003
        centre = centre + (flat[np.linalg.norm(flat - centre, axis=1).argmax()] - centre) / (k + 2)
    beside = np.linalg.norm(flat - centre, axis=1)
    radius, along = float(beside.max()), points @ axis
    cap = np.sqrt(np.maximum(radius**2 - beside**2, 0))
    low, high = (along + cap).min(), (along - cap).max()  # the other way round where a ball holds them
    middle, half = (low + high) / 2, max(high - low, SHORTEST) / 2
    low, high = middle - half, middle + half
    start, end = (tuple(float(x) for x in centre - (centre @ axis) * axis + t * axis) for t in (low, high))
    return Capsule(start, end, radius)  # type: ignore[arg-type]


def _volume(capsules: Sequence[Capsule]) -> float:
    lengths = [np.linalg.norm(np.subtract(c.end, c.start)) for c in capsules]
    return float(sum(np.pi * c.radius**2 * (4 / 3 * c.radius + n) for c, n in zip(capsules, lengths, strict=True)))
