"""What a shake is worth: the pollen it frees from each flower, and the flowers that set fruit for it."""

from __future__ import annotations

import numpy as np

from anther.elastic_rod.rods import Array
from anther.vibration.limits import pollen_dose


def freed_share(acceleration: Array, seconds: Array, half: float, release_time: float) -> Array:
    """Return the share of its pollen that a flower frees in a shake of several pieces, (...).

    What an acceleration can free at most is `pollen_dose`; the flower approaches that within `release_time`, and what
    is free stays free: dR/dt = max(S(a) - R, 0) / tau. Pollen left the anther fast at first, then slower, in grain by
    grain simulations (rsif.2024.0526); amplitude and duration both raise the pollen of a buzz, frequency hardly does
    (De Luca 2013, Rosi-Denadai 2020), so no frequency is preferred here beyond what the pedicel's resonance does to the
    acceleration (stem shaking answered best at 30-35 Hz, Shimizu).

    Args:
        acceleration: (K, ...) peak acceleration of the flower in each piece [m/s2].
        seconds: (K,) how long each lasts [s].
        half: acceleration that frees half [m/s2].
        release_time: tau [s].
    """
    reached = np.zeros(acceleration.shape[1:])
    for a, step in zip(acceleration, seconds, strict=True):
        reached += np.maximum(pollen_dose(a, half) - reached, 0) * -np.expm1(-step / release_time)
    return reached


def set_probability(freed: Array, unshaken: float, gain: float) -> Array:
    """Return P(a flower sets) = p0 + (1 - p0) g R for the share R of its pollen that is free, as `anther.fruit_set`.

    Args:
        freed: R [-].
        unshaken: p0, sets without a shake.
        gain: g, of the others sets when all pollen is free.
    """
    return unshaken + (1 - unshaken) * gain * freed
