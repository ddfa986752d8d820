"""What a plant may be loaded with, what its flowers need, and the wind that loads it as much."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from anther.core.checks import check_range
from anther.core.choices import Crop as Crop  # noqa: PLC0414 - the door gives it
from anther.core.geometry import Array

GRAVITY = 9.81
"""Of the earth [m/s2]."""
GUSTS = 5.0
"""Up to here a leaf's load counts [Hz]: what petioles bear in units of their leaf's weight was measured slowly, and
gusts that load them last a second (facts: pollination 2 and 6). Of faster shakes the strain of their bases counts,
which 1 g bends by 0.05 % (median of 24 simulated plants at 10-38 Hz; one in twenty by 0.2 % on tomatoes, 0.4 % on
peppers)."""
PEAKS = {
    "stem_strain": "stem bending strain [-]",
    "joint_strain": "pedicel bending strain [-]",
    "base_strain": "branch-base strain [-]",
    "leaf_load": "leaf-base load [m/s2]",
}
"""The loads that a plant limits -> their names in the table of limits."""


class Believed(NamedTuple):
    """A lognormal belief: its median, and the standard deviation of its logarithm."""

    median: float
    spread: float

    @classmethod
    def between(cls, low: float, high: float) -> Believed:
        """Return the belief of which 5 % lie below `low`, and 5 % above `high`."""
        return cls(float(np.sqrt(low * high)), float(np.log(high / low) / (2 * 1.6449)))

    @property
    def low(self) -> float:
        """5 % lie below."""
        return self.median * float(np.exp(-1.6449 * self.spread))


TOLERANCE = {
    "stem": Believed.between(0.015, 0.06),
    "pedicel": Believed.between(0.01, 0.05),
    "base": Believed.between(0.01, 0.05),
    "leaf": Believed.between(1.2 * GRAVITY, 10 * GRAVITY),
}
"""What organs bear of one short shake before they stay bent: bending strain [-] of stem, pedicels and the bases of
branches, petioles and peduncles; of leaves the torque at the base that a shake of up to `GUSTS` adds, in units of what
1 m/s2 gives [m/s2]. No elastic limit of a tomato or pepper organ was ever measured (facts: pollination 6)."""
STALK_SPREAD = 0.8
"""Standard deviation of ln of a flower's `stalk_strain`; 0.7 of it is between plants."""
HALF_DOSE = Believed.between(4.0, 80.0)
"""Peak acceleration of a flower that frees half of its pollen [m/s2]; no dose-response was ever measured (facts:
pollination 6)."""
DOSE_MEASURES = {"acceleration": (0, 0.6), "jerk": (1, 0.25), "velocity": (-1, 0.15)}
"""Measure of a flower's motion that may be what frees pollen -> its power of the frequency over that of acceleration,
and how probable it is. A judgement: 5 m/s2 at 100 Hz raised yield, which speaks for jerk and against velocity (facts:
limits 7)."""
LOADED = dict(zip(PEAKS, TOLERANCE.values(), strict=True))
"""Kind of load (`PEAKS`) -> what is believed of what bears it."""
WIND = np.array([2.0, 4.0, 6.0])
"""Local wind about the plant [m/s]."""
BREEZE: dict[str, dict[Crop, Array]] = {
    PEAKS["joint_strain"]: {"tomato": np.array([0.00325, 0.013, 0.0285]), "pepper": np.array([0.002, 0.008, 0.018])},
    PEAKS["leaf_load"]: {
        "tomato": GRAVITY * np.array([0.85, 3.35, 7.5]),
        "pepper": GRAVITY * np.array([0.7, 2.9, 6.5]),
    },
}
"""Name of a limit -> its load in a wind of `WIND`: the pedicel that is bent most, the load of leaf
bases in a gust. Middles of the ranges in facts: pollination 6, computed by us on simulated tomatoes 10-13 and
peppers 10-12 (true rods, canopy drag of Sase 2012, turbulence 35 %, peak = mean + 3.5 rms, linear: above 2 m/s too
much). The main stem and the bases of branches were not computed."""


def stalk_strain(hertz: ArrayLike) -> Array:
    """Return the median of what is believed of the bending strain of a flower's stalks, for each m/s2 it feels [s2/m].

    Of pedicel and peduncle the one that is bent more. At 1-14, 14-20, 20-40 and 40-120 Hz the medians of 24 simulated
    plants of `evaluation.prediction.belief --development` are 1.65, 1.56, 1.24 and 0.73e-4, of tomatoes and peppers
    alike. A flower that swings straight across its pedicel bends it by 1.9e-4 (facts: limits 2).

    Args:
        hertz: frequencies of the shake, of the shape that is returned.
    """
    return 1.6e-4 * np.sqrt(np.minimum(1.0, 17.0 / np.asarray(hertz, dtype=np.float64)))


def breeze(name: str, load: float, crop: Crop) -> float | None:
    """Return the wind [m/s] that loads a plant as much, or None where it was not computed.

    Interpolated on a double logarithmic scale; what lies outside the table is given its end, 2 or 6 m/s.

    Args:
        name: of the limit, as in `ShakePlan.limits`.
        load: [-] or [m/s2], above 0.
        crop: whose table.
    """
    if name not in BREEZE:
        return None
    check_range(name, load, 1e-12, 1e6)
    return float(np.exp(np.interp(np.log(load), np.log(BREEZE[name][crop]), np.log(WIND))))


def like_breeze(name: str, load: float, crop: Crop | None) -> str:
    """Return the wind in words: "3.5 m/s", "2 m/s or less", "6 m/s or more"; "" where it or the crop is not known."""
    wind = None if crop is None else breeze(name, load, crop)
    if wind is None:
        return ""
    if wind <= WIND[0]:
        return f"{WIND[0]:g} m/s or less"
    return f"{WIND[-1]:g} m/s or more" if wind >= WIND[-1] else f"{wind:.1f} m/s"


MOVED = 5.0
"""Median peak acceleration from which on flowers count as moved [m/s2]: an ordinary breeze of 2-4 m/s, which lets open
fields set fruit, gives them 4-24 (facts: pollination 6)."""


def moved(acceleration: ArrayLike) -> bool | None:
    """Return whether the median flower moved, by the known peak accelerations (F,) [m/s2]; None if none is known."""
    known = np.asarray(acceleration, dtype=float)
    known = known[np.isfinite(known)]
    return bool(np.median(known) >= MOVED) if len(known) else None
