"""Identification: stiffness, density and damping from measurements, and a plant's material refined after a trial (P22).

From the bench: `identify` turns a `MaterialTest` (cut samples, plucks, a deflection test) into a material with its
uncertainty; its steps are `density_from_samples`, `fit_free_vibration`, `youngs_from_first_mode`,
`youngs_from_deflection`. From a shake: `refine`.
"""

from anther.identification._clamped_stem import (
    ClampedStem,
    Orientation,
    first_frequency,
    tip_deflections,
    youngs_from_deflection,
    youngs_from_first_mode,
)
from anther.identification._free_vibration import FreeVibration, fit_free_vibration, fitted_motion, mean_vibration
from anther.identification._material_test import (
    Density,
    Identification,
    InstrumentErrors,
    MaterialTest,
    Quantity,
    combine,
    density_from_samples,
    disagreement,
    identify,
    propagate,
    read_material,
    write_material,
)
from anther.identification._observed import Felt, ObservedShake, feel
from anther.identification._refinement import Params, Refinement, refine

__all__ = [
    "ClampedStem",
    "Density",
    "Felt",
    "FreeVibration",
    "Identification",
    "InstrumentErrors",
    "MaterialTest",
    "ObservedShake",
    "Orientation",
    "Params",
    "Quantity",
    "Refinement",
    "combine",
    "density_from_samples",
    "disagreement",
    "feel",
    "first_frequency",
    "fit_free_vibration",
    "fitted_motion",
    "identify",
    "mean_vibration",
    "propagate",
    "read_material",
    "refine",
    "tip_deflections",
    "write_material",
    "youngs_from_deflection",
    "youngs_from_first_mode",
]
