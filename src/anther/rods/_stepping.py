"""Compiled time stepping: one implicit solve by Newton's method, the two integrators made of it, the grip, the record.

It solves M (v - v_n) / h + grad E(q) + C v = M g with v = (q - q_n) / h: implicit Euler. The implicit midpoint rule is
the same solve over half a step, then q_{n+1} = 2 q_mid - q_n and v_{n+1} = 2 v_mid - v_n: second order,
time-reversible, without numerical damping (Hairer, Lubich, Wanner 2006). Its stretch force conserves energy exactly
(`springs.stretched`), because plain midpoint steps make energy out of stretching waves that are too fast for them.
Nothing here allocates memory or raises, so that the same code runs in many threads.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from anther.rods._assembly import Blocks, add_supports, assemble_edges, elastic_energy, move_frames, on_nodes
from anther.rods._model import Frames, Model
from anther.rods._rods import Array
from anther.rods._tree_solver import constrain, factor, solve
from anther.rods._vectors import apart, compiled, cross, dot, inlined, load, norm, peak, scale, transport

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


class Grip(NamedTuple):
    """What the gripper prescribes at the ends of S steps: P nodes, and Q edges that have both ends among them."""

    nodes: Any  # (P,) int, the grip node first
    edges: Any  # (Q,) int
    x: Array  # (S + 1, P, 3) [m]
    director: Array  # (S + 1, Q, 3) first director
    guess: Array  # (N,) share of the grip's next move with which Newton starts (P21); (0,): from the velocity


class Output(NamedTuple):
    """Recorded rows, the first of them the start."""

    x: Array  # (R, N, 3) [m]
    director: Array  # (R, N, 3) first director of every edge
    energy: Array  # (R,) [J]
    force: Array  # (R, 3) [N]
    moment: Array  # (R, 3) [N m]
    work: Array  # (R,) [J]


class Settings(NamedTuple):
    """How to step."""

    dt: float  # [s]
    midpoint: bool
    tolerance: float  # accepted norm of the residual [N]
    most: int  # Newton iterations
    balance: bool  # whether a step that creates energy is refused, so that it is split


@inlined
def _add_rotary(model: Model, blocks: Blocks, old: State, new: State, rate: float) -> None:
    """Add the inertia of what turns with the edges to the residual (blocks.gradient) and to the matrix by edges."""
    g, D, parent, v, v_old, rotary = blocks.gradient, blocks.diagonal, model.parent, new.v, old.v, model.rotary
    for j in range(1, len(rotary)):
        p = parent[j]
        for i in range(3):
            g[j, i] += rotary[j] * rate * ((v[j, i] - v[p, i]) - (v_old[j, i] - v_old[p, i]))
            D[j, i, i] += rotary[j] * rate * rate


@inlined
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
        g[j, 3] += spin_inertia[j] * rate * (v[j, 3] - v_old[j, 3]) - weight[j, 3]
        D[j, 3, 3] += rate * rate * spin_inertia[j]


@inlined
def _largest_turn(parent: Any, x: Any, move: Any) -> float:
    """Return the largest change of an edge, as a share of its length, if the nodes x moved by `move`."""
    worst = 0.0
    for j in range(1, len(x)):
        p = parent[j]
        change, edge = apart(move, j, p), apart(x, j, p)
        turned = dot(change, change) / dot(edge, edge)
        worst = turned if turned > worst else worst
    return math.sqrt(worst)


@inlined
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


@inlined
def _move(x: Any, turn: Any, correction: Any, share: float) -> None:
    """Subtract a share of Newton's correction."""
    for j in range(len(x)):
        turn[j] -= share * correction[j, 3]
        for i in range(3):
            x[j, i] -= share * correction[j, i]


@inlined
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
    on_nodes(model.order, model.parent, model.near, model.far, model.swapped, blocks)
    add_supports(model.supports, x, blocks)
    _add_inertia(model, blocks, old, new, rate)


