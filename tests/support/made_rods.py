"""Small rods that several tests shake."""

from __future__ import annotations

import numpy as np

from anther.rods import Rods

NO_GRAVITY = (0.0, 0.0, 0.0)


def cantilever(edges: int = 40, *, axis: int = 0, length: float = 0.3, **changes) -> Rods:
    nodes = np.zeros((edges + 1, 3))
    nodes[:, axis] = np.linspace(0, length, edges + 1)
    values = {"edge_radius": 3e-3, "youngs": 2e8, "density": 1100.0} | changes
    return Rods(nodes, np.arange(edges + 1) - 1, **values)


def random_tree(seed: int, n: int = 9, **changes) -> Rods:
    """A 3-D tree with several children at the root, different radii, and a natural shape of its own."""
    rng = np.random.default_rng(seed)
    parent = np.array([-1, 0, 0, 0, *(rng.integers(1, j) for j in range(4, n))])
    nodes = np.zeros((n, 3))
    for j in range(1, n):
        way = rng.normal(size=3) + np.array([0, 0, 1.5])
        nodes[j] = nodes[parent[j]] + 0.02 * way / np.linalg.norm(way)
    values = {
        "edge_radius": rng.uniform(1e-3, 3e-3, n),
        "youngs": rng.uniform(1e8, 3e8, n),
        "density": 1000.0,
        "bend_over_twist": 3.0,
    } | changes
    return Rods(nodes, parent, **values)
