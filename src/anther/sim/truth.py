"""What is true of a simulated trial and no stage knows: plant, air, pads, arm and camera, drawn wider than any belief.

No stage reads this file. Only leaf mass, pedicels and the pads' turning are centred near what a planner takes for
granted. `NOMINAL` is a plant and a robot without these doubts; `draw` draws all of them, or one group only, which shows
what that one assumption is worth.
`TOLERANCE` is what plants bear, `tolerances` what one of them does; `HALF_DOSE` and `DOSE_MEASURES` are what its
flowers ask for.
Sources are the facts (docs: facts) where they are named; what is called a guess has none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from anther.core.errors import bad_input


class Spread(NamedTuple):
    """A distribution: uniform from `low` to `high`, or uniform in the logarithm."""

    low: float
    high: float
    log: bool = True

    def draw(self, rng: np.random.Generator) -> float:
        """Return one value."""
        if self.log:
            return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        return float(rng.uniform(self.low, self.high))


def uniform(low: float, high: float) -> Spread:
    """Return a distribution that is flat from `low` to `high`."""
    return Spread(low, high, log=False)


class Lognormal(NamedTuple):
    """A lognormal distribution by its 5 % and its 95 % quantile."""

    low: float
    high: float

    @property
    def median(self) -> float:
        """Half lie below it."""
        return float(np.sqrt(self.low * self.high))

    @property
    def sigma(self) -> float:
        """Standard deviation of the logarithm."""
        return float(np.log(self.high / self.low) / (2 * 1.6448536))

    def draw(self, rng: np.random.Generator) -> float:
        """Return one value."""
        return float(self.median * np.exp(self.sigma * rng.standard_normal()))

    def share_below(self, value: ArrayLike) -> NDArray[Any]:
        """Return the probability that a draw is less than each value (...), which is not negative."""
        with np.errstate(divide="ignore"):
            return ndtr(np.log(np.asarray(value, dtype=float) / self.median) / self.sigma)


@dataclass(frozen=True, slots=True)
class Truth:
    """One plant and one robot as they are; the defaults are the nominal ones.

    Attributes:
        self_support: Young's modulus over that at which the plant would just buckle [-]; None: what the seed says, but
            at least 2.
        stiffness_gradient: ln of Young's modulus at the plant's top over that at its foot [-].
        branch_scatter: standard deviation of ln of each branch's own Young's modulus [-].
        wood_damping, leaf_damping, stalk_damping: damping ratios of stem and branches, of leaves, and of peduncles and
            pedicels [-]; None: one ratio for all, from the seed.
        bend_over_twist: EI/GJ [-].
        leaf_density: factor on the mass of leaf blades [-].
        oval: bending stiffness of a section across its wider over that across its narrower direction [-].
        pedicel_youngs, pedicel_length, flower_mass: factors [-].
        pedicel_joint: compliance of the abscission joint over that of its pedicel [-].
        drag_coefficient: of leaves and flowers, whose drag grows with the square of the speed [-].
        foot: stiffness with which root, soil and pot hold the stem's direction [N m/rad].
        wind: mean speed while the plant is seen and shaken [m/s].
        pad_stiffness, pad_rotation: of both pads together, across [N/m] and in rotation [N m/rad]; inf: only the skin
            of the contact gives way.
        pad_friction: between pad and plant [-].
        pad_wear: share of the friction that one of the pads has lost [-].
        servo_bandwidth: of the arm's joint servos [Hz].
        feedforward_error: standard deviation of each joint's relative error in the torque that the arm expects [-].
        joint_stiffness: factor on the arm's `stiffness` [-]; inf: rigid joints.
        joint_scatter: standard deviation of ln of each joint's own stiffness beside it [-].
        motor_gain: what the gripper's motor moves over what it was asked to [-].
        pose_error, hand_eye_error: factors on the errors of the poses that arm and cart tell, and of the hand-eye
            calibration [-].
        clock_offset: by which the side camera's clock is late on the arm's [s].
        exposure_time: in which an image is blurred by motion [s].
        exposure_spread: standard deviation of the gain from image to image [-].
        imu_scale: what the hand's accelerometer and gyroscope read over what is [-].
        imu_tilt: by which they are turned against where they are thought to be [rad].
        imu_noise: standard deviation of a reading: [m/s2], and a hundredth of it [rad/s].
    """

    self_support: float | None = None
    stiffness_gradient: float = 0.0
    branch_scatter: float = 0.0
    wood_damping: float | None = None
    leaf_damping: float | None = None
    stalk_damping: float | None = None
    bend_over_twist: float = 12.0
    leaf_density: float = 1.0
    oval: float = 1.0
    pedicel_youngs: float = 1.0
    pedicel_length: float = 1.0
    flower_mass: float = 1.0
    pedicel_joint: float = 0.0
    drag_coefficient: float = 0.0
    foot: float = np.inf
    wind: float = 0.0
    pad_stiffness: float = np.inf
    pad_rotation: float = np.inf
    pad_friction: float = 1.0
    pad_wear: float = 0.0
    servo_bandwidth: float = 10.0
    feedforward_error: float = 0.0
    joint_stiffness: float = np.inf
    joint_scatter: float = 0.0
    motor_gain: float = 1.0
    pose_error: float = 1.0
    hand_eye_error: float = 1.0
    clock_offset: float = 0.0
    exposure_time: float = 0.0
    exposure_spread: float = 0.05
    imu_scale: float = 1.0
    imu_tilt: float = 0.0
    imu_noise: float = 0.03


NOMINAL = Truth()

WIDE: dict[str, dict[str, Spread]] = {
    # Plants in pots stand, if barely: 1.1; 6 is a height margin of 1.8 over Greenhill's limit (height ~ E^(1/3)).
    "stiffness": {"self_support": Spread(1.1, 6.0)},
    # Wood lignifies from the foot upwards; broccoli's tissues differ by a factor of 3-15 (facts: pollination 2). Guess.
    "uniform stiffness": {
        "stiffness_gradient": Spread(-1.0, 0.3, log=False),
        "branch_scatter": Spread(0.1, 0.5, log=False),
    },
    # Trees' wood < 0.05, leaves double the whole (facts: pollination 2); branching dissipates 0.028 more.
    "damping by organ": {
        "wood_damping": Spread(0.015, 0.10),
        "leaf_damping": Spread(0.04, 0.25),
        "stalk_damping": Spread(0.015, 0.12),
    },
    # Dicot petioles 11.5-13.3, an isotropic round bar 1.5 (facts: pollination 2).
    "twist": {"bend_over_twist": Spread(3.0, 15.0)},
    # 0.25 kg/m2 is an estimate: 0.15-0.4.
    "leaf mass": {"leaf_density": Spread(0.6, 1.6)},
    # An ellipse with axes 1 : 1.26 has 1.6. Guess.
    "oval sections": {"oval": Spread(1.0, 1.6, log=False)},
    # E 30-250 MPa is assumed, lengths 9-22 mm measured, flowers of 0.05-0.15 g remembered (facts: pollination 2).
    "pedicels": {
        "pedicel_youngs": Spread(0.4, 2.5),
        "pedicel_length": Spread(0.75, 1.35),
        "flower_mass": Spread(0.5, 2.0),
        "pedicel_joint": Spread(0.0, 1.0, log=False),
    },
    # A canopy's leaves, which shelter each other, 0.31 (Sase 2012, facts: pollination 6); the spread is a guess.
    "drag": {"drag_coefficient": Spread(0.15, 0.6)},
    # A stem's own foot, 3 cm of it, has 1-15 N m/rad; a root ball in substrate is taken for softer to rigid. Guess.
    "pot": {"foot": Spread(3.0, 100.0)},
    # Still houses, fans, open vents; 2-4 m/s is an ordinary breeze outdoors (facts: pollination 6). A guess.
    "wind": {"wind": Spread(0.1, 1.5)},
    # 16 mm of soft silicone, 3-8 mm thick, by its shear modulus of 0.1-0.5 MPa. Guess.
    "pads": {
        "pad_stiffness": Spread(2e3, 3e4),
        "pad_rotation": Spread(0.1, 2.0),
        "pad_friction": Spread(0.4, 1.1, log=False),
        "pad_wear": Spread(0.0, 0.3, log=False),
    },
    # Published simulation gains give 4 Hz (facts: sawyer 2); loads unknown to the arm's model. A voice coil that is set
    # in volts, or calibrated by hand. Guess.
    "arm": {
        "servo_bandwidth": Spread(5.0, 12.0),
        "feedforward_error": Spread(0.05, 0.25, log=False),
        "joint_stiffness": Spread(6.0, 60.0),
        "motor_gain": Spread(0.87, 1.15),
        "joint_scatter": Spread(0.1, 0.4, log=False),
    },
    # Registration believes the nominal size of these errors.
    "camera poses": {"pose_error": Spread(0.5, 3.0), "hand_eye_error": Spread(0.5, 3.0)},
    # USB cameras stamp frames on arrival; 33 ms is the longest exposure at 30 frames a second.
    "camera clock and blur": {
        "clock_offset": Spread(0.0, 0.03, log=False),
        "exposure_time": Spread(0.002, 0.012),
        "exposure_spread": Spread(0.03, 0.2),
    },
    # A BMI055 as it comes, without its calibration, in a housing that was screwed on by hand; it has 150 ug/sqrt(Hz).
    # Guess.
    "inertial sensor": {
        "imu_scale": Spread(0.95, 1.05, log=False),
        "imu_tilt": Spread(0.0, 0.06, log=False),
        "imu_noise": Spread(0.01, 0.1),
    },
}
"""The groups of assumptions, and what is drawn in each."""


def draw(seed: int, *groups: str) -> Truth:
    """Return the truth of one trial: everything drawn, or only the named groups of `WIDE`, the rest nominal.

    A group has a random stream of its own: drawn alone it is what it is among all.

    Args:
        seed: of the plant.
        groups: names of `WIDE`; none means all.

    Raises:
        InputError: there is no such group.
    """
    unknown = sorted(set(groups) - set(WIDE))
    if unknown:
        raise bad_input("truth", given=f"'{unknown[0]}'", allowed=", ".join(WIDE), do="Name one of these groups.")
    values: dict[str, Any] = {}
    for number, (group, spreads) in enumerate(WIDE.items()):
        rng = np.random.default_rng([seed, 7, number])
        drawn = {name: spread.draw(rng) for name, spread in spreads.items()}
        values |= drawn if not groups or group in groups else {}
    return replace(NOMINAL, **values)


TOLERANCE: dict[str, Lognormal] = {
    # Fresh broccoli fails near 6-30 % (bending strength 6.9 MPa at 19-111 MPa; agriculture12101519); that lasting bends
    # begin at a quarter of it or less is a guess. Stem and branches, bending strain.
    "stem": Lognormal(0.015, 0.05),
    # No measurement: a judgement between what a breeze of 6 m/s does on the worst pedicels of a plant (1.4-3.7 %) and
    # rupture at 4-15 % (facts: pollination 6). Bending strain.
    "pedicel": Lognormal(0.01, 0.03),
    # A guess: between a pedicel and a stem. Petioles, peduncles, rachises and midribs, bending strain.
    "base": Lognormal(0.009, 0.04),
    # Petioles bear 1.7-2.9 times the leaf's weight (fpls.2021.765605), that is 0.7-1.9 g more, but plants stand breezes
    # that add 3 g: the weakest number here. Quasi-static acceleration at a leaf's base [m/s2].
    "leaf": Lognormal(1.2 * 9.81, 6 * 9.81),
}
"""What plants of either crop bear of each kind of load before something stays bent or falls: elastic limits, not
rupture (facts: pollination 6)."""

HALF_DOSE = Lognormal(5.0, 80.0)
"""Peak acceleration that frees half of a flower's pollen [m/s2], median 20: what still air, wind and bees set leaves
that wide (facts: pollination 6)."""
DOSE_EXPONENT = Spread(1.0, 2.0, log=False)
"""n of the share freed, a^n / (a^n + half^n) [-] (facts: pollination 6)."""


class Measure(NamedTuple):
    """A measure of motion that may free pollen: the peak acceleration times the frequency to a power."""

    power: int
    probability: float


DOSE_MEASURES = {"acceleration": Measure(0, 0.6), "jerk": Measure(1, 0.25), "velocity": Measure(-1, 0.15)}
"""No dose-response tells which it is. 5 m/s2 at 100 Hz raised tomato yield, which speaks for jerk and against velocity
(facts: limits 7). The probabilities are a judgement."""


def tolerances(species: str, seed: int) -> dict[str, float]:
    """Return what one plant bears of each kind of load of `TOLERANCE`, in its unit.

    The same plant from another side or with another truth of `draw` bears the same.

    Args:
        species: of the plant.
        seed: of the plant.
    """
    streams = (np.random.default_rng([seed, 8, number, *species.encode()]) for number in range(len(TOLERANCE)))
    return {kind: range_.draw(rng) for (kind, range_), rng in zip(TOLERANCE.items(), streams, strict=True)}
