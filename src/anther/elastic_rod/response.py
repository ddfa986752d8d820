"""Small vibrations about the equilibrium under gravity: frequency response by complex tree solves."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.checks import check_array, check_range
from anther.elastic_rod.assembly import new_blocks
from anther.elastic_rod.linear import Linear, linearise, set_dynamic
from anther.elastic_rod.model import Model
from anther.elastic_rod.motion import Clamp, Drive, gripped_edges, unit_direction
from anther.elastic_rod.rods import GRAVITY, Array, Rods
from anther.elastic_rod.tree_solver import factor, solve_columns
from anther.elastic_rod.vectors import compiled
from anther.errors import bad_input

ComplexArray = NDArray[np.complex128]

COLUMNS = 128
"""Loads solved side by side: enough for the vector units, few enough for the cache."""


class Driven(NamedTuple):
    """What a shake of one metre does. Q frequencies, G grips, D directions, O observed nodes.

    Attributes:
        motion: (Q, G, D, O, 3) of the observed nodes [m/m].
        force: (Q, G, D, 3) that the grip exerts, summed over its nodes [N/m].
    """

    motion: ComplexArray
    force: ComplexArray


def frequency_response(
    rods: Rods,
    clamp: Clamp,
    grip_node: int,
    direction: ArrayLike,
    frequencies: ArrayLike,
    *,
    gravity: ArrayLike = GRAVITY,
    loss_factor: float = 0.0,
) -> ComplexArray:
    """Return (Q, N, 3) displacement of every node per metre of grip displacement, at (Q,) frequencies [Hz].

    The grip node's three coordinates follow exp(i w t) along `direction` (3,); the others answer linearly about the
    equilibrium under gravity. The modulus is the amplitude ratio, the argument the phase lead [rad]. Times i w it is
    the velocity, times -w^2 the acceleration.

    Raises:
        InputError: node or frequency out of range.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    everything = np.arange(len(rods.nodes))
    axis = check_array("direction", direction, (3,))[None]
    options: Any = {"observe": everything, "gravity": gravity, "loss_factor": loss_factor}
    return response_map(rods, clamp, [grip_node], axis, frequencies, **options)[:, 0, 0]


def response_map(
    rods: Rods,
    clamp: Clamp,
    grip_nodes: ArrayLike,
    directions: ArrayLike,
    frequencies: ArrayLike,
    *,
    observe: ArrayLike,
    gravity: ArrayLike = GRAVITY,
    loss_factor: float = 0.0,
) -> ComplexArray:
    """Return (Q, G, D, O, 3): the motion alone of what `driven_response` returns; arguments and errors are the same."""
    return driven_response(
        rods, clamp, grip_nodes, directions, frequencies, observe=observe, gravity=gravity, loss_factor=loss_factor
    ).motion


