"""Direct solution of tree-structured symmetric systems by elimination from the tips to the root, in O(N).

Works on real and on complex symmetric (not Hermitian) matrices: L D L^T without pivoting, four unknowns a block.
"""

from __future__ import annotations

from typing import Any

from anther.elastic_rod.assembly import Blocks
from anther.elastic_rod.model import Model
from anther.elastic_rod.vectors import compiled


@compiled
def constrain(model: Model, free: Any, blocks: Blocks) -> None:
    """Replace rows and columns of the unknowns with free (N, 4) False by those of the identity, gradient 0."""
    near, far, D, U, V, g = model.near, model.far, blocks.diagonal, blocks.near, blocks.far, blocks.gradient
    for j in range(len(free)):
        a, b = near[j], far[j]
        for i in range(4):
            if not free[j, i]:
                D[j, i, :] = 0
                D[j, :, i] = 0
                D[j, i, i] = 1
                U[j, i, :] = 0
                V[j, i, :] = 0
                g[j, i] = 0
            if a >= 0 and not free[a, i]:
                U[j, :, i] = 0
            if i < 3 and b >= 0 and not free[b, i]:
                V[j, :, i] = 0


@compiled
def factor(model: Model, blocks: Blocks) -> int:
    """Factor in place. Return the number of pivots that are not positive: 0 means positive definite (if real)."""
    order, near, far, D, U, V = model.order, model.near, model.far, blocks.diagonal, blocks.near, blocks.far
    wrong = 0
    for j in order:
        wrong += _factor_block(D, j)
        a, b = near[j], far[j]
        if a < 0:
            continue
        _forward(D, U, j, 4)
        _update(D, j, U, 4, U, 4, D, a)
        if b >= 0:
            _forward(D, V, j, 3)
            _update(D, j, V, 3, V, 3, D, b)
            if near[a] == b:
                _update(D, j, U, 4, V, 3, U, a)
            else:
                _update(D, j, U, 4, V, 3, V, a)
    return wrong


@compiled
def _factor_block(D: Any, j: int) -> int:
    """Overwrite the lower triangle with unit L and the inverse pivots on the diagonal; return the pivots <= 0."""
    wrong = 0
    for i in range(4):
        for k in range(i):
            value = D[j, i, k]
            for m in range(k):
                value -= D[j, i, m] * D[j, k, m]
            D[j, i, k] = value  # still times the pivot
        pivot = D[j, i, i]
        for k in range(i):
            scaled = D[j, i, k] * D[j, k, k]
            pivot -= scaled * D[j, i, k]
            D[j, i, k] = scaled
        if not pivot.real > 0:
            wrong += 1
        D[j, i, i] = 1 / pivot
    return wrong


@compiled
def _forward(D: Any, B: Any, j: int, columns: int) -> None:
    for i in range(1, 4):
        for k in range(i):
            value = D[j, i, k]
            for c in range(columns):
                B[j, i, c] -= value * B[j, k, c]


@compiled
def _update(D: Any, j: int, A: Any, rows: int, B: Any, columns: int, target: Any, at: Any) -> None:
    """Subtract A_j^T pivots^-1 B_j from block `at` of the target."""
    for k in range(4):
        inverse = D[j, k, k]
        for i in range(rows):
            value = A[j, k, i] * inverse
            for c in range(columns):
                target[at, i, c] -= value * B[j, k, c]


@compiled
def solve(model: Model, blocks: Blocks, r: Any) -> None:
    """Overwrite r (N, 4) with the solution of the factored system."""
    order, near, far, D, U, V = model.order, model.near, model.far, blocks.diagonal, blocks.near, blocks.far
    for j in order:
        _eliminate(D, U, V, r, j, near[j], far[j])
    for k in range(len(order) - 1, -1, -1):
        _substitute(D, U, V, r, order[k], near[order[k]], far[order[k]])


@compiled
def solve_at(model: Model, blocks: Blocks, r: Any, loaded: int, wanted: Any) -> None:
    """Like `solve` where r is zero but for row `loaded`, and only the rows `wanted` need be right.

    Args:
        wanted: rows in rising elimination distance from the root, each after its near row.
    """
    near, far, D, U, V = model.near, model.far, blocks.diagonal, blocks.near, blocks.far
    j = loaded
    while j >= 0:  # a load reaches only the rows between it and the root
        _eliminate(D, U, V, r, j, near[j], far[j])
        j = near[j]
    for j in wanted:
        _substitute(D, U, V, r, j, near[j], far[j])


@compiled
def _eliminate(D: Any, U: Any, V: Any, r: Any, j: Any, a: Any, b: Any) -> None:
    for i in range(1, 4):
        for k in range(i):
            r[j, i] -= D[j, i, k] * r[j, k]
    for k in range(4):
        scaled = r[j, k] * D[j, k, k]
        if a >= 0:
            for i in range(4):
                r[a, i] -= U[j, k, i] * scaled
        if b >= 0:
            for i in range(3):
                r[b, i] -= V[j, k, i] * scaled


@compiled
def _substitute(D: Any, U: Any, V: Any, r: Any, j: Any, a: Any, b: Any) -> None:
    for k in range(4):
        value = r[j, k]
        if a >= 0:
            for i in range(4):
                value -= U[j, k, i] * r[a, i]
        if b >= 0:
            for i in range(3):
                value -= V[j, k, i] * r[b, i]
        r[j, k] = value * D[j, k, k]
    for i in range(2, -1, -1):
        for k in range(i + 1, 4):
            r[j, i] -= D[j, k, i] * r[j, k]
