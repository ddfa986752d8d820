"""Parameters of the shake planner: what to look for, and what must not be passed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from anther.checks import check_range
from anther.errors import bad_input
from anther.vibration.pads import PADS, Pads
from anther.vibration.waveforms import SINE, Waveform

FLOWER_SPREAD = 0.65
"""Standard deviation of ln(true over modelled amplitude) of a flower about its plant's mean, measured by us on 16
simulated plants at 5 and 10 Hz (docs/identification.md): how far one flower differs from its plant whatever material
and gain."""

LOAD_SPREAD = {"stem_strain": 0.5, "joint_strain": 0.8, "base_strain": 0.7, "leaf_load": 0.6}
"""Standard deviation of ln(true over modelled) of the largest load of each kind, by its name in `search.Gains`, beside
what scenarios explain."""

RESONANT = 10.0
"""Up to this frequency [Hz] a resonant pedicel is strained in proportion to the grip's acceleration, beyond it to the
grip's speed: so the 98 % quantile of `Params.resonant_strain` is 0.45-0.56 % from 5 to 25 Hz (measured by us)."""


@dataclass(frozen=True, slots=True)
class Params:
    """What to look for and what must not be passed.

    The plant's limits are proposals, to be tuned (facts: pollination 1d); no measured abscission acceleration exists.

    Attributes:
        objective: "fruit_set": expected number of flowers that set; "amplitude": mean flower amplitude, as in the
            paper.
        unshaken: share of flowers that sets without a shake [-]: 30 % (Morandin 2001) to 66 % (Al-Attal 2003).
        gain: of the others, the share that sets when all pollen is free [-]: 0.73-1 with bumblebees, 0.32 with a
            vibrator (the same sources). The choice of the shake depends on neither; they are the medians of the prior
            in `anther.fruit_set`, which `anther fruit-set` replaces by what counts teach.
        half_dose: acceleration that frees half of a flower's pollen [m/s2].
        release_time: in which a flower approaches what the acceleration can free [s]: yields of +71, +68 and +87 %
            after 1, 3 and 5 s (Ilbi & Boztok 1994; differences not significant) give 0.6.
        waveforms: that are compared: `WAVEFORMS` has a sine, two sweeps and a burst. Response and learning need one
            frequency, so only a sine by default.
        lowest, highest: frequencies searched [Hz]; None: the actuator's band.
        frequencies: how many, evenly on a logarithmic scale.
        directions: how many, over half a turn of the horizontal plane.
        heights: grip heights of the response map, beside the grasps.
        draws: scenarios drawn from the material's spread, beside the best guess.
        caution: quantile over the scenarios at which the plant's limits must hold [-].
        seed: of the draws.
        arm_share: share of the actuator's limit that is used [-].
        plant_share: share of the plant's limits that is used [-]: the best models of shaken plants err by some tens of
            per cent (facts: pollination 4), and passing a limit is worse than staying below it. At 0.7 two of twelve
            simulated plants passed theirs, by 10 and 14 %; at 0.6 one of forty, by 0.3 %, in a joint within a leaf, of
            which the plan knows the base only. The stem keeps the other half of its limit for what closing does to it.
        least_amplitude: of the grip [m]; None: what the actuator can be trusted with.
        most_amplitude: of the grip [m].
        most_speed: of the grip [m/s].
        stem_strain: largest bending strain of the main stem [-].
        joint_strain: of pedicels and of the joints at the branches' bases [-].
        resonant_strain: strain of a pedicel that is counted with whatever the model says, per acceleration of the grip
            [s2/m]. Where trusses resonate the model does not know: at 4-17 Hz its largest pedicel strain and the true
            one, over grips and directions of 26 simulated tomatoes seen in 10 views, correlated by -0.1 to 0.3, with a
            measure of the model's strain that was wrong at kinks. 98 % of the true ones are below this (with true rods
            0.41 % of tomatoes', 0.34 % of peppers': docs/limits.md), whatever is believed of the stiffness.
        leaf_load: largest torque at a leaf's base that the shake adds, in units of what 1 m/s2 gives [m/s2]: 0.7 g.
        grip_force: with which the pads press at least [N]: `execution.Params.hold`.
        pads: what is believed of how far they give.
        pad_friction: of a soft pad on a stem [-]; no source found, an estimate on the safe side.
        flower_acceleration: more than this is not useful [m/s2].
        duration: of the shake [s]; longer at low frequency, to have five cycles.
        most_duration: of a visit [s].
    """

    objective: Literal["fruit_set", "amplitude"] = "fruit_set"
    unshaken: float = 0.475
    gain: float = 0.75
    half_dose: float = 45.0
    release_time: float = 0.6
    waveforms: tuple[Waveform, ...] = (SINE,)
    lowest: float | None = None
    highest: float | None = None
    frequencies: int = 40
    directions: int = 8
    heights: int = 8
    draws: int = 6
    caution: float = 0.8
    seed: int = 0
    arm_share: float = 0.8
    plant_share: float = 0.5
    least_amplitude: float | None = None
    most_amplitude: float = 0.03
    most_speed: float = 0.3
    stem_strain: float = 0.01
    joint_strain: float = 0.005
    resonant_strain: float = 0.005
    leaf_load: float = 0.7 * 9.81
    grip_force: float = 8.0
    pad_friction: float = 0.5
    pads: Pads = PADS
    flower_acceleration: float = 200.0
    duration: float = 3.0
    most_duration: float = 5.0

    def __post_init__(self) -> None:
        if self.objective not in ("fruit_set", "amplitude"):
            raise bad_input(
                "objective", given=f"'{self.objective}'", allowed="fruit_set or amplitude", do="Choose one."
            )
        if not self.waveforms:
            raise bad_input("waveforms", given="none", allowed="one or more", do="Add a sine.")
        for name in ("lowest", "highest"):
            if getattr(self, name) is not None:
                check_range(f"{name} frequency", getattr(self, name), 0.05, 500, "Hz")
        if self.lowest is not None and self.highest is not None:
            check_range("highest frequency", self.highest, self.lowest, 500, "Hz")
        check_range("number of frequencies", self.frequencies, 1, 2000)
        check_range("number of directions", self.directions, 1, 360)
        check_range("number of heights", self.heights, 0, 500)
        check_range("number of draws", self.draws, 0, 1000)
        for name in ("caution", "unshaken", "gain"):
            check_range(name, getattr(self, name), 0, 1)
        check_range("resonant_strain", self.resonant_strain, 0, 1e3, "s2/m")
        for name in ("arm_share", "plant_share"):
            check_range(name, getattr(self, name), 0.01, 1)
        if self.least_amplitude is not None:
            check_range("least_amplitude", self.least_amplitude, 1e-7, self.most_amplitude, "m")
        for name in (
            "half_dose", "release_time", "most_speed", "stem_strain", "joint_strain", "leaf_load",
            "grip_force", "pad_friction",
        ):  # fmt: skip
            check_range(name, getattr(self, name), 1e-9, 1e6)
        check_range("most_duration", self.most_duration, 0.1, 60, "s")
        check_range("duration", self.duration, 0.1, self.most_duration, "s")


WAVEFORMS = (SINE, Waveform("sweep", ratio=1.25), Waveform("sweep", ratio=1.6), Waveform("burst", cycles=8))
"""Those worth comparing: a sine trusts one frequency, the others hedge against a resonance that is not where the plant
as believed has it."""
