"""The rods linearised about their equilibrium under gravity: M q'' + C q' + K q = 0, in tree-structured blocks.

Natural frequencies, mode shapes and damping ratios, by a block Lanczos method with the tree solver; and what a shaken
base does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.checks import check_array, check_range
from anther.core.errors import StageFailure, bad_input
from anther.core.geometry import ComplexArray
from anther.rods._assembly import Blocks, add_supports, assemble, assemble_edges, new_blocks, on_nodes
from anther.rods._equilibrium import Tangent, by_edges, loaded_state, tangent
from anther.rods._frequency_solver import (
    NEAR,
    factor_lanes,
    flat,
    new_buffer,
    new_columns,
    new_factors,
    pack,
    solve_lanes,
)
from anther.rods._loads import Loads
from anther.rods._model import Model, build_model
from anther.rods._motion import Clamp, unit_direction
from anther.rods._rods import GRAVITY, Array, Rods
from anther.rods._stepping import State
from anther.rods._tree_solver import constrain
from anther.rods._vectors import LANES

MATRIX = ("diagonal", "near", "far")


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """The linearised system.

    Attributes:
        model: the constants.
        free: (N, 4) which unknowns are free; rows and columns of the others are those of the identity in `stiffness`.
        stiffness: K, with the stiffness of weight under tilt.
        damping: C, from viscosity and drag.
        loss: the elastic stiffness times the loss factor: hysteretic damping, i loss at every frequency.
        mass: M.
        state: the equilibrium.
    """

    model: Model
    free: NDArray[np.bool_]
    stiffness: Blocks
    damping: Blocks
    loss: Blocks
    mass: Blocks
    state: State


def linearise(
    rods: Rods, clamp: Clamp, gravity: ArrayLike, loss_factor: float = 0.0, loads: Loads | None = None
) -> Linear:
    """Return the linearised system; loads are forces that keep their directions in small motions.

    Raises:
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    model, frames = build_model(rods, gravity, clamp.planted)
    free = clamp.free(rods)
    model, state = loaded_state(rods, model, frames, free, loads)
    n = len(free)

    def assembled(constants: Model, rate: float) -> Blocks:
        blocks = new_blocks(n)
        assemble(constants, state.x, state.x, state.frames, state.v, rate, blocks)
        return blocks

    def per_rate(constants: Model) -> Blocks:
        """What viscosity adds per unit of rate."""
        faster = assembled(constants, 1.0)
        for name in MATRIX:
            getattr(faster, name)[:] -= getattr(stiffness, name)
        return faster

    stiffness = assembled(model, 0.0)
    damping = per_rate(model) if np.any(model.viscous) else new_blocks(n)
    _add_diagonal(damping, np.repeat(model.drag[:, None], 3, axis=1))
    loss = per_rate(model._replace(viscous=np.full(n, loss_factor))) if loss_factor > 0 else new_blocks(n)
    constrain(model.near, model.far, free, stiffness)
    return Linear(model, free, stiffness, damping, loss, _mass(model), state)


def _mass(model: Model) -> Blocks:
    blocks = new_blocks(len(model.mass))
    _add_diagonal(blocks, np.repeat(model.rotary[:, None], 3, axis=1))
    on_nodes(model.order, model.parent, model.near, model.far, model.swapped, blocks)
    _add_diagonal(blocks, np.repeat(model.mass[:, None], 3, axis=1))
    blocks.diagonal[:, 3, 3] = model.spin_inertia
    return blocks


def _add_diagonal(blocks: Blocks, values: Array) -> None:
    blocks.diagonal[:, range(3), range(3)] += values


def dynamic_parts(system: Linear) -> Array:
    """Return (N, NUMBERS, 4) K, C, the loss and M for `factor_lanes`.

    The last three are without what couples held unknowns, of which K has the ones.
    """
    free, model = system.free, system.model
    moves = [free[:, :, None] & free[other][:, None] for other in (slice(None), model.near, model.far)]
    for block, other in zip(moves[1:], (model.near, model.far), strict=True):
        block[other < 0] = False
    parts = (system.stiffness, system.damping, system.loss, system.mass)
    found = pack(*(np.stack([getattr(part, name) for part in parts]) for name in MATRIX))
    packed = pack(*moves)
    found[1:] *= packed
    found[0, :, NEAR:] *= packed[:, NEAR:]
    return np.ascontiguousarray(np.moveaxis(found, 0, -1))


