"""How stiff a simulated plant has to be: it holds itself up, and its flowers swing on their pedicels as measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import eigh

from anther.geometry import Array
from anther.sim.plant import GRAVITY, Organ, SimPlant

STEM_YOUNGS = (30e6, 300e6)
"""Range of the stem's Young's modulus [Pa], log-uniform (facts: pollination 0, prior for E, centre about 100 MPa)."""
PEDICEL_YOUNGS = (50e6, 100e6)
"""Range of a pedicel's Young's modulus [Pa] (facts: pollination 1a)."""
FLOWER_RESONANCE = (20.0, 35.0)
"""Range in which a flower swings on its pedicel [Hz] (facts: pollination 1a: 20-35 Hz, 30 Hz measured)."""
SELF_SUPPORT = 2.0
"""How many times stiffer a plant is than one that just does not buckle under its own weight; 2 is a height margin of
2^(1/3) = 1.26 over Greenhill's limit (height ~ E^(1/3)). An estimate: plants in pots stand without a stake."""


def draw_youngs(rng: np.random.Generator) -> float:
    """Return a stem's Young's modulus [Pa], log-uniform over STEM_YOUNGS."""
    return float(np.exp(rng.uniform(*np.log(STEM_YOUNGS))))


def pedicel_radius(length: float, flower_mass: float, youngs: float, resonance: float) -> float:
    """Return the radius [m] with which a pedicel and its flower resonate at `resonance` [Hz].

    A massless cantilever with a tip mass: (2 pi f)^2 = 3 E I / (m L^3), I = pi r^4 / 4.
    """
    stiffness = (2 * np.pi * resonance) ** 2 * flower_mass
    return float((4 * stiffness * length**3 / (3 * np.pi * youngs)) ** 0.25)


def buckling_factor(plant: SimPlant) -> float:
    """Return the factor by which all Young's moduli could fall before the plant buckles under its own weight.

    Segments are rigid, with a bending spring E I / L at each joint (L between the middles of the two segments). A small
    tilt theta of segment k about a horizontal axis releases m_k g dz_k theta^2 / 2, where m_k is all mass it carries
    and dz_k its rise. Buckling is where the spring energy no longer exceeds that: the largest eigenvalue of G x = l K x
    is 1 / factor. For one tapered pole this converges to Greenhill's limit.
    """
    springs, weight = _spring_matrix(plant), _weight_moments(plant)
    return float(1 / max(eigh(np.diag(weight), springs, eigvals_only=True)[-1], 1e-12))


def _spring_matrix(plant: SimPlant) -> Array:
    count = len(plant.parent)
    inertia = np.pi / 4 * plant.radius_start**4
    K = np.zeros((count, count))
    for k, p in enumerate(plant.parent):
        span = plant.length[k] / 2 + (plant.length[p] / 2 if p >= 0 else 0.0)
        stiffness = 1 / (span / (plant.youngs[k] * inertia[k]) + (1 / plant.foot if p < 0 else 0.0))
        K[k, k] += stiffness
        if p >= 0:
            K[p, p] += stiffness
            K[k, p] -= stiffness
            K[p, k] -= stiffness
    return K


def _weight_moments(plant: SimPlant) -> Array:
    """(K,) second derivative of the weight's energy that each segment's tilt releases [N m]."""
    carried = plant.mass + plant.lump_mass
    own = carried.copy()
    for k in range(len(carried) - 1, 0, -1):
        carried[plant.parent[k]] += carried[k]
    rise = (plant.end - plant.start)[:, 2]
    own_rise = plant.mass * rise / 2 + plant.lump_mass * (plant.lump_centre - plant.start)[:, 2]
    return GRAVITY * ((carried - own) * rise + own_rise)


def supported_youngs(plant: SimPlant) -> SimPlant:
    """Return the plant, all but its pedicels stiffened if it could not hold itself up with the margin SELF_SUPPORT."""
    raise_by = SELF_SUPPORT / buckling_factor(plant)
    if raise_by <= 1:
        return plant
    green = plant.organ != Organ.PEDICEL
    return replace(plant, youngs=np.where(green, plant.youngs * raise_by, plant.youngs))
