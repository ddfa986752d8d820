"""What a small vibration does to the plant: flower motion, bending strain and leaf load, linear in the displacement.

N rod nodes, F flowers, K observed vectors (K, 3), each with a factor that turns its length into a physical value.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from anther.elastic_rod.model import bend_stiffness
from anther.elastic_rod.rods import Array
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
    n = len(plant.rods.nodes)
    blocks = [_flower_rows(plant, n), *_strain_rows(plant, n), *_base_rows(plant, n)]
    ends = np.cumsum([0] + [block.shape[0] // 3 for block in blocks])
    rows = [np.arange(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    operator = coo_array(np.concatenate(blocks)).tocsr()
    return Observables(operator, *rows)


def semi_major(vectors: ComplexArray) -> Array:
    """Return the largest length (...) that the real part of vectors (..., 3) exp(i w t) reaches.

    The semi-major axis of the ellipse a: a^2 = (|v|^2 + |v . v|) / 2, the product without conjugation.
    """
    square = np.sum(np.abs(vectors) ** 2, axis=-1)
    return np.sqrt(0.5 * (square + np.abs(np.sum(vectors * vectors, axis=-1))))


def _flower_rows(plant: PlantModel, n: int) -> Array:
    rows = np.zeros((len(plant.flower_nodes), 3, n, 3))
    for k, node in enumerate(plant.flower_nodes):
        rows[k, :, node, :] = np.eye(3)
    return rows.reshape(-1, 3 * n)


def _strain_rows(plant: PlantModel, n: int) -> tuple[Array, Array]:
    """Return rows for the joints of the main stem and for those of the pedicels."""
    rods = plant.rods
    parent, radius = rods.parent, np.asarray(rods.edge_radius)
    stiffness, EI = bend_stiffness(rods), np.asarray(rods.youngs) * np.pi * radius**4 / 4
    stem, pedicel = [], []
    on_stem = np.isin(np.arange(n), plant.stem_nodes)
    for j in range(1, n):
        p = int(parent[j])
        if p == 0 or not (plant.is_pedicel[j] or (on_stem[j] and on_stem[p])):
            continue
        strain = stiffness[j] * max(radius[p] / EI[p], radius[j] / EI[j])
        (pedicel if plant.is_pedicel[j] else stem).append(strain * _bend_row(rods.nodes, int(parent[p]), p, j))
    return _stack(stem, n), _stack(pedicel, n)


def _bend_row(nodes: Array, a: int, b: int, c: int) -> Array:
    """Return (3, 3N): the change of direction from edge a-b to edge b-c, less their common rotation.

    A rigid rotation across the tangents gives nothing; of one about the tangents, a share sin(kink) / 2 remains.
    """
    n = len(nodes)
    turns, spins, tangents = [], [], []
    for start, end in ((a, b), (b, c)):
        edge = nodes[end] - nodes[start]
        size = float(np.linalg.norm(edge))
        t = edge / size
        turn = np.zeros((3, n, 3))
        turn[:, end] = (np.eye(3) - np.outer(t, t)) / size
        turn[:, start] -= turn[:, end]
        turns.append(turn.reshape(3, -1))
        spins.append(_cross(t) @ turns[-1])
        tangents.append(t)
    common = 0.5 * (spins[0] + spins[1])
    return turns[1] - turns[0] + _cross(tangents[1] - tangents[0]) @ common


def _base_rows(plant: PlantModel, n: int) -> tuple[Array, Array]:
    """Return rows (3B, 3N) for the branches' bases, per squared angular frequency: their strain, and the leaves' load.

    A leaf's load is the inertia torque about its base over sum of m |r| [m]. Flowers and pedicels do not count in it,
    nor do branches without leaves (trusses) where the leaves are known: the flowers are meant to move, and their
    stalks have their own limits.
    """
    rods, strains, loads = plant.rods, [], []
    leaf = np.array(rods.lumped_mass)
    leaf[plant.flower_nodes] = 0
    tissue = np.where(plant.is_pedicel, 0, rods.node_mass)
    tissue[plant.flower_nodes] = 0
    radius, youngs = np.asarray(rods.edge_radius), np.asarray(rods.youngs)
    for base in plant.branch_bases:
        beyond = np.zeros(n, dtype=bool)
        beyond[base] = True
        for j in range(int(base) + 1, n):
            beyond[j] = beyond[rods.parent[j]]
        lever = rods.nodes - rods.nodes[rods.parent[base]]
        section = youngs[base] * np.pi * radius[base] ** 3 / 4
        strains.append(_torque_row(lever, np.where(beyond, rods.node_mass, 0)) / section)
        if leaf.sum() > 0 and leaf[beyond].sum() < 1e-4:
            continue
        mass = np.where(beyond, tissue, 0)
        loads.append(_torque_row(lever, mass) / max(np.sum(mass * np.linalg.norm(lever, axis=1)), 1e-12))
    return _stack(strains, n), _stack(loads, n)


def _torque_row(lever: Array, mass: Array) -> Array:
    """Return (3, 3N): sum of m r x displacement."""
    row = np.zeros((3, len(mass), 3))
    for j in np.flatnonzero(mass):
        row[:, j] = mass[j] * _cross(lever[j])
    return row.reshape(3, -1)


def _cross(v: Array) -> Array:
    """Return the matrix of v x."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _stack(rows: list[Array], n: int) -> Array:
    return np.concatenate(rows) if rows else np.zeros((0, 3 * n))
