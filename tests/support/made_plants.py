"""Clouds of cylinders and blades with known centrelines, for the tests of skeleton, stem and flowers."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from anther.core.geometry import Array


def tube(start: ArrayLike, end: ArrayLike, radius: tuple[float, float], step: float, rng: np.random.Generator) -> Array:
    """Return points on the surface of a straight, tapering tube [m]."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = np.linalg.norm(end - start)
    axis = (end - start) / length
    across = np.linalg.svd(axis[None])[2][1:]
    count = max(int(2 * np.pi * max(radius) * length / step**2), 8)
    t, angle = rng.uniform(0, 1, count), rng.uniform(0, 2 * np.pi, count)
    r = radius[0] + (radius[1] - radius[0]) * t
    ring = np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1]
    return start + t[:, None] * (end - start) + r[:, None] * ring


def blade(start: ArrayLike, end: ArrayLike, half_width: float, step: float, rng: np.random.Generator) -> Array:
    """Return points on a flat, horizontal-crosswise leaf blade [m]."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    side = np.cross(end - start, [0, 0, 1.0])
    side /= np.linalg.norm(side)
    count = int(2 * half_width * np.linalg.norm(end - start) / step**2)
    t, s = rng.uniform(0, 1, count), rng.uniform(-1, 1, count)
    return start + t[:, None] * (end - start) + (s * half_width * np.sin(np.pi * t))[:, None] * side


def simple_plant(seed: int = 0, *, noise: float = 0.0004, leaves: int = 4, height: float = 0.5) -> Array:
    """Return the cloud of an upright stem (radius 5 to 3 mm) with petioles (2 mm) that end in blades."""
    rng = np.random.default_rng(seed)
    parts = [tube([0, 0, 0], [0, 0, height], (0.005, 0.003), 0.0012, rng)]
    for k in range(leaves):
        z = height * (0.25 + 0.6 * k / max(leaves - 1, 1))
        out = np.array([np.cos(2.4 * k), np.sin(2.4 * k), 0.7])
        base = np.array([0, 0, z])
        parts.append(tube(base, base + 0.08 * out, (0.002, 0.0015), 0.001, rng))
        parts.append(blade(base + 0.08 * out, base + 0.08 * out + 0.09 * out * [1, 1, 0.2], 0.025, 0.0015, rng))
    cloud = np.concatenate(parts)
    return cloud + rng.normal(0, noise, cloud.shape)


def one_sided_trunk(seen: float, radius: float = 0.06, height: float = 1.2, noise: float = 0.001) -> Array:
    """Return the surface of an upright trunk with limbs of 12 mm, of which `seen` degrees are in the cloud [m]."""
    rng, half = np.random.default_rng(0), np.radians(seen) / 2
    angle, z = rng.uniform(-half, half, 9000), rng.uniform(0, height, 9000)
    parts = [np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)]
    for k in range(4):
        out = np.array([np.cos(2.4 * k), np.sin(2.4 * k), 0.8])
        base = np.array([0, 0, height * (0.75 + 0.08 * k)])
        parts.append(tube(base, base + 0.5 * out, (0.012, 0.01), 0.008, rng))
    cloud = np.concatenate(parts)
    return cloud + rng.normal(0, noise, cloud.shape)


def segment_distance(points: Array, start: ArrayLike, end: ArrayLike) -> Array:
    """Return the distance of each point from a segment [m]."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    t = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    return np.linalg.norm(points - start - t[:, None] * (end - start), axis=1)
