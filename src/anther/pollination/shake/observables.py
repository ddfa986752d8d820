"""What a small vibration does to the plant: flower motion, bending strain and leaf load, linear in the displacement.

N rod nodes, F flowers, K observed vectors (K, 3), each with a factor that turns its length into a physical value.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from anther.core.geometry import Array, ComplexArray
from anther.plant.model import PlantModel
from anther.rods import Rods, displacements, joints


class Observables(NamedTuple):
    """What is observed: K vectors, linear in the unknowns (x, y, z, spin) of all nodes, and where each kind is.

    Attributes:
        operator: (3K, 4N) sparse, from the unknowns to the vectors.
        bending: (3B, 3N) sparse, from the changes of the joints' strains (`elastic_rod.moments`) to those B of the K
            vectors whose length is the bending strain at the surface of an edge [-].
        strains: (B,) their rows of K.
        edges: (B,) the edges in which these strains are.
        flowers: (F,) rows of K that are flower displacements [m].
        stem_strain, joint_strain, base_strain: rows of K among `strains`, of the main stem, of pedicels, of the bases
            of branches.
        leaf_load: rows of K whose length, times the squared angular frequency, is an equivalent acceleration [m/s2].
    """

    operator: Any
    bending: Any
    strains: NDArray[Any]
    edges: NDArray[Any]
    flowers: NDArray[Any]
    stem_strain: NDArray[Any]
    joint_strain: NDArray[Any]
    base_strain: NDArray[Any]
    leaf_load: NDArray[Any]


def observables(plant: PlantModel, like: PlantModel | None = None) -> Observables:
    """Return what is observed of a plant; `like` is the same plant of another material, to have the same rows.

    The bending strain of an edge is |M across the edge| r / (E I), at the surface of either of its ends: the moments
    are those of the rods' own joints, from curvature and twist, so that a rigid motion strains nothing and a kink is no
    exception. Of a branch's base the end on the stem counts. The leaf load of a leaf is the inertia torque about its
    base over the sum of mass times distance: uniform acceleration a gives at most a, gravity gives at most g, so that a
    limit in g is a share of the leaf's own weight (facts: pollination 1d, safety factor 1.7 of petioles).
    """
    n = len(plant.rods.nodes)
    flowers, load = displacements(plant.flower_nodes, n), _operator(_loads(plant), n, 4)
    found = joints(plant.rods, plant.clamp.planted)
    bending, edges, counts = _bending(plant, found.moments, like or plant)
    operator = vstack([flowers, bending @ found.strains, load], format="csr")
    ends = np.cumsum([0, flowers.shape[0] // 3, *counts, load.shape[0] // 3])
    rows = [np.arange(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    return Observables(operator, bending, np.arange(ends[1], ends[4]), edges, *rows)


def branch_of(plant: PlantModel) -> NDArray[Any]:
    """Return (N,) on which branch a node lies, as a row of `PlantModel.branch_bases`; -1 on the main stem."""
    branch, up = np.full(len(plant.rods.nodes), -1), np.maximum(plant.rods.parent, 0)
    branch[plant.branch_bases] = np.arange(len(plant.branch_bases))
    while up.any():  # twice as far towards the root each time
        branch, up = np.maximum(branch, branch[up]), up[up]
    return branch


def semi_major(vectors: ComplexArray) -> Array:
    """Return the largest length (...) that the real part of vectors (..., 3) exp(i w t) reaches.

    The semi-major axis of the ellipse a: a^2 = (|v|^2 + |v . v|) / 2, the product without conjugation.
    """
    square = np.sum(np.abs(vectors) ** 2, axis=-1)
    return np.sqrt(0.5 * (square + np.abs(np.sum(vectors * vectors, axis=-1))))


Blocks = tuple[int, NDArray[Any], NDArray[Any], Array]
"""Vectors that are sums of (3, 3) blocks times vectors of nodes or joints: how many, then of each block which vector
(B,) and which node or joint (B,), and the blocks (B, 3, 3)."""


def _operator(blocks: Blocks, size: int, width: int) -> Any:
    """Return the sparse matrix (3 count, width size) of blocks on the first three of a node's `width` components."""
    count, vector, node, values = blocks
    row = np.broadcast_to(3 * vector[:, None, None] + np.arange(3)[:, None], values.shape)
    column = np.broadcast_to(width * node[:, None, None] + np.arange(3), values.shape)
    operator = csr_array((values.ravel(), (row.ravel(), column.ravel())), (3 * count, width * size))
    operator.eliminate_zeros()
    return operator


