"""The linearised rods solved at several frequencies side by side, one in each lane of the processor's vector units.

Elimination from the tips to the root as in `_tree_solver`, without pivoting. Row j of the factors is block j: the
diagonal's upper triangle by rows, then the columns that join it to its near and far row, the far one's spin left out,
as no spring reaches it. Every number is a row of real parts and one of imaginary parts, `LANES` long. One row more than
there are blocks takes what rows without a near or far one would give to it.

N blocks, C right-hand sides.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.rods._rods import Array
from anther.rods._vectors import LANES, compiled, inlined, merged

NEAR, FAR, NUMBERS = 10, 26, 38
"""Where the columns of the near and of the far row begin, and how many numbers a block has."""
TO_NEAR, BETWEEN, TO_FAR = NUMBERS, NUMBERS + 10, NUMBERS + 22
"""Behind a block in the scratch, what it gives to the triangles of near and far row and to what joins those."""
TRIANGLE = (0, 1, 2, 3, 5, 6, 7, 10, 11, 15)
"""Where the upper triangle is in a block of 16 numbers."""


def pack(diagonal: NDArray[Any], near: NDArray[Any], far: NDArray[Any]) -> NDArray[Any]:
    """Return (..., NUMBERS) the numbers of blocks (..., 4, 4) in the order of the factors."""
    shape = (*near.shape[:-2], -1)
    columns = (np.swapaxes(part, -1, -2).reshape(shape) for part in (near, far[..., :3]))
    return np.concatenate([diagonal.reshape(shape)[..., TRIANGLE], *columns], axis=-1)


def new_factors(n: int) -> Array:
    """Return storage for the factors of N blocks."""
    return np.zeros((n + 1, 2 * NUMBERS * LANES))


def new_columns(n: int, count: int) -> Array:
    """Return zeros (N + 1, C, 4, 2, LANES): of each right-hand side four unknowns a block, real and imaginary parts."""
    return np.zeros((n + 1, count, 4, 2, LANES))


def flat(X: Array) -> Array:
    """Return such columns as the kernels take them, (N + 1, C, 8 LANES)."""
    return X.reshape(*X.shape[:2], -1)


def new_buffer() -> Array:
    """Return the scratch of `factor_lanes`: a block, and what it gives to others."""
    return np.zeros(2 * (NUMBERS + 33) * LANES)


@inlined
def _at(w: Any, number: int, i: int) -> complex:
    return complex(w[2 * number * LANES + i], w[(2 * number + 1) * LANES + i])


@inlined
def _put(w: Any, number: int, i: int, z: complex) -> None:
    w[2 * number * LANES + i], w[(2 * number + 1) * LANES + i] = z.real, z.imag


@inlined
def _column(w: Any, first: int, i: int) -> Any:
    return _at(w, first, i), _at(w, first + 1, i), _at(w, first + 2, i), _at(w, first + 3, i)


@inlined
def _inverse(z: complex) -> complex:
    size = 1 / (z.real * z.real + z.imag * z.imag)
    return complex(z.real * size, -z.imag * size)


@merged
def _solve_column(w: Any, first: int, i: int, f: Any) -> Any:
    """Turn four numbers u into the block's inverse times u, and return both.

    f are the pivots' inverses and the unit factors, in the order of the triangle.
    """
    u = _column(w, first, i)
    x1 = u[1] - f[1] * u[0]
    x2 = u[2] - f[2] * u[0] - f[5] * x1
    x3 = (u[3] - f[3] * u[0] - f[6] * x1 - f[8] * x2) * f[9]
    x2 = x2 * f[7] - f[8] * x3
    x1 = x1 * f[4] - f[5] * x2 - f[6] * x3
    x0 = u[0] * f[0] - f[1] * x1 - f[2] * x2 - f[3] * x3
    _put(w, first, i, x0)
    _put(w, first + 1, i, x1)
    _put(w, first + 2, i, x2)
    _put(w, first + 3, i, x3)
    return u, (x0, x1, x2, x3)


@merged
def _give(w: Any, first: int, i: int, columns: Any, r: Any) -> None:
    """Write four numbers: minus the products of the columns with r."""
    for k in range(4):
        u = columns[k]
        _put(w, first + k, i, -(u[0] * r[0] + u[1] * r[1] + (u[2] * r[2] + u[3] * r[3])))


@compiled
def factor_lanes(order: Any, near: Any, far: Any, parts: Any, omega: Any, W: Any, buffer: Any) -> None:
    """Fill W with K + i omega C + i loss - omega^2 M, and factor it.

    Each block becomes its own factors, and its columns become the block's inverse times them.

    Args:
        order, near, far: of the model.
        parts: (N, NUMBERS, 4) K, C, loss and M, see `pack`.
        omega: (LANES,) angular frequencies [rad/s].
        W: see `new_factors`.
        buffer: see `new_buffer`.
    """
    for j in range(len(W)):
        for k in range(W.shape[1]):
            W[j, k] = 0
    for j in order:
        a, b, w = near[j], far[j], W[j]
        for k in range(NUMBERS):
            for i in range(LANES):
                stiffness = parts[j, k, 0] - omega[i] * omega[i] * parts[j, k, 3]
                buffer[2 * k * LANES + i] = w[2 * k * LANES + i] + stiffness
                loss = omega[i] * parts[j, k, 1] + parts[j, k, 2]
                buffer[(2 * k + 1) * LANES + i] = w[(2 * k + 1) * LANES + i] + loss
        _factor(buffer)
        for k in range(2 * NUMBERS * LANES):
            w[k] = buffer[k]
        _add(W[a], 0, buffer, TO_NEAR, 10)
        if b >= 0:
            _add(W[a], NEAR if near[a] == b else FAR, buffer, BETWEEN, 12)
            _add(W[b], 0, buffer, TO_FAR, 8)


@inlined
def _add(w: Any, to: int, buffer: Any, first: int, count: int) -> None:
    for k in range(2 * count * LANES):
        w[2 * to * LANES + k] += buffer[2 * first * LANES + k]


@inlined
def _factor(w: Any) -> None:
    for i in range(LANES):
        d01, d02, d03 = _at(w, 1, i), _at(w, 2, i), _at(w, 3, i)
        p0 = _inverse(_at(w, 0, i))
        a, b, c = d01 * p0, d02 * p0, d03 * p0
        d12, d13, d23 = _at(w, 5, i) - a * d02, _at(w, 6, i) - a * d03, _at(w, 8, i) - b * d03
        p1 = _inverse(_at(w, 4, i) - a * d01)
        d, e = d12 * p1, d13 * p1
        d23 = d23 - d * d13
        p2 = _inverse(_at(w, 7, i) - b * d02 - d * d12)
        f = d23 * p2
        p3 = _inverse(_at(w, 9, i) - c * d03 - e * d13 - f * d23)
        g = (p0, a, b, c, p1, d, e, p2, f, p3)
        for k in range(10):
            _put(w, k, i, g[k])
        u0, t0 = _solve_column(w, NEAR, i, g)
        u1, t1 = _solve_column(w, NEAR + 4, i, g)
        u2, t2 = _solve_column(w, NEAR + 8, i, g)
        u3, t3 = _solve_column(w, NEAR + 12, i, g)
        v0, s0 = _solve_column(w, FAR, i, g)
        v1, s1 = _solve_column(w, FAR + 4, i, g)
        v2, s2 = _solve_column(w, FAR + 8, i, g)
        none = (0j, 0j, 0j, 0j)
        _give(w, TO_NEAR, i, (t0, t1, t2, t3), u0)  # what goes too far is written over by the next
        _give(w, TO_NEAR + 4, i, (t1, t2, t3, none), u1)
        _give(w, TO_NEAR + 7, i, (t2, t3, none, none), u2)
        _give(w, TO_NEAR + 9, i, (t3, none, none, none), u3)
        _give(w, BETWEEN, i, (u0, u1, u2, u3), s0)
        _give(w, BETWEEN + 4, i, (u0, u1, u2, u3), s1)
        _give(w, BETWEEN + 8, i, (u0, u1, u2, u3), s2)
        _give(w, TO_FAR, i, (s0, s1, s2, none), v0)
        _give(w, TO_FAR + 4, i, (s1, s2, none, none), v1)
        _give(w, TO_FAR + 7, i, (s2, none, none, none), v2)


@compiled
def solve_lanes(near: Any, far: Any, W: Any, rows: Any, begins: Any, X: Any, buffer: Any) -> None:
    """Overwrite right-hand sides with their solutions.

    Args:
        near, far: of the model.
        W: the factors.
        rows: (R,) rows in rising elimination distance from the root, each after its near row, where that is among them.
            Other rows are left alone: `rows` follow them.
        begins: (C,) the last of `rows` on which a right-hand side is not zero; -1 where it is on none. What stands on
            those after it does not count.
        X: (N + 1, C, 8 LANES), see `new_columns`.
        buffer: see `new_buffer`.
    """
    last = -1
    for c in range(len(begins)):
        last = begins[c] if begins[c] > last else last
    for k in range(last, -1, -1):
        j = rows[k]
        a, b = near[j], far[j]
        _copy(buffer, 0, W[j], 2 * NUMBERS)
        for c in range(len(begins)):
            if begins[c] >= k:
                _copy(buffer, 2 * NUMBERS, X[j, c], 8)
                _eliminate(buffer)
                _copy(X[j, c], 0, buffer[2 * NUMBERS * LANES :], 8)
                _add(X[a, c], 0, buffer, NUMBERS + 4, 4)
                _add(X[b, c], 0, buffer, NUMBERS + 8, 3)
    for k in range(len(rows)):
        j = rows[k]
        a, b = near[j], far[j]
        _copy(buffer, 0, W[j], 2 * NUMBERS)
        for c in range(len(begins)):
            _copy(buffer, 2 * NUMBERS, X[a, c], 8)
            _copy(buffer, 2 * NUMBERS + 8, X[b, c], 8)
            _substitute(buffer)
            x, own = X[j, c], 1.0 if begins[c] >= k else 0.0
            for i in range(8 * LANES):
                x[i] = own * x[i] - buffer[(2 * NUMBERS + 16) * LANES + i]


@inlined
def _copy(target: Any, to: int, source: Any, count: int) -> None:
    for k in range(count * LANES):
        target[to * LANES + k] = source[k]


@inlined
def _eliminate(w: Any) -> None:
    """Turn a block's right-hand side into the inverse times it, and write what it gives to near and far row."""
    for i in range(LANES):
        f = _column(w, 0, i) + _column(w, 4, i) + (_at(w, 8, i), _at(w, 9, i))
        r, _ = _solve_column(w, NUMBERS, i, f)
        u0, u1, u2 = _column(w, NEAR, i), _column(w, NEAR + 4, i), _column(w, NEAR + 8, i)
        v0, v1, v2 = _column(w, FAR, i), _column(w, FAR + 4, i), _column(w, FAR + 8, i)
        _give(w, NUMBERS + 4, i, (u0, u1, u2, _column(w, NEAR + 12, i)), r)
        _give(w, NUMBERS + 8, i, (v0, v1, v2, v2), r)


@inlined
def _substitute(w: Any) -> None:
    """Write what the motions of near and far row do to a block, with the opposite sign."""
    for i in range(LANES):
        x, y = _column(w, NUMBERS, i), _column(w, NUMBERS + 4, i)
        for row in range(4):
            z = _at(w, NEAR + row, i) * x[0] + _at(w, NEAR + 4 + row, i) * x[1]
            z += _at(w, NEAR + 8 + row, i) * x[2] + _at(w, NEAR + 12 + row, i) * x[3]
            z += _at(w, FAR + row, i) * y[0] + _at(w, FAR + 4 + row, i) * y[1] + _at(w, FAR + 8 + row, i) * y[2]
            _put(w, NUMBERS + 8 + row, i, z)
