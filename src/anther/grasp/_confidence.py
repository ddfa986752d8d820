"""How sure it is that the fingers close on the main stem, place by place along it. K places, S stem samples."""

from __future__ import annotations

import numpy as np

from anther.geometry import Array
from anther.skeleton import Skeleton
from anther.skeleton.support import probability
from anther.stem import Stem
from anther.stem.confidence import plant_evidence, rise_share

FITTED = (-6.67, 8.66, 1.13, 1.26, 3.08)
"""Constant and weights of `place_evidence` in the log-odds: `python experiments/fit_confidence.py`."""

LITTLE, LITTLE_RIGHT = 0.1, 0.4
"""A stem that rises by less than this share of the plant's height is a leaf's tip, or too short to be held for sure: of
twelve such grasps on the development plants five were right."""


def place_confidence(stem: Stem, skeleton: Skeleton, arcs: Array) -> Array | None:
    """Return (K,) the probability that what stands at these arc lengths [m] is the main stem.

    That is: the true main stem (pepper: below its first fork) passes within 5 mm of the place on the centreline.
    None when the skeleton's own confidence is unknown.
    """
    if skeleton.confidence is None:
        return None
    sure = probability(FITTED, place_evidence(stem, skeleton, arcs))
    return np.minimum(sure, LITTLE_RIGHT) if rise_share(skeleton, stem.node_ids) < LITTLE else sure


def place_evidence(stem: Stem, skeleton: Skeleton, arcs: Array) -> Array:
    """Return (K, 4), larger is better: below a fork or not, and what the plant says of its stem (`plant_evidence`).

    The nodes' confidence and the best rival path add nothing to that (measured).
    """
    below = arcs <= stem.arc_length[stem.fork] + 1e-9
    return np.column_stack([below, np.tile(plant_evidence(skeleton, stem.node_ids), (len(arcs), 1))])
