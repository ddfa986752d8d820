"""How sure it is that the fingers close on the main stem, place by place along it. K places, S stem samples."""

from __future__ import annotations

import numpy as np

from anther.geometry import Array
from anther.skeleton import Skeleton
from anther.skeleton.support import logit, probability
from anther.stem import Stem
from anther.stem.confidence import rivalry

FITTED = (3.0, 0.8, 0.8, -12.0, -4.0)
"""Constant and weights of `place_evidence` in the log-odds: `python experiments/confidence.py --fit`."""

WINDOW = 0.015
"""Half length of the piece of stem whose support counts [m]: half of what the fingers need."""


def place_confidence(stem: Stem, skeleton: Skeleton, arcs: Array) -> Array | None:
    """Return (K,) the probability that what stands at these arc lengths [m] is the main stem.

    That is: the true main stem (pepper: below its first fork) passes within 5 mm of the place on the centreline.
    None when the skeleton's own confidence is unknown.
    """
    return None if skeleton.confidence is None else probability(FITTED, place_evidence(stem, skeleton, arcs))


def place_evidence(stem: Stem, skeleton: Skeleton, arcs: Array) -> Array:
    """Return (K, 4): log-odds of the confidence there and of the whole stem's, rivalry, whether above a fork."""
    assert skeleton.confidence is not None
    along = skeleton.confidence[stem.node_ids]
    near = np.exp(-0.5 * ((stem.arc_length - arcs[:, None]) / WINDOW) ** 2)
    support = near @ along / np.maximum(near.sum(axis=1), 1e-12)
    contested = np.interp(arcs, stem.arc_length, rivalry(skeleton, stem.node_ids))
    above = arcs > stem.arc_length[stem.fork] + 1e-9
    whole = np.full(len(arcs), logit(along.mean()))
    return np.stack([logit(support), whole, contested, above], axis=1)