def _bending(plant: PlantModel, moments: Array, like: PlantModel) -> tuple[Any, NDArray[Any], list[int]]:
    """Return the operator of the bending strains, the edge of each, and how many are of stem, pedicels and bases.

    An edge is strained at its start by the moment of its own joint, and at its end by the sum of those of the edges
    that go on from there. The end is left out where one edge goes straight on that is no thicker: its start says it.
    """
    rods = plant.rods
    j = np.arange(1, len(rods.parent))
    p = rods.parent[j]
    edge = np.arange(len(rods.nodes))
    (surface, along), strength = _surface(rods), np.linalg.norm(_surface(like.rods)[0], axis=(1, 2))
    jointed, on_stem = np.isin(edge, j), np.isin(edge, plant.stem_nodes)
    stem = on_stem & on_stem[rods.parent] & (edge > 0)
    weaker = strength[j] >= strength[p] * (1 - 1e-9)
    straight = 0.999  # cosine of 2.6 degrees: of a twisting moment 4.5 % bends beyond it
    follows = weaker & (np.sum(along[j] * along[p], axis=1) > straight)
    goes_on = np.isin(edge, p) & ~((np.bincount(p, minlength=len(edge)) == 1) & np.isin(edge, p[follows]))
    parts, edges = [], []
    for chosen, ends in ((stem, True), (plant.is_pedicel, True), (np.isin(edge, plant.branch_bases), False)):
        first, last = edge[chosen & jointed], edge[chosen & goes_on & ends]
        edges.append(np.concatenate([first, last]))
        number = np.full(len(edge), -1)
        number[last] = np.arange(len(last)) + len(first)
        after = j[number[p] >= 0]
        at = np.concatenate([np.arange(len(first)), number[rods.parent[after]]])
        parts.append((len(edges[-1]), at, np.concatenate([first, after])))
    strained, shift = np.concatenate(edges), np.cumsum([0] + [count for count, *_ in parts])
    vector = np.concatenate([at + first for (_, at, _), first in zip(parts, shift, strict=False)])
    joint = np.concatenate([joint for *_, joint in parts])
    values = surface[strained[vector]] @ moments[joint]
    operator = _operator((len(strained), vector, joint, values), len(edge), 3)
    return operator, strained, [count for count, *_ in parts]


def _surface(rods: Rods) -> tuple[Array, Array]:
    """Return (N, 3, 3) from a moment on an edge to the bending strain at its surface, and (N, 3) the edges' tangents.

    The part of a moment that twists strains nothing.
    """
    along = rods.nodes - rods.nodes[rods.parent]
    along[0] = 1
    along /= np.linalg.norm(along, axis=1)[:, None]
    section = np.asarray(rods.youngs) * np.pi * np.asarray(rods.edge_radius) ** 3 / 4
    section[0] = np.inf  # there is no edge 0
    return (np.eye(3) - along[:, :, None] * along[:, None]) / section[:, None, None], along


def _loads(plant: PlantModel) -> Blocks:
    """Return the leaves' load per squared angular frequency: the inertia torque about the base over sum of m |r| [m].

    Flowers and pedicels do not count in it, nor do branches without leaves (trusses) where the leaves are known: the
    flowers are meant to move, and their stalks have their own limits.
    """
    rods, bases, branch = plant.rods, plant.branch_bases, branch_of(plant)
    node = np.flatnonzero(branch >= 0)
    of, count = branch[node], len(bases)
    lever = rods.nodes[node] - rods.nodes[rods.parent[bases[of]]]
    leaf, tissue = np.array(rods.lumped_mass), np.where(plant.is_pedicel, 0, rods.node_mass)
    leaf[plant.flower_nodes] = tissue[plant.flower_nodes] = 0
    moment = np.bincount(of, tissue[node] * np.linalg.norm(lever, axis=1), count)
    load = (tissue[node] / np.maximum(moment, 1e-12)[of])[:, None, None] * _cross(lever)
    leafy = (np.bincount(of, leaf[node], count) >= 1e-4) | (leaf.sum() == 0)
    some, number = leafy[of], np.cumsum(leafy) - 1
    return int(leafy.sum()), number[of[some]], node[some], load[some]


def _cross(v: Array) -> Array:
    """Return the matrices (..., 3, 3) of v x."""
    return np.cross(np.eye(3), v[..., None, :])
