"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .errors import AntherError, InputError, MissingExtra, StageFailure
from .geometry import Array, Box, Intrinsics, inverse, look_at, transform, transform_points
from .runs import Advance, Run

__all__ = [
    "Advance",
    "AntherError",
    "Array",
    "Box",
    "InputError",
    "Intrinsics",
    "MissingExtra",
    "Run",
    "StageFailure",
    "inverse",
    "look_at",
    "transform",
    "transform_points",
]
