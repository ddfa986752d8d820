"""What a plant may be loaded with, what its flowers need, and the wind that loads it as much."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from anther.core.checks import check_range
from anther.core.choices import Crop as Crop  # noqa: PLC0414 - the door gives it
from anther.core.geometry import Array
from anther.core.records import Range, Record

GRAVITY = 9.81
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


@dataclass(frozen=True, slots=True)
class PlantLimits(Record):
    """What a plant may be loaded with by a shake.

    No elastic limit of a tomato or pepper organ was ever measured (facts: pollination 6). A breeze of 4 m/s gives the
    same plants 0.4 to 1.7 % in their pedicels and adds 3 g at the bases of their leaves, and field plants endure it; a
    pedicel is probably elastic up to 1-3 %.

    Attributes:
        stem_strain: largest bending strain of the main stem [-].
        pedicel_strain: of pedicels [-].
        base_strain: of the bases of branches, petioles and peduncles on the main stem [-].
        leaf_load: largest torque at a leaf's base that a shake of up to `GUSTS` adds, in units of what 1 m/s2 gives
            [m/s2].
    """

    stem_strain: Annotated[float, Range(1e-9, 1)] = 0.01
    pedicel_strain: Annotated[float, Range(1e-9, 1)] = 0.01
    base_strain: Annotated[float, Range(1e-9, 1)] = 0.01
    leaf_load: Annotated[float, Range(1e-9, 1e4, "m/s2")] = 2.0 * GRAVITY

    def at(self, frequencies: ArrayLike) -> dict[str, float | Array]:
        """Return by kind (`PEAKS`) the limit at frequencies [Hz]; leaves' have their shape, infinite above `GUSTS`."""
        leaf = np.where(np.asarray(frequencies, dtype=np.float64) > GUSTS, np.inf, self.leaf_load)
        return dict(zip(PEAKS, (self.stem_strain, self.pedicel_strain, self.base_strain, leaf), strict=True))


PRESETS = {
    "gentle": PlantLimits(0.005, 0.005, 0.005, 0.7 * GRAVITY),
    "default": PlantLimits(),
    "bold": PlantLimits(0.01, 0.02, 0.02, 3.0 * GRAVITY),
}
"""Starting limits by name; a judgement (facts: pollination 6)."""
FLOWERS = "flower acceleration [m/s2]"
WIND = np.array([2.0, 4.0, 6.0])
"""Local wind about the plant [m/s]."""
BREEZE: dict[str, dict[Crop, Array]] = {
    FLOWERS: {"tomato": np.array([5.0, 20.5, 46.5]), "pepper": np.array([2.5, 12.5, 28.5])},
    PEAKS["joint_strain"]: {"tomato": np.array([0.00325, 0.013, 0.0285]), "pepper": np.array([0.002, 0.008, 0.018])},
    PEAKS["leaf_load"]: {
        "tomato": GRAVITY * np.array([0.85, 3.35, 7.5]),
        "pepper": GRAVITY * np.array([0.7, 2.9, 6.5]),
    },
}
"""Name of a limit -> its load in a wind of `WIND`: the peak of flowers, the pedicel that is bent most, the load of leaf
bases in a gust. Middles of the ranges in facts: pollination 6, computed by us on simulated tomatoes 10-13 and
peppers 10-12 (true rods, canopy drag of Sase 2012, turbulence 35 %, peak = mean + 3.5 rms, linear: above 2 m/s too
much). The main stem and the bases of branches were not computed."""


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
