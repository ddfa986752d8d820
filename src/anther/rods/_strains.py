"""The rods' own strains, two curvatures and the twist of every joint, and the moments that they stand for.

N nodes; joint j lies between edge j and its parent edge. A rigid motion strains nothing, whatever the kinks.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from anther.rods import _springs
from anther.rods._model import Model, build_model, joint_ends, turning_held
from anther.rods._rods import Array, Rods
from anther.rods._supports import full
from anther.rods._vectors import add, compiled, cross, load, norm, scale, store


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
    stresses is the moment, at kinks too. Viscous stresses are left out: strain is what is bent. Where a support
    holds the rotation of a node, the moment jumps; this is the mean of both sides.
    """
    rods = replace(rods, supports=(), natural=None) if turning_held(rods) else rods
    model, frames = build_model(rods, (0, 0, 0), planted)
    n, (slopes, unknown, turning) = len(rods.nodes), joint_slopes(model, rods.nodes, frames.m1)
    j = np.flatnonzero(model.joint[:, 0] > 0)
    column = np.repeat(unknown[j, None], 3, axis=1)
    row = np.broadcast_to((3 * j[:, None] + np.arange(3))[..., None], column.shape)
    strains = csr_array((slopes[j].ravel(), (row.ravel(), column.ravel())), (3 * n, 4 * n))
    return Joints(strains, turning @ joint_stiffness(model))


def strain_changes(rods: Rods, positions: Array, directors: Array, planted: bool = False) -> Array:
    """Return (T, N, 3) by how much (kappa1, kappa2, twist) of every joint differ from the scanned shape's.

    Args:
        rods: the rods.
        positions, directors: (T, N, 3) of a trajectory of them.
        planted: whether the soil holds them, see `Clamp`.
    """
    model, frames = build_model(rods, (0, 0, 0), planted)
    rest, out = np.zeros((1, len(rods.nodes), 3)), np.zeros_like(positions)
    _strains(model, np.array(rods.nodes[None]), frames.m1[None], rest)
    _strains(model, *(np.require(a, requirements=["C", "W"]) for a in (positions, directors)), out)
    return out - rest


def joint_stiffness(model: Model) -> Array:
    """Return (N, 3, 3) the joints' stiffness on (kappa1, kappa2, twist) [N m]."""
    return full(model.joint)


def joint_slopes(model: Model, x: Array, m1: Array) -> tuple[Array, NDArray[Any], Array]:
    """Return the first derivatives of the joints' strains at positions and directors (N, 3).

    They are slopes (N, 3, 11), the numbers (N, 11) of the unknowns by which they are (three nodes' positions, the spins
    of the edge before and of edge j), and the columns m_k (N, 3, 3) of `joints`. Without a joint they are 0.
    """
    n = len(x)
    slopes, turning, j = np.zeros((n, 3, 11)), np.zeros((n, 3, 3)), np.arange(n)[:, None]
    _slopes(model, np.array(x), m1, slopes, turning)
    o, p, a = (
        np.maximum(k, 0)[:, None] for k in (np.where(model.swapped, model.near, model.far), model.parent, model.near)
    )
    axes = np.arange(3)
    return slopes, np.hstack([4 * o + axes, 4 * p + axes, 4 * j + axes, 4 * a + 3, 4 * j + 3]), turning


@compiled
def _slopes(model: Model, x: Any, m1: Any, slopes: Any, turning: Any) -> None:
    for j in range(1, len(x)):
        if model.joint[j, 0] == 0:
            continue
        e, m1e, f = joint_ends(model, x, m1, j)
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


@compiled
def _strains(model: Model, x: Any, m1: Any, out: Any) -> None:
    """Fill (T, N, 3) the curvatures and the twist of every joint."""
    for t in range(len(x)):
        for j in range(1, len(model.far)):
            if model.joint[j, 0] > 0:
                e, m1e, f = joint_ends(model, x[t], m1[t], j)
                store(out[t], j, _springs.strains(_springs.bent(e, f), m1e, load(m1[t], j), 0.0))
