"""What makes a path the main stem, and a node part of an organ."""

from __future__ import annotations

from dataclasses import dataclass

from anther.checks import check_parameters, check_range


@dataclass(frozen=True, slots=True)
class Params:
    """What makes a path the main stem (paper P10, P11), and a node part of an organ.

    Attributes:
        tip: where the main stem ends [m], by who knows better; None: it is found.
        alpha: exponent of the mean radius in the path score S.
        v_bias: weight of verticality in S.
        turn: a step that turns from the growth axis by more than this is not stem-like [degrees].
        window: length over which a step is judged (share of the plant's size).
        broadest: nor is a step broader than the narrowest below it by more than this factor, and than most below it: a
            stem does not broaden upward, a leaf does after the neck at its base. Below the last limb it must be planar
            (`planar_blade`) as well, since leaves touch the stem.
        thinnest: nor one thinner than this share of the median radius so far.
        doubt: how much a length that is not stem-like counts against one that is.
        leaflet: a side line shorter than this, relative to the longest limb, is a leaflet (labelled plants, see
            docs/reports/real_plants.md: from 0.2 to 0.45 ever fewer stems end in a leaf, but simulated ones shorten).
        shortest: a shorter stem is not believed (share of the plant's size).
        fork_share: a branch forks the stem when it is at least this share as thick as the stem beyond it and rises at
            least this share as high (docs/reports/skeletons.md: branches 0.65, 0.85 or more; petioles that thick rise
            0.48 or less),
        fork_angle: and on the whole leans from the vertical by less than this [degrees].
        planar_blade: where the skeleton's flatness (planarity of the surroundings) is this, blade is as likely as axis,
        planar_doubt: and where it is so much less, there is no doubt (both read off the development plants).
        flat_blade: without that, a section flatter than the main stem's by this factor is as likely blade; how flat a
            round stem looks tells what noise and one-sided views do to sections.
        narrow: a section as broad as the main stem tells nothing, one narrower by this factor leaves no doubt.
        stub: an axis that leaves another is leaf when it is shorter than this, relative to the stem's half width.
        truss_breadth: only a node not broader than this, relative to the stem, bears flowers: pedicels broaden a truss.
        flower_reach: and only when it is so near to the flower's centre [m]: a pedicel (9 to 22 mm; facts:
            pollination), a few millimetres of flower, and half the distance between nodes.
        leaf_per_flower: a limb is a truss when it bears more flowers than it has leaf, at so much length a flower [m].
        spur: a leaf that leaves the stem counts as attached when longer than this, relative to the stem's half width.
    """

    tip: tuple[float, float, float] | None = None
    alpha: float = 2.0
    v_bias: float = 1.0
    turn: float = 45.0
    window: float = 0.06
    broadest: float = 1.5
    thinnest: float = 0.35
    doubt: float = 2.0
    leaflet: float = 0.2
    shortest: float = 0.05
    fork_share: float = 0.6
    fork_angle: float = 50.0
    planar_blade: float = 0.68
    planar_doubt: float = 0.25
    flat_blade: float = 1.5
    narrow: float = 4.0
    stub: float = 2.5
    truss_breadth: float = 4.0
    flower_reach: float = 0.03
    leaf_per_flower: float = 0.02
    spur: float = 3.0

    def __post_init__(self) -> None:
        check_parameters(self, places=("tip",))
        check_range("turn", self.turn, 1, 180, "degrees")
        check_range("window", self.window, 1e-3, 1)
        check_range("shortest", self.shortest, 0, 1)
        check_range("fork_angle", self.fork_angle, 0, 180, "degrees")
        check_range("planar_doubt", self.planar_doubt, 1e-3, 1)
        for name in ("flat_blade", "narrow"):
            check_range(name, getattr(self, name), 1.01, 1e3)
