"""Invariances of the energy and consistency of its derivatives, over random trees."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anther.rods import Clamp, Drive, Rods, simulate
from anther.rods._assembly import assemble, elastic_energy, move_frames, new_blocks, new_lanes
from anther.rods._linear import dense
from anther.rods._model import Frames, Model, build_model
from evaluation.rods.beams import NO_GRAVITY, X_AXIS
from evaluation.rods.table import Array, Row

SCALE = np.array([1e-5, 1e-5, 1e-5, 1e-3])
"""Differences of positions [m] and spins [rad] for which truncation and rounding errors of the energy are alike."""


def objectivity_cases(quick: bool) -> list[Row]:
    """Return the rows of rotation, renumbering, force and Hessian: each the worst of some random trees."""
    seeds = range(3 if quick else 10)
    force, symmetry, hessian = np.array([derivative_errors(seed) for seed in seeds]).max(axis=0)
    moved = max(renumbering_change(seed) for seed in seeds)
    turned = max(rotation_energy(seed) for seed in seeds)
    rotation = "energy stored by a rigid rotation of 2.4 rad over a typical bend energy"
    found = {
        "rotation": (rotation, turned, 1e-12),
        "renumbering": ("renumbering the nodes: change of a trajectory over its largest motion", moved, 1e-10),
        "force": ("force against differences of the energy, over the largest force", force, 1e-7),
        "hessian_symmetry": ("Hessian: asymmetry over its largest entry", symmetry, 1e-12),
        "hessian": ("Hessian against differences of the force, over its largest entry", hessian, 1e-6),
    }
    trees = f"{len(seeds)} random trees, worst"
    return [Row(case, f"{what}, {trees}", *values, "") for case, (what, *values) in found.items()]


def random_tree(seed: int, n: int = 12) -> Rods:
    """Return a random tree of n nodes, edges up to 40 mm, radius and stiffness vary; odd seeds: P19 to the letter."""
    rng = np.random.default_rng(seed)
    parent = np.array([-1, *(int(rng.integers(max(0, j - 3), j)) for j in range(1, n))])
    nodes = np.zeros((n, 3))
    for j in range(1, n):
        way = rng.normal(size=3) + np.array([0, 0, 1.5])
        nodes[j] = nodes[parent[j]] + rng.uniform(0.02, 0.04) * way / np.linalg.norm(way)
    return Rods(
        nodes,
        parent,
        rng.uniform(2e-3, 4e-3, n),
        rng.uniform(5e7, 3e8, n),
        1000.0,
        viscous_time=1e-3,
        discretisation="paper" if seed % 2 else "consistent",
    )


def disturbed(rods: Rods, seed: int) -> tuple[Model, Array, Frames]:
    """Return the model, and positions and frames bent and twisted at random."""
    rng = np.random.default_rng(seed)
    model, frames = build_model(rods, NO_GRAVITY)
    x = rods.nodes + 2e-3 * rng.normal(size=rods.nodes.shape)
    return model, x, moved_frames(model, rods.nodes, frames, x, 0.3 * rng.normal(size=len(x)))


def moved_frames(model: Model, old: Array, frames: Frames, x: Array, turn: Array) -> Frames:
    """Return the frames carried from positions `old` to x, each edge turned by turn (N,): 2 tan of half the angle."""
    new = Frames(np.zeros_like(frames.m1), frames.twist.copy())
    move_frames(model, np.array(old), frames.m1, np.array(x), turn, new.m1, new_lanes())
    return new


def rotation_energy(seed: int) -> float:
    """Return the energy after a rotation of twelve times 0.2 rad, frames carried along, over that of a bent state."""
    rods = random_tree(seed)
    model, frames = build_model(rods, NO_GRAVITY)
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    matrix, x = Rotation.from_rotvec(0.2 * axis).as_matrix(), rods.nodes
    for _ in range(12):
        edges = x[1:] - x[rods.parent[1:]]
        along = (edges / np.linalg.norm(edges, axis=1, keepdims=True)) @ axis
        turn = np.concatenate([[0.0], 2 * along * np.tan(0.1)])  # what transport leaves out
        rotated = x @ matrix.T
        frames, x = moved_frames(model, x, frames, rotated, turn), rotated
    return elastic_energy(model, x, frames) / elastic_energy(*disturbed(rods, seed))


def renumbering_change(seed: int) -> float:
    """Return the largest change of a 0.2 s trajectory over its largest motion."""
    rods = random_tree(seed)
    order = _other_order(rods.parent, seed)
    place = np.argsort(order)
    other = replace(
        rods,
        nodes=rods.nodes[order],
        parent=np.where(rods.parent[order] < 0, -1, place[rods.parent[order]]),
        edge_radius=np.asarray(rods.edge_radius)[order],
        youngs=np.asarray(rods.youngs)[order],
    )
    runs = [
        simulate(r, Clamp.root(r), Drive(node, X_AXIS, 2e-3, 20), 0.2, 1e-3, gravity=NO_GRAVITY).positions
        for r, node in ((rods, 8), (other, int(place[8])))
    ]
    return float(np.abs(runs[1][:, place] - runs[0]).max() / np.abs(runs[0] - runs[0][0]).max())


def _other_order(parent: NDArray[Any], seed: int) -> NDArray[Any]:
    rng, order = np.random.default_rng(seed), [0]
    while len(order) < len(parent):
        ready = [j for j in range(len(parent)) if j not in order and parent[j] in order]
        order.append(int(rng.choice(ready)))
    return np.array(order)


def derivative_errors(seed: int) -> tuple[float, float, float]:
    """Return the errors of the force, of the Hessian's symmetry and of the Hessian at a bent and twisted state.

    Frames are carried along a path, and carrying them around a loop turns them: differences of the force therefore
    hold an antisymmetric part (half the area swept by the tangent, times the moment that spins the edge) which is no
    curvature of the energy. The symmetric part is compared.
    """
    model, x, frames = disturbed(random_tree(seed, 8), seed)
    n = len(x)
    gradient, hessian = _assembled(model, x, frames)
    differences = np.zeros(4 * n)
    columns = np.zeros((4 * n, 4 * n))
    for i in range(4, 4 * n):  # the root has no edge to spin, and the rest sees it move as they see themselves
        step = np.zeros(4 * n)
        step[i] = SCALE[i % 4]
        sides = [_moved(model, x, frames, k * step) for k in (-2, -1, 1, 2)]
        weights = np.array([1, -8, 8, -1]) / (12 * step[i])
        differences[i] = weights @ [elastic_energy(model, y, f) for y, f in sides]
        columns[:, i] = weights @ np.array([_assembled(model, y, f)[0] for y, f in sides])
    force_error = np.abs(gradient - differences)[4:].max() / np.abs(gradient).max()
    size, symmetric = np.abs(hessian).max(), (columns + columns.T)[4:, 4:] / 2
    hessian_error = np.abs(hessian[4:, 4:] - symmetric).max() / size
    return force_error, float(np.abs(hessian - hessian.T).max() / size), float(hessian_error)


def _assembled(model: Model, x: Array, frames: Frames) -> tuple[Array, Array]:
    blocks = new_blocks(len(x))
    assemble(model, x, x, Frames(frames.m1, frames.twist.copy()), np.zeros((len(x), 4)), 0.0, blocks)
    return blocks.gradient.ravel().copy(), dense(model, blocks)


def _moved(model: Model, x: Array, frames: Frames, step: Array) -> tuple[Array, Frames]:
    move = step.reshape(-1, 4)
    there = x + move[:, :3]
    return there, moved_frames(model, x, frames, there, move[:, 3])
