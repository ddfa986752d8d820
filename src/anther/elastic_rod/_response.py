"""Small vibrations about the equilibrium under gravity: frequency response by complex tree solves."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.checks import check_array, check_range, check_room
from anther.elastic_rod._assembly import new_blocks
from anther.elastic_rod._grip import RIGID, ComplexArray, Springs, grasped, held_unknowns, rigid_motion
from anther.elastic_rod._linear import Linear, linearise, product, set_dynamic
from anther.elastic_rod._model import Model
from anther.elastic_rod._motion import Clamp, Drive, unit_direction
from anther.elastic_rod._rods import GRAVITY, Array, Rods
from anther.elastic_rod._tree_solver import factor, solve, solve_columns
from anther.elastic_rod._vectors import compiled
from anther.errors import bad_input

COLUMNS = 128
"""Loads solved side by side: enough for the vector units, few enough for the cache."""

FINE = "Nodes a few millimetres apart are fine enough: thin them out, or ask for less at once."
"""What to do about rods that are divided too finely."""


class Driven(NamedTuple):
    """What a shake of one metre does. Q frequencies, G grips, D directions, O observed nodes.

    Attributes:
        motion: (Q, G, D, O, 3) of the observed nodes [m/m].
        force: (Q, G, D, 3) that the grip exerts, summed over its nodes [N/m].
        moment: (Q, G, D, 3) likewise, about its first node [N m/m].
        pads: (Q, G, D, 6) motion of the pads: displacement of the first node [m/m], then rotation [rad/m].
    """

    motion: ComplexArray
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

    The grip is one node or the nodes between the pads, which move as one body (`driven_response`). A grip node's three
    coordinates follow exp(i w t) along `direction` (3,); the others answer linearly about the
    equilibrium under gravity. The modulus is the amplitude ratio, the argument the phase lead [rad]. Times i w it is
    the velocity, times -w^2 the acceleration.

    Raises:
        InputError: node or frequency out of range.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    everything = np.arange(len(rods.nodes))
    axis = check_array("direction", direction, (3,))[None]
    options: Any = {"observe": everything, "gravity": gravity, "loss_factor": loss_factor}
    return response_map(rods, clamp, [np.atleast_1d(grip_node)], axis, frequencies, **options)[:, 0, 0]


def base_response(
    rods: Rods,
    clamp: Clamp,
    direction: ArrayLike,
    frequencies: ArrayLike,
    *,
    gravity: ArrayLike = GRAVITY,
    loss_factor: float = 0.0,
) -> ComplexArray:
    """Return (Q, N, 3) displacement of every node per metre of base displacement, at (Q,) frequencies [Hz].

    All that is clamped moves by exp(i w t) along `direction` (3,), as on a shaking table, and does not turn. What the
    rods do relative to it answers their own inertia and the still air's drag: of u = d + w with the base's motion d,
    (K + i w C - w^2 M) w = w^2 M d - i w C_air d.

    Args:
        rods: the rods.
        clamp: what moves with the base.
        direction: (3,) of its motion.
        frequencies: (Q,) [Hz].
        gravity: (3,) [m/s^2].
        loss_factor: see `driven_response`.

    Raises:
        InputError: a frequency out of range, a direction of no length, nothing clamped.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    hertz = _hertz(frequencies)
    check_range("loss_factor", loss_factor, 0, 10)
    if not len(clamp.nodes):
        raise bad_input("clamp", given="no node", allowed="the nodes that move with the base", do="Use Clamp.root.")
    system = linearise(rods, clamp, gravity, loss_factor)
    carried = np.zeros((len(rods.nodes), 4))
    carried[:, :3] = unit_direction(direction)
    inertia = product(system.model, system.mass, carried[..., None])[..., 0]
    air = system.model.drag[:, None] * carried
    out = np.empty((len(hertz), len(rods.nodes), 3), np.complex128)
    dynamic = new_blocks(len(system.free), np.complex128)
    for q, omega in enumerate(2 * np.pi * hertz):
        set_dynamic(system, float(omega), dynamic)
        factor(system.model, dynamic)
        relative = np.where(system.free, omega**2 * inertia - 1j * omega * air, 0)
        solve(system.model, dynamic, relative)
        out[q] = (carried + relative)[:, :3]
    return out


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
    """Return (Q, G, D, O, 3): the motion alone of what `driven_response` returns; arguments and errors are the same."""
    return driven_response(
        rods, clamp, grip_nodes, directions, frequencies, observe=observe, gravity=gravity, loss_factor=loss_factor
    ).motion


