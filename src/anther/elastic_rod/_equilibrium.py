"""Static equilibrium under weight, its stability, and the natural shape that makes the scanned shape an equilibrium."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from anther.elastic_rod import _springs
from anther.elastic_rod._assembly import Blocks, elastic_energy, move_frames, new_blocks
from anther.elastic_rod._edges import Tangent, tangent
from anther.elastic_rod._model import Frames, Model, build_model
from anther.elastic_rod._motion import Clamp
from anther.elastic_rod._newton import LARGEST_TURN, POSITION_FLOOR, State, new_state
from anther.elastic_rod._rods import GRAVITY, Array, NaturalShape, Rods
from anther.elastic_rod._tree_solver import solve
from anther.elastic_rod._vectors import add, compiled, dot, halves, load, merged, norm, scale, six, store, subtract
from anther.errors import StageFailure

SETTLED = 1e-8
"""A Newton correction below this [m] has found the equilibrium."""

NEWTON_LIMIT = 500
"""Newton iterations of a static solve; a cantilever that bends through 90 degrees needs some tens."""


def with_gravity_equilibrium(rods: Rods, clamp: Clamp, gravity: ArrayLike = GRAVITY) -> Rods:
    """Return the same rods with the natural shape for which the scanned shape hangs in equilibrium under gravity.

    A tree clamped at its root is statically determinate: weights alone fix every tension and moment, whatever the
    stiffness. They are found by one linear solve with the material stiffness K = B W B^T (which picks the least
    elastic energy where several clamped places make it indeterminate); natural strain = strain - stress / stiffness.
    Call it again after changing stiffness, mass or radius.

    Raises:
        StageFailure: kind "no_convergence" when nothing can balance the weight, for instance with a single pin.
    """
    model, frames = build_model(replace(rods, natural=None), gravity, clamp.planted)
    return replace(rods, natural=balancing_shape(rods, model, frames, clamp.free(rods)))


def balancing_shape(rods: Rods, model: Model, frames: Frames, free: Any) -> NaturalShape:
    """Return the natural shape that `with_gravity_equilibrium` gives rods; model and frames are of them without one.

    Raises:
        StageFailure: as there.
    """
    n = len(rods.nodes)
    stiffness = tangent(model, free, rods.nodes, frames, new_blocks(n))
    tension, moments = np.zeros(n), np.zeros((n, 3))
    load_left = scale_of_load = np.where(free, np.pad(model.weight, ((0, 0), (0, 1))), 0)
    for _ in range(4):  # iterative refinement
        sag = stiffness.solve(load_left)
        load_left = load_left - np.where(free, _stress_of(model, rods.nodes, frames, sag, tension, moments), 0)
    if not np.abs(load_left).max() < 1e-8 * np.abs(scale_of_load).max() + 1e-12:
        raise StageFailure(
            "no_convergence",
            "rods: no natural shape lets the clamp balance the weight. One clamped node is only a pin, about which the "
            "rods would swing: clamp both ends of an edge.",
        )
    return _natural_shape(model, rods, tension, moments)


def _natural_shape(model: Model, rods: Rods, tension: Array, moments: Array) -> NaturalShape:
    w11, w12, w22, w13, w23, w33 = np.where(model.joint[:, :1] > 0, model.joint, [1.0, 0, 1, 0, 0, 1]).T
    stiffness = np.moveaxis(np.array([[w11, w12, w13], [w12, w22, w23], [w13, w23, w33]]), 2, 0)
    strain: Array = np.linalg.solve(stiffness, moments[:, :, None])[:, :, 0].astype(np.float64)
    stretch = np.divide(tension, model.stretch, out=np.zeros_like(tension), where=model.stretch > 0)
    if np.any(stretch <= -0.5):
        raise StageFailure("no_convergence", "rods: the weight squeezes an edge by more than half; they are too soft.")
    return NaturalShape(rods.lengths / (1 + stretch), model.curvature - strain[:, :2], -strain[:, 2])


@compiled
def _stress_of(model: Model, x: Any, frames: Frames, move: Any, tension: Any, moments: Any) -> Any:
    """Add the tension and moments [N, N m] of a small move (N, 4) to the given ones; return the force of the move."""
    force = np.zeros_like(move)
    for j in range(1, len(x)):
        p = model.parent[j]
        f, by_f = subtract(load(x, j), load(x, p)), subtract(load(move, j), load(move, p))
        t = scale(1 / model.length[j], f)
        change = model.stretch[j] / model.length[j] * dot(t, by_f)
        tension[j] += change
        _pull(force, j, p, change, t)
        if model.joint[j, 0] == 0:
            continue
        a, o, sign = model.near[j], model.far[j], 1.0
        if o < 0:  # the soil: its director, and no motion
            o = p
            e, m1e = halves(model.soil, j)
        else:
            if model.swapped[j]:
                o, sign = a, -1.0
            e, m1e = subtract(load(x, p), load(x, o)), load(frames.m1, a)
        by_e, turn = subtract(load(move, p), load(move, o)), sign * move[a, 3]
        slopes = _springs.gradients(_springs.bent(e, f), m1e, load(frames.m1, j))
        k1 = _springs.rate_of(slopes[0], by_e, by_f, turn, move[j, 3])
        k2 = _springs.rate_of(slopes[1], by_e, by_f, turn, move[j, 3])
        tau = _springs.rate_of(slopes[2], by_e, by_f, turn, move[j, 3])
        stress = _springs.moments(six(model.joint, j), (k1, k2, tau))
        for k in range(3):
            moment = stress[k]
            moments[j, k] += moment
            _pull(force, p, o, moment, slopes[k].e)
            _pull(force, j, p, moment, slopes[k].f)
            force[a, 3] += sign * moment * slopes[k].spin_e
            force[j, 3] += moment * slopes[k].spin_f
    return force


@merged
def _pull(force: Any, j: int, p: int, size: float, along: Any) -> None:
    """Add size * along to row j and take it from row p."""
    for i in range(3):
        force[j, i] += size * along[i]
        force[p, i] -= size * along[i]


def equilibrium(rods: Rods, clamp: Clamp, *, gravity: ArrayLike = GRAVITY) -> Array:
    """Return the (N, 3) positions [m] at rest in stable equilibrium under gravity.

    Raises:
        StageFailure: kind "no_convergence" when none is found, or it is not stable (buckling).
    """
    model, frames = build_model(rods, gravity, clamp.planted)
    return static_state(model, frames, rods.nodes, clamp.free(rods)).x


def static_state(model: Model, frames: Frames, x: Array, free: Any) -> State:
    """Return the state at rest in the static equilibrium downhill from positions x (N, 3) [m].

    Raises:
        StageFailure: kind "no_convergence" when none is found, or it is not stable (buckling).
    """
    state, blocks = new_state(x, frames), new_blocks(len(x))
    residual, correction, shift = _descend(model, free, state, blocks)
    if not (correction < SETTLED and (shift == 0 or residual < 1e-3 * np.abs(model.weight).sum() + 1e-6)):
        raise StageFailure(
            "no_convergence",
            f"rods: no static equilibrium found; residual {residual:.3g} N after {NEWTON_LIMIT} Newton iterations. "
            "They may be too soft or thin for their weight, or swing about a pin: check radius, stiffness and clamp.",
        )
    if unstable_directions(model, free, state, blocks):
        raise StageFailure(
            "no_convergence",
            "rods: the equilibrium under gravity is not stable: they buckle under their own weight (the tangent "
            "stiffness has a direction <= 0). Such rods cannot stand: check radius [m], Young's modulus [Pa], density "
            "[kg/m^3], lumped masses, and that the clamp holds both ends of an edge.",
        )
    return state


def unstable_directions(model: Model, free: Any, state: State, blocks: Blocks) -> int:
    """Return how many directions have no positive stiffness: 0 where the equilibrium is stable."""
    return tangent(model, free, state.x, state.frames, blocks).unstable


def _potential(model: Model, x: Array, frames: Frames) -> float:
    return elastic_energy(model, x, frames) - float(np.sum(model.weight * x))


def _descend(model: Model, free: Any, state: State, blocks: Blocks) -> tuple[float, float, float]:
    """Minimise the potential energy by Newton's method with a shift where needed and a backtracking line search.

    Returns the last residual [N], the last correction [m] and the shift that it was made with.
    """
    shift, floor, weight = 0.0, 1e-12 * model.stretch.max(), np.pad(model.weight, ((0, 0), (0, 1)))
    residual, correction, unshifted = np.inf, np.inf, False
    for _ in range(NEWTON_LIMIT):
        stiffness = tangent(model, free, state.x, state.frames, blocks, shift)
        gradient = np.where(free, blocks.gradient, 0) - stiffness.forces(weight)
        residual = float(np.linalg.norm(gradient))
        if stiffness.unstable:
            if residual <= floor and shift == 0:
                return residual, 0.0, shift  # balanced but unstable: the caller tells
            shift = max(4 * shift, 1e-3)
            continue
        step = gradient.copy()
        solve(stiffness.model, blocks, step)
        correction, before = float(np.abs(stiffness.moves(step)[:, :3]).max()), correction
        rounding = shift == 0 and SETTLED > correction > before / 2
        if correction < POSITION_FLOOR or rounding or (residual <= floor and correction < SETTLED):
            if shift == 0 or unshifted:
                return residual, correction, shift
            shift, unshifted = 0.0, True
            continue
        _line_search(model, state, stiffness, step, float(np.sum(step * gradient)), correction)
        shift = shift / 8 if shift > 1e-9 else 0.0
    return residual, correction, shift


def _line_search(model: Model, state: State, stiffness: Tangent, step: Array, slope: float, size: float) -> None:
    """Move the state against `step` (N, 4), halving it until the potential energy falls, but for its rounding."""
    x, m1, lanes = state.x.copy(), state.frames.m1.copy(), stiffness.blocks.lanes
    stored, start = elastic_energy(model, x, state.frames), _potential(model, x, state.frames)
    edges = x - x[model.parent]
    if stiffness.together:
        share = min(1.0, LARGEST_TURN / np.max(np.linalg.norm(step[1:, :3], axis=1) / model.length[1:]))
    else:
        share = min(1.0, 5 * model.length.max() / size)
    for _ in range(40):
        if stiffness.together:
            _turn_edges(model.parent, edges, -share * step, state.x)
        else:
            state.x[:] = x - share * step[:, :3]
        move_frames(model, x, m1, state.x, -share * step[:, 3], state.frames.m1, lanes)
        if (
            _potential(model, state.x, state.frames)
            <= start - 1e-4 * share * slope + 1e-14 * abs(start) + 1e-9 * stored
        ):
            return
        share *= 0.5


@compiled
def _turn_edges(parent: Any, edges: Any, step: Any, x: Any) -> None:
    """Write the positions after a step of the edges: across itself an edge turns, so that it does not stretch."""
    for j in range(1, len(x)):
        edge = load(edges, j)
        turned = add(edge, load(step, j))
        size = norm(edge)
        size = (size + dot(edge, load(step, j)) / size) / norm(turned)
        store(x, j, add(load(x, parent[j]), scale(size, turned)))


RANGE = (1e-5, 1e4)
"""Factors on Young's modulus that are searched."""


