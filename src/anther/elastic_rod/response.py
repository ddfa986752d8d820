"""Small vibrations about the equilibrium: frequency response by complex tree solves, and natural frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import eigsh

from anther.checks import check_array, check_range
from anther.elastic_rod.assembly import Blocks, assemble, new_blocks
from anther.elastic_rod.equilibrium import static_state
from anther.elastic_rod.model import Model, build_model
from anther.elastic_rod.motion import Clamp, unit_direction
from anther.elastic_rod.rods import GRAVITY, Array, Rods
from anther.elastic_rod.tree_solver import constrain, factor, solve_at
from anther.elastic_rod.vectors import compiled
from anther.errors import bad_input

ComplexArray = NDArray[np.complex128]


def frequency_response(
    rods: Rods,
    clamp: Clamp,
    grip_node: int,
    direction: ArrayLike,
    frequencies: ArrayLike,
    *,
    gravity: ArrayLike = GRAVITY,
) -> ComplexArray:
    """Return (Q, N, 3) displacement of every node per metre of grip displacement, at (Q,) frequencies [Hz].

    The grip node's three coordinates follow exp(i w t) along `direction` (3,); the others answer linearly about the
    equilibrium under gravity. The modulus is the amplitude ratio, the argument the phase lead [rad].

    Raises:
        InputError: node or frequency out of range.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    everything = np.arange(len(rods.nodes))
    axis = check_array("direction", direction, (3,))[None]
    out = response_map(rods, clamp, [grip_node], axis, frequencies, observe=everything, gravity=gravity)
    return out[:, 0, 0]


def response_map(
    rods: Rods,
    clamp: Clamp,
    grip_nodes: ArrayLike,
    directions: ArrayLike,
    frequencies: ArrayLike,
    *,
    observe: ArrayLike,
    gravity: ArrayLike = GRAVITY,
) -> ComplexArray:
    """Return (Q, G, D, O, 3): the response of the observed nodes to a shake at each grip node in each direction.

    Args:
        rods: the rods.
        clamp: what never moves.
        grip_nodes: (G,) node numbers, none of them clamped; or (G, P), the nodes that move alike between the pads.
            One node alone may turn in the grip; with a neighbour the stem's direction is held too.
        directions: (D, 3) shake directions.
        frequencies: (Q,) [Hz].
        observe: (O,) node numbers, for instance the flowers.
        gravity: (3,) [m/s^2].

    Each frequency is factored once, without any grip. Prescribing the motion u of the nodes g of a grip then takes the
    forces G_gg^-1 u, with G_gg the (3P, 3P) receptance there, so x = G_xg G_gg^-1 u.

    Raises:
        InputError: node or frequency out of range.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    pads = np.asarray(grip_nodes).reshape(len(np.asarray(grip_nodes)), -1)
    grips, seen = _node_list("grip node", pads.ravel(), rods), _node_list("observed node", observe, rods)
    hertz = check_array("frequencies", frequencies, (None,))
    for value in hertz:
        check_range("frequency", value, 0, 1e5, "Hz")
    units = np.stack([unit_direction(d) for d in np.atleast_2d(np.asarray(directions, dtype=np.float64))])
    system = _linearise(rods, clamp, gravity)
    clamp.free(rods, [int(grip) for grip in grips])
    receptances = _receptances(system, grips, 2 * np.pi * hertz, np.concatenate([seen, grips]))
    count, size = len(pads), 3 * pads.shape[1]
    at_seen = receptances[:, :, :, : len(seen)].reshape(len(hertz), count, size, -1)
    between = receptances[:, :, :, len(seen) :].reshape(len(hertz), count, size, count, size)
    at_grip = between[:, np.arange(count), :, np.arange(count)].swapaxes(0, 1)  # (Q, G, 3P, 3P), symmetric
    forces = np.linalg.solve(at_grip, np.tile(units.T, (pads.shape[1], 1)).astype(np.complex128))  # (Q, G, 3P, D)
    moves = np.swapaxes(forces, -1, -2) @ at_seen
    return moves.reshape(len(hertz), count, len(units), len(seen), 3)


def natural_frequencies(rods: Rods, clamp: Clamp, count: int, *, gravity: ArrayLike = GRAVITY) -> tuple[Array, Array]:
    """Return the lowest natural frequencies (K,) [Hz] and mode shapes (K, N, 3), about the equilibrium under gravity.

    Damping is left out; modes are scaled to a largest displacement of 1. K = min(count, unknowns - 2).

    Raises:
        InputError: count < 1.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    check_range("number of modes", count, 1, 1e5)
    system = _linearise(rods, clamp, gravity)
    stiffness, mass = sparse_matrix(system.model, system.tangent), _masses(system.model).ravel()
    keep = np.flatnonzero(system.free.ravel())
    count = min(count, len(keep) - 2)
    K = stiffness[keep][:, keep]
    M = coo_array((mass[keep], (np.arange(len(keep)),) * 2)).tocsc()
    squares, vectors = eigsh(K, count, M=M, sigma=0.0, v0=np.ones(len(keep)))
    modes = np.zeros((count, system.free.size))
    modes[:, keep] = vectors.T
    modes = modes.reshape(count, -1, 4)[:, :, :3]
    modes /= np.abs(modes).max(axis=(1, 2), keepdims=True)
    rising = np.argsort(squares)
    return np.sqrt(np.maximum(squares[rising], 0)) / (2 * np.pi), modes[rising]


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """The linearised system: M q'' + C q' + K q = 0 with K in `tangent` and C in `damping`."""

    model: Model
    free: NDArray[np.bool_]
    tangent: Blocks
    damping: Blocks


