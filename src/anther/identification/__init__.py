"""Identification: stiffness, density and damping from measurements, and a plant's material refined after a trial (P22).

From the bench: `density_from_samples`, `fit_free_vibration`, `youngs_from_frequency`. From a shake: `refine`.
"""

from anther.identification.density import Density, density_from_samples
from anther.identification.free_vibration import FreeVibration, fit_free_vibration
from anther.identification.refinement import Params, Refinement, refine
from anther.identification.stiffness import youngs_from_frequency

__all__ = [
    "Density",
    "FreeVibration",
    "Params",
    "Refinement",
    "density_from_samples",
    "fit_free_vibration",
    "refine",
    "youngs_from_frequency",
]
