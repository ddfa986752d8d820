"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .capture import CaptureTruth, camera_errors, capture_from_poses, capture_views, orbit_poses
from .pepper import grow_pepper
from .plant import Organ, SimPlant
from .render import Scene
from .robot import robot_of
from .row import Row, grow_row, row_scene
from .row_cell import build_row, mapped_others, mapped_string
from .row_drive import STEM_TO_STEM, Drive, drive_past
from .simulated_cell import SimulatedCell, build, grow, layout, photograph, views_at
from .tomato import grow_tomato
from .true_plant import as_true
from .truth import NOMINAL, WIDE, Truth, draw

__all__ = [
    "NOMINAL",
    "STEM_TO_STEM",
    "WIDE",
    "CaptureTruth",
    "Drive",
    "Organ",
    "Row",
    "Scene",
    "SimPlant",
    "SimulatedCell",
    "Truth",
    "as_true",
    "build",
    "build_row",
    "camera_errors",
    "capture_from_poses",
    "capture_views",
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
    "robot_of",
    "row_scene",
    "views_at",
]
