"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .errors import AntherError, InputError, StageFailure
from .geometry import Array, Box, Intrinsics, inverse, transform, transform_points
from .runs import Advance, Run

__all__ = [
    "Advance",
    "AntherError",
    "Array",
    "Box",
    "InputError",
    "Intrinsics",
    "Run",
    "StageFailure",
    "inverse",
    "transform",
    "transform_points",
]
