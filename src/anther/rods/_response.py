"""Small vibrations about the equilibrium under gravity: what a shake of the grip does.

Branches are condensed onto the trunk, the way from the grips to the root, and complex tree solves go along it. A grip
that gives is a body between pads, joined to the gripper by springs.

Q frequencies, G grips, P nodes between the pads, H unknowns that a grip holds, D directions, K observed vectors, L
loaded unknowns, R rows of the trunk, N nodes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from anther.core.checks import check_array, check_range, check_room
from anther.core.geometry import ComplexArray
from anther.rods._frequency_solver import (
    NUMBERS,
    factor_lanes,
    flat,
    new_buffer,
    new_columns,
    new_factors,
    solve_lanes,
)
from anther.rods._linear import Linear, checked_hertz, dynamic_parts, linearise
from anther.rods._model import Model
from anther.rods._motion import (
    RIGID,
    Clamp,
    Drive,
    Springs,
    check_node,
    gripped_edges,
    unit_direction,
)
from anther.rods._rods import GRAVITY, Array, Rods
from anther.rods._vectors import LANES, compiled, filled, inlined

COLUMNS = 16
"""Loads solved side by side: so many that a row of the factors is read seldom, few enough for the cache."""

FINE = "Nodes a few millimetres apart are fine enough: thin them out, or ask for less at once."
"""What to do about rods that are divided too finely."""


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


class Steady(NamedTuple):
    """The steady answer to a drive, as phasors.

    Attributes:
        motion: (N, 4) displacements [m] and spins [rad] of all nodes and edges.
        pads: (6,) displacement of the first gripped node [m], then rotation of the pads [rad].
    """

    motion: ComplexArray
    pads: ComplexArray


def frequency_response(
    rods: Rods,
    clamp: Clamp,
    grip_node: int | ArrayLike,
    direction: ArrayLike,
    frequencies: ArrayLike,
    *,
    gravity: ArrayLike = GRAVITY,
    loss_factor: float = 0.0,
) -> ComplexArray:
    """Return (Q, N, 3) displacement of every node per metre of grip displacement, at (Q,) frequencies [Hz].

    The grip is one node or the nodes between the pads, which move as one body, along `direction` (3,): `response_map`
    of all nodes, whose arguments and errors are the same. The modulus is the amplitude ratio, the argument the phase
    lead [rad]. Times i w it is the velocity, times -w^2 the acceleration.
    """
    everything, axis = np.arange(len(rods.nodes)), check_array("direction", direction, (3,))[None]
    options: Any = {"observe": everything, "gravity": gravity, "loss_factor": loss_factor}
    return response_map(rods, clamp, [np.atleast_1d(grip_node)], axis, frequencies, **options)[:, 0, 0]


def response_map(
    rods: Rods,
    clamp: Clamp,
    grip_nodes: Sequence[ArrayLike] | NDArray[Any],
    directions: ArrayLike,
    frequencies: ArrayLike,
    *,
    observe: ArrayLike,
    gravity: ArrayLike = GRAVITY,
    loss_factor: float = 0.0,
) -> ComplexArray:
    """Return (Q, G, D, O, 3) how the observed nodes answer a shake of one metre at each grip in each direction [m/m].

    Args:
        rods: the rods.
        clamp: what never moves.
        grip_nodes: (G,) node numbers, none of them clamped; or G lists of the nodes between the pads, not all of one
            length. One node alone may turn in the grip; neighbours move as one body, and the edge between them cannot
            twist in it.
        directions: (D, 3) shake directions; their length does not count.
        frequencies: (Q,) [Hz].
        observe: (O,) node numbers, for instance the flowers.
        gravity: (3,) [m/s^2].
        loss_factor: hysteretic damping on top of the rods' own: elastic stiffness times (1 + i loss_factor), the same
            at every frequency; a mode gets the damping ratio loss_factor / 2.

    Raises:
        InputError: node or frequency out of range, or the memory does not suffice.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    pads = [np.array(check_array("grip node", np.atleast_1d(p), (None,), dtype=np.int64)) for p in grip_nodes]
    seen, hertz = np.array(check_array("observed node", observe, (None,), dtype=np.int64)), checked_hertz(frequencies)
    for node in seen:
        check_node("observed node", int(node), len(rods.nodes))
    check_range("loss_factor", loss_factor, 0, 10)
    units = np.stack([unit_direction(d) for d in np.atleast_2d(np.asarray(directions, dtype=np.float64))])
    clamp.free(rods, [int(node) for pad in pads for node in pad])
    operator = displacements(seen, len(rods.nodes))
    found = observed_response(rods, clamp, pads, operator, hertz, loss_factor=loss_factor, gravity=gravity)
    return np.moveaxis(found.vectors @ units.T, -1, 2)


