"""A pot pepper at first flowering, random by seed.

Sources. facts: pollination section 2: 7-12 leaves on the main stem to the first flower, then 2-4 branches, at each node
a flower and one or two branches, spiral simple leaves. Marked [R] there (remembered, no source found): height
0.3-0.6 m, base 8-12 mm, branches 4-6 mm, leaf 0.5-2 g, flower 0.1 g on a pedicel of 10-20 mm. Estimates of ours: leaf
blade 60-130 mm, petiole 0.4 of it, areal density 0.25 kg/m2, tissue density 1000 kg/m3, postures and colours.
"""

from __future__ import annotations

import numpy as np

from anther.core.geometry import Array
from anther.sim.growth import AREAL_DENSITY, GOLDEN_ANGLE, Growth, arc, blade_colours, ripple
from anther.sim.mesh import blade, star, tube, unit
from anther.sim.plant import POT_AXIS, Organ, SimPlant

BRANCH_GREEN = (112, 146, 70)


def grow_pepper(seed: int, *, viewpoint: float = 0.0, axis: tuple[float, float] = POT_AXIS) -> SimPlant:
    """Return a pot pepper at first flowering.

    Args:
        seed: the same seed gives the same plant.
        viewpoint: turns the plant about the pot's axis [deg].
        axis: where the pot stands in the world, x and y [m].
    """
    rng = np.random.default_rng([seed, 2])
    growth = Growth(rng)
    leaves, tallness = int(rng.integers(7, 13)), rng.uniform()
    height, base = 0.3 + 0.25 * tallness, 0.004 + 0.002 * (0.6 * tallness + 0.4 * rng.uniform())
    fork = height * rng.uniform(0.48, 0.58)
    stem = _grow_stem(growth, leaves, fork, base)
    azimuth = rng.uniform(0, 2 * np.pi)
    for node in range(leaves):
        azimuth += GOLDEN_ANGLE + rng.normal(0, np.radians(10))
        size = rng.uniform(0.85, 1.15) * (0.085 + 0.045 * np.sin(np.pi * (node + 1) / (leaves + 0.6)))
        grow_leaf(growth, stem[node], azimuth, size, young=0.0)
    _grow_fork(growth, stem[-1], unit([0.0, 0.0, 1.0]), height - fork, base * 0.72, order=0)
    return growth.finish("pepper", seed, axis=axis, viewpoint=viewpoint)


def _grow_stem(growth: Growth, leaves: int, height: float, base: float) -> list[int]:
    """The main stem to the first fork: a bare foot, then one segment an internode; each but the foot ends at a leaf."""
    rng = growth.rng
    t = np.concatenate([[0, 0.14, 0.26], 0.26 + 0.74 * np.cumsum(rng.uniform(0.8, 1.2, leaves)) / leaves])
    t /= t[-1]
    lean, direction = rng.uniform(0, 0.04), rng.uniform(0, 2 * np.pi)
    along = lean * t**1.5
    points = np.stack([along * np.cos(direction), along * np.sin(direction), height * t], axis=1)
    points[2:-1, :2] += 0.05 * (height / leaves) * rng.normal(size=(leaves, 2))
    return growth.chain(points, base * (1 - 0.28 * t), Organ.STEM, -1, (104, 132, 66), sides=12)[1:]


def _grow_fork(growth: Growth, parent: int, along: Array, reach: float, radius: float, *, order: int) -> None:
    """A fork with its flower: two (now and then three) branches, each of which forks once more."""
    rng = growth.rng
    count = 3 if order == 0 and rng.random() < 0.35 else 2
    spread = rng.uniform(0, 2 * np.pi)
    first = unit(np.cross(along, [0.31, 0.42, 0.2]))
    second = np.cross(along, first)
    grow_flower(growth, parent, unit(np.cos(spread + 1.3) * first + np.sin(spread + 1.3) * second + 0.5 * along))
    for i in range(count):
        angle = spread + 2 * np.pi * i / count + rng.normal(0, 0.25)
        outward = np.cos(angle) * first + np.sin(angle) * second
        tilt = rng.uniform(0.45, 0.75) if order == 0 else rng.uniform(0.4, 0.7)
        way = unit(np.cos(tilt) * along + np.sin(tilt) * outward)
        length, thick = 0.62 * reach * rng.uniform(0.8, 1.1), radius * rng.uniform(0.7, 0.85)
        _grow_branch(growth, parent, way, length=length, radius=thick, order=order)


