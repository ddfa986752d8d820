"""How hard pads may press a stem. One owner: the planner asks here, and safety holds what it reads against it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from anther.core.geometry import Array
from anther.core.records import Range, Record


@dataclass(frozen=True, slots=True)
class Pressing(Record):
    """What a gripper presses with, and what a stem bears.

    Attributes:
        holding: with which the gripper holds [N]: 30 % of 35 N, which cannot be set (facts: sawyer 3).
        stem_stress: largest pressure of a pad on a stem [Pa]. No crushing strength of a tomato or pepper stem was
            found (one was measured, doi 10.13427/j.cnki.njyi.2023.12.022, but its numbers are not public). An
            estimate: the upper end of a pepper fruit's, an eighth of a broccoli stem's bending strength (facts:
            pollination 2: 0.3-0.8 MPa, 6.9 MPa).
        pad_width: of a pad along the stem [m]: basic soft tips (facts: sawyer 3).
        pad_modulus: Young's modulus of a pad's silicone [Pa]; about 30 Shore A, our estimate.
    """

    # nobody switches a limit off: the ranges are wide, but not infinite
    holding: Annotated[float, Range(0.1, 100.0, "N")] = 10.0
    stem_stress: Annotated[float, Range(1e3, 1e7, "Pa")] = 0.8e6
    pad_width: Annotated[float, Range(1e-3, 0.1, "m")] = 0.016
    pad_modulus: Annotated[float, Range(1e4, 1e11, "Pa")] = 1e6

    def stress(self, force: ArrayLike, diameter: ArrayLike) -> Array:
        """Return the greatest pressure [Pa] of pads that press with forces (...) [N] on stems of diameters (...) [m].

        Hertz, a cylinder pressed across a flat: p = sqrt(F E* / (pi w r)) with E* = E / (1 - nu^2) of the pad alone,
        which is far softer than a stem (30-300 MPa), nu = 0.5 (Johnson, Contact Mechanics, 1985, section 4.2).
        """
        return np.sqrt(np.asarray(force) * self._modulus / (np.pi * self.pad_width * np.asarray(diameter) / 2))

    def most(self, diameter: ArrayLike) -> Array:
        """Return what may be asked for on stems of diameters (...) [m] [N]: what they bear and the gripper gives."""
        borne = self.stem_stress**2 * np.pi * self.pad_width * np.asarray(diameter) / 2 / self._modulus
        share = 0.7  # a gripper that closes in steps of 0.5 mm presses by up to 3 N harder than it was asked to
        return np.minimum(share * borne, self.holding)

    @property
    def _modulus(self) -> float:
        return self.pad_modulus / (1 - 0.5**2)


PRESSING = Pressing()
"""Of the Sawyer's gripper with its soft tips."""
