"""Forces and torques of one's own on rods: a pull, wind, a weight on a thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from anther.core.checks import check_array
from anther.core.errors import bad_input
from anther.rods._rods import Array, Rods


@dataclass(frozen=True, slots=True, eq=False)
class Loads:
    """What pulls and turns N nodes, in the world's directions, which stay as the rods move.

    A torque that turns its edge by more than about a right angle has no stable equilibrium here and is refused.

    Attributes:
        force: (N, 3) on node j [N].
        torque: (N, 3) on edge j, the one that ends at node j [N m].
        per_length: (N, 3) on edge j, per metre of its scanned length, as of wind [N/m].
    """

    force: Array
    torque: Array
    per_length: Array

    def __post_init__(self) -> None:
        for name in ("force", "torque", "per_length"):
            object.__setattr__(self, name, check_array(f"load {name}", getattr(self, name), (len(self.force), 3)))
        for name in ("torque", "per_length"):
            if np.any(getattr(self, name)[0]):
                raise bad_input(f"load {name}", given="one on node 0", allowed="edges 1 to N - 1", do="Load an edge.")

    @classmethod
    def at(cls, rods: Rods, node: int, force: ArrayLike = (0, 0, 0), torque: ArrayLike = (0, 0, 0)) -> Loads:
        """Return a force (3,) [N] on one node, and a torque (3,) [N m] on the edge that ends there."""
        if not 0 <= node < len(rods.nodes):
            raise bad_input("load node", given=node, allowed=f"0 to {len(rods.nodes) - 1}", do="Check the node number.")
        forces, torques = np.zeros((2, len(rods.nodes), 3))
        forces[node], torques[node] = force, torque
        return cls(forces, torques, np.zeros_like(forces))

    @classmethod
    def along(cls, rods: Rods, per_length: ArrayLike) -> Loads:
        """Return the same force per length (3,) [N/m] on all edges."""
        all_edges = np.tile(np.asarray(per_length, dtype=np.float64), (len(rods.nodes), 1))
        all_edges[0] = 0
        return cls(0 * all_edges, 0 * all_edges, all_edges)

    def __mul__(self, factor: float) -> Loads:
        """Return all of it times a factor, as of a force history."""
        return Loads(factor * self.force, factor * self.torque, factor * self.per_length)

    def __add__(self, other: Loads) -> Loads:
        """Return both at once."""
        return Loads(self.force + other.force, self.torque + other.torque, self.per_length + other.per_length)

    @property
    def turns(self) -> bool:
        """Whether there is a torque, the forces of which turn with the edges."""
        return bool(np.any(self.torque))

    def on(self, rods: Rods, x: Array) -> Array:
        """Return (N, 4) forces on nodes [N] and moments that spin edges [N m], at positions x (N, 3) [m].

        A torque T across an edge e is the couple of forces T x e / |e|^2 at its end and the opposite one at its start.

        Raises:
            InputError: loads of another number of nodes.
        """
        if len(self.force) != len(x):
            raise bad_input("loads", given=f"{len(self.force)} nodes", allowed=f"{len(x)} nodes", do="Make them anew.")
        edges = x - x[rods.parent]
        edges[0] = 1
        square = np.sum(edges**2, axis=1, keepdims=True)
        couple, half = np.cross(self.torque, edges) / square, self.per_length * rods.lengths[:, None] / 2
        out = np.zeros((len(x), 4))
        out[:, :3] = self.force + couple + half
        np.add.at(out[:, :3], rods.parent[1:], (half - couple)[1:])
        out[:, 3] = np.sum(self.torque * edges, axis=1) / np.sqrt(square[:, 0])
        return out


History = Callable[[float], Loads | None]
"""Loads at a time [s]."""
