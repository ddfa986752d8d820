"""Plants that are harder to take than those that grow: leaning, denser, two stems in a pot, swaying. K segments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.core import Array, transform
from anther.core.geometry import transform_each
from anther.robot.arm.sawyer import SAWYER
from anther.sim import Organ, SimPlant
from anther.sim.cell import Cell
from anther.sim.growth import supported_youngs
from anther.sim.plant import OF_SEGMENTS

LEAN = 20.0  # degrees from upright
SPREAD = 65.0  # degrees by which the added leaves stand beside the old ones
SECOND_STEM = 0.05  # m beside the first
SMALLER = 0.75  # the second plant's size as a share of its own
SWAY = 0.01  # m, about how far the wind moves the plant's tip to either side
GUSTS = 0.8  # their frequency as a share of the plant's first
TIP = 1.5  # of the tip's swing to that of one mass on one spring: a cantilever's first mode (Euler-Bernoulli: 1.57)
CALM = 1.5  # s of wind before the first view


def leaning(plant: SimPlant, rng: np.random.Generator) -> SimPlant:
    """Return the plant leaning by `LEAN` to a random side, in equilibrium so, and stiff enough for it."""
    turn = rng.uniform(0, 2 * np.pi)
    lean = Rotation.from_rotvec(np.radians(LEAN) * np.array([np.cos(turn), np.sin(turn), 0]))
    return supported_youngs(_placed(plant, np.tile(_about(plant.start[0], lean), (len(plant.start), 1, 1))))


def denser(plant: SimPlant, rng: np.random.Generator) -> SimPlant:
    """Return the plant with every leaf twice: again `SPREAD` around the stem, to a random side."""
    leaf = np.isin(plant.organ, (Organ.PETIOLE, Organ.RACHIS, Organ.LEAF))
    root = np.arange(len(leaf))
    for k in np.flatnonzero(leaf):
        root[k] = root[plant.parent[k]] if leaf[plant.parent[k]] else k
    angle = np.radians(SPREAD) * rng.choice([-1.0, 1.0], len(leaf))
    T = [_about(plant.start[r], Rotation.from_rotvec([0, 0, angle[r]])) for r in root]
    return supported_youngs(_grafted(plant, _placed(plant, np.array(T)), leaf, plant.parent))


def two_stems(plant: SimPlant, other: SimPlant, rng: np.random.Generator) -> SimPlant:
    """Return the plant with another, smaller one in its pot, `SECOND_STEM` beside it, whose stem counts as a branch."""
    side = rng.uniform(0, 2 * np.pi)
    foot = plant.start[0] + SECOND_STEM * np.array([np.cos(side), np.sin(side), 0])
    T = transform(np.eye(3), foot)
    T[:3, :3] *= SMALLER
    T[:3, 3] -= SMALLER * other.start[0]
    beside = _placed(other, np.tile(T, (len(other.start), 1, 1)))
    thinner = {name: SMALLER * getattr(beside, name) for name in ("radius_start", "radius_end")}
    organ = np.where(beside.organ == Organ.STEM, int(Organ.BRANCH), beside.organ)
    beside = replace(beside, **thinner, organ=organ, lump_mass=SMALLER**2 * beside.lump_mass)
    everything = np.ones(len(organ), dtype=bool)
    return supported_youngs(_grafted(plant, beside, everything, np.zeros(len(organ), dtype=int)))


def swaying(plant: SimPlant, views: int, rng: np.random.Generator) -> list[Array]:
    """Return T_world_rest (K, 4, 4) of the plant in gusts, as each of the views finds it.

    The wind is a sideways acceleration of all mass, most of which is leaves, near the plant's first frequency, as
    strong as moves the tip by about `SWAY`.
    """
    cell = Cell(plant, SAWYER.ready)
    side, step = rng.uniform(0, 2 * np.pi), cell.params.timestep
    first = 2 * np.pi * float(cell.mechanics.frequencies[0])
    strength = SWAY / TIP * first**2 * (1 - GUSTS**2)
    seen = np.sort(rng.uniform(CALM, CALM + 3.0, views))
    out, still = [], np.zeros((1, 7))
    while len(out) < views:
        push = strength * np.sin(GUSTS * first * cell.time)
        cell.model.opt.gravity[:2] = push * np.cos(side), push * np.sin(side)
        cell.run(cell.arm_command[None], still, np.array([cell.grip_command]))
        while len(out) < views and cell.time >= seen[len(out)] - step / 2:
            out.append(cell.segment_poses())
    return [out[i] for i in rng.permutation(views)]


def sway(plant: SimPlant, poses: list[Array]) -> float:
    """Return how far the plant's highest point is from where it was at rest, at most [m]."""
    top = int(plant.end[:, 2].argmax())
    moved = [(T[top] @ [*plant.end[top], 1])[:3] - plant.end[top] for T in poses]
    return float(np.linalg.norm(moved, axis=1).max())


def _about(point: Array, turn: Rotation) -> Array:
    """Return the transform that turns about a point (3,)."""
    R = turn.as_matrix()
    return transform(R, point - R @ point)


def _placed(plant: SimPlant, T: Array) -> SimPlant:
    """Return the plant with each segment, and all that rides on it, moved by its T (K, 4, 4)."""

    def moved(points: Array, of: NDArray[np.int_]) -> Array:
        return transform_each(T[of], points)

    every = np.arange(len(T))
    ends = {name: moved(getattr(plant, name), every) for name in ("start", "end", "lump_centre")}
    flowers = moved(plant.flower_position, plant.flower_segment)
    return replace(plant, **ends, flower_position=flowers, vertices=plant.posed_vertices(T))


def _grafted(plant: SimPlant, donor: SimPlant, kept: NDArray[np.bool_], parent: NDArray[np.int_]) -> SimPlant:
    """Return the plant with the kept segments (K,) of a donor, whose roots hang on `parent` (K,) of the plant."""
    number = len(plant.start) + np.cumsum(kept) - 1
    inner = (donor.parent >= 0) & kept[donor.parent]
    arrays = {n: np.concatenate([getattr(plant, n), getattr(donor, n)[kept]]) for n in OF_SEGMENTS}
    arrays["parent"] = np.concatenate([plant.parent, np.where(inner, number[donor.parent], parent)[kept]])
    flower = kept[donor.flower_segment]
    arrays["flower_segment"] = np.concatenate([plant.flower_segment, number[donor.flower_segment[flower]]])
    arrays["flower_position"] = np.concatenate([plant.flower_position, donor.flower_position[flower]])
    rides = (donor.vertex_segment >= 0) & kept[donor.vertex_segment]
    place = len(plant.vertices) + np.cumsum(rides) - 1
    face = rides[donor.faces].all(axis=1)
    arrays["vertices"] = np.concatenate([plant.vertices, donor.vertices[rides]])
    arrays["vertex_color"] = np.concatenate([plant.vertex_color, donor.vertex_color[rides]])
    arrays["vertex_segment"] = np.concatenate([plant.vertex_segment, number[donor.vertex_segment[rides]]])
    arrays["faces"] = np.concatenate([plant.faces, place[donor.faces[face]]]).astype(np.int32)
    arrays["face_organ"] = np.concatenate([plant.face_organ, donor.face_organ[face]])
    return replace(plant, **arrays)
