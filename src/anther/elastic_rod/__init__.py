"""Discrete elastic rods: branched, slender, shaken. Knows nothing of plants or robots.

`Rods` (geometry and material), `Clamp` and `Drive` (what is held and moved), then `simulate` for nonlinear motion
(threads run it on all cores), `frequency_response` and `response_map` for small vibrations, `natural_frequencies` for
modes and their damping ratios, `base_response` for a shaking table.
"""

from anther.elastic_rod._equilibrium import equilibrium, least_stiffness, standing, stands, with_gravity_equilibrium
from anther.elastic_rod._linear import Modes, base_response, natural_frequencies
from anther.elastic_rod._motion import (
    RIGID,
    Burst,
    Chirp,
    Clamp,
    Drive,
    Motion,
    Rocking,
    SampledDrive,
    Springs,
    unit_direction,
)
from anther.elastic_rod._response import (
    Observed,
    displacements,
    frequency_response,
    observed_response,
    response_map,
    steady_motion,
)
from anther.elastic_rod._rods import GRAVITY, Array, Discretisation, NaturalShape, Rods
from anther.elastic_rod._simulation import Trajectory, simulate
from anther.elastic_rod._strains import joints, strain_changes
from anther.elastic_rod._vectors import compiled

__all__ = [
    "GRAVITY",
    "RIGID",
    "Array",
    "Burst",
    "Chirp",
    "Clamp",
    "Discretisation",
    "Drive",
    "Modes",
    "Motion",
    "NaturalShape",
    "Observed",
    "Rocking",
    "Rods",
    "SampledDrive",
    "Springs",
    "Trajectory",
    "base_response",
    "compiled",
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
