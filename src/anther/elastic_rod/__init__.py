"""Discrete elastic rods: branched, slender, shaken. Knows nothing of plants or robots.

`Rods` (geometry and material), `Clamp` and `Drive` (what is held and moved), then `simulate` for nonlinear motion
(threads run it on all cores), `frequency_response` and `response_map` for small vibrations, `natural_frequencies` for
modes and their damping ratios, `base_response` for a shaking table.
"""

from anther.elastic_rod.equilibrium import equilibrium, least_stiffness, stands, with_gravity_equilibrium
from anther.elastic_rod.linear import Modes, natural_frequencies
from anther.elastic_rod.motion import Burst, Chirp, Clamp, Drive, Motion, SampledDrive
from anther.elastic_rod.response import base_response, frequency_response, response_map
from anther.elastic_rod.rods import GRAVITY, NaturalShape, Rods
from anther.elastic_rod.simulation import Trajectory, simulate

__all__ = [
    "GRAVITY",
    "Burst",
    "Chirp",
    "Clamp",
    "Drive",
    "Modes",
    "Motion",
    "NaturalShape",
    "Rods",
    "SampledDrive",
    "Trajectory",
    "base_response",
    "equilibrium",
    "frequency_response",
    "least_stiffness",
    "natural_frequencies",
    "response_map",
    "simulate",
    "stands",
    "with_gravity_equilibrium",
]
