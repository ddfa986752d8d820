"""Depth coverage: how much of a plant a depth camera measures, and how thin a stem it can measure from there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anther.perception.masks import LEAST_PIXELS


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
    enough = 0.6  # of the plant's pixels: simulated captures that perception reads well have 0.75
    if share >= enough and only_poor:
        return ""
    near = 0.3  # m: where a D405 and most modes of a D435 still measure (facts: perception, depth sensors)
    said, do = f"depth covers {share:.0%} of the plant's pixels", [f"come to {near:g} m if the camera measures there"]
    if len(measured):
        away = float(np.median(measured))
        window = 9  # px: a stereo camera reads about half of a part as wide as its matching window
        thinnest, closer = (1e3 * window * z / focal for z in (away, near))
        said += f"; at {away:.2f} m parts under {thinnest:.1f} mm are mostly lost"
        do = [f"{do[0]} ({closer:.1f} mm)"] if away > near else []
    do += ["hang a sheet close behind the plant", "choose a high-density preset", "take a D405"]
    return said if share >= enough else f"{said}: {', or '.join([', '.join(do[:-1]), do[-1]])}"
