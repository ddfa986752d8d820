"""Depth coverage: how much of a plant a depth camera measures, and how thin a stem it can measure from there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.perception.masks import LEAST_PIXELS

ENOUGH = 0.6
"""Share of the plant's pixels with a reading below which advice is given: the one real frame of a shrub with thin parts
and nothing close behind has 0.53, simulated captures that perception reads well 0.75 (evaluation: thin_depth)."""
WINDOW = 9
"""A stereo camera reads about half of a part as wide as its matching window [px]; 12 in the real frame, 9 in the middle
of the simulated ones (evaluation: thin_depth)."""
NEAR = 0.3
"""Where a D405 and most modes of a D435 still measure [m] (facts: perception, depth sensors)."""


def describe_depth(depth: NDArray[Any], plant: NDArray[np.bool_], focal: float, *, only_poor: bool = False) -> str:
    """Return one sentence: the share of the plant with depth, the thinnest part that is measured, and what would help.

    Args:
        depth: (..., H, W) z-depth [m], 0 = no reading.
        plant: (..., H, W) the plant's pixels.
        focal: focal length [px].
        only_poor: say nothing of a plant of which enough is measured.

    Returns:
        "" where too few pixels show a plant, too.
    """
    readings = np.asarray(depth)[plant]
    if len(readings) < LEAST_PIXELS:
        return ""
    measured = readings[readings > 0]
    share = len(measured) / len(readings)
    if share >= ENOUGH and only_poor:
        return ""
    said, do = f"depth covers {share:.0%} of the plant's pixels", [f"come to {NEAR:g} m if the camera measures there"]
    if len(measured):
        away = float(np.median(measured))
        thinnest, closer = (1e3 * WINDOW * z / focal for z in (away, NEAR))
        said += f"; at {away:.2f} m parts under {thinnest:.1f} mm are mostly lost"
        do = [f"{do[0]} ({closer:.1f} mm)"] if away > NEAR else []
    do += ["hang a sheet close behind the plant", "choose a high-density preset", "take a D405"]
    return said if share >= ENOUGH else f"{said}: {', or '.join([', '.join(do[:-1]), do[-1]])}"
