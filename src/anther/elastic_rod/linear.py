"""The rods linearised about their equilibrium under gravity: M q'' + C q' + K q = 0, in tree-structured blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.elastic_rod.assembly import Blocks, assemble, new_blocks
from anther.elastic_rod.equilibrium import static_state
from anther.elastic_rod.model import Model, build_model
from anther.elastic_rod.motion import Clamp
from anther.elastic_rod.newton import State
from anther.elastic_rod.rods import Array, Rods
from anther.elastic_rod.tree_solver import constrain
from anther.elastic_rod.vectors import compiled

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


def linearise(rods: Rods, clamp: Clamp, gravity: ArrayLike, loss_factor: float = 0.0) -> Linear:
    """Return the linearised system.

    Raises:
        StageFailure: kind "no_convergence" when there is no stable equilibrium.
    """
    model, frames = build_model(rods, gravity, clamp.planted)
    free = clamp.free(rods)
    state = static_state(model, frames, rods.nodes, free)
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
    damping = per_rate(model)
    _add_diagonal(damping, np.repeat(model.drag[:, None], 3, axis=1))
    loss = per_rate(model._replace(viscous=np.full(n, loss_factor))) if loss_factor > 0 else new_blocks(n)
    constrain(model, free, stiffness)
    return Linear(model, free, stiffness, damping, loss, _mass(model), state)


def _mass(model: Model) -> Blocks:
    blocks = new_blocks(len(model.mass))
    _add_diagonal(blocks, np.repeat(model.mass[:, None], 3, axis=1))
    blocks.diagonal[:, 3, 3] = model.spin_inertia
    j = np.arange(1, len(model.mass))
    p, rotary, three = model.parent[1:], model.rotary[1:, None], np.arange(3)
    near = (model.near[1:] == p)[:, None]
    blocks.diagonal[j[:, None], three, three] += rotary
    np.add.at(blocks.diagonal, (p[:, None], three, three), rotary)
    blocks.near[j[:, None], three, three] -= np.where(near, rotary, 0)
    blocks.far[j[:, None], three, three] -= np.where(near, 0, rotary)
    return blocks


def _add_diagonal(blocks: Blocks, values: Array) -> None:
    blocks.diagonal[:, range(3), range(3)] += values


def set_dynamic(system: Linear, omega: float, dynamic: Blocks) -> None:
    """Fill `dynamic` (complex) with K + i omega C + i loss - omega^2 M, held unknowns as in the identity."""
    for name in MATRIX:
        parts = [getattr(blocks, name) for blocks in (system.stiffness, system.damping, system.loss, system.mass)]
        _combine(*parts, omega, getattr(dynamic, name))
    constrain(system.model, system.free, dynamic)


@compiled
def _combine(stiffness: Any, damping: Any, loss: Any, mass: Any, omega: float, out: Any) -> None:
    for j in range(len(out)):
        for i in range(4):
            for k in range(4):
                real = stiffness[j, i, k] - omega * omega * mass[j, i, k]
                out[j, i, k] = complex(real, omega * damping[j, i, k] + loss[j, i, k])


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
