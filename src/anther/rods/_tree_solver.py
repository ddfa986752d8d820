"""Direct solution of tree-structured symmetric systems by elimination from the tips to the root, in O(N).

Works on real and on complex symmetric (not Hermitian) matrices: L D L^T without pivoting, four unknowns a block. The
rows of a block are handled whole, as four numbers side by side.
"""

from __future__ import annotations

from typing import Any

from anther.rods._assembly import Blocks
from anther.rods._model import Model
from anther.rods._vectors import compiled, inlined, inner, merged

Row = Any
"""Four numbers."""


@merged
def _row(A: Any, j: Any, i: int) -> Row:
    return (A[j, i, 0], A[j, i, 1], A[j, i, 2], A[j, i, 3])


@merged
def _put_row(A: Any, j: Any, i: int, row: Row) -> None:
    A[j, i, 0], A[j, i, 1], A[j, i, 2], A[j, i, 3] = row


@merged
def _less(a: Row, s: Any, b: Row) -> Row:
    """Return a - s b."""
    return (a[0] - s * b[0], a[1] - s * b[1], a[2] - s * b[2], a[3] - s * b[3])


@merged
def _dot(a: Row, b: Row) -> Any:
    return a[0] * b[0] + a[1] * b[1] + (a[2] * b[2] + a[3] * b[3])


@compiled
def constrain(model: Model, free: Any, blocks: Blocks) -> None:
    """Replace rows and columns of the unknowns with free (N, 4) False by those of the identity, gradient 0."""
    near, far, D, U, V, g = model.near, model.far, blocks.diagonal, blocks.near, blocks.far, blocks.gradient
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
def factor(model: Model, blocks: Blocks) -> int:
    """Factor in place. Return the number of pivots that are not positive: 0 means positive definite (if real)."""
    order, near, far, D, U, V = model.order, model.near, model.far, blocks.diagonal, blocks.near, blocks.far
    good = 0
    for j in order:
        good += _factor_block(D, U, V, j)
        a, b = near[j], far[j]
        if a >= 0:
            _update(D, j, U, U, D, a)
        if b >= 0:
            _update(D, j, V, V, D, b)
            if near[a] == b:
                _update(D, j, U, V, U, a)
            else:
                _update(D, j, U, V, V, a)
    return 4 * len(order) - good


@inlined
def _factor_block(D: Any, U: Any, V: Any, j: Any) -> int:
    """Turn the rows of block j into inverse pivots, unit factors above them, and L^-1 times U and V.

    Returns the number of positive pivots.
    """
    d0, d1, d2, d3 = _row(D, j, 0), _row(D, j, 1), _row(D, j, 2), _row(D, j, 3)
    u0, u1, u2, u3 = _row(U, j, 0), _row(U, j, 1), _row(U, j, 2), _row(U, j, 3)
    v0, v1, v2, v3 = _row(V, j, 0), _row(V, j, 1), _row(V, j, 2), _row(V, j, 3)
    p0 = 1 / d0[0]
    a, b, c = d0[1] * p0, d0[2] * p0, d0[3] * p0
    d1, u1, v1 = _less(d1, a, d0), _less(u1, a, u0), _less(v1, a, v0)
    d2, u2, v2 = _less(d2, b, d0), _less(u2, b, u0), _less(v2, b, v0)
    d3, u3, v3 = _less(d3, c, d0), _less(u3, c, u0), _less(v3, c, v0)
    _put_row(D, j, 0, (p0, a, b, c))
    p1 = 1 / d1[1]
    b, c = d1[2] * p1, d1[3] * p1
    d2, u2, v2 = _less(d2, b, d1), _less(u2, b, u1), _less(v2, b, v1)
    d3, u3, v3 = _less(d3, c, d1), _less(u3, c, u1), _less(v3, c, v1)
    D[j, 1, 1], D[j, 1, 2], D[j, 1, 3] = p1, b, c
    p2 = 1 / d2[2]
    c = d2[3] * p2
    d3, u3, v3 = _less(d3, c, d2), _less(u3, c, u2), _less(v3, c, v2)
    D[j, 2, 2], D[j, 2, 3] = p2, c
    p3 = 1 / d3[3]
    D[j, 3, 3] = p3
    _put_row(U, j, 1, u1)
    _put_row(U, j, 2, u2)
    _put_row(U, j, 3, u3)
    _put_row(V, j, 1, v1)
    _put_row(V, j, 2, v2)
    _put_row(V, j, 3, v3)
    return int(p0.real > 0) + int(p1.real > 0) + int(p2.real > 0) + int(p3.real > 0)


