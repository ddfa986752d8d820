"""Skeleton: the plant as ONE rooted tree of centreline nodes with radii. J nodes, E = J - 1 edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array
from anther.errors import bad_input
from anther.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """One connected, acyclic, rooted tree. Node 0 is the root (where the stem leaves the soil).

    Every node comes after its parent, so a plain loop over the arrays walks from the root to the tips.

    Attributes:
        nodes: (J, 3) centreline positions, world frame [m].
        parent: (J,) int, index of the parent node; parent[0] = -1 and parent[j] < j.
        radius: (J,) radius at the node [m].
        notes: what the stage wants the user to know.
    """

    nodes: Array
    parent: NDArray[Any]
    radius: Array
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.nodes)
        object.__setattr__(self, "nodes", check_array("skeleton nodes", self.nodes, (n, 3)))
        parent = check_array("skeleton parent", self.parent, (n,), dtype="int64")
        object.__setattr__(self, "parent", parent)
        object.__setattr__(self, "radius", check_array("skeleton radius", self.radius, (n,)))
        ordered = n >= 2 and parent[0] == -1 and bool(np.all((parent[1:] >= 0) & (parent[1:] < np.arange(1, n))))
        if not ordered:
            raise bad_input(
                "skeleton parent",
                given=f"{n} nodes, parents {parent[:5]}...",
                allowed="at least 2 nodes, parent[0] = -1, 0 <= parent[j] < j",
                do="Order the nodes from the root outward.",
            )
        if np.any(self.radius <= 0):
            raise bad_input("skeleton radius", given="a radius <= 0", allowed="> 0 m", do="Check the radii.")

    @property
    def edges(self) -> NDArray[Any]:
        """(E, 2) node pairs (parent, child)."""
        return np.stack([self.parent[1:], np.arange(1, len(self.nodes))], axis=1)

    @property
    def children_count(self) -> NDArray[Any]:
        """(J,) number of children of each node; 0 at a tip."""
        return np.bincount(self.parent[1:], minlength=len(self.nodes))

    def path_from_root(self, node: int) -> NDArray[Any]:
        """Return the node indices from the root to `node`."""
        path = [node]
        while self.parent[path[-1]] >= 0:
            path.append(int(self.parent[path[-1]]))
        return np.array(path[::-1])
