"""What one core can do at most: multiply-adds per second, and bytes per second from each level of memory.

Measured, not looked up, in the same run as what it is compared with (Williams, Waterman, Patterson 2009, Roofline).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np

FLOPS_PER_ELEMENT = 64
"""A polynomial of degree 32 is 32 multiply-adds, 2 operations each."""


class Roofline(NamedTuple):
    """The ceilings of one core, in fp64."""

    vector: float  # [flop/s] with SIMD instructions
    scalar: float  # [flop/s] one number at a time
    small: float  # [byte/s] with 100 kB in use, as 86 nodes need: second-level cache
    large: float  # [byte/s] with 24 MB in use, as 20 000 nodes need

    def floor(self, flops: float, nbytes: float) -> float:
        """Return the least time [s] for some operations and bytes, with everything overlapped."""
        return max(flops / self.vector, nbytes / (self.small if nbytes < 2e6 else self.large))


def measure_roofline(repeats: int = 7) -> Roofline:
    """Return the best of several repeats of each loop, in processor time."""
    x, y = np.linspace(0, 1, 2048), np.zeros(2048)  # 32 kB: first-level cache
    vector = 200 * len(x) * FLOPS_PER_ELEMENT / _best(lambda: _polynomials(x, y, 200), repeats)
    start = np.linspace(0, 1, 12)
    scalar = 2 * 12 * 500_000 / _best(lambda: _chains(start, 500_000), repeats)
    return Roofline(vector, scalar, _triad_speed(100_000, repeats), _triad_speed(24_000_000, repeats))


def _triad_speed(size: int, repeats: int) -> float:
    """Bytes per second of a = b + s c, where the three arrays take `size` bytes together."""
    a, b, c = (np.ones(size // 24) for _ in range(3))
    rounds = math.ceil(1e8 / size)
    return 24 * len(a) * rounds / _best(lambda: _triad(a, b, c, rounds), repeats)


def _best(work: Callable[[], Any], repeats: int) -> float:
    work()
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


@numba.njit(fastmath={"contract"}, error_model="numpy")
def _polynomials(x: Any, y: Any, rounds: int) -> None:
    """Horner's rule on every element, four quarters at once: fills the SIMD lanes and hides the latency."""
    n = len(x) // 4
    for r in range(rounds):
        for i in range(n):
            a, b, c, d = x[i], x[i + n], x[i + 2 * n], x[i + 3 * n]
            p = q = u = v = 1.0 + r
            for _ in range(32):
                p, q, u, v = p * a + 0.5, q * b + 0.5, u * c + 0.5, v * d + 0.5
            y[i], y[i + n], y[i + 2 * n], y[i + 3 * n] = p, q, u, v


@numba.njit(fastmath={"contract"}, error_model="numpy")
def _chains(start: Any, rounds: int) -> float:
    """Twelve independent chains of multiply-adds, one number each: more than two units of latency 4 can overlap."""
    m, a = 0.999, 1e-3
    c0, c1, c2, c3, c4, c5 = start[0], start[1], start[2], start[3], start[4], start[5]
    c6, c7, c8, c9, d0, d1 = start[6], start[7], start[8], start[9], start[10], start[11]
    for _ in range(rounds):
        c0, c1, c2, c3 = c0 * m + a, c1 * m + a, c2 * m + a, c3 * m + a
        c4, c5, c6, c7 = c4 * m + a, c5 * m + a, c6 * m + a, c7 * m + a
        c8, c9, d0, d1 = c8 * m + a, c9 * m + a, d0 * m + a, d1 * m + a
    return c0 + c1 + c2 + c3 + c4 + c5 + c6 + c7 + c8 + c9 + d0 + d1


@numba.njit(error_model="numpy")
def _triad(a: Any, b: Any, c: Any, rounds: int) -> None:
    for r in range(rounds):
        for i in range(len(a)):
            a[i] = b[i] + (1.0 + r) * c[i]
