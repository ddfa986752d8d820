"""Parameters of finding and following flowers."""

from __future__ import annotations

from dataclasses import dataclass

from anther.checks import check_parameters, check_range


@dataclass(frozen=True, slots=True)
class Params:
    """How flowers are found and followed.

    Attributes:
        depth_gate: a flower is looked for this far before and behind where it was found at rest [m].
        flower_radius: of a flower [m].
        shift: farthest that the held plant may stand from where it was seen at rest [m].
        reach: farthest that a flower may be, in the next frame, from where its last two places point to [m].
        depth_reach: what stands further than this from a flower's depth at rest is not its own [m].
        own_depth: nor are readings further from it than this counted when its depth is measured [m].
        depth_share: of the frames in which depth must be sure; else only the sideways motion is measured.
        least_cover: a flower's own pixels must cover this share of its disc, or else it counts as hidden.
        overlap: flowers closer than this many flower radii in the image may be mixed up.
        crowd: flowers closer than this many are looked for where they should be, not where the petals' middle is.
        least_spread, spread: standard deviation of an amplitude beside what the fit's residual tells [m], and relative:
            a flower turns as it swings, so that what is seen of it moves a little more or less than its middle, and
            its depth is mixed with that of what is beside it. Measured on twenty films of development plants.
        member_spread: the latter, for flowers that may be mixed up.
        depthless: standard deviation of the whole amplitude relative to its sideways part, where depth is not sure.
        phase_error: of each flower, beside what the fit's residual tells [rad]; so that 98 % of the phases measured in
            films of development plants lay within two deviations.
        likeness: a patch is recognised where it differs from its first picture by less than this share of what the
            places around it differ.
        own_likeness: the same for the flower without its surroundings: what differs more is partly hidden.
        again: how often a flower is looked for anew along the swing that was found.
        near: within so many pixels of that swing.
        wide: a flower is first followed with what is around it, out to so many times its radius.
        seen_share: of the frames in which a flower must be followed to be measured.
        residual_pixels, relative_residual: a track whose sideways deviation from a swing is larger than both the former
            [px] and the latter's share of the amplitude jumps from petal to petal and counts as not measured.
        least_error, relative_error: an amplitude whose standard deviation is larger than both the former [m] and the
            latter's share of it counts as not measured.
        least_pixels: swings smaller than this in the image are not measured [px].
        significance: nor are those smaller than this many standard deviations.
        outlier: samples this many robust standard deviations off the fit are left out.
    """

    depth_gate: float = 0.08
    flower_radius: float = 0.007
    shift: float = 0.025
    reach: float = 0.012
    depth_reach: float = 0.025
    own_depth: float = 0.02
    depth_share: float = 0.8
    least_cover: float = 0.12
    overlap: float = 1.5
    crowd: float = 2.0
    least_spread: float = 0.00015
    spread: float = 0.08
    member_spread: float = 0.15
    depthless: float = 0.2
    phase_error: float = 0.05
    likeness: float = 0.6
    own_likeness: float = 0.4
    again: int = 2
    near: int = 3
    wide: float = 2.0
    seen_share: float = 0.7
    residual_pixels: float = 0.75
    relative_residual: float = 0.2
    least_error: float = 0.0003
    relative_error: float = 0.1
    least_pixels: float = 0.2
    significance: float = 3.0
    outlier: float = 4.0

    def __post_init__(self) -> None:
        check_parameters(self)
        for name in ("depth_gate", "flower_radius", "shift", "reach"):
            check_range(name, getattr(self, name), 1e-4, 1.0, "m")
        check_range("seen_share", self.seen_share, 0, 1)
        check_range("again", self.again, 0, 20)
        check_range("near", self.near, 0, 50, "px")
        check_range("wide", self.wide, 1, 10)
