"""Compiled: one implicit solve by Newton's method, the step that all time integration here is made of.

It solves M (v - v_n) / h + grad E(q) + C v = M g with v = (q - q_n) / h. Nothing here allocates memory or raises, so
that the same code runs in many threads and on a graphics processor.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from anther.elastic_rod._assembly import Blocks, assemble_edges, move_frames, on_nodes
from anther.elastic_rod._model import Frames, Model
from anther.elastic_rod._rods import Array
from anther.elastic_rod._tree_solver import constrain, factor, solve
from anther.elastic_rod._vectors import compiled, dot, load, merged, subtract

POSITION_FLOOR = 1e-12
"""A Newton correction below this [m] is rounding noise: the step has converged."""

LARGEST_TURN = 0.5
"""Largest change of an edge, as a share of its length, in one Newton correction and in one solve (0.5: 29 degrees).

Beyond it Newton can converge to a solution in which an edge has flipped over. The step is split instead.
"""

GROWTH = 4.0
"""Line search: a correction after which the residual is this many times larger is halved, up to HALVED times."""

HALVED = 6


class State(NamedTuple):
    """Positions (N, 3) [m], velocities and edge spin rates (N, 4) [m/s, rad/s], and material frames."""

    x: Array
    v: Array
    frames: Frames


class Work(NamedTuple):
    """Scratch arrays of one run, and what it adds up."""

    mid: State
    end: State
    turn: Array  # (N,) spin of each edge over the solve: 2 tan(angle / 2)
    correction: Array  # (N, 4) Newton's
    blocks: Blocks
    energy: Array  # (3,) total and stored energy of the state, work of the grip so far [J]


def new_state(x: Array, frames: Frames) -> State:
    """Return a state at rest with its own copies of the arrays."""
    return State(x.copy(), np.zeros((len(x), 4)), Frames(frames.m1.copy(), frames.twist.copy()))


@compiled
def _add_rotary(model: Model, blocks: Blocks, old: State, new: State, rate: float) -> None:
    """Add the inertia of what turns with the edges to the residual (blocks.gradient) and to the matrix by edges."""
    g, D, parent, v, v_old, rotary = blocks.gradient, blocks.diagonal, model.parent, new.v, old.v, model.rotary
    for j in range(1, len(rotary)):
        p = parent[j]
        for i in range(3):
            g[j, i] += rotary[j] * rate * ((v[j, i] - v[p, i]) - (v_old[j, i] - v_old[p, i]))
            D[j, i, i] += rotary[j] * rate * rate


@compiled
def _add_inertia(model: Model, blocks: Blocks, old: State, new: State, rate: float) -> None:
    """Add inertia, drag and weight to the residual (blocks.gradient) and to the matrix by nodes."""
    g, D, mass, drag, weight = blocks.gradient, blocks.diagonal, model.mass, model.drag, model.weight
    v, v_old, spin_inertia = new.v, old.v, model.spin_inertia
    for j in range(len(mass)):
        stiff = rate * (mass[j] * rate + drag[j])
        for i in range(3):
            momentum = mass[j] * rate * (v[j, i] - v_old[j, i])
            g[j, i] += momentum + drag[j] * v[j, i] - weight[j, i]
            D[j, i, i] += stiff
        g[j, 3] += spin_inertia[j] * rate * (v[j, 3] - v_old[j, 3])
        D[j, 3, 3] += rate * rate * spin_inertia[j]


@compiled
def _largest_turn(parent: Any, x: Any, move: Any) -> float:
    """Return the largest change of an edge, as a share of its length, if the nodes x moved by `move`."""
    worst = 0.0
    for j in range(1, len(x)):
        p = parent[j]
        change, edge = subtract(load(move, j), load(move, p)), subtract(load(x, j), load(x, p))
        worst = max(worst, dot(change, change) / dot(edge, edge))
    return math.sqrt(worst)


@merged
def _residual(free: Any, g: Any, length: Any) -> float:
    """Return the norm of the forces on free positions, with moments on free spins counted over the edge length [N]."""
    total = 0.0
    for j in range(len(g)):
        for i in range(3):
            if free[j, i]:
                total += g[j, i] * g[j, i]
        if free[j, 3] and length[j] > 0:
            moment = g[j, 3] / length[j]
            total += moment * moment
    return math.sqrt(total)


@merged
def _move(x: Any, turn: Any, correction: Any, share: float) -> None:
    """Subtract a share of Newton's correction."""
    for j in range(len(x)):
        turn[j] -= share * correction[j, 3]
        for i in range(3):
            x[j, i] -= share * correction[j, i]


