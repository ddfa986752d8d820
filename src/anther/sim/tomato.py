"""A pot tomato at first flowering, random by seed.

Sources. facts: pollination section 2: spiral phyllotaxis 137.5 deg, 8 leaves to the first truss then 3 a truss,
compound leaves with the petiole 0.2 of their length, scorpioid cyme with flowers alternating left and right, pedicels
9-22 mm. Marked [R] there (remembered, no source found): height 0.5-0.75 m, 8-12 nodes, base 8-12 mm, taper 0.4-0.6,
peduncle 60-120 mm x 2-4 mm, 4-8 flowers of 0.05-0.15 g. Estimates of ours: leaf length 0.15-0.35 m, areal density of a
blade 0.25 kg/m2, tissue density 1000 kg/m3, postures and colours.
"""

from __future__ import annotations

import numpy as np

from anther.core.geometry import Array, interpolate
from anther.sim.growth import AREAL_DENSITY, GOLDEN_ANGLE, Growth, arc, blade_colours, ripple
from anther.sim.mesh import blade, star, tube, unit
from anther.sim.plant import POT_AXIS, Organ, SimPlant

STEM_GREEN, SEPAL_GREEN = (108, 140, 72), (88, 128, 58)


def grow_tomato(seed: int, *, viewpoint: float = 0.0, axis: tuple[float, float] = POT_AXIS) -> SimPlant:
    """Return a pot tomato at first flowering.

    Args:
        seed: the same seed gives the same plant.
        viewpoint: turns the plant about the pot's axis [deg].
        axis: where the pot stands in the world, x and y [m].
    """
    rng = np.random.default_rng([seed, 1])
    growth = Growth(rng)
    internodes = int(rng.integers(8, 13))
    stem = _grow_stem(growth, internodes)
    azimuth = rng.uniform(0, 2 * np.pi)
    for node in range(1, internodes + 1):
        azimuth += GOLDEN_ANGLE + rng.normal(0, np.radians(8))
        grow_leaf(growth, stem[2 * node - 1], azimuth, _leaf_length(rng, node, internodes), node / internodes)
    for size in rng.uniform([0.05, 0.03], [0.075, 0.05]):
        azimuth += GOLDEN_ANGLE
        grow_leaf(growth, stem[-1], azimuth, size, 1.0)
    for truss, node in enumerate(_truss_nodes(rng, internodes)):
        grow_truss(growth, stem[2 * node], azimuth + np.pi + truss * GOLDEN_ANGLE, truss)
    return growth.finish("tomato", seed, axis=axis, viewpoint=viewpoint)


def _truss_nodes(rng: np.random.Generator, internodes: int) -> list[int]:
    """Internodes (lower node) whose middle bears a truss: the first after leaf 6-8, then every second or third."""
    first = min(int(rng.integers(6, 9)), internodes - 1)
    return list(range(first, internodes, int(rng.integers(2, 4))))[:3]


def _leaf_length(rng: np.random.Generator, node: int, internodes: int) -> float:
    """Leaf length [m]: 0.15-0.35 where expanded, less in the three youngest leaves at the head."""
    young = node - (internodes - 3)
    if young > 0:
        return float(rng.uniform(0.15, 0.19) / young**0.6)
    shape = np.sin(np.pi * np.clip(0.25 + 0.6 * node / internodes, 0, 1))
    return float(np.clip(0.33 * shape * rng.uniform(0.85, 1.1), 0.15, 0.35))


