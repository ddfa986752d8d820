"""The air around a simulated plant: drag that grows with the square of the speed, and gusty wind. B bodies."""

from __future__ import annotations

from typing import Any

import numpy as np

from anther.geometry import Array
from anther.sim.plant_mechanics import PlantMechanics

DENSITY = 1.2
"""Of air [kg/m3]."""
TURBULENCE = 0.35
"""Standard deviation of the wind's speed over its mean (facts: pollination 6)."""
GUST_TIME = 1.0
"""For which a gust lasts [s]: eddies of a plant's size at 0.5 to 1 m/s; a guess."""
ALONG, ACROSS = 1.0, 0.5
"""Shares of the turbulence along and across the mean wind; a guess, as in free streams."""


class Air:
    """Drag on the bodies of a plant, at their centres of mass, relative to a wind that is the same everywhere.

    The mean wind blows horizontally from a random side; the speed about it is a first-order Markov process.
    """

    def __init__(self, mechanics: PlantMechanics, wind: float, seed: int) -> None:
        """Let the air move at `wind` [m/s] in the mean; `seed` gives its side and its gusts."""
        plant, pieces = mechanics.plant, mechanics.pieces
        self._model, self._bodies = mechanics.model, mechanics.bodies
        area = np.bincount(pieces.body, plant.drag_area, len(pieces.first))
        self._factor = 0.5 * DENSITY * area[:, None]
        self._rng = np.random.default_rng([seed, 9])
        side = self._rng.uniform(0, 2 * np.pi)
        along = np.array([np.cos(side), np.sin(side), 0.0])
        self._mean = wind * along
        self._gust_size = TURBULENCE * wind * (ACROSS + (ALONG - ACROSS) * np.abs(along))
        self._gust = self._gust_size * self._rng.normal(size=3)
        self.still = not area.any()

    def push(self, data: Any, dt: float) -> None:
        """Set the forces of the air for the step of `dt` [s] that begins now."""
        if self.still:
            return
        keep = np.exp(-dt / GUST_TIME)
        self._gust = keep * self._gust + np.sqrt(1 - keep**2) * self._gust_size * self._rng.normal(size=3)
        against = self._mean + self._gust - self.speed(data)
        data.xfrc_applied[self._bodies, :3] = self._factor * np.linalg.norm(against, axis=1, keepdims=True) * against

    def speed(self, data: Any) -> Array:
        """Return (B, 3) the velocity of each body's centre of mass [m/s]."""
        turn, slide = data.cvel[self._bodies, :3], data.cvel[self._bodies, 3:]
        arm = data.xipos[self._bodies] - data.subtree_com[self._model.body_rootid[self._bodies]]
        return slide + np.cross(turn, arm)

    def linear(self, speed: Array) -> Array:
        """Return (B,) the damping [N s/m] that does the work of the drag when bodies swing with `speed` (B,) [m/s].

        8 / (3 pi) of the drag at that amplitude of the speed, as the mean of |sin|^3 over that of sin^2 says.
        """
        return 8 / (3 * np.pi) * self._factor[:, 0] * speed
