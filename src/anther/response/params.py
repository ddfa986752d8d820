"""Parameters of finding and following flowers."""

from __future__ import annotations

from dataclasses import dataclass

from anther.checks import check_parameters, check_range

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

LEAST_SPREAD = 0.00015
"""Standard deviation of an amplitude that nothing falls below, see `Params.spread` [m]."""


@dataclass(frozen=True, slots=True)
class Params:
    """How flowers are found and followed.

    Attributes:
        shift: farthest that the held plant may stand from where it was seen at rest [m].
        reach: farthest that a flower may be, in the next frame, from where its last two places point to [m].
        overlap: flowers closer than this many flower radii in the image may be mixed up.
        spread: relative standard deviation of an amplitude, beside `LEAST_SPREAD` and what the fit's residual tells: a
            flower turns as it swings, so that what is seen of it moves a little more or less than its middle, and its
            depth is mixed with that of what is beside it. Measured on twenty films of development plants.
        phase_error: of each flower, beside what the fit's residual tells [rad]; so that 98 % of the phases measured in
            films of development plants lay within two deviations.
        likeness: a patch is recognised where it differs from its first picture by less than this share of what the
            places around it differ.
        again: how often a flower is looked for anew along the swing that was found.
        near: within so many pixels of that swing.
        wide: a flower is first followed with what is around it, out to so many times its radius.
        outlier: samples this many robust standard deviations off the fit are left out.
    """

    shift: float = 0.025
    reach: float = 0.012
    overlap: float = 1.5
    spread: float = 0.08
    phase_error: float = 0.05
    likeness: float = 0.6
    again: int = 2
    near: int = 3
    wide: float = 2.0
    outlier: float = 4.0

    def __post_init__(self) -> None:
        check_parameters(self)
        for name in ("shift", "reach"):
            check_range(name, getattr(self, name), 1e-4, 1.0, "m")
        check_range("again", self.again, 0, 20)
        check_range("near", self.near, 0, 50, "px")
        check_range("wide", self.wide, 1, 10)