@merged
def _less_product(a: Row, left: Row, rows: Any) -> Row:
    """Return a - left rows."""
    return _less(_less(_less(_less(a, left[0], rows[0]), left[1], rows[1]), left[2], rows[2]), left[3], rows[3])


@merged
def _update(D: Any, j: Any, A: Any, B: Any, target: Any, at: Any) -> None:
    """Subtract A_j^T pivots^-1 B_j from block `at` of the target."""
    rows = _row(B, j, 0), _row(B, j, 1), _row(B, j, 2), _row(B, j, 3)
    p0, p1, p2, p3 = D[j, 0, 0], D[j, 1, 1], D[j, 2, 2], D[j, 3, 3]
    for i in range(4):
        left = (A[j, 0, i] * p0, A[j, 1, i] * p1, A[j, 2, i] * p2, A[j, 3, i] * p3)
        _put_row(target, at, i, _less_product(_row(target, at, i), left, rows))


@compiled
def solve(model: Model, blocks: Blocks, r: Any) -> None:
    """Overwrite r (N, 4) with the solution of the factored system."""
    order, near, far, D, U, V = model.order, model.near, model.far, blocks.diagonal, blocks.near, blocks.far
    for j in order:
        scaled = _eliminate(D, r, j)
        a, b = near[j], far[j]
        if a >= 0:
            _lessen(r, a, scaled, U, j)
        if b >= 0:
            _lessen(r, b, scaled, V, j)
    for k in range(len(order) - 1, -1, -1):
        j = order[k]
        x, a, b = _four(r, j), near[j], far[j]
        if a >= 0:
            x = _known(x, U, j, _four(r, a))
        if b >= 0:
            x = _known(x, V, j, _four(r, b))
        _substitute(D, r, j, x)


@compiled
def eliminate_columns(model: Model, blocks: Blocks, rows: Any, real: Any, imaginary: Any, M: Any) -> None:
    """Begin the solution of a factored complex system for (N, 4, C) right-hand sides, side by side, in their place.

    Real and imaginary parts lie apart, so that the loops over columns reach the processor's vector units.

    Args:
        model: constants.
        blocks: factored, complex.
        rows: (R,) rows in rising elimination distance from the root, each after its near row. Other rows must be zero
            on the right-hand side, and are left alone.
        real, imaginary: (N, 4, C).
        M: (2, 4, 4) scratch.
    """
    near, far, D, U, V = model.near, model.far, blocks.diagonal, blocks.near, blocks.far
    for k in range(len(rows) - 1, -1, -1):
        j = rows[k]
        a, b = near[j], far[j]
        _eliminate_columns(D, j, real, imaginary)
        if a >= 0:
            _transposed(U, j, M)
            _less_matrix(real, imaginary, a, M, j)
        if b >= 0:
            _transposed(V, j, M)
            _less_matrix(real, imaginary, b, M, j)


@compiled
def substitute_columns(model: Model, blocks: Blocks, rows: Any, real: Any, imaginary: Any, M: Any) -> None:
    """End it; alone, do what the rows do when those they hang on move as they stand there."""
    near, far, D, U, V = model.near, model.far, blocks.diagonal, blocks.near, blocks.far
    for k in range(len(rows)):
        j = rows[k]
        a, b = near[j], far[j]
        if a >= 0:
            _with_pivots(U, D, j, M)
            _less_matrix(real, imaginary, j, M, a)
        if b >= 0:
            _with_pivots(V, D, j, M)
            _less_matrix(real, imaginary, j, M, b)
        _substitute_columns(D, j, real, imaginary)


@inlined
def _transposed(B: Any, j: Any, M: Any) -> None:
    for i in range(4):
        for m in range(4):
            M[0, m, i], M[1, m, i] = B[j, i, m].real, B[j, i, m].imag


@inlined
def _with_pivots(B: Any, D: Any, j: Any, M: Any) -> None:
    for i in range(4):
        for m in range(4):
            value = B[j, i, m] * D[j, i, i]
            M[0, i, m], M[1, i, m] = value.real, value.imag


