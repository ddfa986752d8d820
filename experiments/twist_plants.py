"""The plants of twist.py as rods: the paper's two real ones, and those of the simulated greenhouse."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.elastic_rod import Clamp, Rods, least_stiffness
from anther.formats.skeletons import read_skeleton
from anther.sim.plant import SimPlant

Array = NDArray[np.float64]

SOFTEST = 12.0
"""EI/GJ at which a plant must stand."""
MARGIN = 1.5
"""E is at least so many times that at which the plant buckles."""
REAL = {"tomato2": (27, 73, 1100.0), "pepper0": (71, 143, 1500.0)}
"""The authors' grip node, flower node and density [kg/m^3]."""
REAL_RADIUS, REAL_DAMPING = 3e-3, 0.05
"""[m], the authors' own measured stem; damping ratio, the plant model's prior."""
GRIP_SHARES = (0.25, 0.5, 0.75)
EDGE = 0.01
"""Longest edge of the simulated plants' rods [m]."""


@dataclass(frozen=True, eq=False)
class Plant:
    """A plant to shake.

    Attributes:
        name: shown in the table.
        rods: undamped, EI/GJ = 12, stiff enough to stand.
        grips: (G,) stem nodes.
        flowers: (F,) nodes.
        damping_ratio: of motion at any frequency.
        youngs: of the stem [Pa].
    """

    name: str
    rods: Rods
    grips: NDArray[Any]
    flowers: NDArray[Any]
    damping_ratio: float
    youngs: float


def real_plants(folder: Path) -> list[Plant]:
    """Return the paper's plants that are in a folder."""
    out = []
    for name, (grip, flower, density) in REAL.items():
        path = folder / f"{name}.txt"
        if not path.is_file():
            continue
        skeleton = read_skeleton(path)
        rods = Rods(skeleton.nodes, skeleton.parent, REAL_RADIUS, 1e8, density, bend_over_twist=SOFTEST)
        nodes = ([skeleton.node(grip)], [skeleton.node(flower)])
        out.append(_standing(name, rods, *nodes, REAL_DAMPING, at_least=0.0))
    return out


def simulated_plant(plant: SimPlant) -> Plant:
    """Return a simulated plant as rods: its segments cut to EDGE, leaves and flowers as masses where they are."""
    builder = Builder(plant)
    stem = plant.stem_segments()
    arc = np.cumsum(plant.length[stem])
    grips = [int(builder.last[stem[np.argmin(np.abs(arc - share * arc[-1]))]]) for share in GRIP_SHARES]
    flowers = [int(builder.last[k]) for k in plant.flower_segment]
    name = f"{plant.species} {plant.seed}"
    return _standing(name, builder.rods(), grips, flowers, float(plant.damping_ratio[0]), at_least=1.0)


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


def _standing(name: str, rods: Rods, grips: list[int], flowers: list[int], damping: float, *, at_least: float) -> Plant:
    """Stiffen the rods to MARGIN times what just stands, and to `at_least` times what was given."""
    least = least_stiffness(rods, Clamp.root(rods))
    if least is None:
        raise SystemExit(f"{name}: does not stand at any stiffness")
    stiff = replace(rods, youngs=np.asarray(rods.youngs) * max(MARGIN * least, at_least))
    return Plant(name, stiff, np.array(grips), np.array(flowers), damping, float(np.asarray(stiff.youngs)[1]))
