"""Where a stop of a streamed arm begins: the one rule of every such driver's `hold`. J joints.

What the robot was told a moment ago it still follows, whatever is read, since readings can be what failed: a stop goes
on from there without a jump. After a silence longer than the robot's own time-out it has stopped by itself, and what it
was told is void: then nothing is sent but where it is measured to stand, by readings that were taken since. What rests
is told nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from anther.core.geometry import Array
from anther.robot.devices import DeviceError
from anther.robot.drivers._readings import Readings

NEAR = 0.05
"""An arm further than this from where it was sent does not follow, and no motion begins there [rad]."""
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
