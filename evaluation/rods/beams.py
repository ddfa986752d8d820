"""Rods of known theory: cantilevers of any taper, and the three-dimensional network of the peers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from anther.rods import Clamp, Rods
from evaluation.rods.table import Array
from evaluation.speed.networks import reference_network

NO_GRAVITY = (0.0, 0.0, 0.0)
X_AXIS = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Beam:
    """A horizontal cantilever along x.

    A clamped edge holds the slope in its middle, so that a beam of total length l bends over the free length
    L = l - h/2. The node distance is therefore h = L / (edges - 1/2).

    Attributes:
        length: free length L [m].
        radius: at the clamp [m].
        youngs: [Pa].
        density: [kg/m^3].
    """

    length: float = 0.3
    radius: float = 3e-3
    youngs: float = 2e8
    density: float = 1100.0

    @property
    def bending_stiffness(self) -> float:
        """EI at the clamp [N m^2]."""
        return self.youngs * np.pi * self.radius**4 / 4

    @property
    def line_mass(self) -> float:
        """Mass per length at the clamp [kg/m]."""
        return self.density * np.pi * self.radius**2

    @property
    def rate(self) -> float:
        """sqrt(EI / (rho A L^4)) [rad/s]; frequencies are multiples of it."""
        return float(np.sqrt(self.bending_stiffness / self.line_mass) / self.length**2)

    def spacing(self, nodes: int) -> float:
        """Node distance over free length."""
        return 1 / (nodes - 1.5)

    def rods(
        self, nodes: int, *, taper: Callable[[Array], Array] | None = None, tip_mass: float = 0.0, **material: Any
    ) -> Rods:
        """Return the rods: `taper` maps s / L (N,) in [0, 1] to the radius over that at the clamp."""
        h = self.length * self.spacing(nodes)
        along = np.arange(nodes) * h
        lumps = np.zeros(nodes)
        lumps[-1] = tip_mass
        middle = np.maximum(along - h, 0) / self.length  # of edge j, measured from the middle of the clamped edge
        radius = np.full(nodes, self.radius) if taper is None else self.radius * taper(middle)
        points: Any = np.stack([along, 0 * along, 0 * along], axis=1)
        return Rods(points, np.arange(nodes) - 1, radius, self.youngs, self.density, lumped_mass=lumps, **material)


SLENDER = Beam(radius=3e-4)
"""So thin that stretch and rotary inertia, which Euler-Bernoulli and the elastica leave out, change 1e-5 only."""
CLAMPED = Clamp(np.array([0, 1]))
"""Both ends of the first edge."""


def network(**material: Any) -> Rods:
    """Return the 3-D network of the peers."""
    return replace(reference_network(), **material)
