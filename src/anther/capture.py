"""Capture: the RGB-D views of one plant, and the folder they are kept in. Dimensions: V views, H x W pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from anther.checks import check_array, check_transform
from anther.errors import bad_input
from anther.geometry import Array, Intrinsics


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """RGB-D views of one plant with their camera poses, depth aligned to colour.

    Attributes:
        depth: (V, H, W) float32, z-depth [m]; 0 means no reading.
        intrinsics: of every view.
        T_world_cam: (V, 4, 4) camera poses as the robot believes them.
        rgb: (V, H, W, 3) uint8, or None for a depth-only sensor.
        joints: (V, 7) arm joint angles [rad] of each view, or None.
    """

    depth: NDArray[Any]
    intrinsics: Intrinsics
    T_world_cam: Array
    rgb: NDArray[Any] | None = None
    joints: NDArray[Any] | None = None

    def __post_init__(self) -> None:
        views, size = len(self.depth), (self.intrinsics.height, self.intrinsics.width)
        if views == 0:
            raise bad_input("capture", given="no views", allowed="at least one view", do="Add frames.")
        depth = check_array("depth", self.depth, (views, *size), dtype="float32")
        if depth.min() < 0:
            raise bad_input("depth", given=f"{depth.min():g} m", allowed=">= 0 m", do="0 means no reading.")
        object.__setattr__(self, "depth", depth)
        object.__setattr__(self, "T_world_cam", check_transform("T_world_cam", self.T_world_cam, views))
        if self.rgb is not None:
            object.__setattr__(self, "rgb", check_array("rgb", self.rgb, (views, *size, 3), dtype="uint8"))
        if self.joints is not None:
            object.__setattr__(self, "joints", check_array("joints", self.joints, (views, 7)))

    @property
    def views(self) -> int:
        """Number of views V."""
        return len(self.depth)
