"""Scenes of several plants with strings, stakes and poles, as labelled point clouds. N points, P plants, S stem nodes.

Plants are Anther's own (`anther.sim`), Helios's (`helios.py`) or real labelled scans; each is turned about its stem's
foot and set 0.1-0.5 m from another. Plant 0 is the asked one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.geometry import Array
from anther.perception import Cloud
from anther.perception.masks import FLOWER, PLANT
from anther.sim import Organ, SimPlant

STEM, OTHER, PETAL, SUPPORT = range(4)
"""What a point of a scene is: main stem, another organ, a flower, a support."""
NOISE = 0.0003
"""Standard deviation of a point's place [m], as in the scenes that were tried (issue 59)."""
DENSITY = 2e5
"""Points to a square metre of surface: one every 2.2 mm."""
APART = (0.1, 0.5)
"""Between which a plant stands from its neighbour [m]."""
SUPPORTS = ("free string", "wound string", "stake", "pole", "pipe")


@dataclass(frozen=True, eq=False)
class Grown:
    """A plant whose stem leaves the soil at the origin, z up, as triangles.

    Attributes:
        name: of the plant.
        corners: (F, 3, 3) [m].
        organ: (F,) STEM, OTHER or PETAL.
        stem: (S, 3) main stem from the soil up [m].
        radius: (S,) [m].
    """

    name: str
    corners: Array
    organ: NDArray[Any]
    stem: Array
    radius: Array


@dataclass(frozen=True, eq=False)
class Points:
    """One plant as points, its foot at the origin.

    Attributes:
        name: of the plant.
        points: (N, 3) [m].
        organ: (N,) STEM, OTHER or PETAL.
        stem: (S, 3) main stem from the soil up: its nodes, or means of the points that people labelled [m].
        radius: of the stem, typical [m].
    """

    name: str
    points: Array
    organ: NDArray[Any]
    stem: Array
    radius: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Several plants and what supports them.

    Attributes:
        points: (N, 3) [m], z up.
        owner: (N,) which plant, or P + k of support k.
        organ: (N,) STEM, OTHER, PETAL or SUPPORT.
        plants: P plants where they stand.
        supports: names of the supports.
    """

    points: Array
    owner: NDArray[Any]
    organ: NDArray[Any]
    plants: Sequence[Points]
    supports: Sequence[str] = field(default=())

    @property
    def feet(self) -> Array:
        """(P, 3) where the stems leave the soil [m]."""
        return np.array([plant.stem[0] for plant in self.plants])

    def only(self, plant: int) -> Scene:
        """Return the scene of one plant alone, with the support that was dealt out to it."""
        count = len(self.plants)
        own = [plant, *(count + k for k in range(len(self.supports)) if k % count == plant)]
        kept = np.isin(self.owner, own)
        names = [self.supports[k - count] for k in own[1:]]
        owner = np.searchsorted(own, self.owner[kept])
        return Scene(self.points[kept], owner, self.organ[kept], [self.plants[plant]], names)

    def cloud(self) -> Cloud:
        """Return what perception gets."""
        return Cloud(self.points, labels=np.where(self.organ == PETAL, FLOWER, PLANT).astype(np.uint8))


def of_sim(plant: SimPlant) -> Grown:
    """Return a plant of Anther's own generator; of a pepper the axis up to the first fork is its stem."""
    line, radius, _ = plant.stem_centreline()
    own = plant.face_organ <= Organ.FLOWER
    organ = np.where(plant.face_organ == Organ.STEM, STEM, np.where(plant.face_organ == Organ.FLOWER, PETAL, OTHER))
    corners = plant.vertices[plant.faces[own]]
    return Grown(f"{plant.species}-{plant.seed}", corners - line[0], organ[own], line - line[0], radius)


def sampled(plant: Grown, rng: np.random.Generator) -> Points:
    """Return points spread evenly over a plant's surface."""
    area = np.linalg.norm(np.cross(*np.moveaxis(np.diff(plant.corners, axis=1), 1, 0)), axis=1) / 2
    face = rng.choice(len(area), max(500, int(DENSITY * area.sum())), p=area / area.sum())
    weight = rng.dirichlet(np.ones(3), len(face))
    points = np.einsum("nk,nkx->nx", weight, plant.corners[face])
    return Points(plant.name, points, plant.organ[face], plant.stem, float(np.median(plant.radius)))


