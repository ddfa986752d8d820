"""What a plant may be loaded with by a shake. One owner: planner, nonlinear check and report ask here."""

from __future__ import annotations

from dataclasses import astuple, dataclass

from anther.checks import check_range

GRAVITY = 9.81


@dataclass(frozen=True, slots=True)
class PlantLimits:
    """Limits of one plant (facts: pollination 6: no elastic limit of a tomato or pepper organ was ever measured).

    A breeze of 4 m/s gives the same plants 0.4 to 1.7 % in their pedicels and adds 3 g at the bases of their leaves,
    and fields stand it; a pedicel is probably elastic up to 1-3 %.

    Attributes:
        stem_strain: largest bending strain of the main stem [-].
        pedicel_strain: of pedicels [-].
        base_strain: of the bases of branches, petioles and peduncles on the main stem [-].
        leaf_load: largest torque at a leaf's base that the shake adds, in units of what 1 m/s2 gives [m/s2].
    """

    stem_strain: float = 0.01
    pedicel_strain: float = 0.01
    base_strain: float = 0.01
    leaf_load: float = 2.0 * GRAVITY

    def __post_init__(self) -> None:
        for name, value in zip(("stem_strain", "pedicel_strain", "base_strain"), astuple(self), strict=False):
            check_range(name, value, 1e-9, 1.0)
        check_range("leaf_load", self.leaf_load, 1e-9, 1e4, "m/s2")


GENTLE = PlantLimits(0.005, 0.005, 0.005, 0.7 * GRAVITY)
DEFAULT = PlantLimits()
BOLD = PlantLimits(0.01, 0.02, 0.02, 3.0 * GRAVITY)
PRESETS = {"gentle": GENTLE, "default": DEFAULT, "bold": BOLD}
"""Starting limits by name; a judgement (facts: pollination 6)."""
