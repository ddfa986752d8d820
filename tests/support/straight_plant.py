"""A small straight plant for tests of the cell: stem, one petiole with a leaf, one flower on a pedicel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from anther.sim.plant import Organ, Pot, SimPlant

BASE = np.array([0.72, 0.0, -0.30])


def chain(points: Any, radius: Any, *, organ: int = 0, youngs: float = 150e6, joins: int = -1, first: int = 0) -> dict:
    """Return the segment arrays of a polyline; segment numbers start at `first`, its first hangs on `joins`."""
    points = np.asarray(points, dtype=float)
    n = len(points) - 1
    r = np.broadcast_to(np.asarray(radius, dtype=float), n + 1)
    return {
        "start": points[:-1],
        "end": points[1:],
        "radius_start": r[:-1],
        "radius_end": r[1:],
        "parent": np.r_[joins, first + np.arange(n - 1)],
        "organ": np.full(n, int(organ)),
        "youngs": np.full(n, youngs),
        "density": np.full(n, 1000.0),
        "lump_mass": np.zeros(n),
        "lump_centre": (points[:-1] + points[1:]) / 2,
    }


def plant_of(*chains: dict, damping_ratio: float = 0.05, flower: int | None = None) -> SimPlant:
    """Return a plant of these chains, with a bare triangle as its mesh."""
    arrays = {name: np.concatenate([c[name] for c in chains]) for name in chains[0]}
    return SimPlant(
        species="tomato",
        seed=0,
        **arrays,
        damping_ratio=np.full(len(arrays["start"]), damping_ratio),
        flower_segment=np.array([] if flower is None else [flower], dtype=int),
        flower_position=np.zeros((0, 3)) if flower is None else arrays["end"][[flower]],
        vertices=np.eye(3),
        faces=np.array([[0, 1, 2]]),
        face_organ=np.array([Organ.POT]),
        vertex_color=np.zeros((3, 3)),
        vertex_segment=np.array([-1, -1, -1]),
        pot=Pot(centre=BASE, radius=0.09),
    )


def with_blade(plant: SimPlant, centre: Any, normal: Any, segment: int, size: float = 0.06) -> SimPlant:
    """Return the plant with one leaf blade, `size` x 0.6 `size` [m], on a segment as all there is of its mesh."""
    first = np.cross(normal, [0.3, 0.4, 0.9])
    first = first / np.linalg.norm(first)
    second = np.cross(normal, first)
    u, v = (x.ravel() for x in np.meshgrid(*2 * [np.linspace(-size / 2, size / 2, 7)]))
    corner = (7 * np.arange(6)[:, None] + np.arange(6)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 7], corner[:, None] + [1, 8, 7]])
    return replace(
        plant,
        vertices=np.asarray(centre) + np.outer(u, first) + np.outer(0.6 * v, second),
        faces=faces.astype(np.int32),
        face_organ=np.full(len(faces), Organ.LEAF),
        vertex_color=np.full((49, 3), 90),
        vertex_segment=np.full(49, segment),
    )


def straight_plant(*, leaf: float = 0.01, height: float = 0.5, side: float = 1.0) -> SimPlant:
    """Return a stem 5 -> 3 mm thick, a petiole with a leaf of `leaf` kg, and a 0.1 g flower on a 15 mm pedicel.

    Args:
        side: +1 or -1, the side (y) the petiole grows to.
    """
    n = 20
    z = np.linspace(0, height, n + 1)[:, None] * [0, 0, 1.0]
    stem = chain(BASE + z, np.linspace(0.005, 0.003, n + 1))
    fork = stem["end"][14]
    petiole = chain(
        fork + np.linspace(0, 0.12, 5)[:, None] * [0.3, 0.9 * side, 0.3],
        np.linspace(0.0025, 0.0015, 5),
        organ=Organ.PETIOLE,
        joins=14,
        first=n,
    )
    petiole["lump_mass"][-1], petiole["lump_centre"][-1] = leaf, petiole["end"][-1]
    joint = stem["end"][17]
    pedicel = chain(
        joint + np.linspace(0, 0.015, 3)[:, None] * [0, -side * 0.8, 0.6],
        0.0005,
        organ=Organ.PEDICEL,
        youngs=80e6,
        joins=17,
        first=n + 4,
    )
    pedicel["lump_mass"][-1], pedicel["lump_centre"][-1] = 1e-4, pedicel["end"][-1]
    return plant_of(stem, petiole, pedicel, flower=n + 5)
