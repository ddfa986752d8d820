"""Cloud: one coloured, labelled point cloud of the plant in the world frame. N points, M obstacle points."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.checks import check_array, check_transform
from anther.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """The plant as points in the world frame (z up), and what else the arm must not touch.

    Attributes:
        points: (N, 3) plant points [m].
        normals: (N, 3) unit normals, or None.
        colors: (N, 3) uint8, or None.
        labels: (N,) uint8: `masks.PLANT` or `masks.FLOWER`.
        obstacles: (M, 3) coarse points [m] of pot, soil and bench.
        T_world_cam: (V, 4, 4) camera poses after registration, or None for an imported cloud.
        notes: what the stage wants the user to know (warnings, registration declined, ...).
    """

    points: Array
    normals: Array | None = None
    colors: NDArray[Any] | None = None
    labels: NDArray[Any] | None = None
    obstacles: Array = field(default_factory=lambda: np.zeros((0, 3)))
    T_world_cam: Array | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.points)
        object.__setattr__(self, "points", check_array("points", self.points, (n, 3)))
        object.__setattr__(self, "obstacles", check_array("obstacles", self.obstacles, (None, 3)))
        if self.normals is not None:
            object.__setattr__(self, "normals", check_array("normals", self.normals, (n, 3)))
        if self.colors is not None:
            object.__setattr__(self, "colors", check_array("colors", self.colors, (n, 3), dtype="uint8"))
        labels = np.ones(n, dtype=np.uint8) if self.labels is None else self.labels
        object.__setattr__(self, "labels", check_array("labels", labels, (n,), dtype="uint8"))
        if self.T_world_cam is not None:
            object.__setattr__(
                self, "T_world_cam", check_transform("T_world_cam", self.T_world_cam, len(self.T_world_cam))
            )
