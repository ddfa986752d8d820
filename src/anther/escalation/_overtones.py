"""Flowers that swing far do not swing as a sine: what the camera sees of that. F flowers, H overtones."""

from __future__ import annotations

import numpy as np

from anther.geometry import Array
from anther.oscillation import peak
from anther.response.points import Swings

SIGNIFICANCE = 3.0
"""A flower's motion counts as measured from so many standard deviations on; below, it only narrows what is believed."""


def sharpened(swings: Swings, own: slice) -> Array:
    """Return (F,) the peak of each flower's acceleration over what it would be without overtones.

    Args:
        swings: of one tone.
        own: of its points, the flowers.
    """
    tone, over = np.nan_to_num(swings.phasors[own, 0]), np.nan_to_num(swings.overtones[own])
    if not over.size:
        return np.ones(len(tone))
    least = SIGNIFICANCE * np.sqrt(np.nansum(swings.std[own] ** 2, axis=1))
    over = np.where(np.linalg.norm(over, axis=2, keepdims=True) > least[:, None, None], over, 0.0)
    whole, sine = peak(np.concatenate([tone[:, None], over], axis=1)), peak(tone[:, None])
    return np.divide(whole, sine, out=np.ones(len(tone)), where=sine > 0)
