"""What shakes the grip: an arm, or a gripper that vibrates by itself. The planner asks both the same questions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from anther.core.geometry import Array
from anther.pollination.grasp import Grasp

Limit = Callable[[Grasp, Array, Array], Array]
"""(grasp, unit direction (3,), frequencies (Q,) [Hz]) -> largest amplitudes (Q,) [m]."""


Delivery = Callable[[Grasp, Array, Array], tuple[Array, Array]]
"""See `Actuator.delivers`."""


def within(spread: float) -> Delivery:
    """Return that an actuator does what it is commanded, but for a standard deviation of ln of that."""

    def delivers(_: Grasp, directions: Array, frequencies: Array) -> tuple[Array, Array]:
        shape = len(frequencies), len(directions)
        return np.zeros(shape), np.full(shape, spread)

    return delivers


EXACTLY = within(0.0)


@dataclass(frozen=True, slots=True)
class Actuator:
    """A machine that moves the grip to and fro.

    Attributes:
        name: for the table of limits.
        amplitude: the largest that it manages, with room for ramps.
        lowest, highest: its band [Hz].
        least_amplitude: it cannot be trusted with less [m].
        tones: so many frequencies are worth trying at once; of more, what it can do of each is too little to be seen.
        closing: whether it moves the grip along the gripper's closing axis alone.
        delivers: (grasp, unit directions (D, 3), frequencies (Q,) [Hz]) -> mean and standard deviation (Q, D) of ln of
            what the grip does along them over what is commanded.
    """

    name: str
    amplitude: Limit
    lowest: float
    highest: float
    least_amplitude: float
    tones: int
    closing: bool = False
    delivers: Delivery = EXACTLY


def sawyer_limit(grasp: Grasp, direction: Array, frequencies: Array) -> Array:
    """Return the amplitude (Q,) [m] that a Sawyer manages at the paper's grasp, whatever the grasp's joints are.

    facts: sawyer section 6, SDK limits, orientation held, median of 106 joint solutions at (0.72, 0, -0.05);
    interpolated on a double logarithmic scale, 1/f^2 beyond 30 Hz. The three axes (approach, vertical, lateral) share
    the joints' acceleration, so the amplitudes combine as 1 / sum(|d_k| / A_k), which never promises too much.
    """
    f = np.asarray(frequencies, dtype=float)
    vertical = np.array([0.0, 0.0, 1.0]) - grasp.approach[2] * grasp.approach
    vertical /= max(float(np.linalg.norm(vertical)), 1e-6)  # straight down there is none: all else is lateral
    along, up = abs(float(direction @ grasp.approach)), abs(float(direction @ vertical))
    aside = float(np.sqrt(max(direction @ direction - along**2 - up**2, 0.0)))
    lateral = np.array([180, 45, 20, 7.2, 2.8, 1.8, 0.80, 0.45, 0.20]) * 1e-3
    approach = np.array([111, 28, 12, 4.4, 1.7, 1.1, 0.49, 0.28, 0.12]) * 1e-3
    upward = np.array([122, 30, 13.5, 4.9, 1.9, 1.2, 0.54, 0.30, 0.14]) * 1e-3
    shares = ((along, approach), (up, upward), (aside, lateral))
    return 1 / np.maximum(np.sum([share / _amplitude(table, f) for share, table in shares], axis=0), 1e-9)


def _amplitude(table: Array, frequencies: Array) -> Array:
    hertz = np.array([1, 2, 3, 5, 8, 10, 15, 20, 30.0])
    inside = np.exp(np.interp(np.log(frequencies), np.log(hertz), np.log(table)))
    return inside * np.minimum(1, (hertz[-1] / frequencies) ** 2)


def any_arm(_: Grasp, directions: Array, frequencies: Array) -> tuple[Array, Array]:
    """Return what an arm delivers of which nothing is known: less and less of it the faster it is to be.

    A guess by Sawyers near plants (evaluation/trials/arm_readings.py)."""
    most, fast = 0.4, 15.0  # the spread, reached at a frequency [Hz]
    spread = most * np.minimum(frequencies / fast, 1.0)
    return np.zeros((len(frequencies), len(directions))), np.repeat(spread[:, None], len(directions), axis=1)


def arm_shaker(limit: Limit = sawyer_limit, delivers: Delivery = any_arm) -> Actuator:
    """Return an arm that shakes the closed gripper.

    Its joints' speed, acceleration and torque bound it, so that the amplitude falls as 1/f^2 above 1-2 Hz (facts:
    sawyer 6). Below 1 Hz no flower feels a shake, above 35 Hz the arm moves less than its pads yield. It places itself
    to 0.1 mm (facts: sawyer 2), and soft pads swallow as much. On twelve plants of the whole cell three tones gave 1.08
    times what six did.

    Args:
        limit: what its joints manage at the grasp's own joint angles.
        delivers: what the grip then does; see `Actuator`.
    """
    return Actuator("arm", limit, lowest=1.0, highest=35.0, least_amplitude=0.3e-3, tones=3, delivers=delivers)


STROKE, ACCELERATION = 1.5e-3, 50.0
"""Largest amplitude of the gripper's motor, half of peak to peak [m]; what it gives [m/s2]: that moves a flower with 50
m/s2 at gain 1, 0.51 mm at 50 Hz (facts: pollination 1b)."""


def _motor_limit(_: Grasp, __: Array, frequencies: Array) -> Array:
    ramps = 0.97  # share of a motor's limits: a ramp over half a second adds 1 % at 10 Hz
    return ramps * np.minimum(STROKE, ACCELERATION / (2 * np.pi * np.asarray(frequencies, dtype=float)) ** 2)


VIBRATING_GRIPPER = Actuator(
    "vibrating gripper",
    _motor_limit,
    lowest=10.0,
    highest=40.0,
    least_amplitude=0.02e-3,
    tones=6,
    closing=True,
    delivers=within(0.08),  # a voice coil that is set in volts, or calibrated by hand: within about 14 %, a guess
)
"""A gripper whose fingers a motor moves to and fro along their closing axis, so that the pads push the stem and need no
friction; the arm stands still. A design of ours, not a product.

Its band reaches over the 30-35 Hz at which tomato flowers answer a shaken stem best (Shimizu, 5-50 Hz tested); faster
tones are more than a camera of 90 frames a second can follow. A shaker moved tomato stems by 0.1 mm (Shimizu), and the
motor's stroke is set, not steered. On five plants of the whole cell six tones gave 1.16 times what three did."""
