"""How sure it is that the fingers close on the main stem, place by place along it. K places, S stem samples."""

from __future__ import annotations

import numpy as np

from anther.geometry import Array
from anther.skeleton import Skeleton
from anther.skeleton.support import logit, probability
from anther.stem import Stem
from anther.stem.confidence import rivalry

FITTED = (-4.40, 1.85, 3.55, 5.82)
"""Constant and weights of `place_evidence` in the log-odds: `python experiments/confidence.py --fit`."""


def place_confidence(stem: Stem, skeleton: Skeleton, arcs: Array) -> Array | None:
    """Return (K,) the probability that what stands at these arc lengths [m] is the main stem.

    That is: the true main stem (pepper: below its first fork) passes within 5 mm of the place on the centreline.
    None when the skeleton's own confidence is unknown.
    """
    if skeleton.confidence is None:
        return None
    return skeleton.rooted * probability(FITTED, place_evidence(stem, skeleton, arcs))


def place_evidence(stem: Stem, skeleton: Skeleton, arcs: Array) -> Array:
    """Return (K, 3), larger is better: log-odds of the stem's mean confidence, 0 less the rivalry, below a fork or not.

    The confidence at the place itself adds nothing to that of the whole stem (measured).
    """
    assert skeleton.confidence is not None
    whole = np.full(len(arcs), logit(skeleton.confidence[stem.node_ids].mean()))
    contested = np.interp(arcs, stem.arc_length, rivalry(skeleton, stem.node_ids))
    below = arcs <= stem.arc_length[stem.fork] + 1e-9
    return np.stack([whole, -contested, below], axis=1)
