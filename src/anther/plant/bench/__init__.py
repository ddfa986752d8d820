"""Stiffness, density and damping of a stem from measurements on a bench, with their uncertainty (P22).

`identify` turns a `MaterialTest` (cut samples, plucks, a deflection test) into a material; its steps are
`density_from_samples`, `fit_free_vibration`, `youngs_from_first_mode`, `youngs_from_deflection`.
"""

from anther.plant.bench._clamped_stem import (
    ClampedStem,
    Orientation,
    first_frequency,
    tip_deflections,
    youngs_from_deflection,
    youngs_from_first_mode,
)
from anther.plant.bench._free_vibration import FreeVibration, fit_free_vibration, fitted_motion, mean_vibration
from anther.plant.bench._material_test import (
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

__all__ = [
    "ClampedStem",
    "Density",
    "FreeVibration",
    "Identification",
    "InstrumentErrors",
    "MaterialTest",
    "Orientation",
    "Quantity",
    "combine",
    "density_from_samples",
    "disagreement",
    "first_frequency",
    "fit_free_vibration",
    "fitted_motion",
    "identify",
    "mean_vibration",
    "propagate",
    "read_material",
    "tip_deflections",
    "write_material",
    "youngs_from_deflection",
    "youngs_from_first_mode",
]
