"""How grasps are searched and weighed."""

from __future__ import annotations

from dataclasses import dataclass, field

from anther.checks import check_parameters, check_range
from anther.grasp.clearance import GripperShape

STROKE_MARGIN = 0.008
"""The stem must be thinner than the stroke by this [m]."""
STAND_OFF = 0.12
"""The straight way in begins this far back along the approach axis [m]."""


@dataclass(frozen=True, slots=True)
class Params:
    """How grasps are searched and weighed.

    Attributes:
        gripper: its geometry.
        fit_gripper: True refuses what this gripper cannot do. False gives the best place on the stem whatever its size:
            the plant is looked at as if shrunk until its stem fits, and a collision only lowers the score.
        wanted: how many grasps the arm must confirm.
    """

    gripper: GripperShape = field(default_factory=GripperShape)
    fit_gripper: bool = True
    wanted: int = 3

    def __post_init__(self) -> None:
        check_parameters(self)
        check_range("wanted grasps", self.wanted, 1, 1000)
