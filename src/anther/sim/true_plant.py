"""A simulated plant as it truly is: the one that grew, with a drawn truth's stiffness, masses, damping and sections.

What the cameras see stays as it grew, but for the pedicels' length. K segments.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.sim.growth import AREAL_DENSITY, buckling_factor, supported_youngs
from anther.sim.pieces import Params
from anther.sim.plant import Organ, SimPlant
from anther.sim.plant_mechanics import alone
from anther.sim.row_plants import held_by_string
from anther.sim.truth import NOMINAL, Truth

FOLIAGE = (Organ.PETIOLE, Organ.RACHIS, Organ.LEAF)
STALKS = (Organ.PEDUNCLE, Organ.PEDICEL)


def as_true(plant: SimPlant, truth: Truth) -> SimPlant:
    """Return the plant of a truth. Where the truth does not say how well it supports itself, it does so as it grew."""
    if truth == NOMINAL:
        return plant
    rng, branch = np.random.default_rng([plant.seed, 8]), branches(plant)
    plant = _lengthen_pedicels(plant, truth.pedicel_length)
    plant = _set_masses(plant, truth)
    plant = replace(
        plant,
        youngs=_youngs(plant, truth, branch, rng),
        damping_ratio=_damping(plant, truth),
        oval=_oval(plant, truth, branch, rng),
        bend_over_twist=truth.bend_over_twist,
        foot=truth.foot,
    )
    plant = replace(plant, joint_compliance=_joints(plant, truth))
    return _support(plant, truth, rng)


def branches(plant: SimPlant) -> NDArray[Any]:
    """Return (K,) which branch off the main stem a segment belongs to, by its first segment; -1 on the stem."""
    branch = np.full(len(plant.parent), -1)
    for k, p in enumerate(plant.parent):
        if plant.organ[k] != Organ.STEM:
            branch[k] = branch[p] if branch[p] >= 0 else k
    return branch


def _lengthen_pedicels(plant: SimPlant, factor: float) -> SimPlant:
    """Return the plant with pedicels as long as `factor` says; flowers go along and keep their size."""
    if factor == 1:
        return plant
    pedicel = plant.organ == Organ.PEDICEL
    base = plant.start.copy()
    for k in np.flatnonzero(pedicel):
        base[k] = base[plant.parent[k]] if pedicel[plant.parent[k]] else plant.start[k]
    moved = (factor - 1) * (plant.end - base)
    start = np.where(pedicel[:, None], base + factor * (plant.start - base), plant.start)
    end = np.where(pedicel[:, None], base + factor * (plant.end - base), plant.end)
    lump = np.where(pedicel[:, None], plant.lump_centre + moved, plant.lump_centre)
    bare = pedicel & (plant.lump_mass == 0)
    lump[bare] = (start + end)[bare] / 2
    flower = np.zeros(len(plant.vertices), dtype=bool)
    flower[plant.faces[plant.face_organ == Organ.FLOWER]] = True
    rides = np.where(plant.vertex_segment >= 0, plant.vertex_segment, 0)
    on_pedicel = (plant.vertex_segment >= 0) & pedicel[rides]
    stalk = base[rides] + factor * (plant.vertices - base[rides])
    vertices = np.where((on_pedicel & ~flower)[:, None], stalk, plant.vertices)
    vertices = np.where((on_pedicel & flower)[:, None], plant.vertices + moved[rides], vertices)
    flowers = plant.flower_position + moved[plant.flower_segment]
    return replace(plant, start=start, end=end, lump_centre=lump, vertices=vertices, flower_position=flowers)


def _set_masses(plant: SimPlant, truth: Truth) -> SimPlant:
    """Return the plant with its leaves' and flowers' masses, and what the air finds of them."""
    flowers = np.zeros(len(plant.start), dtype=bool)
    flowers[plant.flower_segment] = True
    drag = truth.drag_coefficient or 0.31  # Sase 2012 (facts: pollination 6)
    area = np.where(flowers, 1.5e-4, drag * plant.lump_mass / AREAL_DENSITY)  # m2 of a flower (facts: pollination 6)
    factor = np.where(flowers, truth.flower_mass, truth.leaf_density)
    blown = truth.drag_coefficient > 0 or truth.wind > 0
    return replace(plant, lump_mass=factor * plant.lump_mass, drag_area=area if blown else 0 * area)


def _youngs(plant: SimPlant, truth: Truth, branch: NDArray[Any], rng: np.random.Generator) -> Array:
    foot, top = plant.start[0, 2], plant.end[plant.stem_segments(), 2].max()
    share = np.clip(((plant.start + plant.end)[:, 2] / 2 - foot) / (top - foot), 0, 1)
    own = rng.normal(size=len(branch) + 1)[branch]
    logs = truth.stiffness_gradient * share + truth.branch_scatter * np.where(branch < 0, 0.0, own)
    pedicel = plant.organ == Organ.PEDICEL
    return plant.youngs * np.where(pedicel, truth.pedicel_youngs, np.exp(logs))


def _damping(plant: SimPlant, truth: Truth) -> Array:
    kinds = [np.isin(plant.organ, FOLIAGE), np.isin(plant.organ, STALKS)]
    ratios = [truth.leaf_damping, truth.stalk_damping, truth.wood_damping]
    leaf, stalk, wood = (plant.damping_ratio if ratio is None else ratio for ratio in ratios)
    return np.select(kinds, [leaf, stalk], wood) * np.ones(len(plant.organ))


def _oval(plant: SimPlant, truth: Truth, branch: NDArray[Any], rng: np.random.Generator) -> Array:
    """Return (K, 3) the wider axes: one horizontal direction a branch, turned with the plant; pedicels are round."""
    angle = rng.uniform(0, 2 * np.pi, len(branch) + 1)[branch] + _azimuth(plant)
    wide = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
    along = (plant.end - plant.start) / plant.length[:, None]
    across = wide - np.einsum("ki,ki->k", wide, along)[:, None] * along
    size = np.linalg.norm(across, axis=1, keepdims=True)
    fits = (size[:, 0] > 0.1) & (plant.organ != Organ.PEDICEL)
    return np.where(fits[:, None], np.log(truth.oval) * across / np.maximum(size, 1e-9), 0.0)


def _azimuth(plant: SimPlant) -> float:
    """Return an angle that turns with the plant when it is turned in its pot [rad]: of its first branch."""
    first = int(np.argmax(plant.organ != Organ.STEM))
    x, y, _ = plant.end[first] - plant.start[first]
    return float(np.arctan2(y, x))


def _joints(plant: SimPlant, truth: Truth) -> Array:
    """Return (K,) the compliance of the abscission joint: at the knee, or at the base where there is none."""
    pedicel = plant.organ == Organ.PEDICEL
    last = pedicel.copy()
    last[plant.parent[pedicel]] = False
    bending = plant.length / (plant.youngs * np.pi / 4 * ((plant.radius_start + plant.radius_end) / 2) ** 4)
    whole = bending + np.where(pedicel[plant.parent], bending[plant.parent], 0.0)
    return np.where(last, truth.pedicel_joint * whole, 0.0)


def _support(plant: SimPlant, truth: Truth, rng: np.random.Generator) -> SimPlant:
    """Return the plant with the self-support of the truth, tied to a stake where that is little: below 1.5.

    A plant on strings is held up by them. A cane of 1 cm in a pot holds the stem with 20-200 N/m (a guess). Plants
    slower than 0.3 Hz are made stiffer.
    """
    share, strength = rng.uniform(0.55, 0.85), np.exp(rng.uniform(*np.log((20.0, 200.0))))
    if plant.twines:
        return held_by_string(plant)
    if truth.self_support is None:
        return supported_youngs(plant)
    stiffer = truth.self_support / buckling_factor(plant)
    youngs = np.where(plant.organ == Organ.PEDICEL, plant.youngs, stiffer * plant.youngs)
    stem = plant.stem_segments()
    arc = np.cumsum(plant.length[stem])
    tied = (int(stem[np.searchsorted(arc, share * arc[-1])]), float(strength))
    plant = replace(plant, youngs=youngs, tie=tied if truth.self_support < 1.5 else None)
    while not _is_stable(plant):
        plant = replace(plant, youngs=np.where(plant.organ == Organ.PEDICEL, plant.youngs, 1.2 * plant.youngs))
    return plant


def _is_stable(plant: SimPlant) -> bool:
    try:
        slowest = 0.3  # Hz: a slower plant would twist over in a breath of air (facts: pollination 2)
        return bool(alone(plant, Params(twist_every=1)).frequencies[0] >= slowest)
    except StageFailure:
        return False
