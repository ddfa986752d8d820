"""What a small vibration does to the plant: flower motion, bending strain and leaf load, linear in the displacement.

N rod nodes, F flowers, K observed vectors (K, 3), each with a factor that turns its length into a physical value.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from anther.elastic_rod.model import bend_stiffness
from anther.elastic_rod.rods import Array, Rods
from anther.plant import PlantModel

ComplexArray = NDArray[np.complex128]


class Observables(NamedTuple):
    """A sparse operator from the displacements (3N,) of all nodes to observed vectors (3K,), and where each kind is.

    Attributes:
        operator: (3K, 3N) sparse.
        flowers: (F,) rows of K that are flower displacements [m].
        stem_strain: rows of K whose length is the bending strain at the surface of a stem edge [-].
        joint_strain: the same for pedicels.
        base_strain: rows of K whose length, times the squared angular frequency, is the bending strain at the surface
            of a branch's base [-].
        leaf_load: rows of K whose length, times the squared angular frequency, is an equivalent acceleration [m/s2].
    """

    operator: Any
    flowers: NDArray[Any]
    stem_strain: NDArray[Any]
    joint_strain: NDArray[Any]
    base_strain: NDArray[Any]
    leaf_load: NDArray[Any]


def observables(plant: PlantModel) -> Observables:
    """Return what is observed of a plant.

    The strain of a joint is its moment, stiffness times change of angle, over the section modulus EI / (E r) of its two
    edges; the larger of both counts. The strain of a branch's base is the inertia torque of all that it carries over
    its section modulus, since the angle of a fork cannot be told from its nodes alone. The leaf load of a leaf is the
    inertia torque about its base over the sum of mass times distance: uniform acceleration a gives at most a, gravity
    gives at most g, so that a limit in g is a share of the leaf's own weight (facts: pollination 1d, safety factor
    1.7 of petioles).
    """
    kinds = [_flowers(plant), *_strains(plant), *_bases(plant)]
    ends = np.cumsum([0] + [count for count, *_ in kinds])
    rows = [np.arange(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    vector = np.concatenate([first + which for first, (_, which, _, _) in zip(ends[:-1], kinds, strict=True)])
    node, block = (np.concatenate([kind[part] for kind in kinds]) for part in (2, 3))
    at = [np.broadcast_to(3 * index[:, None, None] + axis, block.shape) for index, axis in zip((vector, node), _AXES)]  # noqa: B905
    shape = (3 * ends[-1], 3 * len(plant.rods.nodes))
    operator = csr_array((block.ravel(), (at[0].ravel(), at[1].ravel())), shape)
    operator.eliminate_zeros()
    return Observables(operator, *rows)


def branch_of(plant: PlantModel) -> NDArray[Any]:
    """Return (N,) on which branch a node lies, as a row of `PlantModel.branch_bases`; -1 on the main stem."""
    branch = np.full(len(plant.rods.nodes), -1)
    branch[plant.branch_bases] = np.arange(len(plant.branch_bases))
    for j in range(1, len(branch)):
        branch[j] = max(branch[j], branch[plant.rods.parent[j]])
    return branch


def semi_major(vectors: ComplexArray) -> Array:
    """Return the largest length (...) that the real part of vectors (..., 3) exp(i w t) reaches.

    The semi-major axis of the ellipse a: a^2 = (|v|^2 + |v . v|) / 2, the product without conjugation.
    """
    square = np.sum(np.abs(vectors) ** 2, axis=-1)
    return np.sqrt(0.5 * (square + np.abs(np.sum(vectors * vectors, axis=-1))))


_AXES = (np.arange(3)[:, None], np.arange(3))

Blocks = tuple[int, NDArray[Any], NDArray[Any], Array]
"""Vectors that are sums of (3, 3) blocks times node displacements: how many vectors, then of each of B blocks which
vector (B,) and node (B,), and the blocks (B, 3, 3)."""


def _flowers(plant: PlantModel) -> Blocks:
    count = len(plant.flower_nodes)
    return count, np.arange(count), plant.flower_nodes, np.tile(np.eye(3), (count, 1, 1))


def _strains(plant: PlantModel) -> tuple[Blocks, Blocks]:
    """Return the strains of the joints of the main stem, the one with the soil too, and of those of the pedicels."""
    rods = plant.rods
    j = np.arange(1, len(rods.parent))
    p = rods.parent[j]
    of_pedicel, on_stem = plant.is_pedicel[j], np.isin(np.arange(len(rods.nodes)), plant.stem_nodes)
    radius = np.asarray(rods.edge_radius)
    softness = radius / (np.asarray(rods.youngs) * np.pi * radius**4 / 4)
    strain = bend_stiffness(rods, plant.clamp.planted)[j] * np.maximum(softness[np.where(p > 0, p, j)], softness[j])
    nodes, blocks = (
        np.stack([np.maximum(rods.parent[p], 0), p, j], axis=1),
        strain[:, None, None, None] * _bend(rods.nodes, p, j, rods),
    )
    kinds = []
    for chosen in (~of_pedicel & on_stem[j] & on_stem[p], of_pedicel):
        count = int(chosen.sum())
        kinds.append((count, np.repeat(np.arange(count), 3), nodes[chosen].ravel(), blocks[chosen].reshape(-1, 3, 3)))
    return kinds[0], kinds[1]


def _bend(x: Array, p: NDArray[Any], j: NDArray[Any], rods: Rods) -> Array:
    """Return (J, 3, 3, 3): the change of direction from edge p to edge j, less their common rotation, by nodes.

    Nodes are the parent of p, p and j. A rigid rotation across the tangents gives nothing; of one about the tangents, a
    share sin(kink) / 2 remains. Below an edge that leaves the root is the soil, in line with it, which does not turn.
    """
    turns, spins, tangents = [], [], []
    soil = np.flatnonzero(p == 0)
    for start, end in ((rods.parent[p], p), (p, j)):
        edge = x[end] - x[start]
        edge[soil] = (x[j] - x[p])[soil]
        size = np.linalg.norm(edge, axis=1)[:, None]
        t = edge / size
        turn = (np.eye(3) - t[:, :, None] * t[:, None]) / size[:, None]
        if not turns:
            turn[soil] = 0
        turns.append(turn)
        spins.append(_cross(t) @ turn)
        tangents.append(t)
    half = 0.5 * _cross(tangents[1] - tangents[0])
    first, last = turns[0] - half @ spins[0], turns[1] + half @ spins[1]
    return np.stack([first, -first - last, last], axis=1)


def _bases(plant: PlantModel) -> tuple[Blocks, Blocks]:
    """Return, for the branches' bases and per squared angular frequency, their strain, and the leaves' load.

    A leaf's load is the inertia torque about its base over sum of m |r| [m]. Flowers and pedicels do not count in it,
    nor do branches without leaves (trusses) where the leaves are known: the flowers are meant to move, and their
    stalks have their own limits.
    """
    rods, bases, branch = plant.rods, plant.branch_bases, branch_of(plant)
    node = np.flatnonzero(branch >= 0)
    of, count = branch[node], len(bases)
    lever = rods.nodes[node] - rods.nodes[rods.parent[bases[of]]]
    radius, youngs = np.asarray(rods.edge_radius), np.asarray(rods.youngs)
    section = youngs[bases] * np.pi * radius[bases] ** 3 / 4
    strain = (rods.node_mass[node] / section[of])[:, None, None] * _cross(lever)

    leaf, tissue = np.array(rods.lumped_mass), np.where(plant.is_pedicel, 0, rods.node_mass)
    leaf[plant.flower_nodes] = tissue[plant.flower_nodes] = 0
    moment = np.bincount(of, tissue[node] * np.linalg.norm(lever, axis=1), count)
    load = (tissue[node] / np.maximum(moment, 1e-12)[of])[:, None, None] * _cross(lever)
    leafy = (np.bincount(of, leaf[node], count) >= 1e-4) | (leaf.sum() == 0)
    some, number = leafy[of], np.cumsum(leafy) - 1
    return (count, of, node, strain), (int(leafy.sum()), number[of[some]], node[some], load[some])


def _cross(v: Array) -> Array:
    """Return the matrices (..., 3, 3) of v x."""
    return np.cross(np.eye(3), v[..., None, :])
