"""Solutions of Euler-Bernoulli beams and of the elastica that owe nothing to the rod engine.

Lengths are in units of the free length L, clamped at s = 0 and free at s = 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import iv, jv, kv, yv

from evaluation.rods.table import Array


def elastica(own_weight: float, tip_load: float) -> tuple[float, float]:
    """Return the tip (x, drop) in units of L of a beam that is clamped horizontally and sags under vertical loads.

    The inextensible elastica theta'' = -(P + q (1 - s)) cos theta with theta(0) = 0 and theta'(1) = 0 (Bisshopp and
    Drucker 1945 for q = 0, Q. Appl. Math. 3, 272), by shooting from the clamp with an eighth-order Runge-Kutta rule.

    Args:
        own_weight: q = rho A g L^3 / EI.
        tip_load: P = force L^2 / EI.
    """

    def slopes(s: float, y: Array) -> list[float]:
        theta, moment = y[0], y[1]
        return [moment, -(tip_load + own_weight * (1 - s)) * np.cos(theta), np.cos(theta), np.sin(theta)]

    def shot(moment: float) -> Array:
        return solve_ivp(slopes, (0, 1), [0, moment, 0, 0], "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]

    most = tip_load + own_weight / 2  # the moment at the clamp if the beam did not bend
    moment: Any = brentq(lambda m: shot(m)[1], 0.0, most, xtol=1e-15, rtol=np.float64(1e-14))
    tip = shot(moment)
    return float(tip[2]), float(tip[3])


def small_sag(own_weight: float, tip_load: float) -> float:
    """Return the tip's drop in units of L for small loads: q / 8 + P / 3 (Euler-Bernoulli)."""
    return own_weight / 8 + tip_load / 3


def uniform_roots(count: int, tip_mass: float = 0.0) -> Array:
    """Return the frequency parameters b, w = b^2 sqrt(EI / (rho A L^4)), of a cantilever with a mass on its tip.

    1 + cos b cosh b + mu b (cos b sinh b - sin b cosh b) = 0 (Blevins 1979, Formulas for Natural Frequency, table
    8-8), divided by cosh b.

    Args:
        count: how many.
        tip_mass: mu, the tip mass over the mass of the beam.
    """

    def equation(b: float) -> float:
        loaded = np.cos(b) * np.tanh(b) - np.sin(b)
        return float(1 / np.cosh(b) + np.cos(b) + tip_mass * b * loaded)

    return roots(equation, 0.3, 0.05, count)


def rayleigh_roots(count: int, radius: float) -> Array:
    """Return b as in `uniform_roots` for a round cantilever whose cross-sections have rotary inertia.

    w'''' + s b^4 w'' - b^4 w = 0 with s = I / (A L^2); w = w' = 0 at the clamp, w'' = 0 and w''' + s b^4 w' = 0 at the
    tip (Rayleigh 1877, The Theory of Sound, section 186). Solutions: cos, sin of p x and cosh, sinh of q x.

    Args:
        count: how many.
        radius: over the length.
    """
    s = radius**2 / 4

    def equation(b: float) -> float:
        half, root = s * b**4 / 2, np.hypot(s * b**4 / 2, b * b)
        p, q = np.sqrt(half + root), np.sqrt(root - half)
        c, si, ch, sh = np.cos(p), np.sin(p), np.cosh(q), np.sinh(q)
        slope = np.array([-p * si, p * c, q * sh, q * ch])
        curvature = np.array([-p * p * c, -p * p * si, q * q * ch, q * q * sh])
        shear = np.array([-p * p, -p * p, q * q, q * q]) * slope + 2 * half * slope
        return float(np.linalg.det(np.array([[1, 0, 1, 0], [0, p, 0, q], curvature / ch, shear / ch])))

    return roots(equation, 0.3, 0.05, count)


def cone_frequencies(tip_over_base: float, count: int) -> Array:
    """Return w L^2 sqrt(rho A_0 / EI_0), 0 = at the clamp, of cantilevers whose radius falls linearly to the tip.

    With x from the cone's apex, (x^4 w'')'' = k^4 x^2 w has the solutions x^-1 C_2(2 k sqrt x), C = J, Y, I, K
    (Kirchhoff 1879; Naguleswaran 1994, J. Sound Vib. 172, 289). Clamped at x = 1, free at x = tip_over_base.

    Args:
        tip_over_base: radius of the tip over that of the base, above 0 and at most 0.9.
        count: how many.
    """
    sign = np.array([1, 1, 1, -1])

    def equation(k: float) -> float:
        base, tip = 2 * k, 2 * k * np.sqrt(tip_over_base)
        rows = [_bessel(2, base), _bessel(3, base) * [-1, -1, 1, -1], _bessel(4, tip), _bessel(3, tip) * sign]
        matrix = np.array(rows) / np.abs(rows).max(axis=0)
        return float(np.linalg.det(matrix))

    taper = 1 - tip_over_base
    return (roots(equation, 1.2 / taper, 0.05 / taper, count) * taper) ** 2


def _bessel(order: int, z: float) -> Array:
    return np.array([jv(order, z), yv(order, z), iv(order, z), kv(order, z)])


def roots(equation: Callable[[float], float], start: float, step: float, count: int) -> Array:
    """Return the first roots from `start` on, told apart by samples `step` apart."""
    found: list[Any] = []
    left, value = start, equation(start)
    while len(found) < count:
        right = left + step
        after = equation(right)
        if value * after < 0:
            found.append(brentq(equation, left, right, xtol=1e-13))
        left, value = right, after
    return np.array(found, dtype=np.float64)
