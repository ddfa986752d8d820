"""A string that holds a stem up: where it hangs, how hard it pulls, and where it lets go of the stem. S stem nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from anther.core.choices import Crop
from anther.core.geometry import Array
from anther.core.records import Range, Record, Spread
from anther.perception.cloud import Cloud
from anther.plant.limits import Believed
from anther.rods import Support

TENSION = {"tomato": Believed.between(40.0, 60.0), "pepper": Believed.between(8.0, 25.0)}
"""Pull of a string at its hook [N] (facts: rows 0 and D, 4 to 6 kg hang on a tomato's); of a pepper's stem a guess."""
BESIDE = 0.01
"""A string so near a stem's surface is held by it [m]: a clip is as wide."""


@dataclass(frozen=True, slots=True)
class HeldString(Record):
    """The string of the asked stem, as far as it is known before anything is seen.

    Attributes:
        hook: where it hangs, world [m]: by the map of the row.
        tension: of it [N].
        tension_spread: of that [-].
        stretching: EA [N], of twine of 2 mm: a guess.
    """

    CALLED = "string"
    hook: Annotated[tuple[float, float, float], Range(-1e4, 1e4, "m")]
    tension: Annotated[float, Range(0, 1e3, "N")] = TENSION["tomato"].median
    tension_spread: Spread = TENSION["tomato"].spread
    stretching: Annotated[float, Range(1, 1e6, "N")] = 1500.0

    @classmethod
    def of(cls, crop: Crop, hook: ArrayLike) -> Self:
        """Return what is believed of the string of a crop's stem that hangs on a hook (3,) [m]."""
        x, y, z = (float(value) for value in np.asarray(hook, dtype=np.float64))
        return cls((x, y, z), TENSION[crop].median, TENSION[crop].spread)

    def support(self, node: int, place: Array, factor: float = 1.0) -> Support:
        """Return the pull on a node that is at `place` (3,) [m], `factor` times as hard."""
        way = np.array(self.hook) - place
        way[2] = max(way[2], 0.05)  # the seen stem may end beyond the mapped hook
        return Support.string(node, way, factor * self.tension, self.stretching)


def topmost_hold(nodes: Array, radius: Array, cloud: Cloud | None) -> int:
    """Return the position along a stem of (S, 3) nodes and (S,) radii [m] up to which its string is held by it.

    That is where the highest string that is seen leaves it; where none is seen, its top.
    """
    strings: Sequence[Array] = [] if cloud is None else [s.balls(0.005)[:, :3] for s in cloud.supports if s.soft]
    if not strings:
        return len(nodes) - 1
    near = KDTree(np.vstack(strings)).query(nodes)[0] < radius + BESIDE
    return int(np.flatnonzero(near).max()) if near.any() else len(nodes) - 1