@inlined
def implicit_step(model: Model, free: Any, old: State, work: Work, h: float, settings: Settings) -> Any:
    """Solve one implicit Euler step of length h [s] from `old` for work.mid.

    Args:
        model: constants.
        free: (N, 4) which unknowns are free. Of work.mid.x and work.turn the others must be in place already, and the
            free ones hold the first guess, which does not change the result.
        old: the state before.
        work: scratch; on success its blocks.gradient holds the forces that the held unknowns need.
        h: [s]; of a midpoint step half of it, but the stretch force is that of the whole step.
        settings: how to step.

    Returns:
        Iterations used (negative: not converged) and the last residual [N].
    """
    blocks, correction, turn, new = work.blocks, work.correction, work.turn, work.mid
    tolerance, most = settings.tolerance, settings.most
    g, parent, before, share, halved = blocks.gradient, model.parent, math.inf, 1.0, 0
    residual, largest = math.inf, math.inf
    for iteration in range(1, most + 1):
        start = old.x if settings.midpoint else new.x
        _evaluate(model, old, new, start, turn, 1 / h, blocks)
        residual = _residual(free, g, model.length)
        if residual <= tolerance or (largest < POSITION_FLOOR and residual < 1e3 * tolerance):
            for j in range(len(g)):
                for i in range(3):
                    correction[j, i] = new.x[j, i] - old.x[j, i]
            turned = _largest_turn(parent, old.x, correction)
            return (iteration if turned < LARGEST_TURN else -most), residual
        if not residual <= 4 * before and halved < 6:  # line search
            share, halved = 0.5 * share, halved + 1
            _move(new.x, turn, correction, -share)
            continue
        if not math.isfinite(residual):
            break
        before, halved = residual, 0
        for j in range(len(g)):
            for i in range(4):
                correction[j, i] = g[j, i] if free[j, i] else 0.0
        constrain(model.near, model.far, free, blocks)
        factor(model.order, model.near, model.far, blocks)
        solve(model.order, model.near, model.far, blocks, correction)
        share = LARGEST_TURN / (1e-300 + _largest_turn(parent, new.x, correction))
        share = share if share < 1.0 else 1.0
        _move(new.x, turn, correction, share)
        largest = peak(correction)
    return -most, residual


@inlined
def _copy(source: State, target: State) -> None:
    for j in range(len(source.x)):
        for i in range(3):
            target.x[j, i] = source.x[j, i]
            target.frames.m1[j, i] = source.frames.m1[j, i]
        for i in range(4):
            target.v[j, i] = source.v[j, i]
        target.frames.twist[j] = source.frames.twist[j]


@inlined
def _guess(free: Any, grip: Grip, old: State, work: Work, step: int, h: float, share: float) -> None:
    """Write Newton's first guess and what the gripper prescribes after a share of the step into work.mid and turn."""
    x, turn = work.mid.x, work.turn
    for j in range(len(x)):
        turn[j] = h * old.v[j, 3] if free[j, 3] else 0.0
        for i in range(3):
            x[j, i] = old.x[j, i] + (h * old.v[j, i] if free[j, i] else 0.0)
    for j in range(len(grip.guess)):
        turn[j] = 0.0
        for i in range(3):
            along = share * (grip.x[step + 1, 0, i] - grip.x[step, 0, i]) if grip.guess[j] > 0 else 0.0
            x[j, i] = old.x[j, i] + grip.guess[j] * along
    for k in range(len(grip.nodes)):
        for i in range(3):
            x[grip.nodes[k], i] = (1 - share) * grip.x[step, k, i] + share * grip.x[step + 1, k, i]


@inlined
def _turn_gripped_edges(model: Model, grip: Grip, old: State, work: Work, step: int, share: float) -> None:
    """Prescribe the spin that takes the first director of each gripped edge to where the gripper holds it."""
    for q in range(len(grip.edges)):
        j = grip.edges[q]
        p = model.parent[j]
        start = apart(old.x, j, p)
        end = apart(work.mid.x, j, p)
        t = scale(1 / norm(end), end)
        m1 = transport(load(old.frames.m1, j), scale(1 / norm(start), start), t)
        wanted = load(grip.director[step + 1], q)
        angle = share * math.atan2(dot(cross(m1, wanted), t), dot(m1, wanted))
        work.turn[j] = 2 * math.tan(0.5 * angle)


@inlined
def _extrapolate(model: Model, free: Any, old: State, work: Work) -> None:
    """Turn the midpoint state into the state at the end of the step."""
    mid, end = work.mid, work.end
    for j in range(len(old.x)):
        for i in range(3):
            end.x[j, i] = 2 * mid.x[j, i] - old.x[j, i]
        for i in range(4):
            end.v[j, i] = 2 * mid.v[j, i] - old.v[j, i] if free[j, i] else mid.v[j, i]
        end.frames.twist[j] = mid.frames.twist[j]
    move_frames(model, mid.x, mid.frames.m1, end.x, work.turn, end.frames.m1, work.blocks.lanes)
    _copy(end, mid)


