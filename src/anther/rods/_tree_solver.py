"""Direct solution of tree-structured symmetric systems by elimination from the tips to the root, in O(N).

Works on real and on complex symmetric (not Hermitian) matrices: L D L^T without pivoting, four unknowns a block.
Kernels take single arrays, not the whole `Model`: each array among the arguments costs time of compiling.
"""

from __future__ import annotations

from typing import Any

from anther.rods._assembly import Blocks
from anther.rods._vectors import compiled, inlined


@compiled
def constrain(near: Any, far: Any, free: Any, blocks: Blocks) -> None:
    """Replace rows and columns of the unknowns with free (N, 4) False by those of the identity, gradient 0."""
    D, U, V, g = blocks.diagonal, blocks.near, blocks.far, blocks.gradient
    for j in range(len(free)):
        a, b = near[j], far[j]
        for i in range(4):
            if not free[j, i]:
                for k in range(4):
                    D[j, i, k] = 0
                    D[j, k, i] = 0
                    U[j, i, k] = 0
                    V[j, i, k] = 0
                D[j, i, i] = 1
                g[j, i] = 0
            if a >= 0 and not free[a, i]:
                for k in range(4):
                    U[j, k, i] = 0
            if b >= 0 and not free[b, i]:
                for k in range(4):
                    V[j, k, i] = 0


@compiled
def factor(order: Any, near: Any, far: Any, blocks: Blocks) -> int:
    """Factor in place. Return the number of pivots that are not positive: 0 means positive definite (if real)."""
    D, U, V, good = blocks.diagonal, blocks.near, blocks.far, 0
    for j in order:
        good += _factor_block(D, U, V, j)
        a, b = near[j], far[j]
        if a >= 0:
            _update(D, j, U, U, D, a)
        if b >= 0:
            _update(D, j, V, V, D, b)
            _update(D, j, U, V, U if near[a] == b else V, a)
    return 4 * len(order) - good


@inlined
def _factor_block(D: Any, U: Any, V: Any, j: Any) -> int:
    """Turn the rows of block j into inverse pivots, unit factors above them, and L^-1 times U and V.

    Returns the number of positive pivots.
    """
    d01, d02, d03 = D[j, 0, 1], D[j, 0, 2], D[j, 0, 3]
    p0 = 1 / D[j, 0, 0]
    a, b, c = d01 * p0, d02 * p0, d03 * p0
    d12, d13, d23 = D[j, 1, 2] - a * d02, D[j, 1, 3] - a * d03, D[j, 2, 3] - b * d03
    p1 = 1 / (D[j, 1, 1] - a * d01)
    d, e = d12 * p1, d13 * p1
    d23 = d23 - d * d13
    p2 = 1 / (D[j, 2, 2] - b * d02 - d * d12)
    f = d23 * p2
    p3 = 1 / (D[j, 3, 3] - c * d03 - e * d13 - f * d23)
    D[j, 0, 0], D[j, 0, 1], D[j, 0, 2], D[j, 0, 3] = p0, a, b, c
    D[j, 1, 1], D[j, 1, 2], D[j, 1, 3] = p1, d, e
    D[j, 2, 2], D[j, 2, 3], D[j, 3, 3] = p2, f, p3
    _eliminate_rows(U, j, a, b, c, d, e, f)
    _eliminate_rows(V, j, a, b, c, d, e, f)
    return (p0.real > 0) + (p1.real > 0) + (p2.real > 0) + (p3.real > 0)


@inlined
def _eliminate_rows(B: Any, j: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any) -> None:
    """Apply L^-1 to B_j; L has the columns (1, a, b, c), (1, d, e) and (1, f)."""
    for k in range(4):
        x0 = B[j, 0, k]
        x1 = B[j, 1, k] - a * x0
        x2 = B[j, 2, k] - b * x0 - d * x1
        B[j, 1, k], B[j, 2, k], B[j, 3, k] = x1, x2, B[j, 3, k] - c * x0 - e * x1 - f * x2


@inlined
def _update(D: Any, j: Any, A: Any, B: Any, target: Any, at: Any) -> None:
    """Subtract A_j^T pivots^-1 B_j from block `at` of the target."""
    p0, p1, p2, p3 = D[j, 0, 0], D[j, 1, 1], D[j, 2, 2], D[j, 3, 3]
    for i in range(4):
        x0, x1, x2, x3 = A[j, 0, i] * p0, A[j, 1, i] * p1, A[j, 2, i] * p2, A[j, 3, i] * p3
        for k in range(4):
            target[at, i, k] -= x0 * B[j, 0, k] + x1 * B[j, 1, k] + x2 * B[j, 2, k] + x3 * B[j, 3, k]


@compiled
def solve(order: Any, near: Any, far: Any, blocks: Blocks, r: Any) -> None:
    """Overwrite r (N, 4) with the solution of the factored system."""
    D, U, V = blocks.diagonal, blocks.near, blocks.far
    for j in order:
        scaled = _eliminate(D, r, j)
        a, b = near[j], far[j]
        if a >= 0:
            _lessen(r, a, scaled, U, j)
        if b >= 0:
            _lessen(r, b, scaled, V, j)
    for k in range(len(order) - 1, -1, -1):
        j = order[k]
        a, b = near[j], far[j]
        if a >= 0:
            _less_known(r, j, U, a)
        if b >= 0:
            _less_known(r, j, V, b)
        _substitute(D, r, j)


@inlined
def _eliminate(D: Any, r: Any, j: Any) -> Any:
    """Apply L^-1 to row j; return it times the inverse pivots."""
    r0 = r[j, 0]
    r1 = r[j, 1] - D[j, 0, 1] * r0
    r2 = r[j, 2] - D[j, 0, 2] * r0 - D[j, 1, 2] * r1
    r3 = r[j, 3] - D[j, 0, 3] * r0 - D[j, 1, 3] * r1 - D[j, 2, 3] * r2
    r[j, 1], r[j, 2], r[j, 3] = r1, r2, r3
    return (r0 * D[j, 0, 0], r1 * D[j, 1, 1], r2 * D[j, 2, 2], r3 * D[j, 3, 3])


@inlined
def _lessen(r: Any, at: Any, scaled: Any, B: Any, j: Any) -> None:
    """Subtract scaled^T B_j from row `at`."""
    for k in range(4):
        r[at, k] -= scaled[0] * B[j, 0, k] + scaled[1] * B[j, 1, k] + scaled[2] * B[j, 2, k] + scaled[3] * B[j, 3, k]


@inlined
def _less_known(r: Any, j: Any, B: Any, at: Any) -> None:
    """Subtract B_j times row `at` from row j."""
    x0, x1, x2, x3 = r[at, 0], r[at, 1], r[at, 2], r[at, 3]
    for i in range(4):
        r[j, i] -= B[j, i, 0] * x0 + B[j, i, 1] * x1 + (B[j, i, 2] * x2 + B[j, i, 3] * x3)


@inlined
def _substitute(D: Any, r: Any, j: Any) -> None:
    """Apply the pivots and L^-T to row j."""
    x3 = r[j, 3] * D[j, 3, 3]
    x2 = r[j, 2] * D[j, 2, 2] - D[j, 2, 3] * x3
    x1 = r[j, 1] * D[j, 1, 1] - D[j, 1, 2] * x2 - D[j, 1, 3] * x3
    r[j, 0] = r[j, 0] * D[j, 0, 0] - D[j, 0, 1] * x1 - D[j, 0, 2] * x2 - D[j, 0, 3] * x3
    r[j, 1], r[j, 2], r[j, 3] = x1, x2, x3
