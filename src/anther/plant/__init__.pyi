"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .belief import EarlierShake
from .bench import ClampedStem, MaterialTest, fit_free_vibration, identify, read_material, write_material
from .imported import main_stem, read_source
from .limits import Crop, moved
from .model import PEPPER, TOMATO, Material, PlantModel, build_plant
from .string import HeldString
from .visit import GraspRecord, ShakeRecord, Visit

__all__ = [
    "PEPPER",
    "TOMATO",
    "ClampedStem",
    "Crop",
    "EarlierShake",
    "GraspRecord",
    "HeldString",
    "Material",
    "MaterialTest",
    "PlantModel",
    "ShakeRecord",
    "Visit",
    "build_plant",
    "fit_free_vibration",
    "identify",
    "main_stem",
    "moved",
    "read_material",
    "read_source",
    "write_material",
]
