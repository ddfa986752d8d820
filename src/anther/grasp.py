"""Grasp: where and how the gripper takes the main stem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from anther.checks import check_array, check_range, check_transform
from anther.geometry import Array, pose7


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """A grasp of the main stem. The gripper approaches along the flange's +z; its fingers close along +-y.

    Attributes:
        T_world_flange: (4, 4) flange (`right_hand`) pose with the stem between the finger pads.
        point: (3,) grasped point on the stem's centreline, world [m].
        tangent: (3,) unit stem direction there, root to tip.
        approach: (3,) unit approach direction n, world (the flange's +z).
        arc_length: distance from the root along the stem [m].
        stem_diameter: [m], as measured by perception.
        clearance: smallest distance between the gripper (approaching and closed) and plant or pot [m].
        score: higher is better; comparable within one ranked list only.
        reason: why it ranks where it does, for people.
        joints: (7,) arm joints at the grasp [rad], or None when no arm was asked.
    """

    T_world_flange: Array
    point: Array
    tangent: Array
    approach: Array
    arc_length: float
    stem_diameter: float
    clearance: float
    score: float
    reason: str
    joints: NDArray[Any] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_world_flange", check_transform("T_world_flange", self.T_world_flange))
        for name in ("point", "tangent", "approach"):
            object.__setattr__(self, name, check_array(name, getattr(self, name), (3,)))
        if self.joints is not None:
            object.__setattr__(self, "joints", check_array("joints", self.joints, (7,)))
        check_range("grasp arc length", self.arc_length, 0, 20, "m")

    @property
    def pose7(self) -> Array:
        """The flange pose as x, y, z [m], qx, qy, qz, qw."""
        return pose7(self.T_world_flange)


class Reach(Protocol):
    """What grasp planning asks of an arm."""

    def __call__(self, T_world_pregrasp: Array, T_world_grasp: Array) -> Array | None:
        """Return joints (7,) at the grasp if both poses and the line between them can be reached, else None."""
        ...
