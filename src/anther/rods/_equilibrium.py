"""Static equilibrium under weight, its stability, and the natural shape that makes the scanned shape an equilibrium."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anther.core.errors import StageFailure
from anther.rods._assembly import (
    Blocks,
    add_supports,
    assemble_edges,
    elastic_energy,
    move_frames,
    new_blocks,
    on_nodes,
)
from anther.rods._loads import Loads
from anther.rods._model import Frames, Model, build_model, turning_held, with_natural
from anther.rods._motion import Clamp
from anther.rods._rods import GRAVITY, LEAST_YOUNGS, MOST_YOUNGS, Array, NaturalShape, Rods
from anther.rods._stepping import LARGEST_TURN, POSITION_FLOOR, State, new_state
from anther.rods._strains import joint_slopes, joint_stiffness
from anther.rods._supports import full
from anther.rods._tree_solver import constrain, factor, solve
from anther.rods._vectors import add, compiled, dot, load, norm, scale, store

SETTLED = 1e-8
"""A Newton correction below this [m] has found the equilibrium."""

NEWTON_LIMIT = 500
"""Newton iterations of a static solve; a cantilever that bends through 90 degrees needs some tens."""


def by_edges(model: Model) -> Model:
    """Return the constants with the couplings of this matrix: none beyond the near row."""
    return model._replace(far=np.full(len(model.far), -1))


def hangs_together(model: Model, free: NDArray[np.bool_]) -> bool:
    """Return whether free (N, 4) holds the root, other nodes only where their parent is held, and no spring a node.

    Then a held node is an edge that does not move, and the unknowns that are free are the same in both descriptions.
    """
    if np.any(model.supports[:, 4:10]):  # they pull at nodes
        return False
    held = ~free[:, 0]
    return bool(held[0] and np.all(held[model.parent[1:]] | ~held[1:]))


@dataclass(frozen=True, slots=True, eq=False)
class Tangent:
    """The factored stiffness of rods, by edges where these hang together, by nodes where they do not.

    Attributes:
        model: the constants, with the couplings of that matrix.
        free: (N, 4) which unknowns are free.
        blocks: the factors; and the elastic gradient.
        together: whether the unknowns are those of edges.
        unstable: how many directions have no positive stiffness.
    """

    model: Model
    free: NDArray[np.bool_]
    blocks: Blocks
    together: bool
    unstable: int

    def forces(self, loads: Array) -> Array:
        """Return forces on nodes (N, 4) as those on the free unknowns."""
        own = loads.copy()
        if self.together:
            sum_along(self.model.parent, own, False)
        own[~self.free] = 0
        return own

    def moves(self, own: Array) -> Array:
        """Return motions of the unknowns (N, 4) as those of nodes."""
        moves = own.copy()
        if self.together:
            sum_along(self.model.parent, moves, True)
        return moves

    def solve(self, loads: Array) -> Array:
        """Return the motion of nodes (N, 4) under forces on nodes (N, 4)."""
        own = self.forces(loads)
        solve(self.model.order, self.model.near, self.model.far, self.blocks, own)
        return self.moves(own)


def tangent(model: Model, free: Any, x: Array, frames: Frames, blocks: Blocks, shift: float = 0.0) -> Tangent:
    """Return the factored stiffness at positions x (N, 3), in the given blocks, with `shift` added to its diagonal."""
    together, x = hangs_together(model, free), np.array(x)
    assemble_edges(model, x, x, frames, np.zeros((len(x), 4)), 0.0, blocks)
    if together:
        model = by_edges(model)
    else:
        on_nodes(model.order, model.parent, model.near, model.far, model.swapped, blocks)
        add_supports(model.supports, x, blocks)
    blocks.diagonal[:, range(4), range(4)] += shift * np.array([1, 1, 1, 1e-4])
    gradient = blocks.gradient.copy()
    constrain(model.near, model.far, free, blocks)
    unstable = int(factor(model.order, model.near, model.far, blocks))
    blocks.gradient[:] = gradient
    return Tangent(model, free, blocks, together, unstable)


@compiled
def sum_along(parent: Any, values: Any, outward: bool) -> None:
    """Sum values (N, 4) but the last along the tree: motions of edges to those of nodes, outward; else forces on nodes
    to what each edge carries.
    """
    n = len(parent)
    for k in range(1, n):
        j = k if outward else n - k
        p = parent[j]
        to, of = (j, p) if outward else (p, j)
        for i in range(3):
            values[to, i] += values[of, i]


def with_gravity_equilibrium(rods: Rods, clamp: Clamp, gravity: ArrayLike = GRAVITY) -> Rods:
    """Return the same rods with the natural shape for which the scanned shape hangs in equilibrium under gravity.

    A tree clamped at its root is statically determinate: weights alone fix every tension and moment, whatever the
    stiffness. They are found by one linear solve with the material stiffness K = B W B^T (which picks the least
    elastic energy where several clamped places make it indeterminate); natural strain = strain - stress / stiffness.
    Call it again after changing stiffness, mass or radius.

    Supports are part of it: one with a stated `force` exerts that, the others share the weight by their stiffness, as
    if it came upon the scanned shape at once; one-sided ones that would pull let go. What each exerts is then
    `Rods.support_forces`. Rotation springs exert nothing.

    Raises:
        StageFailure: kind "no_convergence" when nothing can balance the weight, for instance with a single pin.
    """
    rods = replace(rods, natural=None)
    model, frames = build_model(rods, gravity, clamp.planted)
    return with_natural(rods, balancing_shape(rods, model, frames, clamp))


def balancing_shape(rods: Rods, model: Model, frames: Frames, clamp: Clamp) -> NaturalShape:
    """Return the natural shape that `with_gravity_equilibrium` gives rods; model and frames are of them without one.

    Raises:
        StageFailure: as there.
    """
    free, weight, springs = clamp.free(rods), model.weight.copy(), model.supports.copy()
    nodes, along, forces = springs[:, 0].astype(np.int64), springs[:, 10:13].copy(), rods.support_forces
    if turning_held(rods):  # rotation springs exert nothing: the joints are as they are without
        model = build_model(replace(rods, supports=()), (0, 0, 0), clamp.planted)[0]
    np.add.at(weight[:, :3], nodes, np.where(along.any(axis=1, keepdims=True), forces, 0))
    springs[:, 1:4], springs[:, 10:13], springs[:, 13] = rods.nodes[nodes], 0, 1
    bears = np.array([s.force is None and s.gap == 0 for s in rods.supports], dtype=np.bool_)
    while True:
        bearing = model._replace(weight=weight, supports=springs[bears])
        strain, forces[bears] = _balance(rods, bearing, frames, free)
        pulled = bears & (np.sum(forces * along, axis=1) < 0)
        if not pulled.any():
            break
        bears, forces[pulled] = bears & ~pulled, 0
    if np.any(strain[:, 3] <= -0.5):
        raise StageFailure("no_convergence", "rods: the weight squeezes an edge by more than half; they are too soft.")
    return NaturalShape(rods.lengths / (1 + strain[:, 3]), model.curvature - strain[:, :2], -strain[:, 2], forces)


def _balance(rods: Rods, model: Model, frames: Frames, free: Any) -> tuple[Array, Array]:
    """Return (N, 4) strains and (S, 3) forces of supports that bear the weight in the scanned shape, by stiffness.

    Raises:
        StageFailure: kind "no_convergence" when they cannot.
    """
    n, along = len(rods.nodes), np.zeros_like(rods.nodes)
    stiffness = tangent(model, free, rods.nodes, frames, new_blocks(n))
    slopes, unknown, _ = joint_slopes(model, rods.nodes, frames.m1)
    along[1:] = (rods.nodes[1:] - rods.nodes[rods.parent[1:]]) / rods.lengths[1:, None] ** 2
    stretching = np.hstack([0 * along, -along, along, np.zeros((n, 2))])[:, None]  # the fourth strain
    strains = np.concatenate([slopes, stretching], axis=1)
    forces = np.concatenate(
        [joint_stiffness(model) @ slopes, (model.stretch * model.length)[:, None, None] * stretching], 1
    )
    held, springs = model.supports[:, 0].astype(np.int64), full(model.supports[:, 4:10])
    strain, borne = np.zeros((n, 4)), np.zeros((len(held), 3))
    load_left = load = np.where(free, model.weight, 0)
    for _ in range(4):  # iterative refinement
        moves = stiffness.solve(load_left)
        strained = np.einsum("nki,ni->nk", strains, moves.ravel()[unknown])
        force = np.bincount(unknown.ravel(), np.einsum("nki,nk->ni", forces, strained).ravel(), 4 * n).reshape(n, 4)
        pull = np.einsum("sij,sj->si", springs, moves[held, :3])
        np.add.at(force[:, :3], held, pull)
        strain, borne = strain + strained, borne - pull
        load_left = load_left - np.where(free, force, 0)
    if not np.abs(load_left).max() < 1e-8 * np.abs(load).max() + 1e-12:
        raise StageFailure(
            "no_convergence",
            "rods: no natural shape lets the clamp balance the weight. One clamped node is only a pin, about which the "
            "rods would swing: clamp both ends of an edge.",
        )
    return strain, borne


def equilibrium(rods: Rods, clamp: Clamp, *, gravity: ArrayLike = GRAVITY, loads: Loads | None = None) -> Array:
    """Return the (N, 3) positions [m] at rest in stable equilibrium under gravity (3,) [m/s^2] and loads of one's own.

    Raises:
        StageFailure: kind "no_convergence" when none is found, or it is not stable (buckling).
    """
    model, frames = build_model(rods, gravity, clamp.planted)
    return loaded_state(rods, model, frames, clamp.free(rods), loads)[1].x


def loaded_state(
    rods: Rods, model: Model, frames: Frames, free: Any, loads: Loads | None, ramp: int = 8
) -> tuple[Model, State]:
    """Return the constants with the loads in their weight, and the state at rest under them.

    A torque is a couple of forces and a moment that spins the edge. It grows in `ramp` steps; then the forces turn with
    the edge until nothing moves.

    Raises:
        StageFailure: kind "no_convergence", as of `static_state`.
    """
    if loads is None:
        return model, static_state(model, frames, rods.nodes, free)
    x, moved = rods.nodes, np.inf
    for k in range(ramp + 100 if loads.turns else 1):
        share = min(1.0, (k + 1) / ramp) if loads.turns else 1.0
        loaded = model._replace(weight=model.weight + share * loads.on(rods, x))
        state = static_state(loaded, frames, x, free)
        moved, x, frames = float(np.abs(state.x - x).max()), state.x, state.frames
        if not loads.turns or (share == 1 and moved < SETTLED):
            warn_of_twist(loaded, state.frames.twist)
            return loaded, state
    raise StageFailure("no_convergence", f"rods: no equilibrium under a torque, the last step moved {moved:.2g} m.")


def warn_of_twist(model: Model, twist: Array, largest: float = 0.45) -> None:
    """Warn where a joint is twisted (N,) [rad] so far that it bends more than 5 % too easily, by cos^2(twist / 2)."""
    most = float(np.abs(np.where(model.joint[:, 0] > 0, twist, 0)).max())
    if most > largest:
        warnings.warn(
            f"rods: a joint is twisted by {most:.2g} rad, where it bends {100 * (1 - np.cos(most / 2) ** 2):.0f} % too "
            f"easily; up to {largest} rad it is 5 %. Use shorter edges.",
            stacklevel=3,
        )


def static_state(model: Model, frames: Frames, x: Array, free: Any) -> State:
    """Return the state at rest in the static equilibrium downhill from positions x (N, 3) [m].

    Raises:
        StageFailure: kind "no_convergence" when none is found, or it is not stable (buckling).
    """
    state, blocks = new_state(x, frames), new_blocks(len(x))
    residual, correction, shift, stable = _descend(model, free, state, blocks)
    if not (correction < SETTLED and (shift == 0 or residual < 1e-3 * np.abs(model.weight).sum() + 1e-6)):
        raise StageFailure(
            "no_convergence",
            f"rods: no static equilibrium found; residual {residual:.3g} N after {NEWTON_LIMIT} Newton iterations. "
            "They may be too soft or thin for their weight, or swing about a pin: check radius, stiffness and clamp.",
        )
    if not stable and tangent(model, free, state.x, state.frames, blocks).unstable:
        raise StageFailure(
            "no_convergence",
            "rods: the equilibrium under gravity is not stable: they buckle under their own weight (the tangent "
            "stiffness has a direction <= 0). Such rods cannot stand: check radius [m], Young's modulus [Pa], density "
            "[kg/m^3], lumped masses, and that the clamp holds both ends of an edge.",
        )
    return state


def _potential(model: Model, x: Array, frames: Frames) -> float:
    return elastic_energy(model, x, frames) - float(np.sum(model.weight[:, :3] * x))


def _descend(model: Model, free: Any, state: State, blocks: Blocks) -> tuple[float, float, float, bool]:
    """Minimise the potential energy by Newton's method with a shift where needed and a backtracking line search.

    Returns the last residual [N], the last correction [m], the shift that it was made with, and whether the tangent
    stiffness is known to be positive definite there.
    """
    shift, floor, weight = 0.0, 1e-12 * model.stretch.max(), model.weight
    residual, correction, unshifted = np.inf, np.inf, False
    arm = model.length if np.any(weight[:, 3]) else np.zeros(len(weight))  # spins count where something spins them
    for _ in range(NEWTON_LIMIT):
        stiffness = tangent(model, free, state.x, state.frames, blocks, shift)
        gradient = np.where(free, blocks.gradient, 0) - stiffness.forces(weight)
        residual = float(np.linalg.norm(gradient))
        if stiffness.unstable:
            if residual <= floor and shift == 0:
                return residual, 0.0, shift, False  # balanced but unstable: the caller tells
            shift = max(4 * shift, 1e-3)
            continue
        step = gradient.copy()
        solve(stiffness.model.order, stiffness.model.near, stiffness.model.far, blocks, step)
        moves = stiffness.moves(step)
        moves[:, 3] *= arm
        correction, before = float(np.abs(moves).max()), correction
        rounding = shift == 0 and SETTLED > correction > before / 2
        if correction < POSITION_FLOOR or rounding or (residual <= floor and correction < SETTLED):
            if shift == 0 or unshifted:
                return residual, correction, shift, shift == 0
            shift, unshifted = 0.0, True
            continue
        _line_search(model, state, stiffness, step, float(np.sum(step * gradient)), correction)
        shift = shift / 8 if shift > 1e-9 else 0.0
    return residual, correction, shift, False


def _line_search(model: Model, state: State, stiffness: Tangent, step: Array, slope: float, size: float) -> None:
    """Move the state against `step` (N, 4), halving it until the potential energy falls, but for its rounding."""
    x, m1, lanes = state.x.copy(), state.frames.m1.copy(), stiffness.blocks.lanes
    stored, start, spinning = (
        elastic_energy(model, x, state.frames),
        _potential(model, x, state.frames),
        model.weight[:, 3],
    )
    edges = x - x[model.parent]
    if stiffness.together:
        turned = np.max(np.linalg.norm(step[1:, :3], axis=1) / model.length[1:])
        share = min(1.0, LARGEST_TURN / max(turned, 1e-300))
    else:
        share = min(1.0, 5 * model.length.max() / size)
    for _ in range(40):
        if stiffness.together:
            _turn_edges(model.parent, edges, -share * step, state.x)
        else:
            state.x[:] = x - share * step[:, :3]
        move_frames(model, x, m1, state.x, -share * step[:, 3], state.frames.m1, lanes)
        spun = float(np.sum(spinning * 2 * np.arctan(-share * step[:, 3] / 2)))
        if (
            _potential(model, state.x, state.frames) - spun
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


def standing(rods: Rods, clamp: Clamp) -> Rods | None:
    """Return rods whose scanned shape hangs in stable equilibrium: its tangent stiffness is positive definite.

    Rods without a natural shape get the one of `with_gravity_equilibrium`. None if it is not stable, or none balances.
    """
    free = clamp.free(rods)
    model, frames = build_model(rods, GRAVITY, clamp.planted)
    if rods.natural is None:
        try:
            rods = with_natural(rods, balancing_shape(rods, model, frames, clamp))
        except StageFailure:
            return None
        model, frames = build_model(rods, GRAVITY, clamp.planted)
    unstable = tangent(model, free, rods.nodes, frames, new_blocks(len(rods.nodes))).unstable
    return None if unstable else rods


def stands(rods: Rods, clamp: Clamp) -> bool:
    """Return whether the scanned shape hangs in stable equilibrium; see `standing`."""
    return standing(rods, clamp) is not None


def least_stiffness(
    rods: Rods,
    clamp: Clamp,
    *,
    fixed: Any = False,
    between: tuple[float, float] = (1e-5, 1e4),
    within: float = 0.01,
) -> float | None:
    """Return the factor on Young's modulus at which the rods just stand; None if none of those searched does.

    Where they stand with the least that is searched, it is that.

    The moments of the weight do not depend on the stiffness: the tangent stiffness is E A - B, so there is one such
    factor, found by bisection of its logarithm.

    Args:
        rods: the rods; their natural shape is found anew for every factor.
        clamp: what is held.
        fixed: (N,) edges that keep their own Young's modulus.
        between: the factors that are searched; no softer and no stiffer than rods may be.
        within: relative error of the factor.
    """

    def holds(logarithm: float) -> bool:
        youngs = np.where(fixed, rods.youngs, np.asarray(rods.youngs) * np.exp(logarithm))
        return stands(replace(rods, youngs=youngs, natural=None), clamp)

    softest = float(np.broadcast_to(np.where(fixed, np.inf, rods.youngs), len(rods.nodes))[1:].min())
    stiffest = float(np.broadcast_to(np.where(fixed, 0.0, rods.youngs), len(rods.nodes))[1:].max())
    low = np.log(max(between[0], (1 + 1e-9) * LEAST_YOUNGS / softest))
    high = np.log(min(between[1], (1 - 1e-9) * MOST_YOUNGS / max(stiffest, LEAST_YOUNGS)))
    if not holds(high):
        return None
    if holds(low):
        return float(np.exp(low))
    while high - low > within:
        middle = (low + high) / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return float(np.exp(high))