def _grow_stem(growth: Growth, internodes: int) -> list[int]:
    """Two segments an internode, slight lean, bend and zigzag at the nodes."""
    rng = growth.rng
    tallness = rng.uniform()
    height, base = 0.5 + 0.25 * tallness, 0.004 + 0.002 * (0.6 * tallness + 0.4 * rng.uniform())
    young = np.clip((internodes - np.arange(internodes)) / 3.5, 0.3, 1)
    lengths = np.repeat(rng.uniform(0.8, 1.2, internodes) * young, 2)
    t = np.concatenate([[0], np.cumsum(lengths)]) / lengths.sum()
    lean, bend = rng.uniform(0, 0.06), rng.normal(0, 0.025)
    direction = rng.uniform(0, 2 * np.pi)
    along = lean * t + bend * np.sin(np.pi * t) * t
    points = np.stack([along * np.cos(direction), along * np.sin(direction), height * t], axis=1)
    zigzag = 0.05 * height * lengths[1:-1:2, None] / lengths.sum() * 2
    points[2:-1:2, :2] += zigzag * rng.normal(size=(internodes - 1, 2))
    taper = rng.uniform(0.4, 0.6)
    return growth.chain(points, base * (1 - (1 - taper) * t**1.2), Organ.STEM, -1, STEM_GREEN, sides=12)


def grow_leaf(growth: Growth, parent: int, azimuth: float, length: float, height: float) -> None:
    """A compound leaf: petiole, rachis, terminal leaflet and two to four pairs."""
    rng = growth.rng
    young = np.clip((0.2 - length) / 0.12, 0, 1)
    rise = np.radians(rng.uniform(25, 45) + 30 * young)
    fall = np.radians(rng.uniform(-45, -15) * (0.4 + 0.6 * height) + 50 * young)
    points = arc(growth.end(parent), azimuth, 0.72 * length, (rise, fall), 4)
    thick = 0.0012 + 0.0045 * length
    radii = thick * np.array([1.15, 0.9, 0.72, 0.55, 0.4])
    petiole = growth.chain(points[:2], radii[:2], Organ.PETIOLE, parent, STEM_GREEN, sides=7, tip=False)
    rachis = growth.chain(points[1:], radii[1:], Organ.RACHIS, petiole[-1], STEM_GREEN, sides=6)
    colour = (1 - young) * np.array((58, 104, 44)) + young * np.array((112, 150, 62))
    pairs = int(np.clip(np.round(length / 0.085 + rng.normal(0, 0.4)), 2, 4))
    forward = unit(points[-1] - points[-2])
    _grow_leaflet(growth, rachis[-1], points[-1], forward, length=(0.27 + 0.08 * young) * length, colour=colour)
    for i in range(pairs):
        along = 0.05 + 0.85 * (i + rng.uniform(-0.1, 0.1) + 0.2) / pairs
        k = min(int(max(along, 0) * 3), 2)
        here = points[1 + k] + (points[2 + k] - points[1 + k]) * np.clip(along * 3 - k, 0, 1)
        forward = unit(points[2 + k] - points[1 + k])
        size = length * (rng.uniform(0.25, 0.31) + 0.08 * young) * (0.75 + 0.25 * np.sin(np.pi * (i + 0.7) / pairs))
        for hand in (-1.0, 1.0):
            side = hand * unit(np.cross(forward, [0, 0, 1.0]))
            outward = unit(side + forward * rng.uniform(0.25, 0.6))
            beside, long = growth.beside(rachis[k], here), size * rng.uniform(0.85, 1.1)
            _grow_leaflet(growth, beside, here, outward, length=long, colour=colour)


