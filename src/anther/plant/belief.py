"""Results of an earlier visit to a plant."""

from __future__ import annotations

from dataclasses import dataclass

from anther.core.geometry import Array


@dataclass(frozen=True, slots=True)
class EarlierShake:
    """The final shake of an earlier, observed visit to the same plant.

    Attributes:
        arc_length: of the grip along the stem [m].
        direction: (3,) of the shake, world.
        frequency, amplitude: [Hz], [m].
    """

    arc_length: float
    direction: Array
    frequency: float
    amplitude: float
