"""The public names of the room, and where they stand; `__init__.py` finds them when they are asked for."""

from ._equilibrium import equilibrium, least_stiffness, standing, stands, with_gravity_equilibrium
from ._linear import base_response, natural_frequencies
from ._loads import Loads
from ._motion import (
    RIGID,
    Burst,
    Chirp,
    Clamp,
    Drive,
    FunctionDrive,
    Rocking,
    SampledDrive,
    Springs,
    unit_direction,
)
from ._response import Observed, displacements, frequency_response, observed_response, response_map, steady_motion
from ._rods import GRAVITY, NaturalShape, Rods, Section
from ._simulation import Trajectory, simulate
from ._strains import joints, strain_changes
from ._supports import Support

__all__ = [
    "GRAVITY",
    "RIGID",
    "Burst",
    "Chirp",
    "Clamp",
    "Drive",
    "FunctionDrive",
    "Loads",
    "NaturalShape",
    "Observed",
    "Rocking",
    "Rods",
    "SampledDrive",
    "Section",
    "Springs",
    "Support",
    "Trajectory",
    "base_response",
    "displacements",
    "equilibrium",
    "frequency_response",
    "joints",
    "least_stiffness",
    "natural_frequencies",
    "observed_response",
    "response_map",
    "simulate",
    "standing",
    "stands",
    "steady_motion",
    "strain_changes",
    "unit_direction",
    "with_gravity_equilibrium",
]
