"""Compiled time stepping: the two integrators made of the implicit solve, the grip, and what is recorded.

Implicit Euler is the solve itself. The implicit midpoint rule is the same solve over half a step, then
q_{n+1} = 2 q_mid - q_n and v_{n+1} = 2 v_mid - v_n: second order, time-reversible, without numerical damping
(Hairer, Lubich, Wanner 2006). Its stretch force conserves energy exactly (`springs.stretched`), because plain midpoint
steps make energy out of stretching waves that are too fast for them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from anther.elastic_rod._assembly import elastic_energy, move_frames
from anther.elastic_rod._model import Model
from anther.elastic_rod._newton import State, Work, implicit_step
from anther.elastic_rod._rods import Array
from anther.elastic_rod._vectors import compiled, cross, dot, load, merged, norm, scale, subtract, transport

CREATED = 1e-3
"""Share of the elastic and kinetic energy that a midpoint step may create out of nothing (`_step`)."""


class Grip(NamedTuple):
    """What the gripper prescribes at the ends of S steps: P nodes, and Q edges that have both ends among them."""

    nodes: Any  # (P,) int, the grip node first
    edges: Any  # (Q,) int
    x: Array  # (S + 1, P, 3) [m]
    director: Array  # (S + 1, Q, 3) first director
    guess: Array  # (N,) share of the grip's next move with which Newton starts at each free node (P21)


class Output(NamedTuple):
    """Recorded rows."""

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
    inertia: float  # 1: Newton starts from x + v dt; 0: from x
    tolerance: float  # accepted norm of the residual [N]
    most: int  # Newton iterations
    balance: bool  # whether a step that creates energy is refused, so that it is split


@merged
def _copy(source: State, target: State) -> None:
    for j in range(len(source.x)):
        for i in range(3):
            target.x[j, i] = source.x[j, i]
            target.frames.m1[j, i] = source.frames.m1[j, i]
        for i in range(4):
            target.v[j, i] = source.v[j, i]
        target.frames.twist[j] = source.frames.twist[j]


@merged
def _guess(free: Any, grip: Grip, old: State, work: Work, step: int, h: float, share: float, inertia: float) -> None:
    """Write Newton's first guess and what the gripper prescribes after a share of the step into work.mid and turn."""
    x, turn = work.mid.x, work.turn
    for j in range(len(x)):
        turn[j] = inertia * h * old.v[j, 3] if free[j, 3] else 0.0
        for i in range(3):
            moved = grip.guess[j] * share * (grip.x[step + 1, 0, i] - grip.x[step, 0, i]) if len(grip.nodes) else 0.0
            x[j, i] = old.x[j, i] + (inertia * h * old.v[j, i] + moved if free[j, i] else 0.0)
    for k in range(len(grip.nodes)):
        for i in range(3):
            x[grip.nodes[k], i] = (1 - share) * grip.x[step, k, i] + share * grip.x[step + 1, k, i]


@merged
def _turn_gripped_edges(model: Model, grip: Grip, old: State, work: Work, step: int, share: float) -> None:
    """Prescribe the spin that takes the first director of each gripped edge to where the gripper holds it."""
    for q in range(len(grip.edges)):
        j = grip.edges[q]
        p = model.parent[j]
        start = subtract(load(old.x, j), load(old.x, p))
        end = subtract(load(work.mid.x, j), load(work.mid.x, p))
        t = scale(1 / norm(end), end)
        m1 = transport(load(old.frames.m1, j), scale(1 / norm(start), start), t)
        wanted = load(grip.director[step + 1], q)
        angle = share * math.atan2(dot(cross(m1, wanted), t), dot(m1, wanted))
        work.turn[j] = 2 * math.tan(0.5 * angle)


@compiled
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
        p = max(parent[j], 0)
        stored += 0.5 * spin_inertia[j] * v[j, 3] * v[j, 3]
        for i in range(3):
            change = v[j, i] - v[p, i]
            stored += 0.5 * mass[j] * v[j, i] * v[j, i] + 0.5 * rotary[j] * change * change
            raised -= weight[j, i] * x[j, i]
    return stored, stored + raised


@merged
def _drive_speed(grip: Grip, state: State, step: int, dt: float) -> None:
    """Give the gripped nodes the speed of the drive at the end of the step, which the midpoint rule leaves out."""
    last = min(step + 2, len(grip.x) - 1)
    for k in range(len(grip.nodes)):
        for i in range(3):
            state.v[grip.nodes[k], i] = (grip.x[last, k, i] - grip.x[step, k, i]) / ((last - step) * dt)


@merged
def _grip_work(grip: Grip, work: Work, step: int, midpoint: bool) -> float:
    """Return the work of the grip over the step [J]."""
    g, total = work.blocks.gradient, 0.0
    for k in range(len(grip.nodes)):
        for i in range(3):
            total += g[grip.nodes[k], i] * (grip.x[step + 1, k, i] - grip.x[step, k, i])
    for q in range(len(grip.edges)):
        total += g[grip.edges[q], 3] * (2.0 if midpoint else 1.0) * work.turn[grip.edges[q]]
    return total


@compiled
def _step(model: Model, free: Any, grip: Grip, state: State, work: Work, settings: Settings, step: int) -> Any:
    """Take one step from `state`, of which the end comes into work.mid.

    A midpoint step that creates energy is refused: undamped waves too fast for the step would go on creating it until
    everything flies apart.

    Returns:
        Newton iterations used (negative: not solved, or refused) and the last residual [N].
    """
    share = 0.5 if settings.midpoint else 1.0
    h = share * settings.dt
    _guess(free, grip, state, work, step, h, share, settings.inertia)
    _turn_gripped_edges(model, grip, state, work, step, share)
    used, residual = implicit_step(model, free, state, work, h, settings.midpoint, settings.tolerance, settings.most)
    if used < 0:
        return used, residual
    gained = _grip_work(grip, work, step, settings.midpoint)
    if settings.midpoint:
        _extrapolate(model, free, state, work)
        _drive_speed(grip, work.mid, step, settings.dt)
    stored, total = energies(model, work.mid)
    created = total - work.energy[0] - gained
    if settings.midpoint and settings.balance and created > CREATED * max(stored, work.energy[1]):
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
    out.energy[row] = work.energy[0]
    out.work[row] = work.energy[2]
    g = work.blocks.gradient
    for i in range(3):
        out.force[row, i] = 0.0
        out.moment[row, i] = 0.0
    for k in range(len(grip.nodes)):
        node = grip.nodes[k]
        force = load(g, node)
        lever = cross(subtract(load(state.x, node), load(state.x, grip.nodes[0])), force)
        for i in range(3):
            out.force[row, i] += force[i]
            out.moment[row, i] += lever[i]
    for q in range(len(grip.edges)):
        j = grip.edges[q]
        edge = subtract(load(state.x, j), load(state.x, model.parent[j]))
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
            record(model, grip, state, work, out, (step + 1) // every - 1)
    return steps, spent, residual
