"""How the gripper swings when an arm reads and was told so. K tones, M members, R readings."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from anther.devices import ArmSample
from anther.geometry import Array
from anther.shake.observables import ComplexArray
from anther.shake.plant_limits import FAST

ARM_MODE, ARM_ERROR = 28.0, 0.6
"""Links swing beyond their motors, which is what an arm reads, by 1 / (1 - (f / `ARM_MODE`)^2) [Hz], with an error of
`ARM_ERROR` (f / `FAST`)^3 times what was commanded. Measured on 24 simulated Sawyers (experiments/arm_readings.py, wide
truth, two lines each) that hold nothing: by 1.10 at 8.5, 1.19 at 11.3, 1.5 at 16.9 Hz; median and 75 % quantile of the
error 3 and 12 % at 6.4, 8 and 33 % at 11.3, 20 and 104 % at 16.9 Hz."""
ARM_FOLLOWS, ARM_ASIDE = 0.9, 0.3
"""Whatever it reads an arm does about so much of what is commanded, at any phase (the same arms: 0.54 to 1.55 at 18.5
Hz), and so much of that along any other line."""


def gripper_motion(samples: Sequence[ArmSample], middle: Callable[[Array], Array], tones: Array) -> ComplexArray:
    """Return (K, 3) phasors of the gripper's motion by the arm's readings, world, on the robot's clock [m].

    Args:
        samples: of the arm while the tones were steady.
        middle: joints (R, J) -> (R, 3) place of the grip, world [m].
        tones: (K,) [Hz].
    """
    times = np.array([s.time for s in samples])
    places = middle(np.array([s.measured for s in samples]))
    phase = 2 * np.pi * times[:, None] * tones
    basis = np.column_stack([np.sin(phase), np.cos(phase), np.ones_like(times), times - times.mean()])
    parts = np.linalg.solve(basis.T @ basis + 1e-12 * np.eye(basis.shape[1]), basis.T @ places)
    return np.asarray(parts[: len(tones)] + 1j * parts[len(tones) : 2 * len(tones)], dtype=np.complex128)


def links(readings: ComplexArray, tones: Array) -> tuple[ComplexArray, Array]:
    """Return how the gripper swings, (K, 3) phasors [m], and `Look.doubt`, when an arm reads so.

    An arm reads its motors. Above the modes of its links that says less of its gripper than what it was told.

    Args:
        readings: (K, 3) phasors of the gripper, if links went as their motors do [m].
        tones: (K,) [Hz].
    """
    error = ARM_ERROR * (tones / FAST) ** 3
    weight = ARM_FOLLOWS**2 / (ARM_FOLLOWS**2 + error**2)
    beyond = 1 / (1 - np.minimum(tones / ARM_MODE, 0.7) ** 2)  # nearer to the mode readings count for little
    return readings * (weight * beyond)[:, None], error * np.sqrt(weight)


def drawn_errors(count: int, direction: Array, tone: int) -> ComplexArray:
    """Return (M, 3) what `count` members add to the gripper's motion, with a `Look.doubt` of 1.

    Each turns the `direction` (3,) that is commanded in its own way, the same in every look at a tone, so that lines
    still add up.
    """
    parts = np.random.default_rng([0, tone]).normal(size=(2, count, 10)) / np.sqrt(2)
    along, aside = np.split(parts[0] + 1j * parts[1], [1], axis=1)
    return np.asarray(along * direction + ARM_ASIDE * aside.reshape(-1, 3, 3) @ direction, dtype=np.complex128)
