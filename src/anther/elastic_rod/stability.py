"""Do the rods stand? Stability of the scanned shape under gravity, and the least stiffness that keeps it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from anther.elastic_rod.assembly import new_blocks
from anther.elastic_rod.equilibrium import balancing_shape, unstable_directions
from anther.elastic_rod.model import build_model
from anther.elastic_rod.motion import Clamp
from anther.elastic_rod.newton import new_state
from anther.elastic_rod.rods import GRAVITY, Rods
from anther.errors import StageFailure

RANGE = (1e-5, 1e4)
"""Factors on Young's modulus that are searched."""


def stands(rods: Rods, clamp: Clamp, *, gravity: ArrayLike = GRAVITY) -> bool:
    """Return whether the scanned shape, hanging in equilibrium, is stable: its tangent stiffness is positive definite.

    Rods without a natural shape get the one of `with_gravity_equilibrium`.
    """
    free = clamp.free(rods)
    model, frames = build_model(rods, gravity, clamp.planted)
    if rods.natural is None:
        try:
            natural = balancing_shape(rods, model, frames, free)
        except StageFailure:
            return False
        model = model._replace(length=natural.length, curvature=natural.curvature, natural_twist=natural.twist)
    return unstable_directions(model, free, new_state(rods.nodes, frames), new_blocks(len(rods.nodes))) == 0


def least_stiffness(rods: Rods, clamp: Clamp, *, gravity: ArrayLike = GRAVITY) -> float | None:
    """Return the factor on Young's modulus at which the rods just stand, within 1 %; None if none in RANGE does.

    The moments of the weight do not depend on the stiffness: the tangent stiffness is E A - B, so there is one such
    factor, found by bisection of its logarithm.
    """
    low, high = np.log(RANGE)

    def holds(logarithm: float) -> bool:
        stiffer = np.asarray(rods.youngs) * np.exp(logarithm)
        return stands(replace(rods, youngs=stiffer, natural=None), clamp, gravity=gravity)

    if not holds(high):
        return None
    while high - low > 0.01:
        middle = (low + high) / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return float(np.exp(high))