def product(model: Model, blocks: Blocks, vectors: Array) -> Array:
    """Return the symmetric matrix that the blocks stand for, times (N, 4, B) vectors."""
    full = np.triu(blocks.diagonal) + np.swapaxes(np.triu(blocks.diagonal, 1), 1, 2)
    out = np.einsum("nij,njb->nib", full, vectors)
    for block, other in ((blocks.near, model.near), (blocks.far, model.far)):
        j = np.flatnonzero(other >= 0)
        out[j] += np.einsum("nij,njb->nib", block[j], vectors[other[j]])
        np.add.at(out, other[j], np.einsum("nij,nib->njb", block[j], vectors[j]))
    return out


def dense(model: Model, blocks: Blocks) -> Any:
    """Return the (4N, 4N) matrix that the blocks stand for."""
    n = 4 * len(model.parent)
    return product(model, blocks, np.eye(n).reshape(-1, 4, n)).reshape(n, n)


class Modes(NamedTuple):
    """The lowest K modes of N nodes.

    Attributes:
        frequencies: (K,) undamped natural frequencies [Hz], rising.
        shapes: (K, N, 3) mode shapes, largest displacement 1.
        damping_ratios: (K,) share of critical damping [-] from viscosity and drag: phi^T C phi / (2 w phi^T M phi).
    """

    frequencies: Array
    shapes: Array
    damping_ratios: Array


