"""What rigid pads do to the joints at their ends: the piece of an edge between the pads bends no more.

Every joint takes half of either edge that meets in it. Where one of the two is gripped, its half is taken away, so that
a grip is of second order in the edge length. The joint keeps the moment that it has when the pads close.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.rods._model import Model, edges_of, joint_matrix
from anther.rods._motion import gripped_edges
from anther.rods._rods import Array, Rods
from anther.rods._stepping import State
from anther.rods._strains import joint_strains, stiffness_of


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
