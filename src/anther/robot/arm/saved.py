"""An arm in a file of its own: a run keeps the arm and the gripper of its cell file, to be shown later."""

from __future__ import annotations

from dataclasses import dataclass

from anther.core.geometry import Box
from anther.core.records import Stored
from anther.robot.arm.model import ArmModel


@dataclass(frozen=True, slots=True, eq=False)
class SavedArm(Stored):
    """An arm with its tool, and the boxes that it keeps out of; a JSON file."""

    KIND, SCHEMA = "arm", 1
    arm: ArmModel
    keep_out: tuple[Box, ...] = ()
