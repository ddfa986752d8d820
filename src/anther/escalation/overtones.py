"""Flowers that swing far do not swing as a sine: what the camera sees of that. F flowers, H overtones."""

from __future__ import annotations

import numpy as np

from anther.geometry import Array
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
    order, phase = np.arange(2, over.shape[1] + 2), np.linspace(0, 2 * np.pi, 64, endpoint=False)
    alone = np.imag(np.exp(1j * phase)[:, None, None] * tone)
    beside = np.imag(np.einsum("h,th,fhx->tfx", order**2, np.exp(1j * phase[:, None] * order), over))
    whole, sine = (np.linalg.norm(path, axis=2).max(axis=0) for path in (alone + beside, alone))
    return np.divide(whole, sine, out=np.ones(len(tone)), where=sine > 0)
