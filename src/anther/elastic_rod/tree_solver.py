"""Direct solution of tree-structured symmetric systems by elimination from the tips to the root, in O(N).

Works on real and on complex symmetric (not Hermitian) matrices: L D L^T without pivoting, four unknowns a block.
"""

from __future__ import annotations

from typing import Any

import numba

from anther.elastic_rod.assembly import Blocks
from anther.elastic_rod.model import Model


@numba.njit(cache=True)
def constrain(model: Model, free: Any, blocks: Blocks) -> None:
    """Replace rows and columns of the unknowns with free (N, 4) False by those of the identity, gradient 0."""
    for j in range(len(free)):
        a, b = model.near[j], model.far[j]
        for i in range(4):
            if not free[j, i]:
                blocks.diagonal[j, i, :] = 0
                blocks.diagonal[j, :, i] = 0
                blocks.diagonal[j, i, i] = 1
                blocks.near[j, i, :] = 0
                blocks.far[j, i, :] = 0
                blocks.gradient[j, i] = 0
            if a >= 0 and not free[a, i]:
                blocks.near[j, :, i] = 0
            if i < 3 and b >= 0 and not free[b, i]:
                blocks.far[j, :, i] = 0


@numba.njit(cache=True)
def _factor_block(L: Any) -> int:
    """Overwrite the lower triangle with unit L below the diagonal and D on it; return the pivots <= 0."""
    wrong = 0
    for i in range(4):
        for j in range(i):
            value = L[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            L[i, j] = value  # still times the pivot
        pivot = L[i, i]
        for k in range(i):
            scaled = L[i, k] / L[k, k]
            pivot -= scaled * L[i, k]
            L[i, k] = scaled
        if not pivot.real > 0:
            wrong += 1
        L[i, i] = pivot
    return wrong


@numba.njit(cache=True)
def _forward(L: Any, B: Any, columns: int) -> None:
    for i in range(1, 4):
        for k in range(i):
            value = L[i, k]
            for c in range(columns):
                B[i, c] -= value * B[k, c]


@numba.njit(cache=True)
def factor(model: Model, blocks: Blocks) -> int:
    """Factor in place. Return the number of pivots that are not positive: 0 means positive definite (if real)."""
    wrong = 0
    for j in model.order:
        L = blocks.diagonal[j]
        wrong += _factor_block(L)
        a, b = model.near[j], model.far[j]
        if a < 0:
            continue
        U, V = blocks.near[j], blocks.far[j]
        _forward(L, U, 4)
        _update(L, U, U, blocks.diagonal[a], 4)
        if b >= 0:
            _forward(L, V, 3)
            _update(L, V, V, blocks.diagonal[b], 3)
            _update(L, U, V, blocks.near[a] if model.near[a] == b else blocks.far[a], 3)
    return wrong


@numba.njit(cache=True)
def _update(L: Any, U: Any, V: Any, target: Any, columns: int) -> None:
    """Subtract U^T D^-1 V from the target block."""
    for k in range(4):
        inverse = 1 / L[k, k]
        for i in range(U.shape[1]):
            value = U[k, i] * inverse
            for c in range(columns):
                target[i, c] -= value * V[k, c]


@numba.njit(cache=True)
def solve(model: Model, blocks: Blocks, r: Any) -> None:
    """Overwrite r (N, 4) with the solution of the factored system."""
    for j in model.order:
        L, y = blocks.diagonal[j], r[j]
        for i in range(1, 4):
            for k in range(i):
                y[i] -= L[i, k] * y[k]
        a, b = model.near[j], model.far[j]
        for k in range(4):
            scaled = y[k] / L[k, k]
            if a >= 0:
                for i in range(4):
                    r[a, i] -= blocks.near[j, k, i] * scaled
            if b >= 0:
                for i in range(3):
                    r[b, i] -= blocks.far[j, k, i] * scaled
    for j in model.order[::-1]:
        L, y = blocks.diagonal[j], r[j]
        a, b = model.near[j], model.far[j]
        for k in range(4):
            value = y[k]
            if a >= 0:
                for i in range(4):
                    value -= blocks.near[j, k, i] * r[a, i]
            if b >= 0:
                for i in range(3):
                    value -= blocks.far[j, k, i] * r[b, i]
            y[k] = value / L[k, k]
        for i in range(2, -1, -1):
            for k in range(i + 1, 4):
                y[i] -= L[k, i] * y[k]
