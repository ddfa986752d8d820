"""Arms that a process of its own can make: one that takes its time, and a Sawyer's driver on a slow clock."""

from __future__ import annotations

import time
from typing import Any

from fake_robot import FakeArm
from slow_clock import clock, sleep

from anther.robot.devices import ArmSample, JointTrajectory


class SlowArm(FakeArm):
    def follow(self, trajectory: JointTrajectory, watch: Any = None, more: Any = None) -> Any:
        def watching(sample: ArmSample) -> None:
            time.sleep(0.01)
            if watch:
                watch(sample)

        return super().follow(trajectory, watching, more)

    def shout(self, word: str) -> str:
        return word.upper()


def slow_sawyer(master: str) -> Any:
    from anther.robot.drivers.intera import types  # noqa: PLC0415
    from anther.robot.drivers.ros1 import Node  # noqa: PLC0415
    from anther.robot.drivers.sawyer_ros1 import Sawyer  # noqa: PLC0415

    return Sawyer(Node(master, "/anther", types()), mode="trajectory", clock=clock, sleep=sleep)
