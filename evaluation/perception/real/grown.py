"""Labelled plants that nobody has grown: what the confidences of root, stem and grasp are fitted on beside real ones.

Grasses and broad-leaved plants with leaves that rise or hang below the base, and the simulator's tomatoes and peppers;
their labels are exact. All sizes are relative to a stem of 1 and drawn wide: what is fitted is to hold on any plant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import cycle, islice

import numpy as np
from numpy.typing import NDArray

from anther.core import Array
from anther.perception import Cloud
from anther.sim import Organ, SimPlant, grow_pepper, grow_tomato
from anther.sim.growth import arc, ripple
from anther.sim.mesh import Mesh, blade, tube, unit
from evaluation.perception.real.plants import Labelled

Parts = list[tuple[Mesh, bool]]
"""Meshes, and whether each belongs to the stem system."""


def grown_plants(count: int, first: int = 0) -> Iterator[Labelled]:
    """Yield plants, kind after kind, each of its own seed from `first` on."""
    for seed, (name, grow) in enumerate(islice(cycle(_KINDS.items()), count), first):
        rng = np.random.default_rng([seed, 20])
        points, is_stem = _scanned(grow(rng), rng)
        yield Labelled(f"{name}_{seed}", Cloud(points), is_stem, 0)


def _grass(rng: np.random.Generator) -> Parts:
    """A maize or sorghum: leaves by turns to either side, the youngest rolled and going on where the stem ends."""
    stem, radius = _stem(rng, rng.uniform(0.008, 0.04))
    nodes = np.sort(rng.uniform(0.08, 1, rng.integers(3, 10)))
    side, droop = rng.uniform(0, 2 * np.pi), rng.uniform(-1.7, 0.3)
    long = rng.uniform(0.5, 2.0)
    parts = [(tube(stem, radius), True)]
    for k, at in enumerate(nodes):
        length = long * rng.uniform(0.7, 1.1) * (0.6 + 0.8 * np.sin(np.pi * (k + 1) / (len(nodes) + 1)))
        rise = (rng.uniform(0.6, 1.3), droop + rng.normal(0, 0.3))
        azimuth, width = side + np.pi * k + rng.normal(0, 0.25), length * rng.uniform(0.025, 0.12)
        surface = radius[0] * np.array([np.cos(azimuth), np.sin(azimuth), 0])
        line = arc(_at(stem, at) + surface, azimuth, length, rise, 40)
        parts.append((_leaf(rng, line, width, neck=0.3), False))
    length = rng.uniform(0.15, 0.8)
    line = arc(stem[-1], side, length, (rng.uniform(1.2, 1.57), rng.uniform(0.5, 1.4)), 40)
    rolled = rng.integers(8, 25)
    parts.append((tube(line[:rolled], np.linspace(radius[-1], 0.6 * radius[-1], rolled), tip=False), False))
    parts.append((_leaf(rng, line[rolled - 1 :], length * rng.uniform(0.03, 0.1), neck=0.2), False))
    return parts


def _broad(rng: np.random.Generator) -> Parts:
    """A tobacco or a seedling with simple leaves: petioles around a stem, which may be short beside its leaves."""
    stem, radius = _stem(rng, rng.uniform(0.015, 0.08))
    size = rng.uniform(0.4, 2.5)
    parts = [(tube(stem, radius), True)]
    for k, at in enumerate(np.sort(rng.uniform(0.2, 1, rng.integers(4, 10)))):
        length = size * rng.uniform(0.5, 1) * (1.1 - 0.6 * at)
        rise = (rng.uniform(0.2, 1.1), rng.uniform(-1.2, 0.6))
        line = arc(_at(stem, at), 2.4 * k + rng.normal(0, 0.2), length, rise, 40)
        cut, thick = int(rng.integers(8, 22)), np.interp(at, [0, 1], radius[[0, -1]]) * rng.uniform(0.35, 0.7)
        parts.append((tube(line[: cut + 1], np.linspace(thick, 0.7 * thick, cut + 1), tip=False), True))
        parts.append((_leaf(rng, line[cut:], length * rng.uniform(0.1, 0.25), neck=0.15), False))
    return parts


def _simulated(grow: Callable[[int], SimPlant]) -> Callable[[np.random.Generator], Parts]:
    def parts(rng: np.random.Generator) -> Parts:
        plant = grow(int(rng.integers(10_000, 20_000)))
        organs = (Organ.STEM, Organ.BRANCH, Organ.PETIOLE, Organ.RACHIS, Organ.PEDUNCLE, Organ.PEDICEL)
        pieces = ((organs, True), ((Organ.LEAF,), False))
        return [((plant.vertices, plant.faces[np.isin(plant.face_organ, of)]), stem) for of, stem in pieces]

    return parts


_KINDS = {
    "grass": _grass,
    "broad": _broad,
    "tomato": _simulated(grow_tomato),
    "maize": _grass,
    "tobacco": _broad,
    "pepper": _simulated(grow_pepper),
}


def _stem(rng: np.random.Generator, radius: float) -> tuple[Array, Array]:
    """Return (21, 3) points of a stem of length 1 that leans and bends a little, and its radii (21,)."""
    azimuth, (low, high) = rng.uniform(0, 2 * np.pi), np.pi / 2 - rng.normal(0, [0.1, 0.15])
    return arc(np.zeros(3), azimuth, 1.0, (low, high), 20), radius * np.linspace(1, rng.uniform(0.4, 0.9), 21)


def _at(line: Array, share: float) -> Array:
    return line[round(share * (len(line) - 1))]


def _leaf(rng: np.random.Generator, line: Array, width: float, neck: float) -> Mesh:
    """Return a blade of half width `width` along a line (n, 3), widest after `neck` of its length."""
    u = np.linspace(0, 1, len(line))
    half = width * np.maximum(np.minimum(u / neck, 1) ** 0.7 * (1 - u) ** 0.6 * 1.2, 0.05)
    side = np.cross(np.gradient(line, axis=0), [0, 0, 1.0]) + 1e-6
    twist = rng.normal(0, 0.4) * u[:, None]
    side = unit(side) * np.cos(twist) + np.array([0, 0, 1.0]) * np.sin(twist)
    return blade(line, unit(side), half, fold=rng.uniform(0, 1.2), ripple=ripple(rng, len(u), 0.3 * width))


def _scanned(parts: Parts, rng: np.random.Generator) -> tuple[Array, NDArray[np.bool_]]:
    """Return points (N, 3) on the surfaces as a scanner sees them, the plant 0.03 to 1.5 m tall; and which are stem."""
    area: list[Array] = [np.linalg.norm(_across(mesh), axis=1) / 2 for mesh, _ in parts]
    density = rng.integers(3_000, 40_000) / sum(a.sum() for a in area)
    points, labels = [], []
    for (mesh, is_stem), a in zip(parts, area, strict=True):
        face = rng.choice(len(a), round(float(density * a.sum())), p=a / a.sum())
        one, two = np.sort(rng.uniform(0, 1, (2, face.size)), axis=0)
        share = np.stack([one, two - one, 1 - two], axis=1)
        points.append(np.einsum("nk,nkd->nd", share, mesh[0][mesh[1][face]]))
        labels.append(np.full(face.size, is_stem))
    cloud = np.concatenate(points)
    size = float(np.linalg.norm(np.ptp(cloud, axis=0)))
    cloud = cloud + rng.normal(0, size / rng.uniform(350, 3000), cloud.shape)
    return cloud * np.exp(rng.uniform(np.log(0.03), np.log(1.5))) / size, np.concatenate(labels)


def _across(mesh: Mesh) -> Array:
    a, b, c = (mesh[0][mesh[1][:, k]] for k in range(3))
    return np.cross(b - a, c - a)
