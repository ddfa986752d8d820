"""Learning: a plant's material refined from measured shakes (P22). From bench tests: `plant.bench`."""

from anther.pollination.learning._observed import NOT_MEASURED, GripMeasurement, ObservedShake, measure_grip
from anther.pollination.learning._refinement import Params, Refinement, refine

__all__ = ["NOT_MEASURED", "GripMeasurement", "ObservedShake", "Params", "Refinement", "measure_grip", "refine"]
