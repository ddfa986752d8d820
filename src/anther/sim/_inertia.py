"""Mass and inertia of a simulated plant's pieces. K segments, B bodies."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.geometry import Array
from anther.sim.plant import Organ, SimPlant


def mass_properties(plant: SimPlant, piece: NDArray[Any]) -> tuple[Array, Array, Array]:
    """Return mass (B,), centre (B, 3) and MuJoCo's full inertia (B, 6) of the bodies: tapered rods and what they carry.

    Args:
        plant: the truth.
        piece: (K,) the body of each segment.
    """
    rod, length = plant.mass, plant.length
    r2 = rod / (plant.density * np.pi * length)
    u = (plant.end - plant.start) / length[:, None]
    across = np.eye(3) - u[:, :, None] * u[:, None, :]
    centre, spread = _along(plant.radius_start, plant.radius_end)
    own = rod[:, None, None] * ((length**2 * spread + r2 / 4)[:, None, None] * across)
    own += (rod * r2 / 2)[:, None, None] * (np.eye(3) - across)
    masses = np.concatenate([rod, plant.lump_mass])
    centres = np.concatenate([plant.start + (centre * length)[:, None] * u, plant.lump_centre])
    body = np.tile(piece, 2)
    mass: Array = np.bincount(body, masses).astype(np.float64)
    com = np.stack([np.bincount(body, masses * c) for c in centres.T], axis=1) / mass[:, None]
    d = centres - com[body]
    steiner = masses[:, None, None] * ((d**2).sum(1)[:, None, None] * np.eye(3) - d[:, :, None] * d[:, None, :])
    steiner[: len(rod)] += own
    steiner[len(rod) :] += _spread(plant)
    inertia = np.zeros((len(mass), 3, 3))
    np.add.at(inertia, body, steiner)
    i, j = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return mass, com, inertia[:, i, j]


def _along(a: Array, b: Array) -> tuple[Array, Array]:
    """Return (K,) where the mass centre of frusta lies, and the variance of their mass along them; of length 1.

    Their area grows from a^2 to b^2 as the square of a radius that is linear.
    """
    whole = a**2 + a * b + b**2
    centre = (a**2 + 2 * a * b + 3 * b**2) / (4 * whole)
    return centre, (a**2 + 3 * a * b + 6 * b**2) / (10 * whole) - centre**2


def _spread(plant: SimPlant) -> Array:
    """Return (K, 3, 3) the inertia of what each segment carries about its own centre: it spreads as its mesh does.

    Without it a leaf had hardly any about its midrib, and spun when its margin was touched.
    """
    seen = np.unique(plant.faces[np.isin(plant.face_organ, (Organ.LEAF, Organ.FLOWER))])
    k, count = plant.vertex_segment[seen], len(plant.start)
    share = 1 / np.maximum(np.bincount(k, minlength=count), 1)
    mean = np.stack([np.bincount(k, x, count) for x in plant.vertices[seen].T], axis=1) * share[:, None]
    d, second = plant.vertices[seen] - mean[k], np.zeros((count, 3, 3))
    np.add.at(second, k, d[:, :, None] * d[:, None, :])
    second *= (plant.lump_mass * share)[:, None, None]
    return np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
