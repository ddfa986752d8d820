"""The rods' own strains, two curvatures and the twist of every joint, and the moments that they stand for.

N nodes; joint j lies between edge j and its parent edge. A rigid motion strains nothing, whatever the kinks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array

from anther.elastic_rod import _springs
from anther.elastic_rod._model import Model, build_model, spring_edges
from anther.elastic_rod._rods import Array, Rods
from anther.elastic_rod._vectors import (
    add,
    compiled,
    cross,
    halves,
    load,
    merged,
    norm,
    scale,
    store,
    subtract,
    twist_angle,
)


class Joints(NamedTuple):
    """What small motions about the scanned shape do to the joints.

    Attributes:
        strains: (3N, 4N) sparse, from the unknowns (x, y, z, spin) of all nodes to the changes of (kappa1, kappa2,
            twist) of all joints; rows of edges without a joint are empty.
        moments: (N, 3, 3) from these changes to the moment vector that edge j feels at its joint [N m].
    """

    strains: Any
    moments: Array


def joints(rods: Rods, planted: bool = False) -> Joints:
    """Return the joints' strains and moments about the scanned shape; of planted rods also those with the soil.

    A rotation w of edge j with its frame, while its parent edge is still, changes the strain k by m_k . w with
    m_k = f x (d strain_k / df) + (d strain_k / d spin) t; f is the edge, t its tangent. So the sum of m_k times the
    stresses is the moment, at kinks too. Viscous stresses are left out: strain is what is bent.
    """
    model, frames = build_model(rods, (0, 0, 0), planted)
    n = len(rods.nodes)
    slopes, turning = np.zeros((n, 3, 11)), np.zeros((n, 3, 3))
    _slopes(model, rods.nodes, frames.m1, slopes, turning)
    j = np.flatnonzero(model.joint[:, 0] > 0)
    o, p = np.maximum(np.where(model.swapped, model.near, model.far), 0)[j], model.parent[j]
    axes, spin = np.arange(3), np.full((len(j), 1), 3)
    places = [4 * o[:, None] + axes, 4 * p[:, None] + axes, 4 * j[:, None] + axes]
    unknown = np.concatenate([*places, 4 * model.near[j, None] + spin, 4 * j[:, None] + spin], axis=1)
    column = np.repeat(unknown[:, None], 3, axis=1)
    row = np.broadcast_to((3 * j[:, None] + axes)[..., None], column.shape)
    strains = csr_array((slopes[j].ravel(), (row.ravel(), column.ravel())), (3 * n, 4 * n))
    w11, w12, w22, w13, w23, w33 = model.joint.T
    stiffness = np.moveaxis(np.array([[w11, w12, w13], [w12, w22, w23], [w13, w23, w33]]), 2, 0)
    return Joints(strains, turning @ stiffness)


def strain_changes(rods: Rods, positions: Array, directors: Array, planted: bool = False) -> Array:
    """Return (T, N, 3) by how much (kappa1, kappa2, twist) of every joint differ from the scanned shape's.

    Args:
        rods: the rods.
        positions, directors: (T, N, 3) of a trajectory of them.
        planted: whether the soil holds them, see `Clamp`.
    """
    model, frames = build_model(rods, (0, 0, 0), planted)
    rest, out = np.zeros((1, len(rods.nodes), 3)), np.zeros_like(positions)
    _strains(model, rods.nodes[None], frames.m1[None], rest)
    _strains(model, positions, directors, out)
    return out - rest


@compiled
def _slopes(model: Model, x: Any, m1: Any, slopes: Any, turning: Any) -> None:
    """Fill slopes (N, 3, 11) by x_o, x_p, x_j, spin of the near edge, spin of edge j, and turning: m_k by columns."""
    for j in range(1, len(x)):
        if model.joint[j, 0] == 0:
            continue
        e, m1e, f = _ends(model, x, m1, j)
        gradients, moves = _springs.gradients(_springs.bent(e, f), m1e, load(m1, j)), model.far[j] >= 0
        for k in range(3):
            g = gradients[k]
            arm = add(cross(f, g.f), scale(g.spin_f / norm(f), f))
            for i in range(3):
                slopes[j, k, i] = -g.e[i] if moves else 0.0
                slopes[j, k, 3 + i] = g.e[i] - g.f[i] if moves else -g.f[i]
                slopes[j, k, 6 + i] = g.f[i]
                turning[j, i, k] = arm[i]
            slopes[j, k, 9] = (-g.spin_e if model.swapped[j] else g.spin_e) if moves else 0.0
            slopes[j, k, 10] = g.spin_f


@merged
def _ends(model: Model, x: Any, m1: Any, j: int) -> Any:
    """Return the edge before joint j with its director, which of a planted root are the soil's, and edge j."""
    if model.far[j] < 0:
        e, m1e = halves(model.soil, j)
        return e, m1e, subtract(load(x, j), load(x, model.parent[j]))
    e, f = spring_edges(x, model.parent, model.near, model.far, model.swapped, j)
    return e, load(m1, model.near[j]), f


@compiled
def _strains(model: Model, x: Any, m1: Any, out: Any) -> None:
    """Fill (T, N, 3) the curvatures and the twist of every joint."""
    for t in range(len(x)):
        for j in range(1, len(model.far)):
            if model.joint[j, 0] == 0:
                continue
            e, m1e, f = _ends(model, x[t], m1[t], j)
            b, m1f = _springs.bent(e, f), load(m1[t], j)
            kappa1, kappa2 = _springs.curvatures(b, m1e, m1f)
            sine, cosine = _springs.twist_parts(b, m1e, m1f)
            store(out[t], j, (kappa1, kappa2, twist_angle(sine, cosine, 0.0)))