def natural_frequencies(
    rods: Rods, clamp: Clamp, count: int, *, gravity: ArrayLike = GRAVITY, loads: Loads | None = None
) -> Modes:
    """Return the lowest modes of small vibrations about the equilibrium under gravity and loads of one's own.

    Block Lanczos iteration with K^-1 M (Golub & Underwood 1977) and full orthogonalisation. A block has more vectors
    than modes are wanted, so that equal frequencies, as of a round rod in its two planes, come out as often as they
    occur. K = min(count, half of the unknowns).

    Raises:
        InputError: count < 1.
        StageFailure: kind "no_convergence" when there is no stable equilibrium, or the modes do not converge.
    """
    check_range("number of modes", count, 1, 1e5)
    system = linearise(rods, clamp, gravity, loads=loads)
    count = max(1, min(count, int(system.free.sum()) // 2))
    n = len(system.free)
    stiffness = tangent(system.model, system.free, system.state.x, system.state.frames, new_blocks(n))
    squares, vectors = _lowest(stiffness, partial(_times_mass, system), count)
    ratios = _damping_of(system, vectors) / (2 * np.sqrt(squares))
    shapes = vectors[:, :, :3]
    largest = np.abs(shapes).max(axis=(1, 2), keepdims=True)
    return Modes(np.sqrt(squares) / (2 * np.pi), shapes / np.where(largest > 0, largest, 1), ratios)


Operator = Callable[[Array], Array]
"""From rows (B, 4N) to as many."""


def _times_mass(system: Linear, rows: Array) -> Array:
    """Return M times rows (B, 4N), without the held unknowns."""
    vectors = np.moveaxis(rows.reshape(-1, *system.free.shape), 0, 2)
    weights = np.where(system.free[:, :, None], product(system.model, system.mass, vectors), 0)
    return np.moveaxis(weights, 2, 0).reshape(rows.shape)


def _damping_of(system: Linear, vectors: Array) -> Array:
    """Return (K,) v^T C v of vectors (K, N, 4), what viscosity adds by edges, which rounds less."""
    v, model = np.moveaxis(vectors, 0, 2), system.model
    turns = v.copy()
    turns[1:, :3] -= v[model.parent[1:], :3]
    faster, still = new_blocks(len(v)), new_blocks(len(v))
    for rate, blocks in ((1.0, faster), (0.0, still)):
        assemble_edges(model, system.state.x, system.state.x, system.state.frames, system.state.v, rate, blocks)
    viscous = Blocks(*(a - b for a, b in zip(faster, still, strict=True)))
    drag = np.einsum("n,nik->k", model.drag, v[:, :3] ** 2)
    return drag + np.einsum("nik,nik->k", turns, product(by_edges(model), viscous, turns))


def _lowest(stiffness: Tangent, mass: Operator, count: int) -> tuple[Array, Array]:
    """Return (K,) squared angular frequencies and (K, N, 4) vectors with v^T M v = 1.

    What is left of a mode after K^-1 M, over what K^-1 M makes of it, falls to 1e-8; to 1e-4 where rounding forbids
    more. The error of the squared frequency is that squared, over the relative distance to the next one.

    Raises:
        StageFailure: kind "no_convergence".
    """
    free, most = stiffness.free, int(stiffness.free.sum())
    start = np.where(free, np.random.default_rng(0).normal(size=(min(most, count + 2), *free.shape)), 0)
    block, basis, weights, images = (
        _solved(stiffness, mass(start.reshape(len(start), -1))),
        *np.empty((3, 0, free.size)),
    )
    errors: list[float] = []
    while len(basis) < most:
        block, weight = _orthonormal(block, basis, weights, mass)
        image = _solved(stiffness, weight)
        basis, weights, images = (np.vstack(pair) for pair in ((basis, block), (weights, weight), (images, image)))
        gram = weights @ images.T
        values, mix = np.linalg.eigh((gram + gram.T) / 2)
        inverse, mix = values[: -count - 1 : -1], mix[:, : -count - 1 : -1].T
        left = mix @ images - inverse[:, None] * (mix @ basis)
        errors.append(float(np.max(np.sqrt(np.abs(np.sum(left * mass(left), axis=1))) / inverse)))
        rounded = len(errors) > 3 and errors[-1] > errors[-4] / 2 and errors[-1] < 1e-4
        if len(inverse) == count and (errors[-1] < 1e-8 or rounded or len(block) == 0):
            return 1 / inverse, (mix @ basis).reshape(-1, *free.shape)
        if len(block) == 0:
            break
        block = image
    raise StageFailure("no_convergence", f"rods: {count} modes did not converge. Ask for a few more or fewer modes.")


def _solved(stiffness: Tangent, loads: Array) -> Array:
    """Return K^-1 times rows (B, 4N)."""
    shape = stiffness.free.shape
    return np.array([stiffness.solve(load.reshape(shape)).ravel() for load in loads]).reshape(loads.shape)


def _orthonormal(block: Array, basis: Array, weights: Array, mass: Operator) -> tuple[Array, Array]:
    """Return rows (B, 4N) made orthogonal to the basis and to each other, v^T M v = 1, and M times them.

    Done twice, as the first time leaves rounding; what depends on the other rows is dropped.
    """
    weight = block
    for _ in range(2):
        block = block - (block @ weights.T) @ basis
        weight = mass(block)
        gram = block @ weight.T
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, mix = np.linalg.eigh(gram / size / size[:, None])
        sound = values > 1e-12
        mix = (mix / size[:, None])[:, sound] / np.sqrt(values[sound])
        block, weight = mix.T @ block, mix.T @ weight
    return block, weight


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

    All that is clamped moves by exp(i w t) along `direction` (3,), as on a shaking table, and does not turn; the ground
    of `Rods.supports` stands still. What the rods do relative to the base answers their own inertia, the still air's
    drag and the supports K_s: of u = d + w with the base's motion d,
    (K + i w C - w^2 M) w = w^2 M d - i w C_air d - K_s d.

    Args:
        rods: the rods.
        clamp: what moves with the base.
        direction: (3,) of its motion.
        frequencies: (Q,) [Hz].
        gravity: (3,) [m/s^2].
        loss_factor: see `response_map`.

    Raises:
        InputError: a frequency out of range, a direction of no length, nothing clamped.
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    hertz = checked_hertz(frequencies)
    check_range("loss_factor", loss_factor, 0, 10)
    if not len(clamp.nodes):
        raise bad_input("clamp", given="no node", allowed="the nodes that move with the base", do="Use Clamp.root.")
    system = linearise(rods, clamp, gravity, loss_factor)
    model, tree = system.model, (system.model.order, system.model.near, system.model.far)
    carried = np.zeros((len(rods.nodes), 4))
    carried[:, :3] = unit_direction(direction)
    inertia = product(system.model, system.mass, carried[..., None])[..., 0]
    air, springs = system.model.drag[:, None] * carried, new_blocks(len(rods.nodes))
    add_supports(model.supports, system.state.x, springs)
    held = product(system.model, springs, carried[..., None])[..., 0]
    out = np.empty((len(hertz), len(rods.nodes), 3), np.complex128)
    n, parts, rows, buffer = len(rods.nodes), dynamic_parts(system), system.model.order[::-1].copy(), new_buffer()
    factors, moves, begins = new_factors(n), new_columns(n, 1), np.array([n - 1])
    for first in range(0, len(hertz), LANES):
        omega = 2 * np.pi * hertz[first : first + LANES, None, None]
        pull: Any = np.where(system.free, omega**2 * inertia - 1j * omega * air - held, 0)
        factor_lanes(*tree, parts, np.resize(omega, LANES), factors, buffer)
        relative = np.moveaxis(moves[:n, 0, :, :, : len(omega)], 3, 0)
        relative[..., 0], relative[..., 1] = pull.real, pull.imag
        solve_lanes(*tree[1:], factors, rows, begins, flat(moves), buffer)
        out[first : first + LANES] = (carried + relative[..., 0] + 1j * relative[..., 1])[:, :, :3]
    return out


def checked_hertz(frequencies: ArrayLike) -> Array:
    """Return (Q,) frequencies, each in range [Hz]."""
    hertz = check_array("frequencies", frequencies, (None,))
    for value in hertz:
        check_range("frequency", value, 0, 1e5, "Hz")
    return hertz