def _linearise(rods: Rods, clamp: Clamp, gravity: ArrayLike) -> _Linear:
    model, frames = build_model(rods, gravity)
    free = clamp.free(rods)
    state = static_state(model, frames, rods.nodes, free)
    tangent, faster = new_blocks(len(free)), new_blocks(len(free))
    assemble(model, state.x, state.frames, state.v, 0.0, tangent)
    assemble(model, state.x, state.frames, state.v, 1.0, faster)
    for k in range(3):  # the three matrices; rate 1 adds what viscosity adds per unit of rate
        np.subtract(faster[k], tangent[k], out=faster[k])
    faster.diagonal[:, range(3), range(3)] += model.drag[:, None]
    constrain(model, free, tangent)
    return _Linear(model, free, tangent, faster)


def _masses(model: Model) -> Array:
    """(N, 4) masses [kg] and spin inertias [kg m^2]."""
    return np.concatenate([np.repeat(model.mass[:, None], 3, axis=1), model.spin_inertia[:, None]], axis=1)


def sparse_matrix(model: Model, blocks: Blocks) -> Any:
    """Return the (4N, 4N) scipy sparse matrix that the blocks stand for."""
    n = len(model.parent)
    rows, columns, values = [], [], []
    index = 4 * np.arange(n)[:, None] + np.arange(4)
    full = np.tril(blocks.diagonal) + np.swapaxes(np.tril(blocks.diagonal, -1), 1, 2)
    for block, other in ((full, index), (blocks.near, index[model.near]), (blocks.far, index[model.far][:, :3])):
        i, k = np.broadcast_arrays(index[:, :, None], other[:, None, :])
        off = block is not full
        present = (model.near if block is blocks.near else model.far) >= 0 if off else np.ones(n, dtype=bool)
        for r, c in ((i, k), (k, i)) if off else ((i, k),):
            rows.append(r[present].ravel())
            columns.append(c[present].ravel())
            values.append(block[present].ravel())
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return coo_array(entries, shape=(4 * n, 4 * n)).tocsc()


def _set_dynamic(system: _Linear, omega: float, dynamic: Blocks) -> None:
    """Fill `dynamic` with K + i omega C - omega^2 M."""
    for k in range(3):  # the three matrices
        dynamic[k][:] = system.tangent[k] + 1j * omega * system.damping[k]
    dynamic.diagonal[:, range(4), range(4)] -= omega**2 * _masses(system.model)


def _receptances(system: _Linear, grips: NDArray[Any], omegas: Array, seen: NDArray[Any]) -> ComplexArray:
    """Return the motion of what is seen (Q, G, 3, O, 3) per unit force on each grip node."""
    dynamic = new_blocks(len(system.free), np.complex128)
    wanted = _towards_root(system.model, np.concatenate([grips, seen]))
    at_seen = np.zeros((len(omegas), len(grips), 3, len(seen), 3), np.complex128)
    for q, omega in enumerate(omegas):
        _set_dynamic(system, omega, dynamic)
        constrain(system.model, system.free, dynamic)
        factor(system.model, dynamic)
        _solve_columns(system.model, dynamic, grips, seen, wanted, at_seen[q])
    return at_seen


@compiled
def _solve_columns(model: Model, dynamic: Blocks, grips: Any, seen: Any, wanted: Any, at_seen: Any) -> None:
    column = np.zeros_like(dynamic.gradient)
    for g in range(len(grips)):
        for i in range(3):
            column[:] = 0
            column[grips[g], i] = 1
            solve_at(model, dynamic, column, grips[g], wanted)
            for k in range(3):
                for o in range(len(seen)):
                    at_seen[g, i, o, k] = column[seen[o], k]


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


def _node_list(name: str, nodes: ArrayLike, rods: Rods) -> NDArray[Any]:
    numbers = np.array(check_array(name, np.asarray(nodes), (None,), dtype=np.int64))
    wrong = numbers[(numbers < 0) | (numbers >= len(rods.nodes))]
    if wrong.size:
        raise bad_input(
            name, given=int(wrong[0]), allowed=f"0 <= {name} <= {len(rods.nodes) - 1}", do="Check the node numbers."
        )
    return numbers