def driven_response(
    rods: Rods,
    clamp: Clamp,
    grip_nodes: Sequence[ArrayLike] | NDArray[Any],
    directions: ArrayLike,
    frequencies: ArrayLike,
    *,
    observe: ArrayLike,
    gravity: ArrayLike = GRAVITY,
    loss_factor: float = 0.0,
    springs: Springs = RIGID,
) -> Driven:
    """Return how the observed nodes answer a shake at each grip node in each direction, and the force it takes.

    Args:
        rods: the rods.
        clamp: what never moves.
        grip_nodes: (G,) node numbers, none of them clamped; or G lists of the nodes between the pads, not all of one
            length. One node alone may turn in the grip; neighbours move as one body, and the edge between them cannot
            twist in it.
        directions: (D, 3) shake directions.
        frequencies: (Q,) [Hz].
        observe: (O,) node numbers, for instance the flowers.
        gravity: (3,) [m/s^2].
        loss_factor: hysteretic damping on top of the rods' own: elastic stiffness times (1 + i loss_factor), the same
            at every frequency; a mode gets the damping ratio loss_factor / 2.
        springs: between the gripper, which follows the shake and does not turn, and the pads.

    Each frequency is factored once, without any grip; what a grip then takes is in `grip.grasped`. All cores share the
    frequencies.

    Raises:
        InputError: node or frequency out of range, or the memory does not suffice.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    pads = [np.atleast_1d(np.asarray(pad)) for pad in grip_nodes]
    gripped, seen = _node_list("grip node", np.concatenate(pads), rods), _node_list("observed node", observe, rods)
    hertz = _hertz(frequencies)
    check_range("loss_factor", loss_factor, 0, 10)
    units = np.stack([unit_direction(d) for d in np.atleast_2d(np.asarray(directions, dtype=np.float64))])
    clamp.free(rods, [int(grip) for grip in gripped])
    system = linearise(rods, clamp, gravity, loss_factor)
    held = [held_unknowns(rods.parent, pad) for pad in pads]
    loads = np.unique(np.concatenate(held))
    wanted = np.concatenate([(4 * seen[:, None] + np.arange(3)).ravel(), loads])
    receptances = _receptances(system, loads, wanted, 2 * np.pi * hertz)
    shape = (len(hertz), len(pads), len(units))
    motion, wrench, moved = (np.empty((*shape, width), np.complex128) for width in (3 * len(seen), 6, 6))
    for g, (pad, unknowns) in enumerate(zip(pads, held, strict=True)):
        rows = np.searchsorted(loads, unknowns)
        body = rigid_motion(rods.parent, system.state.x, pad)
        taken = grasped(receptances[:, rows][:, :, 3 * len(seen) + rows], body, units, springs)
        motion[:, g] = np.swapaxes(taken.forces, 1, 2) @ receptances[:, rows, : 3 * len(seen)]
        wrench[:, g], moved[:, g] = (np.swapaxes(part, 1, 2) for part in (taken.wrench, taken.pads))
    return Driven(motion.reshape(*shape, len(seen), 3), wrench[..., :3], wrench[..., 3:], moved)


def steady_motion(
    rods: Rods, clamp: Clamp, drive: Drive, *, gravity: ArrayLike = GRAVITY, springs: Springs = RIGID
) -> Steady:
    """Return the steady answer to a drive of the gripper, with springs between it and the pads.

    Small vibrations about the equilibrium: the motion is the imaginary part of this times exp(i w t), since the drive
    is a sine.

    Raises:
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    system, everything, pad = linearise(rods, clamp, gravity), np.arange(4 * len(rods.nodes)), np.array(drive.nodes)
    held = held_unknowns(rods.parent, pad)
    receptance = _receptances(system, held, everything, np.array([2 * np.pi * drive.frequency]))
    body = rigid_motion(rods.parent, system.state.x, pad)
    taken = grasped(receptance[:, :, held], body, drive.direction[None], springs)
    motion = taken.forces[0, :, 0] @ receptance[0]
    return Steady(drive.amplitude * motion.reshape(-1, 4), drive.amplitude * taken.pads[0, :, 0])


def _hertz(frequencies: ArrayLike) -> Array:
    hertz = check_array("frequencies", frequencies, (None,))
    for value in hertz:
        check_range("frequency", value, 0, 1e5, "Hz")
    return hertz


def _receptances(system: Linear, loads: NDArray[Any], wanted: NDArray[Any], omegas: Array) -> ComplexArray:
    """Return (Q, L, W) the motion of the wanted unknowns per unit load on each of the loaded ones."""
    rows = towards_root(system.model, np.concatenate([loads, wanted]) // 4)
    check_room(f"{len(loads)} loads, {len(wanted)} unknowns", 16.0 * len(omegas) * len(loads) * len(wanted), FINE)
    out = np.zeros((len(omegas), len(loads), len(wanted)), np.complex128)

    def solve_some(which: NDArray[Any]) -> None:
        dynamic = new_blocks(len(system.free), np.complex128)
        for q in which:
            set_dynamic(system, float(omegas[q]), dynamic)
            factor(system.model, dynamic)
            _solve_columns(system.model, dynamic, loads, wanted, rows, out[q])

    on_all_cores(solve_some, len(omegas))
    return out


def on_all_cores(solve_some: Callable[[NDArray[Any]], None], count: int) -> None:
    """Share the numbers 0 to `count` - 1 out among the cores of this process; one alone is not worth a thread."""
    cores = min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, count)
    if cores <= 1:
        solve_some(np.arange(count))
        return
    with ThreadPoolExecutor(cores) as pool:
        list(pool.map(solve_some, np.array_split(np.arange(count), cores)))


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
