"""Response of a few observed quantities to shaking many grips: branches are condensed onto the way the grips share.

Q frequencies, G grips, K observed vectors, L loaded unknowns, R rows of the trunk, N nodes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from anther.checks import check_room
from anther.elastic_rod._assembly import new_blocks
from anther.elastic_rod._grip import RIGID, ComplexArray, Springs, grasped, held_unknowns, rigid_motion
from anther.elastic_rod._linear import linearise, set_dynamic
from anther.elastic_rod._model import Model
from anther.elastic_rod._motion import Clamp
from anther.elastic_rod._response import FINE, on_all_cores, towards_root
from anther.elastic_rod._rods import GRAVITY, Array, Rods
from anther.elastic_rod._tree_solver import factor, solve_columns, substitute_columns
from anther.elastic_rod._vectors import (
    compiled,
)


class Observed(NamedTuple):
    """What shakes of one metre along x, y and z do.

    Attributes:
        vectors: (Q, G, K, 3, 3) observed vectors (rows) for each axis of the shake (columns).
        force: (Q, G, 3, 3) that the grip exerts, summed over its nodes, in the same way [N/m].
        moment: (Q, G, 3, 3) likewise, about its first node [N m/m].
        pads: (Q, G, 6, 3) motion of the pads: displacement of the first node [m/m], then rotation [rad/m].
    """

    vectors: ComplexArray
    force: ComplexArray
    moment: ComplexArray
    pads: ComplexArray


def observed_response(
    rods: Rods,
    clamp: Clamp,
    grip_nodes: Sequence[NDArray[Any]],
    operator: Any,
    frequencies: Array,
    *,
    loss_factor: float = 0.0,
    gravity: ArrayLike = GRAVITY,
    springs: Springs = RIGID,
) -> Observed:
    """Return what `driven_response` says of linear functions of the displacements, at less cost for many grips.

    The trunk is the way from the grips to the root. Off it nothing is loaded, so that a branch only follows the two
    nodes that its base hangs on: x_j = T_j (x_near, x_far), eight columns whatever the number of grips. Only the trunk
    is solved for every grip.

    Args:
        rods: the rods.
        clamp: what never moves.
        grip_nodes: G lists of the nodes between the pads, not all of one length.
        operator: (3K, 4N) sparse, from the unknowns (x, y, z, spin) of all nodes to observed vectors. A vector may look
            at the trunk and at branches that hang on the same two nodes of it.
        frequencies: (Q,) [Hz].
        loss_factor: see `driven_response`.
        gravity: (3,) [m/s^2].
        springs: between gripper and pads.

    Raises:
        InputError: the rods are divided so finely that the memory does not suffice.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    system = linearise(rods, clamp, gravity, loss_factor)
    held = [held_unknowns(rods.parent, pad) for pad in grip_nodes]
    loads = np.unique(np.concatenate(held))
    view = _view(system.model, towards_root(system.model, loads // 4), operator)
    threads = min(os.cpu_count() or 1, len(frequencies))  # each has columns of its own, see below
    size = 16 * len(frequencies) * len(loads) * 4 * len(view.trunk) + threads * 64 * len(rods.nodes) * len(loads)
    check_room(f"a skeleton of {len(rods.nodes)} nodes", size, FINE)
    trunk = np.empty((len(frequencies), len(loads), 4 * len(view.trunk)), np.complex128)
    branch = np.empty((len(frequencies), operator.shape[0], 8), np.complex128)

    def solve_some(which: NDArray[Any]) -> None:
        n = len(system.free)
        dynamic, columns = new_blocks(n, np.complex128), np.zeros((2, n, 4, len(loads)))
        for q in which:
            set_dynamic(system, 2 * np.pi * float(frequencies[q]), dynamic)
            factor(system.model, dynamic)
            _trunk_motion(system.model, dynamic, loads, view.trunk, columns, trunk[q])
            _branch_motion(system.model, dynamic, view.branches, view.preset, view.beyond, branch[q])

    on_all_cores(solve_some, len(frequencies))
    vectors = np.empty((len(frequencies), len(held), operator.shape[0] // 3, 3, 3), np.complex128)
    wrench, moved = (np.empty((len(frequencies), len(held), 6, 3), np.complex128) for _ in range(2))
    for g, (pad, unknowns) in enumerate(zip(grip_nodes, held, strict=True)):
        body = rigid_motion(rods.parent, system.state.x, np.asarray(pad))
        at, rows = view.place[unknowns // 4] * 4 + unknowns % 4, np.searchsorted(loads, unknowns)
        taken = grasped(trunk[:, rows][:, :, at], body, np.eye(3), springs)
        wrench[:, g], moved[:, g] = taken.wrench, taken.pads
        moves = np.swapaxes(trunk[:, rows], 1, 2) @ taken.forces
        for q in range(len(frequencies)):
            _observe(branch[q], view.base, view.direct, moves[q], vectors[q, g])
    return Observed(vectors, wrench[:, :, :3], wrench[:, :, 3:], moved)


class _View(NamedTuple):
    """Where the observed vectors look: at the trunk itself, and at branches.

    Neighbours on the trunk take turns: one's motion is in the first four columns of T, the next one's in the last.
    """

    trunk: NDArray[Any]  # (R,) rows, root outward
    place: NDArray[Any]  # (N,) of a row in `trunk`, -1 off it
    branches: NDArray[Any]  # the other rows, root outward
    preset: Array  # (N, 4, 8) the motions of the trunk that T answers
    beyond: tuple[Any, Any, Any]  # (3K, 4N) the part of the operator that looks at branches: CSR
    base: NDArray[Any]  # (K, 2) where on the trunk that branch hangs, in the order of the columns
    direct: tuple[Any, Any, Any]  # (3K, 4R) the part that looks at the trunk: CSR


def _view(model: Model, trunk: NDArray[Any], operator: Any) -> _View:
    n = len(model.near)
    place, odd, preset = np.full(n, -1), np.zeros(n, dtype=int), np.zeros((n, 4, 8))
    place[trunk] = np.arange(len(trunk))
    for j in trunk[1:]:
        odd[j] = 1 - odd[model.near[j]]
    preset[trunk[:, None], np.arange(4), 4 * odd[trunk, None] + np.arange(4)] = 1
    rootward = model.order[::-1]
    branches = rootward[place[rootward] < 0]
    base = np.zeros((n, 2), dtype=int)  # of each branch row
    for j in branches:
        a, b = int(model.near[j]), int(model.far[j])
        base[j] = base[a] if place[a] < 0 else place[[b, a] if odd[a] else [a, b]]
    parts = operator.tocoo()
    node, size = parts.col // 4, operator.shape[0]
    off = place[node] < 0
    unknown = np.where(off, node, place[node]) * 4 + parts.col % 4
    split = [csr_array((parts.data[s], (parts.row[s], unknown[s])), (size, 4 * n)) for s in (off, ~off)]
    seen = np.zeros((size // 3, 2), dtype=int)
    seen[parts.row[off] // 3] = base[node[off]]
    beyond, direct = ((m.indptr, m.indices, m.data) for m in split)
    return _View(trunk, place, branches, preset, beyond, seen, direct)


@compiled
def _trunk_motion(model: Model, dynamic: Any, loads: Any, trunk: Any, columns: Any, out: Any) -> None:
    """Write (L, 4R) the motion of the trunk per unit load; `columns` (2, N, 4, L) is scratch."""
    real, imaginary = columns[0], columns[1]
    for j in trunk:
        real[j] = 0
        imaginary[j] = 0
    for k in range(len(loads)):
        real[loads[k] // 4, loads[k] % 4, k] = 1
    solve_columns(model, dynamic, trunk, real, imaginary)
    for k in range(len(loads)):
        for r in range(len(trunk)):
            for i in range(4):
                out[k, 4 * r + i] = complex(real[trunk[r], i, k], imaginary[trunk[r], i, k])


@compiled
def _branch_motion(model: Model, dynamic: Any, branches: Any, preset: Any, beyond: Any, out: Any) -> None:
    """Write (3K, 8) what is seen of branches when the nodes of the trunk move one at a time."""
    real, imaginary = preset.copy(), np.zeros_like(preset)
    substitute_columns(model, dynamic, branches, real, imaginary)
    start, unknown, share = beyond
    for row in range(len(out)):
        for c in range(8):
            out[row, c] = 0
        for k in range(start[row], start[row + 1]):
            j, i = unknown[k] // 4, unknown[k] % 4
            for c in range(8):
                out[row, c] += share[k] * complex(real[j, i, c], imaginary[j, i, c])


@compiled
def _observe(branch: Any, base: Any, direct: Any, moves: Any, out: Any) -> None:
    """Write (K, 3, 3) the observed vectors for the trunk's motion (4R, 3)."""
    start, unknown, share = direct
    for row in range(len(branch)):
        k, i = row // 3, row % 3
        for axis in range(3):
            out[k, i, axis] = 0
        for c in range(8):
            at = 4 * base[k, c // 4] + c % 4
            if branch[row, c] != 0:
                for axis in range(3):
                    out[k, i, axis] += branch[row, c] * moves[at, axis]
        for n in range(start[row], start[row + 1]):
            for axis in range(3):
                out[k, i, axis] += share[n] * moves[unknown[n], axis]