@merged
def _largest(correction: Any) -> float:
    worst = 0.0
    for j in range(len(correction)):
        for i in range(3):
            worst = max(worst, abs(correction[j, i]))
    return worst


@compiled
def _evaluate(model: Model, old: State, new: State, start: Any, turn: Any, rate: float, blocks: Blocks) -> None:
    """Fill frames and velocities of `new` from its positions and turns, and blocks with residual and matrix."""
    move_frames(model, old.x, old.frames.m1, new.x, turn, new.frames.m1, blocks.lanes)
    x, x_old, v = new.x, old.x, new.v
    for j in range(len(x)):
        v[j, 3] = rate * turn[j]
        for i in range(3):
            v[j, i] = rate * (x[j, i] - x_old[j, i])
    assemble_edges(model, start, x, new.frames, v, rate, blocks)
    _add_rotary(model, blocks, old, new, rate)
    on_nodes(model, blocks)
    _add_inertia(model, blocks, old, new, rate)


@compiled
def implicit_step(
    model: Model, free: Any, old: State, work: Work, h: float, midpoint: bool, tolerance: float, most: int
) -> Any:
    """Solve one implicit Euler step of length h [s] from `old` for work.mid.

    Args:
        model: constants.
        free: (N, 4) which unknowns are free. Of work.mid.x and work.turn the others must be in place already, and the
            free ones hold the first guess, which does not change the result.
        old: the state before.
        work: scratch; on success its blocks.gradient holds the forces that the held unknowns need.
        h: [s].
        midpoint: whether this is the first half of a midpoint step: the stretch force is then that of the whole step.
        tolerance: accepted norm of the residual force [N].
        most: Newton iterations allowed.

    Returns:
        Iterations used (negative: not converged) and the last residual [N].
    """
    blocks, correction, turn, new = work.blocks, work.correction, work.turn, work.mid
    g, parent, before, share, halved = blocks.gradient, model.parent, math.inf, 1.0, 0
    residual, largest = math.inf, math.inf
    for iteration in range(1, most + 1):
        if midpoint:
            _evaluate(model, old, new, old.x, turn, 1 / h, blocks)
        else:
            _evaluate(model, old, new, new.x, turn, 1 / h, blocks)
        residual = _residual(free, g, model.length)
        if residual <= tolerance or (largest < POSITION_FLOOR and residual < 1e3 * tolerance):
            for j in range(len(g)):
                for i in range(3):
                    correction[j, i] = new.x[j, i] - old.x[j, i]
            turned = _largest_turn(parent, old.x, correction)
            return (iteration if turned < LARGEST_TURN else -most), residual
        if not residual <= GROWTH * before and halved < HALVED:
            share, halved = 0.5 * share, halved + 1
            _move(new.x, turn, correction, -share)
            continue
        if not math.isfinite(residual):
            break
        before, halved = residual, 0
        for j in range(len(g)):
            for i in range(4):
                correction[j, i] = g[j, i] if free[j, i] else 0.0
        constrain(model, free, blocks)
        factor(model, blocks)
        solve(model, blocks, correction)
        share = min(1.0, LARGEST_TURN / (1e-300 + _largest_turn(parent, new.x, correction)))
        _move(new.x, turn, correction, share)
        largest = _largest(correction)
    return -most, residual