def of_scan(name: str, points: Array, is_stem: NDArray[np.bool_], height: float) -> Points:
    """Return a labelled scan enlarged to `height` [m]; its foot is the middle of the lowest hundredth of its stem."""
    stem = points[is_stem]
    lowest = stem[stem[:, 2] <= np.quantile(stem[:, 2], 0.01)].mean(axis=0)
    scale = height / float(np.ptp(np.quantile(points[:, 2], [0.005, 0.995])))
    moved, stem = scale * (points - lowest), scale * (stem - lowest)
    slices = np.array_split(stem[np.argsort(stem[:, 2])], 40)
    line = np.vstack([np.zeros(3), *(part.mean(axis=0) for part in slices if len(part))])
    return Points(name, moved, np.where(is_stem, STEM, OTHER), line, 0.01 * height)


def thinned(plant: Points, most: int, rng: np.random.Generator) -> Points:
    """Return a plant with at most so many points."""
    kept = rng.permutation(len(plant.points))[:most]
    return Points(plant.name, plant.points[kept], plant.organ[kept], plant.stem, plant.radius)


def placed(plant: Points, at: Array, turn: float) -> Points:
    """Return a plant turned by `turn` [rad] about z, its foot at (3,) [m]."""
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return Points(plant.name, plant.points @ R.T + at, plant.organ, plant.stem @ R.T + at, plant.radius)


def arrangement(count: int, rng: np.random.Generator, apart: tuple[float, float] = APART) -> Array:
    """Return feet (count, 3) [m]: the first at the origin, each other `apart` from the one before or the first, and
    none nearer than that to any."""
    feet = [np.zeros(3)]
    while len(feet) < count:
        angle, away = rng.uniform(0, 2 * np.pi), rng.uniform(*apart)
        new = feet[rng.integers(len(feet))] + away * np.array([np.cos(angle), np.sin(angle), 0.0])
        if min(np.linalg.norm(new - foot) for foot in feet) >= apart[0] - 1e-9:
            feet.append(new)
    return np.array(feet)


def support(name: str, plant: Points, rng: np.random.Generator) -> Array:
    """Return the points (M, 3) [m] of a support of a plant."""
    foot, angle = plant.stem[0], rng.uniform(0, 2 * np.pi)
    side = np.array([np.cos(angle), np.sin(angle), 0.0])
    top = 1.2 * float(np.ptp(plant.points[:, 2]))
    rise = np.linspace(0, top, 60)[:, None] * [0, 0, 1.0]
    radius, beside = {
        "free string": (0.001, rng.uniform(0.005, 0.06)),
        "wound string": (0.001, 0.0),
        "stake": (rng.uniform(0.004, 0.006), rng.uniform(0.015, 0.06)),
        "pole": (rng.uniform(0.008, 0.015), rng.uniform(0.025, 0.08)),
        "pipe": (0.0255, rng.uniform(0.1, 0.2)),
    }[name]
    line = foot + beside * side + rise
    if name == "wound string":
        heights, order = np.linspace(0.02, 0.98, 400) * np.ptp(plant.stem[:, 2]), np.argsort(plant.stem[:, 2])
        axis = np.stack([np.interp(heights + foot[2], *plant.stem[order].T[[2, k]]) for k in range(3)], axis=1)
        turn = angle + heights / 0.08 * 2 * np.pi  # a turn every 80 mm
        around = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
        line = np.vstack([axis + (plant.radius + radius) * around, axis[-1] + rise[: len(rise) // 4]])
    return _tube(line, radius, rng)


def _tube(line: Array, radius: float, rng: np.random.Generator) -> Array:
    """Return points (M, 3) on a tube along a line (n, 3) [m]."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    count = max(200, int(DENSITY * 2 * np.pi * radius * lengths.sum()))
    k = rng.choice(len(lengths), count, p=lengths / lengths.sum())
    axis = (line[k + 1] - line[k]) / lengths[k, None]
    across = np.cross(axis, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return line[k] + rng.uniform(size=(count, 1)) * (line[k + 1] - line[k]) + radius * across


def build(
    plants: Sequence[Points],
    rng: np.random.Generator,
    supported: Sequence[str] = (),
    apart: tuple[float, float] = APART,
) -> Scene:
    """Return a scene of plants `apart` [m], each turned, the first at the origin, with supports dealt out to them."""
    feet = arrangement(len(plants), rng, apart)
    stand = [placed(p, foot, rng.uniform(0, 2 * np.pi)) for p, foot in zip(plants, feet, strict=True)]
    points, organ = [p.points for p in stand], [p.organ for p in stand]
    for k, name in enumerate(supported):
        points.append(support(name, stand[k % len(stand)], rng))
        organ.append(np.full(len(points[-1]), SUPPORT))
    owner = np.repeat(np.arange(len(points)), [len(part) for part in points])
    everything = np.concatenate(points)
    everything = everything + NOISE * rng.normal(size=everything.shape)
    return Scene(everything, owner, np.concatenate(organ), stand, tuple(supported))
