"""How grasps are searched and weighed."""

from __future__ import annotations

from dataclasses import dataclass, field

from anther.checks import check_parameters, check_range
from anther.grasp.clearance import Gripper

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
        spacing: of the stations along the stem [m].
        directions: approach directions tried at each; with an arm, only those that lead away from its base.
        straight: half length of the stem piece that gives its direction [m]: little more than the pads hold. With 30 mm
            the pads bent stems that change direction at a node nearly twice as much (measured).
        window: how far along a branch the paper's rule takes its direction [m].
        base_margin, top_margin: stem left out at its ends [m]; each at most a quarter of the stem.
        obstacle_clearance: least distance of gripper from pot, soil and bench [m].
        stem_clearance: least distance of the open fingers from the stem's surface [m].
        leaf_size: leaves are counted as pieces of this size [m].
        touch: a piece nearer than this to the way in counts as touched [m].
        doubt: how far skeleton and cloud may lie beside the truth [m]: of petioles 1.8 to 3.2 mm in 90 of 100 places
            (measured on peppers); what comes this near the closing pads counts as between them.
        openings: of the pads on the way in, shares of the stroke, all tried: wide open forgives errors, half open fits
            between petioles.
        toward_tips: the stem stands this far from the pads' middle towards their tips [m], so that less of the pads
            reaches into the petioles behind it. With 8 mm closing strained the stem by 0.65 instead of 0.72 % in the
            mean (61 grasps of eight dense peppers, simulated), but lost it in 6 of 32 instead of 2 of 29.
        wanted: how many grasps the arm must confirm.
        apart: along the stem, so that the next differs when one fails [m]; at most a twentieth of the stem.
        slack: a grasp whose score is lower than the best's by more than this is a last resort: it is tried when the
            better ones have failed.
        asked: how often the arm is asked before what it has confirmed is enough; `PATIENCE` times as often while that
            is nothing.
    """

    gripper: Gripper = field(default_factory=Gripper)
    fit_gripper: bool = True
    spacing: float = 0.005
    directions: int = 24
    straight: float = 0.014
    window: float = 0.03
    base_margin: float = 0.065
    top_margin: float = 0.05
    obstacle_clearance: float = 0.015
    stem_clearance: float = 0.003
    leaf_size: float = 0.006
    touch: float = 0.002
    doubt: float = 0.003
    openings: tuple[float, ...] = (1.0, 0.576)
    toward_tips: float = 0.006
    wanted: int = 3
    apart: float = 0.012
    slack: float = 0.6
    asked: int = 150

    def __post_init__(self) -> None:
        check_parameters(self)
        check_range("spacing", self.spacing, 1e-4, 1, "m")
        check_range("directions", self.directions, 1, 360)
        check_range("wanted grasps", self.wanted, 1, 1000)
        for name in ("straight", "window", "leaf_size"):
            check_range(name, getattr(self, name), 1e-3, 0.5, "m")
        check_range("number of openings", len(self.openings), 1, 100)
        for opening in self.openings:
            check_range("openings", opening, 0.05, 1)
        check_range("asked", self.asked, 1, 1e5)
