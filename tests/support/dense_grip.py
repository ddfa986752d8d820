"""Soft pads by another way: springs in one dense matrix, where the engine adds their compliance to the receptance."""

from __future__ import annotations

from typing import Any

import numpy as np

from anther.rods import GRAVITY, Clamp, Rods, Springs
from anther.rods._linear import dense, linearise


def dense_answer(rods: Rods, pad: list[int], springs: Springs, hertz: float, ways: Any, loss: float = 0.0) -> Any:
    """Return (D, N, 4) the motion of rods per metre of a gripper that moves along `ways` (D, 3).

    The gripped unknowns are replaced by a body on springs, all in one matrix.
    """
    system, omega = linearise(rods, Clamp.root(rods), GRAVITY, loss), 2 * np.pi * hertz
    stiffness, damping, lossy, mass = (
        dense(system.model, part) for part in (system.stiffness, system.damping, system.loss, system.mass)
    )
    moves, held = np.outer(system.free, system.free), np.array(pad)
    matrix = stiffness + np.where(moves, 1j * (omega * damping + lossy) - omega**2 * mass, 0)
    edges = [j for j in pad if rods.parent[j] in pad]
    rows = np.concatenate([(4 * held[:, None] + np.arange(3)).ravel(), 4 * np.array(edges) + 3])
    others = np.setdiff1d(np.arange(len(matrix)), rows)
    follow = np.zeros((len(matrix), len(others) + 6))
    follow[others, np.arange(len(others))] = 1
    x = system.state.x
    for k, node in enumerate(pad):
        for axis in range(3):
            turn = np.cross(np.eye(3)[axis], x[node] - x[pad[0]])
            follow[rows[3 * k : 3 * k + 3], len(others) + axis] = np.eye(3)[axis]
            follow[rows[3 * k : 3 * k + 3], len(others) + 3 + axis] = turn
    for k, j in enumerate(edges):
        way = x[j] - x[rods.parent[j]]
        follow[rows[3 * len(pad) + k], len(others) + 3 :] = way / np.linalg.norm(way)
    stiff = np.diag(np.repeat([springs.translation, springs.rotation], 3))
    reduced = follow.T @ matrix @ follow
    reduced[-6:, -6:] += stiff
    pull = np.zeros((len(reduced), len(ways)))
    pull[-6:-3] = springs.translation * ways.T
    return (follow @ np.linalg.solve(reduced, pull)).T.reshape(len(ways), -1, 4)
