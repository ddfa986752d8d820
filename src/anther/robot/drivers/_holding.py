"""Where a stop of a streamed arm begins: the one rule of every such driver's `hold`. J joints.

Within its time-out the robot still follows its last command, even if readings have failed: a stop starts from that
command, without a jump. After a longer silence the robot has stopped by itself and the last command is void: the driver
then sends only the measured rest position, from readings taken since, or nothing. An arm at rest is sent nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from anther.core.geometry import Array
from anther.robot.devices import DeviceError
from anther.robot.drivers._readings import Readings

NEAR = 0.05
"""An arm further than this from where it was sent does not follow, and no motion begins there [rad]."""


class Late(DeviceError):
    """The robot waited for a command longer than it may."""


class LastCommand(NamedTuple):
    """The last command: sent at `time` [s], infinite for a rest; joints and rates (J,) [rad], [rad/s]."""

    time: float
    joints: Array
    rate: Array

    @property
    def rests(self) -> bool:
        """Whether it commands a rest, which the robot keeps without further commands."""
        return self.time == float("inf")


def find_rest_joints(readings: Readings, since: float) -> Array | None:
    """Return the joints (J,) of an arm at rest, by a reading not older than `since` [s]; None: unknown, or moving."""
    reading, speed = readings.last, readings.speed()
    if reading is None or speed is None or reading.time < since:
        return None
    if np.abs(speed).max() > 0.02:  # [rad/s]: 0.6 mrad between readings that are 30 ms apart
        return None
    return reading.joints
