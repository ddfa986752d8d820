"""Direct solution of tree-structured symmetric systems by elimination from the tips to the root, in O(N).

Works on real and on complex symmetric (not Hermitian) matrices: L D L^T without pivoting, four unknowns a block.
"""

# ruff: noqa: PLR0917 - compiled kernels take their arrays by position

from __future__ import annotations

from typing import Any

from anther.elastic_rod.assembly import Blocks
from anther.elastic_rod.model import Model
from anther.elastic_rod.vectors import compiled


@compiled
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


@compiled
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


@compiled
def _forward(L: Any, B: Any, columns: int) -> None:
    for i in range(1, 4):
        for k in range(i):
            value = L[i, k]
            for c in range(columns):
                B[i, c] -= value * B[k, c]


@compiled
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


@compiled
def _update(L: Any, U: Any, V: Any, target: Any, columns: int) -> None:
    """Subtract U^T D^-1 V from the target block."""
    for k in range(4):
        inverse = 1 / L[k, k]
        for i in range(U.shape[1]):
            value = U[k, i] * inverse
            for c in range(columns):
                target[i, c] -= value * V[k, c]


@compiled
def solve(model: Model, blocks: Blocks, r: Any) -> None:
    """Overwrite r (N, 4) with the solution of the factored system."""
    for j in model.order:
        _eliminate(blocks.diagonal[j], blocks.near[j], blocks.far[j], r, j, model.near[j], model.far[j])
    for j in model.order[::-1]:
        _substitute(blocks.diagonal[j], blocks.near[j], blocks.far[j], r, j, model.near[j], model.far[j])


@compiled
def _eliminate(L: Any, U: Any, V: Any, r: Any, j: Any, a: Any, b: Any) -> None:
    for i in range(1, 4):
        for k in range(i):
            r[j, i] -= L[i, k] * r[j, k]
    for k in range(4):
        scaled = r[j, k] / L[k, k]
        if a >= 0:
            for i in range(4):
                r[a, i] -= U[k, i] * scaled
        if b >= 0:
            for i in range(3):
                r[b, i] -= V[k, i] * scaled


@compiled
def _substitute(L: Any, U: Any, V: Any, r: Any, j: Any, a: Any, b: Any) -> None:
    for k in range(4):
        value = r[j, k]
        if a >= 0:
            for i in range(4):
                value -= U[k, i] * r[a, i]
        if b >= 0:
            for i in range(3):
                value -= V[k, i] * r[b, i]
        r[j, k] = value / L[k, k]
    for i in range(2, -1, -1):
        for k in range(i + 1, 4):
            r[j, i] -= L[k, i] * r[j, k]
