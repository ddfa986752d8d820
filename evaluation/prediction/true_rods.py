"""A simulated plant as rods with its own geometry, masses and stiffness."""

from __future__ import annotations

import numpy as np

from anther.core import Array
from anther.rods import Rods
from anther.sim import SimPlant

SOFTEST = 12.0
"""EI/GJ of everything that twists."""
EDGE = 0.01
"""Longest edge [m]."""


class Builder:
    """A simulated plant as nodes; `nodes_of` are those of each segment, `last` its end."""

    def __init__(self, plant: SimPlant) -> None:
        self.plant, self.last = plant, np.zeros(len(plant.start), dtype=int)
        self.nodes_of: list[list[int]] = [[] for _ in plant.start]
        self.nodes, self.parent, self.mass = [plant.start[0]], [-1], [0.0]
        self.material = [(plant.radius_start[0], plant.youngs[0], plant.density[0])]
        for k in range(len(plant.start)):
            self._add_segment(k)
        for k in np.flatnonzero(plant.lump_mass > 0):
            self._add_mass(int(k))

    def _add(self, node: Array, parent: int, material: tuple[float, float, float], mass: float = 0.0) -> int:
        self.nodes.append(node)
        self.parent.append(parent)
        self.material.append(material)
        self.mass.append(mass)
        return len(self.nodes) - 1

    def _add_segment(self, k: int) -> None:
        plant, above = self.plant, int(self.last[self.plant.parent[k]]) if self.plant.parent[k] >= 0 else 0
        count = max(1, int(np.ceil(plant.length[k] / EDGE)))
        for i in range(1, count + 1):
            thick = plant.radius_start[k] + (plant.radius_end[k] - plant.radius_start[k]) * (i - 0.5) / count
            node = plant.start[k] + (plant.end[k] - plant.start[k]) * i / count
            above = self._add(node, above, (thick, plant.youngs[k], plant.density[k]))
            self.nodes_of[k].append(above)
        self.last[k] = above

    def _add_mass(self, k: int) -> None:
        """Hang leaf or flower mass by a light, stiff arm on the last node of the segment that lies before it.

        The mass sits on the node itself where the arm would be shorter than 1 mm or fold back.
        """
        plant, mass = self.plant, float(self.plant.lump_mass[k])
        along = (plant.end[k] - plant.start[k]) / plant.length[k]
        ahead = np.array([(plant.lump_centre[k] - self.nodes[n]) @ along for n in self.nodes_of[k]])
        node = self.nodes_of[k][max(int(np.sum(ahead >= 0)) - 1, 0)]
        arm = plant.lump_centre[k] - self.nodes[node]
        reach = float(np.linalg.norm(arm))
        if reach < 1e-3 or arm @ along < -0.9 * reach:
            self.mass[node] += mass
        else:
            self._add(plant.lump_centre[k], node, (plant.radius_end[k], 10 * plant.youngs[k], 1.0), mass)

    def rods(self) -> Rods:
        """Return the nodes as undamped rods."""
        radius, youngs, density = np.array(self.material).T
        nodes, parent = np.array(self.nodes), np.array(self.parent)
        return Rods(nodes, parent, radius, youngs, density, bend_over_twist=SOFTEST, lumped_mass=np.array(self.mass))
