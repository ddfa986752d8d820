"""Where a stop of a streamed arm begins: the one rule of every such driver's `hold`. J joints.

What the robot was told a moment ago it still follows: a stop goes on from there without a jump. After a silence longer
than the robot's own time-out it has stopped by itself, and what it was told is void: then nothing is sent but where it
is measured to stand, by readings that were taken since. Where measured and told differ, the measured counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from anther.devices import DeviceError
from anther.drivers._readings import Readings
from anther.geometry import Array

NEAR = 0.05
"""An arm further than this from where it was sent is held where it is instead, and no motion begins there [rad]."""
STANDS = 0.02
"""An arm with no joint faster than this stands [rad/s]: 0.6 mrad between readings that are 30 ms apart."""


class Late(DeviceError):
    """The robot waited for a command longer than it may."""


class Told(NamedTuple):
    """What the robot was told last: at `time` [s], infinite for a rest; joints and rates (J,) [rad], [rad/s]."""

    time: float
    joints: Array
    rate: Array

    @property
    def rests(self) -> bool:
        """Whether it was told to stay, and stays without being told again."""
        return self.time == float("inf")


def stands_at(heard: Readings, since: float) -> Array | None:
    """Return where the arm is measured to stand by a reading not older than `since` [s]; None: not known, or moving."""
    reading, speed = heard.last, heard.speed()
    if reading is None or speed is None or reading.time < since or np.abs(speed).max() > STANDS:
        return None
    return reading.joints


def stop_from(told: Told, heard: Readings, now: float, stale: float) -> tuple[Array, Array] | None:
    """Return joints and rates (J,) from which the arm is to be stopped; None: nothing is to be sent.

    Args:
        told: what the robot follows now, at `now` [s]; its time-out has not come.
        heard: readings; older than `stale` [s] they say nothing.
        now: on the clock of the readings.
        stale: see `heard`.
    """
    reading, none = heard.last, np.zeros_like(told.rate)
    if reading is None or not abs(now - reading.time) <= stale:
        return None if told.rests else (told.joints, told.rate)
    speed = heard.speed()
    if np.any(told.rate) and stands_at(heard, now - stale) is not None:
        moves = np.abs(told.rate).max() > STANDS
        return (reading.joints, none) if moves else (told.joints, told.rate)
    speed = none if speed is None or told.rests else speed
    here = reading.joints + speed * (now - reading.time)
    return (here, speed) if np.abs(here - told.joints).max() > NEAR else (told.joints, told.rate)
