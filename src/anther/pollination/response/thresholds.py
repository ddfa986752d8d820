"""Thresholds shared by the detection and tracking of flowers and stem."""

from __future__ import annotations

FEWEST_FRAMES = 8
"""Least number of frames for a fit of a swing."""

SHIFT = 0.025
"""Largest displacement of the held plant from its scanned position [m]."""

DEPTH_GATE = 0.08
"""Depth range of the search around a flower's scanned position [m]; a guess."""

DEPTH_REACH = 0.025
"""Largest depth difference between a flower and its own pixels [m]: more than a flower's width."""

SEEN_SHARE = 0.7
"""Least share of the frames in which a flower is tracked."""

REACH = 0.012
"""Search range around a flower's extrapolated position in the next frame [m]."""

LIKENESS = 0.6
"""Largest difference of a match from its template, relative to the median difference around it."""

OUTLIER = 4.0
"""Samples beyond this many robust standard deviations from the fit are outliers."""

SPREAD = 0.08
"""Relative standard deviation of an amplitude beyond `LEAST_SPREAD` and the fit's residual: a flower rotates as it
swings, and its depth mixes with its surroundings. Measured on films of simulated plants."""

LEAST_SPREAD = 0.00015
"""Least standard deviation of an amplitude, see `SPREAD` [m]."""


def most_residual(pixel: float, amplitude: float) -> float:
    """Return the sideways residual beyond which a track is rejected [m]: three quarters of a pixel [m], or a fifth of
    the amplitude [m]."""
    return max(0.75 * pixel, 0.2 * amplitude)


def overtones(hertz: float) -> int:
    """Return the number of overtones fitted to a shake.

    A pedicel is pulled twice a period and can excite a mode at twice the frequency. Above 8 Hz overtones make
    amplitudes less accurate (films of simulated plants).
    """
    return 2 if hertz <= 8.0 else 0
