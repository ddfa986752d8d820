"""Identification: a plant's material refined by what a shake of it showed (P22). From bench tests: `plant.bench`."""

from anther.pollination.learning._observed import Felt, ObservedShake, feel
from anther.pollination.learning._refinement import Params, Refinement, refine

__all__ = ["Felt", "ObservedShake", "Params", "Refinement", "feel", "refine"]
