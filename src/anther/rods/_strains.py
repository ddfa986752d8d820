"""The rods' own strains, two curvatures and the twist of every joint, and the moments that they stand for.

N nodes; joint j lies between edge j and its parent edge. A rigid motion strains nothing, whatever the kinks.

What rigid pads do to the joints at their ends: the piece of an edge between the pads bends no more. Every joint takes
half of either edge that meets in it; where one of the two is gripped its half is taken away, so that a grip is of
second order in the edge length. The joint keeps the moment that it has when the pads close.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from anther.rods import _springs
from anther.rods._model import Frames, Model, build_model, edges_of, joint_ends, joint_matrix
from anther.rods._motion import gripped_edges
from anther.rods._rods import Array, Rods
from anther.rods._stepping import State
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
    stresses is the moment, at kinks too. Viscous stresses are left out: strain is what is bent.
    """
    model, frames = build_model(rods, (0, 0, 0), planted)
    n, (slopes, unknown, turning) = len(rods.nodes), joint_slopes(model, rods.nodes, frames.m1)
    j = np.flatnonzero(model.joint[:, 0] > 0)
    column = np.repeat(unknown[j, None], 3, axis=1)
    row = np.broadcast_to((3 * j[:, None] + np.arange(3))[..., None], column.shape)
    strains = csr_array((slopes[j].ravel(), (row.ravel(), column.ravel())), (3 * n, 4 * n))
    return Joints(strains, turning @ joint_stiffness(model))


def strain_changes(
    rods: Rods, positions: Array, directors: Array, planted: bool = False, grip: tuple[int, ...] = ()
) -> Array:
    """Return (T, N, 3) by how much (kappa1, kappa2, twist) of every joint differ from the scanned shape's.

    With a grip, those at its ends are by how much they would differ under their moments without it (`_grip`).

    Args:
        rods: the rods.
        positions, directors: (T, N, 3) of a trajectory of them.
        planted: whether the soil holds them, see `Clamp`.
        grip: the nodes between the pads of the drive.
    """
    model, frames = build_model(rods, (0, 0, 0), planted)
    rest, out = np.zeros((1, len(rods.nodes), 3)), np.zeros_like(positions)
    _strains(model, rods.nodes[None], frames.m1[None], rest)
    _strains(model, positions, directors, out)
    out -= rest
    if len(grip) > 1 and rods.discretisation != "paper":
        joints = stiffer_joints(rods, planted)
        for j, stiffness in zip(*ends_of_grip(model, grip, joints), strict=True):
            out[:, j] = out[:, j] @ np.linalg.solve(joints.free[j], stiffness).T
    return out


class Stiffer(NamedTuple):
    """(N, 3, 3) stiffness of every joint on its strains [N m]: free, and with the one or the other edge gripped."""

    free: Array
    near_gripped: Array
    own_gripped: Array


def stiffer_joints(rods: Rods, planted: bool) -> Stiffer:
    """Return the stiffness of all joints, whichever of their edges may be gripped."""
    edges = edges_of(rods, planted)
    which = ((False, False), (True, False), (False, True))
    return Stiffer(*(stiffness_of(joint_matrix(rods, edges, gripped)) for gripped in which))


def ends_of_grip(model: Model, nodes: NDArray[Any] | tuple[int, ...], joints: Stiffer) -> tuple[NDArray[Any], Array]:
    """Return (J,) the joints between an edge that has both ends among the gripped nodes and one that has not.

    With them (J, 3, 3) their stiffness [N m], where it is another than without the grip.
    """
    gripped = np.zeros(len(model.parent), dtype=np.bool_)
    gripped[gripped_edges(model.parent, tuple(int(node) for node in nodes))] = True
    near = gripped[np.maximum(model.near, 0)] & (model.far >= 0)
    ends = np.flatnonzero((model.joint[:, 0] > 0) & (near != gripped))
    stiffness = np.where(gripped[ends, None, None], joints.own_gripped[ends], joints.near_gripped[ends])
    other = np.abs(stiffness - joints.free[ends]).max(axis=(1, 2), initial=0) > 1e-9 * joints.free[ends, 0, 0]
    return ends[other], stiffness[other]


def held(rods: Rods, model: Model, planted: bool, state: State, nodes: tuple[int, ...]) -> Model:
    """Return the constants with the joints at the ends of a grip as stiff as it makes them, at rest in `state`."""
    if len(nodes) < 2 or rods.discretisation == "paper":
        return model
    ends, stiffness = ends_of_grip(model, nodes, stiffer_joints(rods, planted))
    strain = joint_strains(model, state.x, state.frames)[ends]
    natural = np.column_stack([model.curvature, model.natural_twist])[ends]
    moment = np.einsum("jik,jk->ji", stiffness_of(model.joint[ends]), strain - natural)
    natural = strain - np.linalg.solve(stiffness, moment[..., None])[..., 0]
    joint, curvature, twist = model.joint.copy(), model.curvature.copy(), model.natural_twist.copy()
    joint[ends] = stiffness[:, [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    curvature[ends], twist[ends] = natural[:, :2], natural[:, 2]
    return model._replace(joint=joint, curvature=curvature, natural_twist=twist)


def joint_stiffness(model: Model) -> Array:
    """Return (N, 3, 3) the joints' stiffness on (kappa1, kappa2, twist) [N m]."""
    return stiffness_of(model.joint)


def joint_strains(model: Model, x: Array, frames: Frames) -> Array:
    """Return (N, 3) the curvatures and the twist of every joint at positions x (N, 3), the twist on its own branch."""
    out = np.zeros((1, len(x), 3))
    _strains(model, x[None], frames.m1[None], out)
    return np.column_stack([out[0, :, :2], frames.twist])


def stiffness_of(entries: Array) -> Array:
    """Return (N, 3, 3) the symmetric matrices of entries (N, 6) 11, 12, 22, 13, 23, 33."""
    w11, w12, w22, w13, w23, w33 = entries.T
    return np.moveaxis(np.array([[w11, w12, w13], [w12, w22, w23], [w13, w23, w33]]), 2, 0)


def joint_slopes(model: Model, x: Array, m1: Array) -> tuple[Array, NDArray[Any], Array]:
    """Return the first derivatives of the joints' strains at positions and directors (N, 3).

    They are slopes (N, 3, 11), the numbers (N, 11) of the unknowns by which they are (three nodes' positions, the spins
    of the edge before and of edge j), and the columns m_k (N, 3, 3) of `joints`. Without a joint they are 0.
    """
    n = len(x)
    slopes, turning, j = np.zeros((n, 3, 11)), np.zeros((n, 3, 3)), np.arange(n)[:, None]
    _slopes(model, x, m1, slopes, turning)
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
