"""A load of the plant as that of a breeze: what wind does to the same plants every day."""

from __future__ import annotations

from typing import Literal

import numpy as np

from anther.checks import check_range
from anther.geometry import Array
from anther.shake._verification import PEAKS

Crop = Literal["tomato", "pepper"]

WIND = np.array([2.0, 4.0, 6.0])
"""Local wind about the plant [m/s]."""

FLOWERS = "flower acceleration [m/s2]"

BREEZE: dict[str, dict[Crop, Array]] = {
    FLOWERS: {"tomato": np.array([5.0, 20.5, 46.5]), "pepper": np.array([2.5, 12.5, 28.5])},
    PEAKS[1]: {"tomato": np.array([0.00325, 0.013, 0.0285]), "pepper": np.array([0.002, 0.008, 0.018])},
    PEAKS[3]: {"tomato": 9.81 * np.array([0.85, 3.35, 7.5]), "pepper": 9.81 * np.array([0.7, 2.9, 6.5])},
}
"""Name of a limit -> its load in a wind of `WIND`: the peak of flowers, the pedicel that is bent most, the load of leaf
bases in a gust. Middles of the ranges in facts: pollination 6, computed by us on simulated tomatoes 10-13 and
peppers 10-12 (true rods, canopy drag of Sase 2012, turbulence 35 %, peak = mean + 3.5 rms, linear: above 2 m/s too
much). The main stem and the bases of branches were not computed."""


def breeze(name: str, load: float, crop: Crop) -> float | None:
    """Return the wind [m/s] that loads a plant as much, or None where nobody computed it.

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
