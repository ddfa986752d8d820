"""Natural frequencies, mode shapes and damping ratios, by subspace iteration with the tree solver."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh

from anther.checks import check_range
from anther.elastic_rod.assembly import Blocks, new_blocks
from anther.elastic_rod.linear import MATRIX, Linear, linearise, product
from anther.elastic_rod.motion import Clamp
from anther.elastic_rod.rods import GRAVITY, Array, Rods
from anther.elastic_rod.tree_solver import constrain, factor, solve
from anther.errors import StageFailure

SWEEPS = 200
"""Most iterations; each shrinks the error of mode k by the ratio of its squared frequency to the first one left out."""


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


def natural_frequencies(rods: Rods, clamp: Clamp, count: int, *, gravity: ArrayLike = GRAVITY) -> Modes:
    """Return the lowest modes of small vibrations about the equilibrium under gravity.

    Subspace iteration (Bathe & Wilson 1972) with more vectors than modes, so that equal frequencies, as of a round rod
    in its two planes, come out as often as they occur. That none is missing is checked by Sylvester's law of inertia:
    the tree factorisation of K - s M has as many negative pivots as there are modes below s. K = min(count, half of
    the unknowns).

    Raises:
        InputError: count < 1.
        StageFailure: kind "no_convergence" when there is no stable equilibrium, or the modes do not converge.
    """
    check_range("number of modes", count, 1, 1e5)
    system = linearise(rods, clamp, gravity)
    unknowns = int(system.free.sum())
    count = max(1, min(count, unknowns // 2))
    squares, vectors = _subspace(system, count, min(unknowns, 2 * count + 8))
    damped = product(system.model, system.damping, vectors)
    ratios = np.einsum("nik,nik->k", vectors, damped) / (2 * np.sqrt(squares))
    shapes = np.moveaxis(vectors, 2, 0)[:, :, :3]
    largest = np.abs(shapes).max(axis=(1, 2), keepdims=True)
    return Modes(np.sqrt(squares) / (2 * np.pi), shapes / np.where(largest > 0, largest, 1), ratios)


def _subspace(system: Linear, count: int, size: int) -> tuple[Array, Array]:
    """Return (K,) squared angular frequencies and (N, 4, K) vectors with v^T M v = 1."""
    model, free = system.model, system.free
    stiffness = _copied(system.stiffness)
    factor(model, stiffness)
    vectors = np.where(free[:, :, None], np.random.default_rng(0).normal(size=(*free.shape, size)), 0)
    previous, squares = np.zeros(count), np.zeros(0)
    for _ in range(SWEEPS):
        load = np.where(free[:, :, None], product(model, system.mass, vectors), 0)
        for k in range(vectors.shape[2]):
            column = load[:, :, k].copy()
            solve(model, stiffness, column)
            vectors[:, :, k] = column
        weight = np.where(free[:, :, None], product(model, system.mass, vectors), 0)
        inverse, mix = _ritz(_gram(vectors, weight), _gram(vectors, load))
        vectors = vectors @ mix
        squares = 1 / inverse[:count]
        if np.all(np.abs(squares - previous) <= 1e-11 * squares):
            break
        previous = squares
    found = vectors[:, :, :count]
    if not _complete(system, squares):
        raise StageFailure(
            "no_convergence",
            f"rods: {count} modes did not converge in {SWEEPS} sweeps. Ask for a few more or fewer modes.",
        )
    return squares, found


def _ritz(mass: Array, stiffness: Array) -> tuple[Array, Array]:
    """Return 1 / squared frequencies, falling, and the mixtures of columns that are modes with v^T M v = 1."""
    scale = 1 / np.sqrt(np.diag(stiffness))
    values, basis = eigh(scale[:, None] * stiffness * scale)
    sound = values > 1e-13 * values[-1]
    basis = scale[:, None] * basis[:, sound] / np.sqrt(values[sound])
    inverse, mix = eigh(basis.T @ mass @ basis)
    return inverse[::-1], (basis @ mix)[:, ::-1] / np.sqrt(np.maximum(inverse[::-1], 1e-300))


def _gram(a: Array, b: Array) -> Array:
    product_ = np.einsum("nik,nil->kl", a, b)
    return (product_ + product_.T) / 2


def _complete(system: Linear, squares: Array) -> bool:
    """Return whether as many modes lie below just above the last frequency as were found (or an equal one is cut)."""
    shifted = _copied(system.stiffness)
    shift = float(squares[-1]) * (1 - 1e-6)
    for name in MATRIX:
        getattr(shifted, name)[:] -= shift * getattr(system.mass, name)
    constrain(system.model, system.free, shifted)
    return factor(system.model, shifted) == int(np.sum(squares < shift))


def _copied(blocks: Blocks) -> Blocks:
    copy = new_blocks(len(blocks.diagonal))
    for name in MATRIX:
        getattr(copy, name)[:] = getattr(blocks, name)
    return copy
