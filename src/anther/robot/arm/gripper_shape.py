"""The shape of a gripper as a grasp sees it: what it opens, and which boxes it fills. It follows from an arm's tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from anther.core.geometry import Array
from anther.robot.arm.model import Solid, Tool
from anther.robot.arm.sawyer import TOOL

Corners = tuple[float, float, float, float, float, float]
"""(lower x, y, z, upper x, y, z) [m]."""


def _corners(solid: Solid) -> Corners:
    centre, half = np.array(solid.center), np.array(solid.half)
    corners: Any = tuple(np.concatenate([centre - half, centre + half]).round(9).tolist())
    return corners


def _body(tool: Tool) -> tuple[Corners, ...]:
    wrist = (-0.045, -0.045, -0.05, 0.045, 0.045, 0.0)  # behind the flange of any arm: Sawyer's last link [m]
    return (_corners(tool.body), wrist, *map(_corners, tool.camera))


@dataclass(frozen=True, slots=True)
class GripperShape:
    """A parallel gripper with its wrist camera, in the flange frame; fingers close along +-y.

    The defaults are those of `TOOL`, which gives the source of each number.

    Attributes:
        stroke: largest opening between the pads [m].
        depth: distance from the flange to the middle of the pads along +z [m].
        pad: width along x and length along z of a pad [m].
        finger: thickness along y of finger and pad together [m], and z where the fingers begin [m].
        body: boxes (lower x, y, z, upper x, y, z) [m] of gripper body, wrist, camera and bracket.
    """

    stroke: float = TOOL.stroke
    depth: float = round(TOOL.tip - TOOL.pad[2] / 2, 9)
    pad: tuple[float, float] = (TOOL.pad[0], TOOL.pad[2])
    finger: tuple[float, float] = (TOOL.pad[1] + TOOL.thickness, TOOL.finger)
    body: tuple[Corners, ...] = _body(TOOL)

    @classmethod
    def of(cls, tool: Tool) -> GripperShape:
        """Return the shape of an arm's tool."""
        pad, finger = (tool.pad[0], tool.pad[2]), (tool.pad[1] + tool.thickness, tool.finger)
        return cls(tool.stroke, round(tool.tip - tool.pad[2] / 2, 9), pad, finger, _body(tool))

    def boxes(self, sweep: float, opening: float | None = None) -> Array:
        """Return (G, 6) corners of the open gripper's boxes, each stretched by `sweep` [m] back along the approach.

        Args:
            sweep: length of the way in [m].
            opening: between the pads [m]; None: the whole stroke.
        """
        inner, tip = (self.stroke if opening is None else opening) / 2, self.depth + self.pad[1] / 2
        x, outer, start = self.pad[0] / 2, inner + self.finger[0], self.finger[1]
        fingers = [(-x, inner, start, x, outer, tip), (-x, -outer, start, x, -inner, tip)]
        boxes = np.array([*self.body, *fingers])
        boxes[:, 2] -= sweep
        return boxes

    def closing(self, margin: float = 0.0, opening: float | None = None) -> Array:
        """Return (2, 6) corners of the space between the open pads, and of that between the open fingers.

        Both are broader than the pads by `margin` [m], and end as far beyond the tips.
        """
        x, y, z = self.pad[0] / 2 + margin, (self.stroke if opening is None else opening) / 2, self.pad[1] / 2 + margin
        return np.array([[-x, -y, low, x, y, self.depth + z] for low in (self.depth - z, self.finger[1])])