@compiled
def energies(model: Model, state: State) -> tuple[float, float]:
    """Return the stored energy, elastic + kinetic, and the total, which also has - weight . x [J]."""
    stored, raised, v, x, parent = elastic_energy(model, state.x, state.frames), 0.0, state.v, state.x, model.parent
    mass, weight, rotary, spin_inertia = model.mass, model.weight, model.rotary, model.spin_inertia
    for j in range(len(x)):
        p = parent[j] if j > 0 else 0
        stored += 0.5 * spin_inertia[j] * v[j, 3] * v[j, 3]
        for i in range(3):
            change = v[j, i] - v[p, i]
            stored += 0.5 * mass[j] * v[j, i] * v[j, i] + 0.5 * rotary[j] * change * change
            raised -= weight[j, i] * x[j, i]
    return stored, stored + raised


@inlined
def _drive_speed(grip: Grip, state: State, step: int, dt: float) -> None:
    """Give the gripped nodes the speed of the drive at the end of the step, which the midpoint rule leaves out."""
    last = step + 2 if step + 2 < len(grip.x) else len(grip.x) - 1
    for k in range(len(grip.nodes)):
        for i in range(3):
            state.v[grip.nodes[k], i] = (grip.x[last, k, i] - grip.x[step, k, i]) / ((last - step) * dt)


@inlined
def _grip_work(grip: Grip, work: Work, step: int, midpoint: bool) -> float:
    """Return the work of the grip over the step [J]."""
    g, total = work.blocks.gradient, 0.0
    for k in range(len(grip.nodes)):
        for i in range(3):
            total += g[grip.nodes[k], i] * (grip.x[step + 1, k, i] - grip.x[step, k, i])
    for q in range(len(grip.edges)):
        total += g[grip.edges[q], 3] * (2.0 if midpoint else 1.0) * work.turn[grip.edges[q]]
    return total


@inlined
def _step(model: Model, free: Any, grip: Grip, state: State, work: Work, settings: Settings, step: int) -> Any:
    """Take one step from `state`, of which the end comes into work.mid.

    A midpoint step that creates energy is refused: undamped waves too fast for the step would go on creating it until
    everything flies apart.

    Returns:
        Newton iterations used (negative: not solved, or refused) and the last residual [N].
    """
    share = 0.5 if settings.midpoint else 1.0
    h = share * settings.dt
    _guess(free, grip, state, work, step, h, share)
    _turn_gripped_edges(model, grip, state, work, step, share)
    used, residual = implicit_step(model, free, state, work, h, settings)
    if used < 0:
        return used, residual
    gained = _grip_work(grip, work, step, settings.midpoint)
    if settings.midpoint:
        _extrapolate(model, free, state, work)
        _drive_speed(grip, work.mid, step, settings.dt)
    stored, total = energies(model, work.mid)
    created = total - work.energy[0] - gained
    if settings.midpoint and settings.balance and created > 1e-3 * stored and created > 1e-3 * work.energy[1]:
        return -used, residual
    work.energy[0], work.energy[1] = total, stored
    work.energy[2] += gained
    return used, residual


@compiled
def record(model: Model, grip: Grip, state: State, work: Work, out: Output, row: int) -> None:
    """Write the state, its energy and what the gripper exerts to one row; moments are about the grip node."""
    for j in range(len(state.x)):
        for i in range(3):
            out.x[row, j, i] = state.x[j, i]
            out.director[row, j, i] = state.frames.m1[j, i]
    out.energy[row], out.work[row] = work.energy[0], work.energy[2]
    g = work.blocks.gradient
    for i in range(3):
        out.force[row, i] = out.moment[row, i] = 0.0
    for k in range(len(grip.nodes)):
        node = grip.nodes[k]
        force = load(g, node)
        lever = cross(apart(state.x, node, grip.nodes[0]), force)
        for i in range(3):
            out.force[row, i] += force[i]
            out.moment[row, i] += lever[i]
    for q in range(len(grip.edges)):
        j = grip.edges[q]
        edge = apart(state.x, j, model.parent[j])
        for i in range(3):
            out.moment[row, i] += g[j, 3] * edge[i] / norm(edge)


@compiled
def advance(
    model: Model,
    free: Any,
    grip: Grip,
    state: State,
    work: Work,
    settings: Settings,
    out: Output,
    first: int,
    steps: int,
    every: int,
) -> Any:
    """Take the steps first .. steps - 1 and record every `every`-th state (none if 0).

    On failure `state` stays at the last good step.

    Returns:
        The step it got to, Newton iterations spent, and the residual [N] of the step that failed.
    """
    spent, residual = 0, 0.0
    for step in range(first, steps):
        used, residual = _step(model, free, grip, state, work, settings, step)
        spent += abs(used)
        if used < 0:
            return step, spent, residual
        _copy(work.mid, state)
        if every > 0 and (step + 1) % every == 0:
            record(model, grip, state, work, out, (step + 1) // every)
    return steps, spent, residual
