"""The branched networks that `rods.py` times: shapes only, 10 mm an edge, radius 3 mm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anther.rods import Rods

EDGE = 0.01
"""Length of every edge [m]."""
GOLDEN = np.radians(137.5)
"""Turn from one branch to the next up the stem [rad]: the phyllotactic golden angle."""
BRANCHES = ((15, 7), (20, 7), (28, 7), (35, 7), (42, 7))
"""(stem node, edges) of the branches of the reference network."""
SIDE_SHOOTS = (10, 25, 40, 50)
"""Stem nodes at which a shoot of a bush carries further shoots."""


def reference_network() -> Rods:
    """The 86-node network of the peers: a 51-node stem, five branches of 7 edges in 3-D, E 200 MPa, undamped."""
    return bush(1)


def bush(shoots: int) -> Rods:
    """A network of 1 + 85 `shoots` nodes: copies of the reference network that grow out of each other's stems.

    A stem of 12 000 nodes would be 120 m long: its coordinates alone would round the forces to 1e-6 N, and it could
    not stand. A bush keeps edge length, stiffness and joint degree (at most 4) and stays within a few metres. It is
    meant to be run without gravity.
    """
    nodes, parent, waiting = [np.zeros(3)], [-1], [(0, np.eye(3))]
    for made in range(shoots):
        foot, axes = waiting.pop(0)
        stem = [foot, *_grow(nodes, parent, foot, axes[:, 2], 50)]
        for k, (at, edges) in enumerate(BRANCHES):
            _grow(nodes, parent, stem[at], axes @ _outward(k), edges)
        turns = (axes @ _tilted(made + k) for k in range(len(SIDE_SHOOTS)))
        waiting += [(stem[at], turned) for at, turned in zip(SIDE_SHOOTS, turns, strict=True)]
    return Rods(np.array(nodes), np.array(parent), edge_radius=3e-3, youngs=2e8, density=1000.0)


def tall_plant() -> Rods:
    """A 200-node plant: a 130-node stem, ten branches of 7 edges in 3-D; E 5 GPa, so that 1.3 m can stand."""
    nodes, parent = [np.zeros(3)], [-1]
    stem = [0, *_grow(nodes, parent, 0, np.array([0.0, 0, 1]), 129)]
    for k in range(10):
        _grow(nodes, parent, stem[15 + 11 * k], _outward(k), 7)
    return Rods(np.array(nodes), np.array(parent), edge_radius=3e-3, youngs=5e9, density=1000.0, viscous_time=1e-4)


def tips(rods: Rods) -> NDArray[np.int64]:
    """Nodes without children, but for the top of the stem: where the flowers are."""
    bare = np.setdiff1d(np.arange(len(rods.nodes)), rods.parent)
    return bare[bare != np.argmax(rods.nodes[:, 2])]


def _grow(nodes: list, parent: list, start: int, way: NDArray[np.float64], edges: int) -> list[int]:
    """Append a straight branch to the lists; return its node numbers."""
    first = len(nodes)
    nodes += [nodes[start] + EDGE * (k + 1) * way for k in range(edges)]
    parent += [start, *range(first, first + edges - 1)]
    return list(range(first, first + edges))


def _outward(k: int) -> NDArray[np.float64]:
    """Unit vector at 45 degrees to z, in the direction of branch k."""
    return np.array([np.cos(GOLDEN * k), np.sin(GOLDEN * k), 1]) / np.sqrt(2)


def _tilted(k: int) -> NDArray[np.float64]:
    """Rotation whose z axis is `_outward(k)`."""
    axis = _outward(k)
    side = np.array([-np.sin(GOLDEN * k), np.cos(GOLDEN * k), 0])
    return np.stack([np.cross(side, axis), side, axis], axis=1)
