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
from anther.identification._estimates import Quantity, combine, disagreement, propagate
from anther.identification._free_vibration import FreeVibration, fit_free_vibration, fitted_motion, mean_vibration
from anther.identification._material_test import (
    Density,
    Identification,
    InstrumentErrors,
    MaterialTest,
    density_from_samples,
    identify,
    read_material,
    write_material,
)
from anther.identification._observed import Felt, ObservedShake, feel
from anther.identification._refinement import Expected, Params, Refinement, expect, flowers_at, loads_at, refine

__all__ = [
    "ClampedStem",
    "Density",
    "Expected",
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
    "expect",
    "feel",
    "first_frequency",
    "fit_free_vibration",
    "fitted_motion",
    "flowers_at",
    "identify",
    "loads_at",
    "mean_vibration",
    "propagate",
    "read_material",
    "refine",
    "tip_deflections",
    "write_material",
    "youngs_from_deflection",
    "youngs_from_first_mode",
]
