"""What shakes the grip: an arm, or a gripper that vibrates by itself. The planner asks both the same questions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from anther.checks import check_range
from anther.elastic_rod import Array
from anther.grasp import Grasp
from anther.shake._limits import ArmLimit, sawyer_limit

RAMPS = 0.97
"""Share of a motor's limits that a steady shake may take: a ramp over half a second adds 1 % at 10 Hz."""

ActuatorName = Literal["arm", "gripper"]


class Actuator(Protocol):
    """A machine that moves the grip to and fro.

    Attributes:
        name: for the table of limits.
        lowest, highest: its band [Hz].
        least_amplitude: it cannot be trusted with less [m].
        tones: so many frequencies are worth trying at once; of more, what it can do of each is too little to be seen.
    """

    @property
    def name(self) -> str: ...
    @property
    def lowest(self) -> float: ...
    @property
    def highest(self) -> float: ...
    @property
    def least_amplitude(self) -> float: ...
    @property
    def tones(self) -> int: ...

    def amplitude(self, grasp: Grasp, direction: Array, frequencies: Array) -> Array:
        """Return the largest amplitudes (Q,) [m] at a grasp along a unit direction (3,) at (Q,) frequencies [Hz]; they
        leave room for ramps."""
        ...

    def axis(self, grasp: Grasp) -> Array | None:
        """Return the only line (3,) along which it moves the grip, world; None: along any."""
        ...


@dataclass(frozen=True, slots=True)
class ArmShaker:
    """The arm shakes the closed gripper.

    Attributes:
        limit: what its joints manage at the grasp's own joint angles: speed, acceleration and torque, so the amplitude
            falls as 1/f^2 above 1-2 Hz (facts: sawyer 6).
        lowest, highest: [Hz]; below 1 Hz no flower feels a shake, above 35 Hz the arm moves less than its pads yield.
        least_amplitude: the arm places itself to 0.1 mm (facts: sawyer 2), and soft pads swallow as much [m].
        tones: on twelve plants of the whole cell three gave 1.08 times what six did.
    """

    limit: ArmLimit = sawyer_limit
    lowest: float = 1.0
    highest: float = 35.0
    least_amplitude: float = 0.3e-3
    tones: int = 3

    @property
    def name(self) -> str:
        """Return "arm"."""
        return "arm"

    def amplitude(self, grasp: Grasp, direction: Array, frequencies: Array) -> Array:
        """Return the largest amplitudes (Q,) [m]."""
        return self.limit(grasp, direction, frequencies)

    def axis(self, grasp: Grasp) -> None:
        """Return None: an arm shakes along any line."""


@dataclass(frozen=True, slots=True)
class VibratingGripper:
    """A gripper whose fingers a motor moves to and fro; the arm stands still. A design of ours, not a product.

    Its band reaches over the 30-35 Hz at which tomato flowers answer a shaken stem best (Shimizu, 5-50 Hz tested), and
    its acceleration is what moves a flower with 50 m/s2 at gain 1: 0.51 mm at 50 Hz (facts: pollination 1b).

    Attributes:
        stroke: largest amplitude, half of peak to peak [m].
        acceleration: what its motor gives [m/s2].
        lowest, highest: [Hz]; faster tones are more than a camera of 90 frames a second can follow.
        least_amplitude: [m]; a shaker moved tomato stems by 0.1 mm (Shimizu), and the motor's stroke is set, not
            steered.
        tones: on five plants of the whole cell six gave 1.16 times what three did.
    """

    stroke: float = 1.5e-3
    acceleration: float = 50.0
    lowest: float = 10.0
    highest: float = 40.0
    least_amplitude: float = 0.02e-3
    tones: int = 6

    def __post_init__(self) -> None:
        check_range("stroke", self.stroke, 1e-6, 0.1, "m")
        check_range("acceleration of the gripper", self.acceleration, 1e-3, 1e4, "m/s2")
        check_range("lowest frequency", self.lowest, 0.1, 500, "Hz")
        check_range("highest frequency", self.highest, self.lowest, 500, "Hz")

    @property
    def name(self) -> str:
        """Return "vibrating gripper"."""
        return "vibrating gripper"

    def amplitude(self, grasp: Grasp, direction: Array, frequencies: Array) -> Array:
        """Return the largest amplitudes (Q,) [m], whatever the grasp and the direction; 0 outside its band."""
        f = np.asarray(frequencies, dtype=float)
        inside = (f >= self.lowest * (1 - 1e-9)) & (f <= self.highest * (1 + 1e-9))
        return np.where(inside, RAMPS * np.minimum(self.stroke, self.acceleration / (2 * np.pi * f) ** 2), 0.0)

    def axis(self, grasp: Grasp) -> Array:
        """Return the flange's y: the pads close along it, so that they push the stem and need no friction."""
        return grasp.T_world_flange[:3, 1]
