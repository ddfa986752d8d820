"""Density of cut stem samples (P22)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from anther.checks import check_array
from anther.errors import bad_input


@dataclass(frozen=True, slots=True)
class Density:
    """Density of stem samples [kg/m3]: mean, standard deviation between samples, standard error of the mean.

    The two last are NaN for a single sample.
    """

    mean: float
    sd: float
    standard_error: float


def density_from_samples(mass: ArrayLike, radius: ArrayLike, length: ArrayLike) -> Density:
    """Return the density of round stem pieces (P22).

    Args:
        mass: (n,) [kg].
        radius: (n,) [m].
        length: (n,) [m].

    Raises:
        InputError: no samples, different counts, or a value <= 0.
    """
    m = check_array("sample mass", mass, (None,))
    r = check_array("sample radius", radius, (len(m),))
    h = check_array("sample length", length, (len(m),))
    if not len(m) or min(m.min(), r.min(), h.min()) <= 0:
        raise bad_input("stem samples", given=f"{len(m)} samples", allowed="one or more, values > 0", do="Check units.")
    each = m / (np.pi * r**2 * h)
    sd = float(np.std(each, ddof=1)) if len(each) > 1 else float("nan")
    return Density(float(each.mean()), sd, sd / float(np.sqrt(len(each))))
