"""The shape of a gripper: what it opens, and which boxes it fills."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from anther.core.geometry import Array


@dataclass(frozen=True, slots=True)
class GripperShape:
    """A parallel gripper with its wrist camera, in the flange frame; fingers close along +-y.

    The defaults are Sawyer's electric gripper with standard narrow fingers, soft pads and a D455 (arm/sawyer.py, which
    gives the source of each number).

    Attributes:
        stroke: largest opening between the pads [m].
        depth: distance from the flange to the middle of the pads along +z [m].
        pad: width along x and length along z of a pad [m].
        finger: thickness along y of finger and pad together [m], and z where the fingers begin [m].
        body: boxes (lower x, y, z, upper x, y, z) [m] of gripper body, wrist, camera and bracket.
    """

    stroke: float = 0.041667
    depth: float = 0.11712
    pad: tuple[float, float] = (0.016, 0.037)
    finger: tuple[float, float] = (0.015, 0.05992)
    body: tuple[tuple[float, float, float, float, float, float], ...] = (
        (-0.032, -0.055, 0.0, 0.032, 0.055, 0.06),
        (-0.045, -0.045, -0.05, 0.045, 0.045, 0.0),
        (0.0755, -0.062, 0.004, 0.1045, 0.062, 0.03),
        (0.025, -0.02, 0.0, 0.09, 0.02, 0.006),
    )

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
        """Return (6,) corners of the space between the open pads, longer and broader than these by `margin` [m]."""
        x, y, z = self.pad[0] / 2 + margin, (self.stroke if opening is None else opening) / 2, self.pad[1] / 2 + margin
        return np.array([-x, -y, self.depth - z, x, y, self.depth + z])