def displacements(nodes: NDArray[Any], count: int) -> Any:
    """Return the operator (3K, 4N) of `observed_response` that sees the displacements of K of N nodes."""
    unknown = (4 * nodes[:, None] + np.arange(3)).ravel()
    return csr_array((np.ones(len(unknown)), (np.arange(len(unknown)), unknown)), (len(unknown), 4 * count))


def steady_motion(
    rods: Rods, clamp: Clamp, drive: Drive, *, gravity: ArrayLike = GRAVITY, springs: Springs = RIGID
) -> Steady:
    """Return the steady answer to a drive of the gripper, with springs between it and the pads.

    Small vibrations about the equilibrium: the motion is the imaginary part of this times exp(i w t), since the drive
    is a sine.

    Raises:
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    n = len(rods.nodes)
    every = 6 * np.arange(n)[:, None] + np.arange(4)  # of a node one vector is its displacement, one has its spin
    operator = csr_array((np.ones(4 * n), (every.ravel(), np.arange(4 * n))), (6 * n, 4 * n))
    found = observed_response(
        rods, clamp, [np.array(drive.nodes)], operator, np.array([drive.frequency]), gravity=gravity, springs=springs
    )
    motion, pads = (drive.amplitude * part[0, 0] @ drive.direction for part in (found.vectors, found.pads))
    return Steady(motion.reshape(n, 6)[:, :4], pads)


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
    """Return how linear functions of the displacements answer shakes of many grips.

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
        loss_factor: see `response_map`.
        gravity: (3,) [m/s^2].
        springs: between the gripper, which follows the shake and does not turn, and the pads.

    Each frequency is factored once, without any grip; what a grip then takes is in `_grasped`. `LANES` frequencies go
    side by side, and all cores share such groups.

    Raises:
        InputError: the rods are divided so finely that the memory does not suffice.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    system = linearise(rods, clamp, gravity, loss_factor)
    held = [_held_unknowns(rods.parent, pad) for pad in grip_nodes]
    loads = np.unique(np.concatenate(held))
    view = _view(system.model, loads, operator)
    size = 16.0 * len(frequencies) * (len(loads) * len(view.wanted) + 8 * operator.shape[0])
    size += 48.0 * len(frequencies) * len(held) * operator.shape[0]
    size += 16.0 * LANES * _cores() * len(rods.nodes) * (NUMBERS + 4 * (COLUMNS + 8))  # see below, each core its own
    check_room(f"a skeleton of {len(rods.nodes)} nodes", size, FINE)
    trunk, branch = _solved(system, 2 * np.pi * frequencies, loads, view)
    shape = len(frequencies), len(held)
    vectors = np.empty((*shape, operator.shape[0] // 3, 3, 3), np.complex128)
    (wrench, moved), scratch = np.empty((2, *shape, 6, 3), np.complex128), np.empty((len(view.wanted) + 1, 6 * LANES))
    for g, (pad, unknowns) in enumerate(zip(grip_nodes, held, strict=True)):
        body = rigid_motion(rods.parent, system.state.x, np.asarray(pad))
        at, rows = np.searchsorted(view.wanted, unknowns), np.searchsorted(loads, unknowns)
        receptance = _in_turn(trunk[:, at[:, None], rows], len(frequencies))
        forces, wrench[:, g], moved[:, g] = _grasped(receptance, body, springs)
        moving = trunk, rows, _in_lanes(forces)
        _observe(moving, branch, view.beyond.indptr, view.base, view.direct, scratch, vectors, g)
    return Observed(vectors, wrench[:, :, :3], wrench[:, :, 3:], moved)


def _solved(system: Linear, omega: Array, loads: NDArray[Any], view: _View) -> tuple[Array, Array]:
    """Return what unit loads do to the wanted unknowns of the trunk, (Q / LANES, W, L, 2 LANES), and of branches what
    is seen of T, (Q / LANES, 3K, 16 LANES)."""
    n, (order, near, far) = len(system.free), (system.model.order, system.model.near, system.model.far)
    parts, groups = dynamic_parts(system), -(-len(omega) // LANES)
    trunk = np.empty((groups, len(view.wanted), len(loads), 2 * LANES))
    branch = np.empty((groups, view.beyond.shape[0], 16 * LANES))
    begins = np.argsort(view.trunk)[np.searchsorted(np.sort(view.trunk), loads // 4)]

    def solve_some(which: NDArray[Any]) -> None:
        factors, columns, eight, buffer = _work(n, min(len(loads), COLUMNS))
        (node, part), (seen, way) = np.divmod(view.wanted, 4), np.divmod(view.unknown, 4)
        eight[:] = 0
        eight[view.trunk, :, :, 0] = view.preset[..., None]
        for group in which:
            some = np.resize(omega[group * LANES : (group + 1) * LANES], LANES)
            factor_lanes(order, near, far, parts, some, factors, buffer)
            for first in range(0, len(loads), COLUMNS):
                last = min(first + COLUMNS, len(loads))
                loaded, axis = np.divmod(loads[first:last], 4)
                columns[view.trunk] = columns[-1] = 0
                columns[loaded, np.arange(last - first), axis, 0] = 1
                solve_lanes(near, far, factors, view.trunk, begins[first:last], flat(columns), buffer)
                answer = columns[node, : last - first, part]
                trunk[group, :, first:last] = answer.reshape(*answer.shape[:2], -1)
            solve_lanes(near, far, factors, view.branches, np.full(8, -1), flat(eight), buffer)
            branch[group] = view.beyond @ eight[seen, :, way].reshape(len(seen), 16 * LANES)

    _on_all_cores(solve_some, groups)
    return trunk, branch


_KEPT = threading.local()


def _work(n: int, loads: int) -> tuple[Array, Array, Array, Array]:
    """Return factors, columns of loads, eight columns and scratch, this thread's own, with anything in them.

    They are kept for the next solve of that size: to get new memory takes longer than to solve in it.
    """
    if getattr(_KEPT, "size", None) != (n, loads):
        _KEPT.size, _KEPT.work = (n, loads), (new_factors(n), new_columns(n, loads), new_columns(n, 8), new_buffer())
    return _KEPT.work


def _in_lanes(values: ComplexArray) -> Array:
    """Return (Q, R, C) values as groups of frequencies (Q / LANES, R, 2 C LANES), the last one filled up."""
    q, rows, columns = values.shape
    out = np.zeros((-(-q // LANES), LANES, rows, columns, 2))
    out.reshape(-1, rows, columns, 2)[:q] = values.view(np.float64).reshape(q, rows, columns, 2)
    return np.ascontiguousarray(np.moveaxis(out, 1, -1)).reshape(len(out), rows, -1)


def _in_turn(lanes: Array, q: int) -> ComplexArray:
    """Return values (Q / LANES, R, C, 2 LANES) in lanes as (Q, R, C)."""
    apart = np.moveaxis(lanes.reshape(*lanes.shape[:3], 2, LANES), 4, 1)
    return np.ascontiguousarray(apart).view(np.complex128).reshape(-1, *lanes.shape[1:3])[:q]


def _cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _on_all_cores(solve_some: Callable[[NDArray[Any]], None], count: int) -> None:
    """Share the numbers 0 to `count` - 1 out among the cores of this process; two are the least worth a thread."""
    cores = min(_cores(), count // 2)
    if cores <= 1:
        solve_some(np.arange(count))
        return
    with ThreadPoolExecutor(cores) as pool:
        list(pool.map(solve_some, np.array_split(np.arange(count), cores)))


def _towards_root(model: Model, nodes: NDArray[Any]) -> NDArray[Any]:
    """Return the rows on the ways from the nodes to the root, in the order in which they can be substituted."""
    needed = np.zeros(len(model.near), dtype=np.bool_)
    for start in nodes:
        node = int(start)
        while node >= 0 and not needed[node]:
            needed[node] = True
            node = int(model.near[node])
    rootward = model.order[::-1]
    return rootward[needed[rootward]]


def _held_unknowns(parent: NDArray[Any], pad: NDArray[Any]) -> NDArray[Any]:
    """Return the unknowns 4 node + component that a grip holds: positions, then spins of the edges between the pads."""
    edges = gripped_edges(parent, tuple(pad.tolist()))
    return np.concatenate([(4 * pad[:, None] + np.arange(3)).ravel(), 4 * edges + 3])


def rigid_motion(parent: NDArray[Any], positions: Array, pad: NDArray[Any]) -> Array:
    """Return (H, 6) what the held unknowns do when the pads move and turn about the first node of `pad` (P,)."""
    edges = gripped_edges(parent, tuple(pad.tolist()))
    lever = positions[pad] - positions[pad[0]]
    along = positions[edges] - positions[parent[edges]]
    turns = np.swapaxes(np.cross(np.eye(3), lever[:, None]), 1, 2)
    moves = np.concatenate([np.tile(np.eye(3), (len(pad), 1, 1)), turns], axis=2)
    spins = np.concatenate([0 * along, along / np.linalg.norm(along, axis=1, keepdims=True)], axis=1)
    return np.concatenate([moves.reshape(-1, 6), spins])


def _grasped(
    receptance: ComplexArray, body: Array, springs: Springs
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return what a gripper does that moves by one metre along x, y or z without turning.

    The held unknowns x = G F follow the pads, x = B p, and the pads are in balance, p = u - C B^T F; so
    (G + B C B^T) F = B u. Without compliance C this is the rigid grip, G F = B u.

    Args:
        receptance: (Q, H, H) G: held unknowns per unit load on them, of the rods that nobody holds.
        body: (H, 6) B, see `rigid_motion`.
        springs: C is their compliance.

    Returns:
        (Q, H, 3) forces on the held unknowns, (Q, 6, 3) the grip's wrench on the rods about the first node, (Q, 6, 3)
        the motion of the pads: displacement of the first node, then rotation.
    """
    asked = np.eye(6)[:, :3]
    forces: Any = np.linalg.solve(receptance + (body * springs.compliance) @ body.T, body @ asked)
    wrench = body.T @ forces
    return forces, wrench, asked - springs.compliance[:, None] * wrench


Rows = tuple[NDArray[Any], NDArray[Any], Array]
"""Of a sparse matrix: where each row begins, the columns, and the values."""


class _View(NamedTuple):
    """Where the observed vectors look: at the trunk itself, and at branches.

    Neighbours on the trunk take turns: one's motion is in the first four columns of T, the next one's in the last.
    """

    trunk: NDArray[Any]  # (R,) rows, root outward
    wanted: NDArray[Any]  # (W,) unknowns of the trunk that are loaded, looked at, or move a branch that is
    branches: NDArray[Any]  # the other rows, root outward
    preset: Array  # (R, 8, 4) the motions of the trunk that T answers
    unknown: NDArray[Any]  # (U,) of branches, that are looked at
    beyond: Any  # (3K, U) the part of the operator that does, sparse
    base: NDArray[Any]  # (K, 8) which of the wanted unknowns move the branch, in the order of the columns
    direct: Rows  # (3K, W) the part that looks at the trunk


def _view(model: Model, loads: NDArray[Any], operator: Any) -> _View:
    n, trunk = len(model.near), _towards_root(model, loads // 4)
    on_trunk, preset, (odd, top) = np.zeros(n, np.bool_), np.zeros((len(trunk), 8, 4)), _ways(model, trunk)
    on_trunk[trunk] = True
    preset[np.arange(len(trunk))[:, None], 4 * odd[trunk, None] + np.arange(4), np.arange(4)] = 1
    rootward = model.order[::-1]
    off, row = ~on_trunk[operator.indices // 4], np.repeat(np.arange(operator.shape[0]), np.diff(operator.indptr))
    base = np.zeros((operator.shape[0] // 3, 2), dtype=np.int64)
    base[row[off] // 3] = np.maximum(np.stack([model.near, model.far], axis=1)[top[operator.indices[off] // 4]], 0)
    base = np.where(odd[base[:, :1]] > 0, base[:, ::-1], base)
    base = (4 * base[..., None] + np.arange(4)).reshape(-1, 8)
    of_branch, of_trunk = operator.indices[off], operator.indices[~off]
    unknown, of_branch = _numbered(4 * n, of_branch)
    wanted, at = _numbered(4 * n, np.concatenate([loads, base.ravel(), of_trunk]))
    starts = [np.append(0, np.cumsum(np.bincount(row[part], minlength=operator.shape[0]))) for part in (off, ~off)]
    beyond = csr_array((operator.data[off], of_branch, starts[0]), (operator.shape[0], len(unknown)))
    direct = starts[1], at[len(loads) + base.size :], operator.data[~off]
    base = at[len(loads) :][: base.size].reshape(base.shape)
    return _View(trunk, wanted, rootward[~on_trunk[rootward]], preset, unknown, beyond, base, direct)


def _numbered(count: int, numbers: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the different ones among numbers below `count`, rising, and which of them each is."""
    place = np.zeros(count, dtype=np.int64)
    place[numbers] = 1
    found = np.flatnonzero(place)
    place[found] = np.arange(len(found))
    return found, place[numbers]


def _ways(model: Model, trunk: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return (N,) 1 where a row is an odd number of near rows away from the root, and which row of the branch that a
    row is on hangs on the trunk; each time twice as far towards the root."""
    rows, up = np.arange(len(model.near)), np.maximum(model.near, 0)
    odd, hangs = (model.near >= 0).astype(np.int64), np.zeros(len(up), np.bool_)
    hangs[trunk] = True
    top = np.where(hangs | hangs[up], rows, up)
    while up.any():
        odd, top, up = odd ^ odd[up], top[top], up[up]
    return odd, top


@compiled
def _observe(moving: Any, branch: Any, begins: Any, base: Any, direct: Any, scratch: Any, out: Any, g: int) -> None:
    """Write (Q, g, K, 3, 3) the observed vectors for forces on some of the loaded unknowns.

    Args:
        moving: the trunk's answer (Q / LANES, W, L, 2 LANES), which H of its loads, forces (Q / LANES, H, 6 LANES).
        branch: (Q / LANES, 3K, 16 LANES) what is seen of T.
        begins: of the rows that look at branches.
        base, direct: see `_View`.
        scratch: (W + 1, 6 LANES).
        out: (Q, G, K, 3, 3).
        g: which grip.
    """
    (trunk, rows, forces), (start, unknown, share), sums = moving, direct, scratch[len(scratch) - 1]
    for group in range(len(branch)):
        first = group * LANES
        for w in range(trunk.shape[1]):
            move = scratch[w]
            for i in range(6 * LANES):
                move[i] = 0
            for h in range(len(rows)):
                _add_product(move, trunk[group, w, rows[h]], forces[group, h])
        for row in range(branch.shape[1]):
            k, r = row // 3, row % 3
            for i in range(6 * LANES):
                sums[i] = 0
            for c in range(8 if begins[row + 1] > begins[row] else 0):
                _add_product(sums, branch[group, row, 2 * c * LANES :], scratch[base[k, c]])
            for n in range(start[row], start[row + 1]):
                move = scratch[unknown[n]]
                for i in range(6 * LANES):
                    sums[i] += share[n] * move[i]
            for axis in range(3):
                x, y = sums[2 * axis * LANES :], sums[(2 * axis + 1) * LANES :]
                for i in range(filled(len(out), first)):
                    out[first + i, g, k, r, axis] = complex(x[i], y[i])


@inlined
def _add_product(sums: Any, factor: Any, move: Any) -> None:
    for axis in range(3):
        for i in range(LANES):
            c, s = factor[i], factor[LANES + i]
            x, y = move[2 * axis * LANES + i], move[(2 * axis + 1) * LANES + i]
            sums[2 * axis * LANES + i] += c * x - s * y
            sums[(2 * axis + 1) * LANES + i] += c * y + s * x