@inner
def _less_matrix(real: Any, imaginary: Any, at: Any, M: Any, source: Any) -> None:
    """Subtract M (real and imaginary part) times the rows of block `source` from those of block `at`."""
    for m in range(4):
        c0, c1, c2, c3 = M[0, m, 0], M[0, m, 1], M[0, m, 2], M[0, m, 3]
        s0, s1, s2, s3 = M[1, m, 0], M[1, m, 1], M[1, m, 2], M[1, m, 3]
        for k in range(real.shape[2]):
            x0, x1, x2, x3 = real[source, 0, k], real[source, 1, k], real[source, 2, k], real[source, 3, k]
            y0, y1, y2, y3 = (
                imaginary[source, 0, k],
                imaginary[source, 1, k],
                imaginary[source, 2, k],
                imaginary[source, 3, k],
            )
            real[at, m, k] -= c0 * x0 - s0 * y0 + c1 * x1 - s1 * y1 + c2 * x2 - s2 * y2 + c3 * x3 - s3 * y3
            imaginary[at, m, k] -= c0 * y0 + s0 * x0 + c1 * y1 + s1 * x1 + c2 * y2 + s2 * x2 + c3 * y3 + s3 * x3


@inlined
def _eliminate_columns(D: Any, j: Any, real: Any, imaginary: Any) -> None:
    """Apply L^-1 and the inverse pivots to the rows of block j."""
    for i in range(4):
        for m in range(i + 1, 4):
            _take(real, imaginary, j, m, D[j, i, m], i)
    for i in range(4):
        c, s = D[j, i, i].real, D[j, i, i].imag
        for k in range(real.shape[2]):
            x, y = real[j, i, k], imaginary[j, i, k]
            real[j, i, k], imaginary[j, i, k] = c * x - s * y, c * y + s * x


@inlined
def _substitute_columns(D: Any, j: Any, real: Any, imaginary: Any) -> None:
    """Apply L^-T to the rows of block j."""
    for i in range(2, -1, -1):
        for m in range(i + 1, 4):
            _take(real, imaginary, j, i, D[j, i, m], m)


@merged
def _take(real: Any, imaginary: Any, j: Any, i: int, size: complex, m: int) -> None:
    """Subtract size times row m of block j from its row i."""
    c, s = size.real, size.imag
    for k in range(real.shape[2]):
        x, y = real[j, m, k], imaginary[j, m, k]
        real[j, i, k] -= c * x - s * y
        imaginary[j, i, k] -= c * y + s * x


@merged
def _four(r: Any, j: Any) -> Row:
    return (r[j, 0], r[j, 1], r[j, 2], r[j, 3])


@merged
def _eliminate(D: Any, r: Any, j: Any) -> Row:
    """Apply L^-1 to row j; return it times the inverse pivots."""
    r0, r1, r2, r3 = _four(r, j)
    r1 = r1 - D[j, 0, 1] * r0
    r2 = r2 - D[j, 0, 2] * r0 - D[j, 1, 2] * r1
    r3 = r3 - D[j, 0, 3] * r0 - D[j, 1, 3] * r1 - D[j, 2, 3] * r2
    r[j, 1], r[j, 2], r[j, 3] = r1, r2, r3
    return (r0 * D[j, 0, 0], r1 * D[j, 1, 1], r2 * D[j, 2, 2], r3 * D[j, 3, 3])


@merged
def _lessen(r: Any, at: Any, scaled: Row, B: Any, j: Any) -> None:
    """Subtract scaled^T B_j from row `at`."""
    rows = _row(B, j, 0), _row(B, j, 1), _row(B, j, 2), _row(B, j, 3)
    r[at, 0], r[at, 1], r[at, 2], r[at, 3] = _less_product(_four(r, at), scaled, rows)


@merged
def _known(r: Row, B: Any, j: Any, x: Row) -> Row:
    """Return r - B_j x."""
    return (
        r[0] - _dot(_row(B, j, 0), x),
        r[1] - _dot(_row(B, j, 1), x),
        r[2] - _dot(_row(B, j, 2), x),
        r[3] - _dot(_row(B, j, 3), x),
    )


@merged
def _substitute(D: Any, r: Any, j: Any, x: Row) -> None:
    """Apply the pivots and L^-T and write row j."""
    x3 = x[3] * D[j, 3, 3]
    x2 = x[2] * D[j, 2, 2] - D[j, 2, 3] * x3
    x1 = x[1] * D[j, 1, 1] - D[j, 1, 2] * x2 - D[j, 1, 3] * x3
    r[j, 0] = x[0] * D[j, 0, 0] - D[j, 0, 1] * x1 - D[j, 0, 2] * x2 - D[j, 0, 3] * x3
    r[j, 1], r[j, 2], r[j, 3] = x1, x2, x3
