"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .log import Log
from .pictures.plant import draw_plant
from .pictures.report import draw_plan
from .summary import summarise

__all__ = [
    "Log",
    "draw_plan",
    "draw_plant",
    "summarise",
]
