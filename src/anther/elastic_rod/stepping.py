"""Compiled time stepping: one implicit solve by Newton's method, and the two integrators made of it.

Implicit Euler solves M (v - v_n) / h + grad E(q) + C v = M g with v = (q - q_n) / h. The implicit midpoint rule is
the same solve over half a step, then q_{n+1} = 2 q_mid - q_n and v_{n+1} = 2 v_mid - v_n: second order, symplectic,
without numerical damping (Hairer, Lubich, Wanner 2006, VI.1).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from anther.elastic_rod.assembly import Blocks, assemble, elastic_energy, move_frames
from anther.elastic_rod.model import Frames, Model
from anther.elastic_rod.rods import Array
from anther.elastic_rod.tree_solver import constrain, factor, solve
from anther.elastic_rod.vectors import compiled, dot, load, merged, subtract

POSITION_FLOOR = 1e-12
"""A Newton correction below this [m] is rounding noise: the step has converged."""

LARGEST_TURN = 0.5
"""Largest change of an edge, as a share of its length, in one Newton correction and in one solve (0.5: 29 degrees).

Beyond it Newton can converge to a solution in which an edge has flipped over. The step is split instead.
"""


class State(NamedTuple):
    """Positions (N, 3) [m], velocities and edge spin rates (N, 4) [m/s, rad/s], and material frames."""

    x: Array
    v: Array
    frames: Frames


def new_state(x: Array, frames: Frames) -> State:
    """Return a state at rest with its own copies of the arrays."""
    return State(x.copy(), np.zeros((len(x), 4)), Frames(frames.m1.copy(), frames.twist.copy()))


@compiled
def _copy(source: State, target: State) -> None:
    target.x[:] = source.x
    target.v[:] = source.v
    target.frames.m1[:] = source.frames.m1
    target.frames.twist[:] = source.frames.twist


@compiled
def _add_inertia(model: Model, blocks: Blocks, old: State, new: State, rate: float) -> None:
    """Add inertia, drag and weight to the residual (blocks.gradient) and to the diagonal blocks."""
    for j in range(len(new.x)):
        mass, drag = model.mass[j], model.drag[j]
        for i in range(3):
            momentum = mass * rate * (new.v[j, i] - old.v[j, i])
            blocks.gradient[j, i] += momentum + drag * new.v[j, i] - model.weight[j, i]
            blocks.diagonal[j, i, i] += rate * (mass * rate + drag)
        inertia = model.spin_inertia[j]
        blocks.gradient[j, 3] += inertia * rate * (new.v[j, 3] - old.v[j, 3])
        blocks.diagonal[j, 3, 3] += rate * rate * inertia


@compiled
def _largest_turn(parent: Any, x: Any, step: Any) -> float:
    """Return the largest change of an edge, as a share of its length, if the nodes x moved by `step`."""
    worst = 0.0
    for j in range(1, len(x)):
        p = parent[j]
        change, edge = subtract(load(step, j), load(step, p)), subtract(load(x, j), load(x, p))
        worst = max(worst, dot(change, change) / dot(edge, edge))
    return np.sqrt(worst)


@compiled
def _accepted(model: Model, old: State, new: State, iterations: int, most: int) -> int:
    """Return the iterations, or -most where an edge changed so much that Newton may have found another solution."""
    return iterations if _largest_turn(model.parent, old.x, new.x - old.x) < LARGEST_TURN else -most


@merged
def implicit_step(
    model: Model,
    free: Any,
    old: State,
    new: State,
    turn: Any,
    blocks: Blocks,
    h: float,
    tolerance: float,
    most: int,
) -> Any:
    """Solve one implicit Euler step of length h [s] from `old`; held nodes of `new.x` must be in place already.

    Args:
        turn: (N,) scratch: spin of each edge over the step [rad].
        tolerance: accepted norm of the residual force [N].
        most: Newton iterations allowed.

    Returns:
        Iterations used (negative: not converged) and the last residual [N].
    """
    n, rate = len(old.x), 1 / h
    for j in range(n):
        turn[j] = h * old.v[j, 3] if free[j, 3] else 0.0
        for i in range(3):
            if free[j, i]:
                new.x[j, i] = old.x[j, i] + h * old.v[j, i]
    residual = np.inf
    for iteration in range(1, most + 1):
        move_frames(model, old.x, old.frames.m1, old.frames.twist, new.x, turn, new.frames.m1, new.frames.twist)
        for j in range(n):
            new.v[j, 3] = rate * turn[j]
            for i in range(3):
                new.v[j, i] = rate * (new.x[j, i] - old.x[j, i])
        assemble(model, new.x, new.frames, new.v, rate, blocks)
        _add_inertia(model, blocks, old, new, rate)
        held_force = blocks.gradient.copy()
        constrain(model, free, blocks)
        residual = np.sqrt(np.sum(blocks.gradient[:, :3] ** 2))
        if residual <= tolerance:
            blocks.gradient[:] = held_force
            return _accepted(model, old, new, iteration, most), residual
        if not np.isfinite(residual):
            break
        factor(model, blocks)
        solve(model, blocks, blocks.gradient)
        share = min(1.0, LARGEST_TURN / (1e-300 + _largest_turn(model.parent, new.x, blocks.gradient)))
        for j in range(n):
            turn[j] -= share * blocks.gradient[j, 3]
            for i in range(3):
                new.x[j, i] -= share * blocks.gradient[j, i]
        if np.max(np.abs(blocks.gradient[:, :3])) < POSITION_FLOOR and residual < 1e3 * tolerance:
            blocks.gradient[:] = held_force
            return _accepted(model, old, new, iteration, most), residual
    return -most, residual


@compiled
def _extrapolate(model: Model, free: Any, old: State, new: State, turn: Any, far: State) -> None:
    """Turn the midpoint state `new` into the state at the end of the step."""
    for j in range(len(old.x)):
        for i in range(3):
            far.x[j, i] = 2 * new.x[j, i] - old.x[j, i]
            far.v[j, i] = 2 * new.v[j, i] - old.v[j, i] if free[j, i] else new.v[j, i]
        far.v[j, 3] = 2 * new.v[j, 3] - old.v[j, 3]
    move_frames(model, new.x, new.frames.m1, new.frames.twist, far.x, turn, far.frames.m1, far.frames.twist)
    _copy(far, new)


@compiled
def total_energy(model: Model, state: State) -> float:
    """Return elastic + kinetic - weight . x [J]."""
    energy = elastic_energy(model, state.x, state.frames.m1, state.frames.twist)
    for j in range(len(state.x)):
        energy += 0.5 * model.spin_inertia[j] * state.v[j, 3] ** 2
        for i in range(3):
            energy += 0.5 * model.mass[j] * state.v[j, i] ** 2 - model.weight[j, i] * state.x[j, i]
    return energy


@compiled
def advance(
    model: Model,
    free: Any,
    driven: Any,
    home: Any,
    targets: Any,
    state: State,
    scratch: State,
    turn: Any,
    blocks: Blocks,
    dt: float,
    midpoint: bool,
    tolerance: float,
    most: int,
    out_x: Any,
    out_energy: Any,
    out_force: Any,
    out_work: Any,
    work: Any,
    first: int,
    every: int,
) -> Any:
    """Take steps `first` .. S - 1; `targets` (S + 1, 3) is the displacement of the `driven` nodes (m,) from `home`
    (m, 3) at each step's end [m].

    Writes every `every`-th state (none if 0) to out_x, out_energy, out_force and out_work; work (1,) sums up the work
    of the drive [J]. On failure `state` stays at the last good step.

    Returns:
        The step it got to, Newton iterations spent, and the residual [N] of the step that failed.
    """
    far = State(state.x.copy(), state.v.copy(), Frames(state.frames.m1.copy(), state.frames.twist.copy()))
    spent, residual = 0, 0.0
    for step in range(first, len(targets) - 1):
        scratch.x[:] = state.x
        share = 0.5 if midpoint else 1.0
        for k, node in enumerate(driven):
            scratch.x[node] = home[k] + (1 - share) * targets[step] + share * targets[step + 1]
        h = 0.5 * dt if midpoint else dt
        used, residual = implicit_step(model, free, state, scratch, turn, blocks, h, tolerance, most)
        if used < 0:
            return step, spent - used, residual
        spent += used
        if midpoint:
            _extrapolate(model, free, state, scratch, turn, far)
        _copy(scratch, state)
        last = min(step + 2, len(targets) - 1)
        for node in driven:
            for i in range(3):
                work[0] += blocks.gradient[node, i] * (targets[step + 1, i] - targets[step, i])
                if midpoint:
                    state.v[node, i] = (targets[last, i] - targets[step, i]) / ((last - step) * dt)
        if every > 0 and (step + 1) % every == 0:
            row = (step + 1) // every - 1
            out_x[row] = state.x
            out_energy[row] = total_energy(model, state)
            out_work[row] = work[0]
            out_force[row] = 0.0
            for node in driven:
                out_force[row] += blocks.gradient[node, :3]
    return len(targets) - 1, spent, residual
