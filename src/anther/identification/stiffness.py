"""Young's modulus from the first natural frequency and from the deflection under a tip mass (P22)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, root_scalar

from anther.checks import check_array, check_range
from anther.errors import InputError, StageFailure, bad_input
from anther.geometry import Array
from anther.identification.clamped_stem import (
    ClampedStem,
    G,
    Orientation,
    first_frequency,
    tip_compliance,
    tip_deflections,
)

FARTHEST = 4.0
"""How far ln E is searched on either side of its small-deflection value [-]."""
STRETCHED = 0.02
"""A stem that its own weight would stretch by more than this is too soft to be searched [-]."""


def youngs_from_first_mode(stem: ClampedStem, frequency: float, density: float, orientation: Orientation) -> float:
    """Return Young's modulus [Pa] of a tapered stem with leaves from its undamped first natural frequency.

    The rod engine gives the frequency for a modulus; the root is searched. Without gravity the frequency goes with the
    root of E. Gravity makes an upright stem slower (E comes out higher than without it) and a hanging one faster.

    Args:
        stem: shape and leaves.
        frequency: undamped, f / sqrt(1 - zeta^2) [Hz]; of vertical motion if the stem is horizontal.
        density: [kg/m3].
        orientation: how it was held.

    Raises:
        InputError: out of range, or gravity alone makes such a stem swing faster.
    """
    check_range("frequency", frequency, 1e-3, 1e4, "Hz")
    check_range("density", density, 10, 5000, "kg/m3")
    reference = 1e8
    light = reference * (frequency / first_frequency(stem, reference, density, "weightless")) ** 2
    if orientation == "weightless":
        return light

    def excess(youngs: float) -> float:
        try:
            return first_frequency(stem, youngs, density, orientation) ** 2 / frequency**2 - 1
        except StageFailure:
            return -1.0  # it buckles: too soft

    softest = G * _mass(stem, density) / (np.pi * float(stem.radius.min()) ** 2 * STRETCHED)
    low = high = light
    while excess(high) < 0:
        low, high = high, 2 * high
    while low > softest and excess(low) >= 0:
        low, high = max(low / 2, softest), low
    if excess(low) >= 0:
        slowest = frequency * np.sqrt(1 + excess(low))
        raise bad_input(
            "frequency",
            given=f"{frequency:g} Hz",
            allowed=f"> {slowest:.3g} Hz, at which gravity alone swings this stem, {orientation}",
            do="Check how it was held, its length, and the trace.",
        )
    root: Any = brentq(excess, low, high, xtol=1e-7 * high)
    return float(root)


def _mass(stem: ClampedStem, density: float) -> float:
    """Return the mass of stem and leaves [kg]."""
    at = np.linspace(0, stem.length, 1001)
    area = np.pi * np.interp(at, stem.distance, stem.radius) ** 2
    return density * float(np.trapezoid(area, at)) + float(stem.leaf_mass.sum())


def youngs_from_deflection(
    stem: ClampedStem, tip_mass: ArrayLike, deflection: ArrayLike, density: float, *, reading_error: float = 5e-4
) -> tuple[float, float]:
    """Return Young's modulus [Pa] of a horizontal stem from how far masses pull its tip down, and its relative error.

    The deflections d of the model come from the rod engine (large ones, the stem's own weight and taper included). E
    solves sum d (d - measured) = 0, the normal equation of least squares where d goes as 1 / E, by the secant method
    from Euler-Bernoulli's E. The error is that of the fit, with `reading_error` or the scatter of the residuals,
    whichever is larger; errors of radius, length and masses come on top (`propagate`).

    Args:
        stem: shape and leaves.
        tip_mass: (n,) hung on the tip [kg], > 0.
        deflection: (n,) how far the tip sinks from its position without them [m], > 0.
        density: [kg/m3].
        reading_error: standard error of one deflection [m].

    Raises:
        InputError: no readings, values <= 0, or deflections that no stiffness explains.
    """
    mass = check_array("tip mass", tip_mass, (None,))
    sunk = check_array("deflection", deflection, (len(mass),))
    if not len(mass) or min(mass.min(), sunk.min()) <= 0:
        raise bad_input("deflection test", given=f"{len(mass)} readings", allowed="one or more, > 0", do="Check signs.")
    if sunk.max() >= stem.length:
        raise bad_input(
            "deflection", given=f"{sunk.max():g} m", allowed=f"< {stem.length:g} m, the length", do="Units?"
        )
    stiff = G * tip_compliance(stem) * float(mass @ sunk / (sunk @ sunk))

    def model(log_ratio: float) -> Array:
        if abs(log_ratio) > FARTHEST:
            raise _inexplicable(sunk)
        return tip_deflections(stem, stiff * float(np.exp(log_ratio)), density, mass)

    def step(log_ratio: float) -> float:
        found = model(log_ratio)
        return float(found @ (found - sunk) / (found @ found))

    try:
        first = step(0.0)
        solved = root_scalar(step, x0=0.0, x1=first if abs(first) > 1e-6 else 1e-3, method="secant", xtol=1e-7)
    except StageFailure as failure:
        raise _inexplicable(sunk) from failure
    if not solved.converged:
        raise _inexplicable(sunk)
    best = model(solved.root)
    scatter = float(np.sqrt(np.sum((best - sunk) ** 2) / max(len(mass) - 1, 1)))
    slope = float(abs((model(solved.root + 1e-3) - best) @ best) / np.linalg.norm(best)) / 1e-3
    return stiff * float(np.exp(solved.root)), max(scatter, reading_error) / slope


def _inexplicable(deflection: Array) -> InputError:
    return bad_input(
        "deflection test",
        given=f"{deflection.max() * 1e3:g} mm at most",
        allowed="what some stiffness explains that also carries the stem's own weight",
        do="Check masses, radius, length and their units.",
    )
