"""A straight stem held at one end: tapered, with leaves, upright, horizontal or hanging. P profile points, L leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, root_scalar

from anther.core.checks import check_array, check_range
from anther.core.errors import InputError, StageFailure, bad_input
from anther.core.geometry import Array
from anther.plant.limits import GRAVITY
from anther.rods import Clamp, Rods, equilibrium, natural_frequencies

Orientation = Literal["upright", "horizontal", "hanging", "weightless"]
"""How the stem is held. "weightless" leaves gravity out, as beam formulas do."""


@dataclass(frozen=True, slots=True, eq=False)
class ClampedStem:
    """A straight round stem, clamped at distance 0.

    Attributes:
        distance: (P,) from the clamp, increasing [m].
        radius: (P,) there [m]; linear in between, constant beyond the first and last.
        length: from the clamp to the tip [m].
        leaf_distance: (L,) where leaves, flowers or weights are [m].
        leaf_mass: (L,) their masses [kg].
        edges: of the rod model. 50 give the first frequency within 0.1 %, hence E within 0.2 %.
    """

    distance: Array
    radius: Array
    length: float
    leaf_distance: Array
    leaf_mass: Array
    edges: int = 50

    def __post_init__(self) -> None:
        distance = check_array("profile distance", self.distance, (None,))
        if not len(distance) or np.any(np.diff(distance) <= 0):
            raise bad_input("profile distance", given=f"{len(distance)} points", allowed="increasing", do="Sort them.")
        object.__setattr__(self, "distance", distance)
        object.__setattr__(self, "radius", check_array("profile radius", self.radius, (len(distance),)))
        for value in self.radius:
            check_range("radius", float(value), 1e-5, 0.5, "m")
        check_range("length", self.length, 1e-3, 20, "m")
        place = check_array("leaf distance", self.leaf_distance, (None,))
        object.__setattr__(self, "leaf_distance", place)
        object.__setattr__(self, "leaf_mass", check_array("leaf mass", self.leaf_mass, (len(place),)))
        for at, mass in zip(place, self.leaf_mass, strict=True):
            check_range("leaf distance", float(at), 0, self.length * (1 + 1e-9), "m")
            check_range("leaf mass", float(mass), 0, 100, "kg")
        check_range("edges", self.edges, 4, 5000)

    @classmethod
    def uniform(cls, length: float, radius: float, tip_mass: float = 0.0) -> ClampedStem:
        """Return a stem of one radius [m], with a mass at the tip [kg]."""
        return cls(np.zeros(1), np.array([radius]), length, np.array([length]), np.array([tip_mass]))

    def changed(self, *, radius: float = 0.0, length: float = 0.0, leaf_mass: float = 0.0) -> ClampedStem:
        """Return the stem as it is if the instruments were wrong.

        Args:
            radius: added to every radius [m] (one calliper, one error).
            length: added to the length [m], all distances in proportion (one ruler).
            leaf_mass: share added to every leaf's mass [-].
        """
        stretch = 1 + length / self.length
        return replace(
            self,
            distance=self.distance * stretch,
            radius=self.radius + radius,
            length=self.length + length,
            leaf_distance=self.leaf_distance * stretch,
            leaf_mass=self.leaf_mass * (1 + leaf_mass),
        )

    def with_tip_mass(self, mass: float) -> ClampedStem:
        """Return the stem with a further mass at the tip [kg]."""
        return replace(
            self,
            leaf_distance=np.append(self.leaf_distance, self.length),
            leaf_mass=np.append(self.leaf_mass, mass),
        )

    def rods(self, youngs: float, density: float, orientation: Orientation) -> Rods:
        """Return the stem as rods, `edges` equal ones, to be planted at the root; it is stress-free when straight.

        A leaf's mass is shared by the two nearest nodes so that its moment about the clamp is kept.
        """
        at = np.linspace(0, self.length, self.edges + 1)
        nodes = np.zeros((len(at), 3))
        nodes[:, 0 if orientation == "horizontal" else 2] = -at if orientation == "hanging" else at
        middle = np.concatenate([[0], (at[1:] + at[:-1]) / 2])
        mass = np.zeros(len(at))
        step = self.length / self.edges
        low = np.clip((self.leaf_distance // step).astype(int), 0, self.edges - 1)
        upper = self.leaf_distance / step - low
        np.add.at(mass, low, (1 - upper) * self.leaf_mass)
        np.add.at(mass, low + 1, upper * self.leaf_mass)
        return Rods(
            nodes,
            np.arange(len(at)) - 1,
            np.interp(middle, self.distance, self.radius),
            youngs,
            density,
            lumped_mass=np.maximum(mass, 0),
        )


def first_frequency(stem: ClampedStem, youngs: float, density: float, orientation: Orientation) -> float:
    """Return the first natural frequency [Hz] about the equilibrium; of a horizontal stem, that of vertical motion.

    The damped one is lower by the factor sqrt(1 - zeta^2).

    Raises:
        StageFailure: kind "no_convergence": an upright stem that would buckle.
    """
    rods = stem.rods(youngs, density, orientation)
    gravity = (0.0, 0.0, 0.0 if orientation == "weightless" else -GRAVITY)
    modes = natural_frequencies(rods, Clamp.root(rods), 2, gravity=gravity)
    frequencies, shapes = modes[0], modes[1]
    sideways = np.sum(shapes[0, :, 1] ** 2) / np.sum(shapes[0] ** 2)
    return float(frequencies[1 if orientation == "horizontal" and sideways > 0.5 else 0])


def tip_deflections(stem: ClampedStem, youngs: float, density: float, tip_mass: ArrayLike) -> Array:
    """Return (n,) how far the tip of a horizontal stem sinks [m] under (n,) masses hung on it [kg].

    Counted from where the stem's own weight and leaves hold it; by the rod engine, so large deflections are right.
    """
    rest = _tip_height(stem, youngs, density)
    masses = check_array("tip mass", tip_mass, (None,))
    return np.array([rest - _tip_height(stem.with_tip_mass(float(m)), youngs, density) for m in masses])


def _tip_height(stem: ClampedStem, youngs: float, density: float) -> float:
    rods = stem.rods(youngs, density, "horizontal")
    return float(equilibrium(rods, Clamp.root(rods))[-1, 2])


def tip_compliance(stem: ClampedStem) -> float:
    """Return E times the small tip deflection per tip force [1/m], Euler-Bernoulli: integral of (l - s)^2 / I ds."""
    at = np.linspace(0, stem.length, 2001)
    second_moment = np.pi * np.interp(at, stem.distance, stem.radius) ** 4 / 4
    return float(np.trapezoid((stem.length - at) ** 2 / second_moment, at))


def droop(stem: ClampedStem, youngs: float, density: float) -> float:
    """Return how far the tip of the horizontal stem sinks under its own weight and leaves, over its length [-]."""
    return -_tip_height(stem, youngs, density) / stem.length


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

    stretched = 0.02  # by its own weight: no such stem is searched
    softest = GRAVITY * _mass(stem, density) / (np.pi * float(stem.radius.min()) ** 2 * stretched)
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
    stiff = GRAVITY * tip_compliance(stem) * float(mass @ sunk / (sunk @ sunk))

    def model(log_ratio: float) -> Array:
        if abs(log_ratio) > 4:  # 55 times softer or stiffer than small deflections say
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