def driven_response(
    rods: Rods,
    clamp: Clamp,
    grip_nodes: ArrayLike,
    directions: ArrayLike,
    frequencies: ArrayLike,
    *,
    observe: ArrayLike,
    gravity: ArrayLike = GRAVITY,
    loss_factor: float = 0.0,
) -> Driven:
    """Return how the observed nodes answer a shake at each grip node in each direction, and the force it takes.

    Args:
        rods: the rods.
        clamp: what never moves.
        grip_nodes: (G,) node numbers, none of them clamped; or (G, P), the nodes that move alike between the pads.
            One node alone may turn in the grip; neighbours hold the stem's direction, and the edge between them cannot
            twist.
        directions: (D, 3) shake directions.
        frequencies: (Q,) [Hz].
        observe: (O,) node numbers, for instance the flowers.
        gravity: (3,) [m/s^2].
        loss_factor: hysteretic damping on top of the rods' own: elastic stiffness times (1 + i loss_factor), the same
            at every frequency; a mode gets the damping ratio loss_factor / 2.

    Each frequency is factored once, without any grip. Prescribing the motion u of the unknowns g of a grip then takes
    the forces G_gg^-1 u, with G_gg their receptance, so x = G_xg G_gg^-1 u. All cores share the frequencies.

    Raises:
        InputError: node or frequency out of range.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    pads = np.asarray(grip_nodes).reshape(len(np.asarray(grip_nodes)), -1)
    gripped, seen = _node_list("grip node", pads.ravel(), rods), _node_list("observed node", observe, rods)
    hertz = check_array("frequencies", frequencies, (None,))
    for value in hertz:
        check_range("frequency", value, 0, 1e5, "Hz")
    check_range("loss_factor", loss_factor, 0, 10)
    units = np.stack([unit_direction(d) for d in np.atleast_2d(np.asarray(directions, dtype=np.float64))])
    clamp.free(rods, [int(grip) for grip in gripped])
    system = linearise(rods, clamp, gravity, loss_factor)
    held = [held_unknowns(rods, pad) for pad in pads]
    loads, places = np.unique(np.concatenate(held), return_inverse=True)
    wanted = np.concatenate([(4 * seen[:, None] + np.arange(3)).ravel(), loads])
    receptances = _receptances(system, loads, wanted, 2 * np.pi * hertz)
    motion = np.empty((len(hertz), len(pads), len(units), len(seen), 3), np.complex128)
    force = np.empty((len(hertz), len(pads), len(units), 3), np.complex128)
    ends = np.cumsum([len(h) for h in held])
    for g, (end, unknowns) in enumerate(zip(ends, held, strict=True)):
        rows = places[end - len(unknowns) : end]
        moved = np.zeros((len(unknowns), len(units)), np.complex128)
        moved[: 3 * pads.shape[1]] = np.tile(units.T, (pads.shape[1], 1))  # spins stay 0
        forces = np.linalg.solve(receptances[:, rows][:, :, 3 * len(seen) + rows], moved)
        moves = np.swapaxes(forces, 1, 2) @ receptances[:, rows, : 3 * len(seen)]
        motion[:, g] = moves.reshape(len(hertz), len(units), len(seen), 3)
        pushes = np.swapaxes(forces[:, : 3 * pads.shape[1]], 1, 2)
        force[:, g] = pushes.reshape(len(hertz), len(units), pads.shape[1], 3).sum(axis=2)
    return Driven(motion, force)


def steady_motion(rods: Rods, clamp: Clamp, drive: Drive, *, gravity: ArrayLike = GRAVITY) -> ComplexArray:
    """Return (N, 4) the steady answer to a drive, displacements [m] and spins [rad] of all nodes and edges.

    Small vibrations about the equilibrium: the motion is the imaginary part of this times exp(i w t), since the drive
    is a sine.

    Raises:
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    system, everything = linearise(rods, clamp, gravity), np.arange(4 * len(rods.nodes))
    held = held_unknowns(rods, np.array(drive.nodes))
    moved = np.concatenate([np.tile(drive.direction, len(drive.nodes)), np.zeros(len(held) - 3 * len(drive.nodes))])
    receptance = _receptances(system, held, everything, np.array([2 * np.pi * drive.frequency]))[0]
    return drive.amplitude * (np.linalg.solve(receptance[:, held].T, moved) @ receptance).reshape(-1, 4)


def held_unknowns(rods: Rods, pad: NDArray[Any]) -> NDArray[Any]:
    """Return the unknowns 4 node + component that a grip holds: positions, then spins of the edges between the pads."""
    edges = gripped_edges(rods.parent, tuple(pad.tolist()))
    return np.concatenate([(4 * pad[:, None] + np.arange(3)).ravel(), 4 * edges + 3])


def _receptances(system: Linear, loads: NDArray[Any], wanted: NDArray[Any], omegas: Array) -> ComplexArray:
    """Return (Q, L, W) the motion of the wanted unknowns per unit load on each of the loaded ones."""
    rows = towards_root(system.model, np.concatenate([loads, wanted]) // 4)
    out = np.zeros((len(omegas), len(loads), len(wanted)), np.complex128)

    def solve_some(which: NDArray[Any]) -> None:
        dynamic = new_blocks(len(system.free), np.complex128)
        for q in which:
            set_dynamic(system, float(omegas[q]), dynamic)
            factor(system.model, dynamic)
            _solve_columns(system.model, dynamic, loads, wanted, rows, out[q])

    cores = min(os.cpu_count() or 1, len(omegas))
    with ThreadPoolExecutor(cores) as pool:
        list(pool.map(solve_some, np.array_split(np.arange(len(omegas)), cores)))
    return out


@compiled
def _solve_columns(model: Model, dynamic: Any, loads: Any, wanted: Any, rows: Any, out: Any) -> None:
    for first in range(0, len(loads), COLUMNS):
        count = min(COLUMNS, len(loads) - first)
        real = np.zeros((len(model.near), 4, count))
        imaginary = np.zeros_like(real)
        for k in range(count):
            real[loads[first + k] // 4, loads[first + k] % 4, k] = 1
        solve_columns(model, dynamic, rows, real, imaginary)
        for w in range(len(wanted)):
            j, i = wanted[w] // 4, wanted[w] % 4
            for k in range(count):
                out[first + k, w] = complex(real[j, i, k], imaginary[j, i, k])


def towards_root(model: Model, nodes: NDArray[Any]) -> NDArray[Any]:
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
