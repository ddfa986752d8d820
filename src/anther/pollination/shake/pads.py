"""The pads that hold the stem: what is believed of the gripper, and which nodes of a plant lie between them.

The stem between soft pads keeps neither its place nor its direction: it follows as one body, on springs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from anther.core.errors import StageFailure
from anther.core.geometry import Array
from anther.core.records import Range, Record, Spread
from anther.plant.model import PlantModel
from anther.rods import Springs


@dataclass(frozen=True, slots=True)
class Pads(Record):
    """What is believed of a gripper with a stem between its pads. A spread is the standard deviation of ln.

    A foundation of stiffness k / width along the stem turns with k width^2 / 12: 2e4 N/m and 16 mm give 0.43 N m/rad.
    No measurement of a gripper's pads on a stem was found; the spreads are a guess, wide enough for gel and for steel.

    Attributes:
        width: of the pads along the stem [m] (facts: sawyer 3, basic soft tips).
        stiffness: of both pads against moving the stem between them [N/m]: silicone of 1 MPa, 7 mm thick, on the 6 mm
            that a stem of 4 mm radius touches: 1.4e4 for each when pressed, a third of it when sheared; a guess.
        turning: of both against turning it [N m/rad]; by the rule above.
        stiffness_spread, turning_spread: their spreads [-].
    """

    CALLED = "pads'"
    width: Annotated[float, Range(1e-3, 0.2, "m")] = 0.016
    stiffness: Annotated[float, Range(1, 1e12, "N/m")] = 2e4
    turning: Annotated[float, Range(1e-6, 1e9, "N m/rad")] = 0.5
    stiffness_spread: Spread = 0.8
    turning_spread: Spread = 0.8

    @property
    def springs(self) -> Springs:
        """As the rods take them."""
        return Springs(self.stiffness, self.turning)

    def drawn(self, z: Sequence[float] | Array) -> Pads:
        """Return the pads at standard normal deviates z (2,) of ln stiffness and ln turning stiffness."""
        return replace(
            self,
            stiffness=float(self.stiffness * np.exp(self.stiffness_spread * z[0])),
            turning=float(self.turning * np.exp(self.turning_spread * z[1])),
        )


PADS_LEARNED = {"stiffness": "stiffness_spread", "turning": "turning_spread"}
"""What a shake teaches of `Pads` -> its spread."""

PADS = Pads()
"""Before anything was measured."""


def friction_force(force: Array, pivot: Array, twist: Array, *, radius: Array | float, width: float) -> Array:
    """Return (...) the force e that bears a force f, a pivoting moment T and a twist M of a stem between two pads [N].

    Pads that each press with P slide at e = 2 mu P. Each touches the stem on a line of length w, with uniform pressure.
    When the stem slides across that line and turns about a point c w / 2 from its middle, friction pulls one way beyond
    that point and the other way before it: the force of both pads is 2 mu P c, the moment 2 mu P w (1 - c^2) / 4. So
    4 T / (w e) + (f / e)^2 = 1; a stem that only pivots has the lever w / 4, and forces along the line need less. A
    twist about the stem's own axis pulls at its surface in opposite directions at the two pads, so it adds to the force
    at one of them: f + M / r. Along the closing axis pads also bear by pressing unevenly, which takes a P of
    f / 2 + 3 T / w, less than this asks for with mu up to 0.5: so the gripper's axes are not asked for.

    Args:
        force: (...) between pads and stem [N].
        pivot: (...) moment that turns the stem's direction [N m].
        twist: (...) moment about the stem's axis [N m].
        radius: (...) of the stem [m].
        width: w, of the pads along the stem [m].
    """
    slides, turns = force + twist / radius, 4 * pivot / width
    return (turns + np.sqrt(turns**2 + 4 * slides**2)) / 2


def grip_rows(plant: PlantModel, points: Array) -> NDArray[Any]:
    """Return for each of (n, 3) points the position within `plant.stem_nodes` of the nearest node that can be moved.

    Raises:
        StageFailure: "no_grasp_found": every stem node is clamped.
    """
    usable = np.flatnonzero(~np.isin(plant.stem_nodes, plant.clamp.nodes))
    if not len(usable):
        raise StageFailure("no_grasp_found", "the main stem is too short to be held above its root.")
    nodes = plant.rods.nodes[plant.stem_nodes[usable]]
    return usable[np.linalg.norm(nodes[None] - np.asarray(points)[:, None], axis=2).argmin(axis=1)]


def pad_nodes(plant: PlantModel, rows: NDArray[Any], width: float = PADS.width) -> list[NDArray[Any]]:
    """Return for each of (G,) stem positions the rod nodes between the pads: the node itself first, then the others.

    Those within half the width of it along the stem, and at least its nearest neighbour, since pads hold a direction;
    not those that are clamped.
    """
    usable = np.flatnonzero(~np.isin(plant.stem_nodes, plant.clamp.nodes))
    held = []
    for row in rows:
        apart = np.abs(plant.arc_length[usable] - plant.arc_length[row])
        order = np.argsort(apart, kind="stable")
        count = max(2, int(np.sum(apart <= width / 2)))
        held.append(plant.stem_nodes[usable[order[:count]]])
    return held