def _grow_leaflet(growth: Growth, segment: int, base: Array, direction: Array, *, length: float, colour: Array) -> None:
    """One lobed, drooping blade on a short stalk; its mass is carried by the rachis segment."""
    rng = growth.rng
    stalk = 0.12 * length
    start = np.arcsin(np.clip(direction[2], -1, 1)) + rng.normal(0, 0.12)
    azimuth = np.arctan2(direction[1], direction[0])
    line = arc(base, azimuth, stalk + length, (start, start - rng.uniform(0.2, 0.9)), 15)
    growth.surface(tube(line[:3], [0.0009, 0.0007, 0.0006], sides=5), Organ.LEAF, STEM_GREEN, segment)
    midrib = line[1:]
    u = np.linspace(0, 1, len(midrib))
    side = unit(np.cross(unit(np.gradient(midrib, axis=0)), [0, 0, 1.0]))
    roll = rng.normal(0, 0.25)
    side = side * np.cos(roll) + np.cross(side, np.gradient(midrib, axis=0) / np.gradient(u)[:, None]) * np.sin(roll)
    outline = np.sin(np.pi * u**0.72) ** 0.8 * (1 - 0.35 * u)
    lobes = 1 + 0.2 * np.cos(2 * np.pi * (3.5 * u + rng.uniform(0, 1))) * (u < 0.9)
    half_width = length * rng.uniform(0.30, 0.40) * np.maximum(outline * lobes, 0.004)
    wave = ripple(rng, len(u), 0.035 * length)
    vertices, faces = blade(midrib, unit(side), half_width, fold=rng.normal(0.05, 0.18), ripple=wave)
    growth.surface((vertices, faces), Organ.LEAF, blade_colours(rng, colour, len(u)), segment)
    area = 2 * float(np.trapezoid(half_width, u)) * length
    growth.carry(segment, AREAL_DENSITY * area, midrib.mean(axis=0))


def grow_truss(growth: Growth, parent: int, azimuth: float, order: int) -> None:
    """A scorpioid cyme: a drooping peduncle, then flowers left and right by turns; younger trusses are smaller."""
    rng = growth.rng
    flowers = int(rng.integers(4, 9)) if order == 0 else int(rng.integers(4, 7))
    length = rng.uniform(0.06, 0.12) if order == 0 else rng.uniform(0.06, 0.08)
    rise, fall = np.radians(rng.uniform(15, 45)), np.radians(rng.uniform(-40, -5))
    fine = arc(growth.end(parent), azimuth, length, (rise, fall), 24)
    at = np.concatenate([[0, 0.25, 0.5], 0.5 + 0.5 * np.arange(1, flowers) / (flowers - 1)])
    points = interpolate(at * 24, np.arange(25), fine)
    thick = rng.uniform(0.001, 0.0018)
    peduncle = growth.chain(points, thick * (1 - 0.5 * at), Organ.PEDUNCLE, parent, STEM_GREEN, sides=7)
    for i in range(flowers):
        k = peduncle[1 + i]
        forward = unit(points[2 + i] - points[1 + i])
        side = (-1.0) ** i * unit(np.cross(forward, [0, 0, 1.0]))
        out = unit(side + rng.uniform(0.3, 0.8) * forward + np.array([0, 0, rng.uniform(-0.3, 0.4)]))
        _grow_flower(growth, k, out, openness=np.clip(1.15 - 0.12 * i - 0.25 * order + rng.normal(0, 0.1), 0.35, 1))


def _grow_flower(growth: Growth, parent: int, out: Array, *, openness: float) -> None:
    """A pedicel with a knee at the abscission joint, and a nodding flower at its end."""
    rng = growth.rng
    kind = {"length": (0.009, 0.02), "mass": (0.05e-3, 0.15e-3), "nod": (0.5, 1.4)}
    pedicel, tip, nod = growth.flower(parent, out, SEPAL_GREEN, **kind, parts=(0.55, 0.45), widths=(1.05, 1, 1))
    corolla = rng.uniform(0.0075, 0.01) * (0.45 + 0.55 * openness)
    spin = rng.uniform(0, 2 * np.pi)
    petals = star(tip + 0.001 * nod, nod, 5, corolla, reflex=-1.2 + 1.5 * openness, spin=spin)
    sepals = star(tip, nod, 5, 0.8 * corolla, reflex=0.2 * openness - 0.5, spin=spin + 0.6, slim=0.45)
    cone = tube(tip + np.outer([0, 0.004, 0.008], nod), [0.0016, 0.0017, 0.0006], sides=8)
    for mesh, colour in ((petals, (247, 214, 36)), (sepals, SEPAL_GREEN), (cone, (232, 170, 22))):
        growth.surface(mesh, Organ.FLOWER, colour, pedicel)
