"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .capture import CaptureTruth, capture_from_poses, orbit_poses
from .pepper import grow_pepper
from .plant import Organ, SimPlant
from .render import Scene
from .row import Row, grow_row
from .row_cell import build_row, mapped_others, mapped_string
from .row_drive import STEM_TO_STEM, drive_past
from .simulated_cell import SimulatedCell, build, grow, layout, photograph, views_at
from .tomato import grow_tomato
from .truth import NOMINAL, WIDE, Truth, draw

__all__ = [
    "NOMINAL",
    "STEM_TO_STEM",
    "WIDE",
    "CaptureTruth",
    "Organ",
    "Row",
    "Scene",
    "SimPlant",
    "SimulatedCell",
    "Truth",
    "build",
    "build_row",
    "capture_from_poses",
    "draw",
    "drive_past",
    "grow",
    "grow_pepper",
    "grow_row",
    "grow_tomato",
    "layout",
    "mapped_others",
    "mapped_string",
    "orbit_poses",
    "photograph",
    "views_at",
]