def _grow_branch(growth: Growth, parent: int, way: Array, *, length: float, radius: float, order: int) -> None:
    """One branch that curves upwards, with a leaf at its end node and the next fork or a young shoot there."""
    rng = growth.rng
    base = growth.end(parent)
    upward = unit(way + np.array([0, 0, 0.45]))
    points = np.stack([base, base + 0.5 * length * way, base + length * (0.5 * way + 0.5 * upward)])
    branch = growth.chain(points, radius * np.array([1, 0.88, 0.78]), Organ.BRANCH, parent, BRANCH_GREEN)
    azimuth = float(np.arctan2(way[1], way[0]))
    grow_leaf(growth, branch[-1], azimuth + rng.normal(0, 0.4), rng.uniform(0.07, 0.115), young=0.3 * (order + 1))
    grow_leaf(
        growth, branch[0], azimuth + rng.choice([-1.0, 1.0]) * rng.uniform(1.2, 2.2), rng.uniform(0.05, 0.09), young=0.4
    )
    if order == 0:
        _grow_fork(growth, branch[-1], upward, length, radius * 0.8, order=1)
        return
    if rng.random() < 0.6:
        grow_flower(growth, branch[-1], unit(np.array([*rng.normal(size=2), 0.2])))
    for turn in (0.8, 2.9, 5.0):
        size = rng.uniform(0.025, 0.055)
        grow_leaf(growth, branch[-1], azimuth + turn + rng.normal(0, 0.3), size, young=1.0)


def grow_leaf(growth: Growth, parent: int, azimuth: float, length: float, *, young: float) -> None:
    """A simple leaf: petiole, then a midrib that carries an ovate, pointed blade."""
    rng = growth.rng
    stalk = (0.45 - 0.2 * young) * length * rng.uniform(0.8, 1.2)
    rise = np.radians(rng.uniform(20, 50) + 15 * young)
    radius = 0.0006 + 0.009 * length
    line = arc(growth.end(parent), azimuth, stalk, (rise, rise - 0.15), 2)
    petiole = growth.chain(
        line[[0, 2]], [radius * 1.2, radius * 0.9], Organ.PETIOLE, parent, BRANCH_GREEN, sides=6, tip=False
    )
    droop = rng.uniform(0.5, 1.1) * (1 - 0.6 * young)
    midrib = arc(line[-1], azimuth + rng.normal(0, 0.1), length, (rise - 0.3, rise - 0.3 - droop), 14)
    rib = growth.chain(
        midrib[[0, 7, 14]], radius * np.array([0.85, 0.6, 0.3]), Organ.LEAF, petiole[-1], BRANCH_GREEN, sides=5
    )
    u = np.linspace(0, 1, 15)
    half_width = (
        length * rng.uniform(0.24, 0.31) * np.maximum(np.sin(np.pi * u**0.75) ** 0.9 * (1.05 - 0.35 * u), 0.004)
    )
    side = unit(np.cross(np.gradient(midrib, axis=0), [0, 0, 1.0]))
    wave = ripple(rng, 15, 0.03 * length)
    vertices, faces = blade(midrib, side, half_width, fold=rng.normal(0.12, 0.15) + 0.3 * young, ripple=wave)
    beside = [growth.beside(rib[-1], point) for point in midrib]
    colour = (1 - young) * np.array((46, 96, 38)) + young * np.array((96, 142, 52))
    rides = np.repeat(beside, wave.shape[1])
    growth.surface((vertices, faces), Organ.LEAF, blade_colours(rng, colour, 15), rides)
    strip = AREAL_DENSITY * 2 * half_width * length / 14
    for segment, mass, point in zip(beside, strip, midrib, strict=True):
        growth.carry(segment, float(mass), point)


def grow_flower(growth: Growth, parent: int, out: Array) -> None:
    """A single nodding white flower on a curved pedicel."""
    rng = growth.rng
    kind = {"length": (0.01, 0.02), "mass": (0.07e-3, 0.13e-3), "nod": (0.6, 1.6)}
    green = (98, 136, 62)
    pedicel, tip, nod = growth.flower(parent, out, green, **kind, parts=(0.5, 0.5), widths=(1, 1, 1.1))
    corolla, spin = rng.uniform(0.009, 0.0125), rng.uniform(0, 2 * np.pi)
    petals = star(tip + 0.002 * nod, nod, int(rng.integers(5, 8)), corolla, reflex=rng.uniform(-0.4, 0.3), spin=spin)
    cup = tube(tip + np.outer([-0.001, 0.002, 0.004], nod), [0.0015, 0.0032, 0.0034], sides=8, tip=False)
    cone = tube(tip + np.outer([0.001, 0.005, 0.0065], nod), [0.0012, 0.0019, 0.001], sides=8)
    for mesh, colour in ((petals, (244, 244, 236)), (cup, green), (cone, (120, 118, 150))):
        growth.surface(mesh, Organ.FLOWER, colour, pedicel)