def standing(rods: Rods, clamp: Clamp, *, gravity: ArrayLike = GRAVITY) -> Rods | None:
    """Return rods whose scanned shape hangs in stable equilibrium: its tangent stiffness is positive definite.

    Rods without a natural shape get the one of `with_gravity_equilibrium`. None if it is not stable, or none balances.
    """
    free = clamp.free(rods)
    model, frames = build_model(rods, gravity, clamp.planted)
    natural = rods.natural
    if natural is None:
        try:
            natural = balancing_shape(rods, model, frames, free)
        except StageFailure:
            return None
        model = model._replace(length=natural.length, curvature=natural.curvature, natural_twist=natural.twist)
    if unstable_directions(model, free, new_state(rods.nodes, frames), new_blocks(len(rods.nodes))):
        return None
    return rods if rods.natural is natural else replace(rods, natural=natural)


def stands(rods: Rods, clamp: Clamp, *, gravity: ArrayLike = GRAVITY) -> bool:
    """Return whether the scanned shape hangs in stable equilibrium; see `standing`."""
    return standing(rods, clamp, gravity=gravity) is not None


def least_stiffness(rods: Rods, clamp: Clamp, *, gravity: ArrayLike = GRAVITY) -> float | None:
    """Return the factor on Young's modulus at which the rods just stand, within 1 %; None if none in RANGE does.

    The moments of the weight do not depend on the stiffness: the tangent stiffness is E A - B, so there is one such
    factor, found by bisection of its logarithm.
    """
    low, high = np.log(RANGE)

    def holds(logarithm: float) -> bool:
        stiffer = np.asarray(rods.youngs) * np.exp(logarithm)
        return stands(replace(rods, youngs=stiffer, natural=None), clamp, gravity=gravity)

    if not holds(high):
        return None
    while high - low > 0.01:
        middle = (low + high) / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return float(np.exp(high))
