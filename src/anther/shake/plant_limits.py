"""What a plant may be loaded with by a shake. One owner: planner, nonlinear check and report ask here."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import ArrayLike

from anther.checks import check_range
from anther.geometry import Array

GRAVITY = 9.81
FAST = 14.0
"""Up to here an arm's readings tell what its gripper does, and loads err as they do at slow tones [Hz]."""
GUSTS = 5.0
"""Up to here a leaf's load counts [Hz]: what petioles bear in units of their leaf's weight was measured slowly, and
gusts that load them last a second (facts: pollination 2 and 6). Of faster shakes the strain of their bases counts,
which 1 g bends by 0.05 % (median of 24 simulated plants at 10-38 Hz; one in twenty by 0.2 % on tomatoes, 0.4 % on
peppers)."""


@dataclass(frozen=True, slots=True)
class PlantLimits:
    """Limits of one plant (facts: pollination 6: no elastic limit of a tomato or pepper organ was ever measured).

    A breeze of 4 m/s gives the same plants 0.4 to 1.7 % in their pedicels and adds 3 g at the bases of their leaves,
    and fields stand it; a pedicel is probably elastic up to 1-3 %.

    Attributes:
        stem_strain: largest bending strain of the main stem [-].
        pedicel_strain: of pedicels [-].
        base_strain: of the bases of branches, petioles and peduncles on the main stem [-].
        leaf_load: largest torque at a leaf's base that a shake of up to `GUSTS` adds, in units of what 1 m/s2 gives
            [m/s2].
    """

    stem_strain: float = 0.01
    pedicel_strain: float = 0.01
    base_strain: float = 0.01
    leaf_load: float = 2.0 * GRAVITY

    def __post_init__(self) -> None:
        for name, value in zip(("stem_strain", "pedicel_strain", "base_strain"), astuple(self), strict=False):
            check_range(name, value, 1e-9, 1.0)
        check_range("leaf_load", self.leaf_load, 1e-9, 1e4, "m/s2")

    def leaf_load_at(self, frequencies: ArrayLike) -> Array:
        """Return the limit of the leaves' load at frequencies [Hz], of their shape [m/s2]; infinite above `GUSTS`."""
        return np.where(np.asarray(frequencies, dtype=np.float64) > GUSTS, np.inf, self.leaf_load)


GENTLE = PlantLimits(0.005, 0.005, 0.005, 0.7 * GRAVITY)
DEFAULT = PlantLimits()
BOLD = PlantLimits(0.01, 0.02, 0.02, 3.0 * GRAVITY)
PRESETS = {"gentle": GENTLE, "default": DEFAULT, "bold": BOLD}
"""Starting limits by name; a judgement (facts: pollination 6)."""
