"""The made-up arm of six joints of `examples/my_arm`: cylinders, a sphere and a box, whose hand is turned a little."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from anther.robot.arm.model import ArmModel
from anther.robot.cells import read_cell

EXAMPLE = Path(__file__).parents[2] / "examples" / "my_arm"
CELL, URDF = EXAMPLE / "my_cell.toml", EXAMPLE / "my_arm.urdf"


@cache
def six() -> ArmModel:
    """Return the arm."""
    return read_cell(CELL).model
