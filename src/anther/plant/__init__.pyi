"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from .imported import read_source
from .limits import Crop
from .model import PEPPER, PRIORS, TOMATO, Material, PlantModel, build_plant
from .visit import GraspRecord, ShakeRecord, Visit

__all__ = [
    "PEPPER",
    "PRIORS",
    "TOMATO",
    "Crop",
    "GraspRecord",
    "Material",
    "PlantModel",
    "ShakeRecord",
    "Visit",
    "build_plant",
    "read_source",
]
