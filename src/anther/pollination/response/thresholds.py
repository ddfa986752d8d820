"""What finding and following flowers goes by."""

from __future__ import annotations

FEWEST_FRAMES = 8
"""Fewer tell no swing."""

SHIFT = 0.025
"""Farthest that the held plant may stand from where it was seen at rest [m]."""

DEPTH_GATE = 0.08
"""A flower is looked for this far before and behind where it was found at rest [m]; our choice."""

DEPTH_REACH = 0.025
"""What stands further than this from a flower's depth at rest is not its own [m]: more than a flower's width."""

LEAST_COVER = 0.12
"""A flower's own pixels must cover this share of its disc, or else it counts as hidden."""

SEEN_SHARE = 0.7
"""Of the frames in which a flower must be followed to be measured."""

RESIDUAL_PIXELS, RELATIVE_RESIDUAL = 0.75, 0.2
"""A track whose sideways deviation from a swing is larger than both the former [px] and the latter's share of the
amplitude jumps from petal to petal and counts as not measured."""

REACH = 0.012
"""Farthest that a flower may be, in the next frame, from where its last two places point to [m]."""

LIKENESS = 0.6
"""A patch is recognised where it differs from its first picture by less than this share of what the places around it
differ."""

OUTLIER = 4.0
"""Samples this many robust standard deviations off the fit are left out."""

SPREAD = 0.08
"""Relative standard deviation of an amplitude, beside `LEAST_SPREAD` and what the fit's residual tells: a flower turns
as it swings, so that what is seen of it moves a little more or less than its middle, and its depth is mixed with that
of what is beside it. Measured on twenty films of development plants."""

LEAST_SPREAD = 0.00015
"""Standard deviation of an amplitude that nothing falls below, see `SPREAD` [m]."""

OVERTONES, LARGE = 2, 8.0
"""Twice and three times the frequency of a shake up to `LARGE` [Hz] are looked for: of a flower that swings about its
pedicel the pull along it comes twice a period, and what is shaken at 5 Hz may ring at 10. Of one pepper (9917) at
5.2 Hz the second gave its seven flowers 0.2 to 2.6 times the acceleration that the first did, and pedicels bent twice
as far. With overtones 7 of 12 flowers were measured within 15 % (43 % of 81 without); from 8 to 14 Hz 1 of 6 (78 % of
23)."""


def overtones(hertz: float) -> int:
    """Return how many overtones of a shake are looked for; of faster ones swings are too small for any."""
    return OVERTONES if hertz <= LARGE else 0
