"""What the leaves of tomato and pepper have in common: an arching axis and a wavy margin. Lengths in m."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.geometry import Array

AREAL_DENSITY = 0.25
"""Mass of a fresh blade per area [kg/m2]: 0.25 mm of tissue that is mostly water (an estimate)."""


def arc(base: Array, azimuth: float, length: float, elevation: tuple[float, float], count: int) -> Array:
    """Return points (count + 1, 3) of an arc of `length` [m].

    Args:
        base: (3,) where it starts.
        azimuth: of the vertical plane it lies in [rad].
        length: [m].
        elevation: of its first and last piece above the horizon [rad].
        count: pieces.
    """
    angle = np.linspace(*elevation, count)
    steps = np.stack([np.cos(angle) * np.cos(azimuth), np.cos(angle) * np.sin(azimuth), np.sin(angle)], axis=1)
    return np.vstack([base, base + np.cumsum(steps * length / count, axis=0)])


def ripple(rng: np.random.Generator, rows: int, size: float) -> Array:
    """Return (rows, 7) smooth waves over a blade along its normal, growing to `size` [m] at its margins."""
    across, along = np.linspace(-1, 1, 7), np.linspace(0, 1, rows)[:, None]
    left, right = (size * np.sin(2 * np.pi * (rng.uniform(1.5, 3) * along + rng.uniform())) for _ in range(2))
    return np.where(across < 0, left, right) * across**2


def blade_colours(rng: np.random.Generator, colour: ArrayLike, rows: int) -> NDArray[np.uint8]:
    """Return (rows * 7, 3) sRGB colours of a blade: a lighter midrib, patches, a shade of its own."""
    shade = rng.normal(0, 7) + rng.normal(0, 3, (rows, 7))
    warm = max(0.0, rng.normal(0, 9))
    midrib = np.array([0, 0, 6, 22, 6, 0, 0.0])
    level = shade + midrib
    tinted = np.stack([level + warm, level, 0.6 * level], axis=-1) + np.asarray(colour)
    return np.clip(tinted, 0, 255).astype(np.uint8).reshape(-1, 3)
