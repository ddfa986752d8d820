"""Rods with a simulated plant's own geometry, masses, stiffness and twist, cut where MuJoCo's pieces are.

K segments, N nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.core import Array
from anther.core.geometry import arc_length
from anther.plant import PRIORS, PlantModel
from anther.rods import Clamp, Rods, with_gravity_equilibrium
from anther.sim import Organ, SimPlant
from anther.sim.pieces import TWISTING

RIGID = 1e6
"""The edge below the soil is so many times as stiff as the one above it: the stem is clamped at the soil itself."""
ARM = 10.0
"""An arm to what a segment carries is so many times as stiff as the segment, and weighs nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueRods:
    """A simulated plant as rods.

    Attributes:
        model: as a planner would have it that knew everything.
        first: (K,) the first edge of each segment.
        last: (K,) the node at each segment's end.
    """

    model: PlantModel
    first: NDArray[Any]
    last: NDArray[Any]


def bare(plant: SimPlant) -> SimPlant:
    """Return the plant without blades and petals: what they weigh stays at their centres, and does not resist turning.

    The rods have no such inertia, which leaves MuJoCo and them the same plant.
    """
    stays = ~np.isin(plant.face_organ, (Organ.LEAF, Organ.FLOWER))
    return replace(plant, faces=plant.faces[stays], face_organ=plant.face_organ[stays])


class _Tree:
    """Nodes and edges in the making; edge j and node j have a number in common."""

    def __init__(self, plant: SimPlant) -> None:
        below = plant.start[0] - (plant.end[0] - plant.start[0])
        self.nodes, self.parent, self.mass = [below, plant.start[0]], [-1, 0], [0.0, 0.0]
        self.edges = [(plant.radius_start[0], RIGID * plant.youngs[0], plant.density[0], 0.0)] * 2

    def add(self, node: Array, parent: int, edge: tuple[float, float, float, float], mass: float = 0.0) -> int:
        """Add a node and the edge to it: radius, E, density, EI/GJ."""
        self.nodes.append(node)
        self.parent.append(parent)
        self.edges.append(edge)
        self.mass.append(mass)
        return len(self.nodes) - 1

    def rods(self) -> Rods:
        """Return the rods, hanging in equilibrium."""
        radius, youngs, density, twist = np.array(self.edges).T
        parent, mass = np.array(self.parent), np.array(self.mass)
        rods = Rods(np.array(self.nodes), parent, radius, youngs, density, bend_over_twist=twist, lumped_mass=mass)
        return with_gravity_equilibrium(rods, Clamp.root(rods))


def true_rods(plant: SimPlant) -> TrueRods:
    """Return a plant as rods, one edge a segment, or two where it carries a leaf or flower beside its middle."""
    tree, count = _Tree(plant), len(plant.start)
    first, last, tips = np.zeros(count, dtype=int), np.zeros(count, dtype=int), np.zeros(count, dtype=int)
    for k in range(count):
        above = int(last[plant.parent[k]]) if plant.parent[k] >= 0 else 1
        first[k], last[k], tips[k] = _add_segment(tree, plant, k, above)
    rods, n = tree.rods(), len(tree.nodes)
    of_pedicel = np.zeros(n, dtype=bool)
    for k in np.flatnonzero(plant.organ == Organ.PEDICEL):
        of_pedicel[first[k] : last[k] + 1] = True
    stem = plant.stem_segments()
    stem_nodes = np.concatenate([[0, 1], *(np.arange(int(first[k]), int(last[k]) + 1) for k in stem)])
    stem_nodes = np.array([0, *(j for j in stem_nodes[1:] if np.asarray(rods.density)[j] > 1)])
    leaving = np.flatnonzero(~np.isin(np.arange(count), stem) & np.isin(plant.parent, stem))
    material = replace(
        PRIORS[plant.species],
        youngs=float(plant.youngs[0]),
        density=float(plant.density[0]),
        damping_ratio=float(plant.damping_ratio[0]),
        bend_over_twist=plant.bend_over_twist,
    )
    model = PlantModel(
        rods=rods,
        stem_nodes=stem_nodes,
        arc_length=arc_length(rods.nodes[stem_nodes]),
        flower_nodes=tips[plant.flower_segment],
        branch_bases=first[leaving],
        is_pedicel=of_pedicel,
        material=material,
        pedicel_spread=0.2,
        least_youngs=1.0,
    )
    return TrueRods(model, first, last)


def _add_segment(tree: _Tree, plant: SimPlant, k: int, above: int) -> tuple[int, int, int]:
    """Add one segment; return its first edge, the node at its end and the node of what it carries.

    What it carries hangs on a node beside its centre, as it is held by the middle of a rigid piece in MuJoCo; on the
    end's where the centre lies beyond.
    """
    way, mass, centre = plant.end[k] - plant.start[k], float(plant.lump_mass[k]), plant.lump_centre[k]
    twist = plant.bend_over_twist if plant.organ[k] in TWISTING else 0.0

    def edge(share: float) -> tuple[float, float, float, float]:
        radius = plant.radius_start[k] + share * (plant.radius_end[k] - plant.radius_start[k])
        return radius, plant.youngs[k], plant.density[k], twist

    beside = float((centre - plant.start[k]) @ way / (way @ way))
    if mass == 0 or beside > 0.9:
        first = end = holder = tree.add(plant.end[k], above, edge(0.5))
    else:
        beside = max(beside, 0.1)
        first = holder = tree.add(plant.start[k] + beside * way, above, edge(beside / 2))
        end = tree.add(plant.end[k], first, edge(0.5 + beside / 2))
    if mass > 0 and np.linalg.norm(centre - tree.nodes[holder]) > 1e-4:
        radius, youngs, _, _ = edge(1.0)
        holder = tree.add(centre, holder, (radius, ARM * youngs, 1.0, twist), mass)
    else:
        tree.mass[holder] += mass
    return first, end, holder
