"""The stiffness of rods held at the root, in the motion of every edge instead of that of every node.

A node moves with its parent, and edge j by d_j more: x_j = x_parent + d_j. In these unknowns a joint sees only its own
two edges, so that the matrix of a line of N edges has the condition number of N^2, in node positions that of N^4: there
doubles leave nothing of the lowest modes of some thousand nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.elastic_rod import _lanes as lanes
from anther.elastic_rod import _springs
from anther.elastic_rod._assembly import Blocks, assemble, gather_springs
from anther.elastic_rod._lanes import LANES, get, get3
from anther.elastic_rod._model import Frames, Model
from anther.elastic_rod._rods import Array
from anther.elastic_rod._tree_solver import constrain, factor, solve
from anther.elastic_rod._vectors import compiled, merged


def by_edges(model: Model) -> Model:
    """Return the constants with the couplings of this matrix: none beyond the near row."""
    return model._replace(far=np.full(len(model.far), -1))


def hangs_together(model: Model, free: NDArray[np.bool_]) -> bool:
    """Return whether free (N, 4) holds the root, and other nodes only where their parent is held.

    Then a held node is an edge that does not move, and the unknowns that are free are the same in both descriptions.
    """
    held = ~free[:, 0]
    return bool(held[0] and np.all(held[model.parent[1:]] | ~held[1:]))


@dataclass(frozen=True, slots=True, eq=False)
class Tangent:
    """The factored stiffness of rods, by edges where these hang together, by nodes where they do not.

    Attributes:
        model: the constants, with the couplings of that matrix.
        free: (N, 4) which unknowns are free.
        blocks: the factors; and the elastic gradient.
        together: whether the unknowns are those of edges.
        unstable: how many directions have no positive stiffness.
    """

    model: Model
    free: NDArray[np.bool_]
    blocks: Blocks
    together: bool
    unstable: int

    def forces(self, loads: Array) -> Array:
        """Return forces on nodes (N, 4) as those on the free unknowns."""
        own = loads.copy()
        if self.together:
            to_edges(self.model.parent, own)
        own[~self.free] = 0
        return own

    def moves(self, own: Array) -> Array:
        """Return motions of the unknowns (N, 4) as those of nodes."""
        moves = own.copy()
        if self.together:
            to_nodes(self.model.parent, moves)
        return moves

    def solve(self, loads: Array) -> Array:
        """Return the motion of nodes (N, 4) under forces on nodes (N, 4)."""
        own = self.forces(loads)
        solve(self.model, self.blocks, own)
        return self.moves(own)


def tangent(model: Model, free: Any, x: Array, frames: Frames, blocks: Blocks, shift: float = 0.0) -> Tangent:
    """Return the factored stiffness at positions x (N, 3), in the given blocks, with `shift` added to its diagonal."""
    together = hangs_together(model, free)
    if together:
        assemble_edges(model, x, frames, 0.0, blocks)
        model = by_edges(model)
    else:
        assemble(model, x, x, frames, np.zeros((len(x), 4)), 0.0, blocks)
    blocks.diagonal[:, range(4), range(4)] += shift * np.array([1, 1, 1, 1e-4])
    gradient = blocks.gradient.copy()
    constrain(model, free, blocks)
    unstable = int(factor(model, blocks))
    blocks.gradient[:] = gradient
    return Tangent(model, free, blocks, together, unstable)


@compiled
def to_nodes(parent: Any, moves: Any) -> None:
    """Turn motions of edges (N, 4) into motions of nodes."""
    for j in range(1, len(parent)):
        for i in range(3):
            moves[j, i] += moves[parent[j], i]


@compiled
def to_edges(parent: Any, forces: Any) -> None:
    """Turn forces on nodes (N, 4) into those on edges: the sum over all that an edge carries."""
    for j in range(len(parent) - 1, 0, -1):
        for i in range(3):
            forces[parent[j], i] += forces[j, i]


@compiled
def assemble_edges(model: Model, x: Any, frames: Frames, rate: float, blocks: Blocks) -> None:
    """Fill blocks with the elastic gradient and Hessian at rest; arguments as of `assembly.assemble`, `far` unused."""
    order, near, far, swapped = model.order, model.near, model.far, model.swapped
    D, U, g, b = blocks.diagonal, blocks.near, blocks.gradient, blocks.lanes
    still, n = np.zeros((len(x), 4)), len(x)
    D[:] = 0
    U[:] = 0
    g[:] = 0
    for first in range(1, n, LANES):
        count = min(LANES, n - first)
        gather_springs(model, x, x, frames, still, b, first, count)
        _springs.spring_lanes(b, rate)
        for i in range(count):
            j = order[n - 1 - first - i]
            _add_own(D, g, b, j, i)
            if far[j] >= 0:
                _add_near(D, U, g, b, j, near[j], -1.0 if swapped[j] else 1.0, i)


@merged
def _add_own(D: Any, g: Any, b: Any, j: Any, i: int) -> None:
    f = get3(b, lanes.FORCE_J, i)
    a, c, turn = get3(b, lanes.JJ, i), get3(b, lanes.JJ + 3, i), get3(b, lanes.TURN_J_J, i)
    D[j, 0, 0] += a[0]
    D[j, 0, 1] += a[1]
    D[j, 1, 1] += a[2]
    D[j, 0, 2] += c[0]
    D[j, 1, 2] += c[1]
    D[j, 2, 2] += c[2]
    D[j, 3, 3] += get(b, lanes.TURN_JJ, i)
    g[j, 3] += get(b, lanes.MOMENT_J, i)
    for k in range(3):
        g[j, k] += f[k]
        D[j, k, 3] += turn[k]


@merged
def _add_near(D: Any, U: Any, g: Any, b: Any, j: Any, a: Any, sign: float, i: int) -> None:
    """Add what the joint of edge j does to edge a, which runs towards it (sign 1) or, at the root, away (-1)."""
    e, f = get3(b, lanes.OO, i), get3(b, lanes.OO + 3, i)
    force, turn, across = get3(b, lanes.FORCE_O, i), get3(b, lanes.TURN_M_O, i), get3(b, lanes.TURN_M_J, i)
    D[a, 0, 0] += e[0]
    D[a, 0, 1] += e[1]
    D[a, 1, 1] += e[2]
    D[a, 0, 2] += f[0]
    D[a, 1, 2] += f[1]
    D[a, 2, 2] += f[2]
    D[a, 3, 3] += get(b, lanes.TURN_MM, i)
    g[a, 3] += sign * get(b, lanes.MOMENT_M, i)
    U[j, 3, 3] = sign * get(b, lanes.TURN_MJ, i)
    for k in range(3):
        g[a, k] -= sign * force[k]
        D[a, k, 3] -= turn[k]
        U[j, k, 3] = sign * across[k]
        U[j, 3, k] = -sign * get(b, lanes.TURN_J_O + k, i)
        for c in range(3):
            U[j, k, c] = -sign * get(b, lanes.JO + 3 * k + c, i)
