"""The names that a person may choose among: each owned here, so that a command line reads them without the rooms."""

from __future__ import annotations

from typing import Literal

Units = Literal["m", "cm", "mm", "0.01mm", "um", "in", "ft"]
"""Of the lengths in a file."""
Axis = Literal["x", "y", "z"]
Crop = Literal["tomato", "pepper"]
"""Crops whose material and limits are described (`anther.plant`)."""
Preset = Literal["gentle", "default", "bold", "paper"]
"""What a lost flower counts (`anther.pollination.decision.PRICES`); "paper" asks for none."""
ArmName = Literal["sawyer", "ur5e", "fr3", "xarm7"]
"""The arms that are described (`anther.robot.arm.arms.find_arm`); a cell file may describe another."""
ActuatorName = Literal["arm", "gripper"]
"""What shakes the plant."""
MaskSource = Literal["colour", "grounded-sam2", "sam3"]
"""What finds plant and flowers in an image (docs/masks.md)."""
HandEyeMethod = Literal["tsai", "park", "horaud", "daniilidis"]
"""Closed-form solvers of a camera's place on the flange."""
Discretisation = Literal["consistent", "paper"]
"""Of elastic rods: second order at forks and kinks too, or the paper's formula."""
SIDES = ("left", "right")
"""Of a row, as seen by who looks along the rails the way that the cart's travel grows."""
Species = Literal["tomato", "pepper", "maize"]
"""Plants whose limbs have names of their own (`anther.perception.traits`)."""
