"""Parameters of the shake planner: what to look for, what a plant may be loaded with, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from anther.checks import check_range
from anther.geometry import Array
from anther.shake.pads import PADS, Pads

GRAVITY = 9.81
FAST = 14.0
"""Up to here an arm's readings tell what its gripper does, and loads err as they do at slow tones [Hz]."""
RINGING = 20.5
"""From `FAST` up to here single pedicels ring [Hz], and errors blend: on 61 plants pedicels err at 14 to 15 Hz as at
slower tones, at 20 Hz as at faster ones (docs/reports/limits.md)."""
GUSTS = 5.0
"""Up to here a leaf's load counts [Hz]: what petioles bear in units of their leaf's weight was measured slowly, and
gusts that load them last a second (facts: pollination 2 and 6). Of faster shakes the strain of their bases counts,
which 1 g bends by 0.05 % (median of 24 simulated plants at 10-38 Hz; one in twenty by 0.2 % on tomatoes, 0.4 % on
peppers)."""

FLOWER_SPREAD = 0.65
"""Standard deviation of ln(true over modelled amplitude) of a flower about its plant's mean, measured by us on 16
simulated plants at 5 and 10 Hz (docs/reports/response.md): how far one flower differs from its plant whatever
material and gain."""

LOAD_ERROR = {
    "stem_strain": (0.8, 0.5),
    "joint_strain": (1.0, 1.1),
    "base_strain": (0.65, 0.9),
    "leaf_load": (1.3, 0.5),
    "grip_force": (0.5, 0.55),
}
"""True over modelled largest load of each kind, by its name in `search.Gains`: median, and standard deviation of ln
beside what scenarios explain. Measured by us on 85 simulated plants whose truth no stage believes
(docs/reports/wide_truth.md), three grips and 1-17 Hz; of leaves on 16 of them; of the force that friction bears in the
grip on 20 plants, tomatoes and peppers 3 and 40-48, 1.3-15 Hz."""

LOADS = tuple(LOAD_ERROR)

FAST_LOAD_ERROR = LOAD_ERROR | {"joint_strain": (0.4, 0.8), "base_strain": (0.9, 0.95)}
"""The same from `RINGING` on: 24 plants (seeds 500-511), two grips, 17 to 38 Hz (docs/reports/limits.md)."""

MOST_DURATION = 5.0
"""Of a visit [s]."""


def load_error(kind: str, frequencies: ArrayLike) -> tuple[Array, Array]:
    """Return median and spread of a kind of load, each of the shape of the frequencies [Hz]."""
    return blended(LOAD_ERROR[kind], FAST_LOAD_ERROR[kind], frequencies)


def fastness(frequencies: ArrayLike) -> Array:
    """Return 0 up to `FAST`, 1 from `RINGING` on, and between them as the logarithm of the frequencies [Hz] goes."""
    return np.clip(np.log(np.asarray(frequencies, dtype=np.float64) / FAST) / np.log(RINGING / FAST), 0, 1)


def blended(slow: tuple[float, float], fast: tuple[float, float], frequencies: ArrayLike) -> tuple[Array, Array]:
    """Return median and spread, each of the shape of the frequencies [Hz], between those of slow and of fast tones."""
    share = fastness(frequencies)
    return slow[0] * (fast[0] / slow[0]) ** share, slow[1] + (fast[1] - slow[1]) * share


PEAKS = {
    "stem_strain": "stem bending strain [-]",
    "joint_strain": "pedicel bending strain [-]",
    "base_strain": "branch-base strain [-]",
    "leaf_load": "leaf-base load [m/s2]",
}
"""The loads that a plant limits -> their names in the table of limits."""


@dataclass(frozen=True, slots=True)
class PlantLimits:
    """What a plant may be loaded with by a shake.

    No elastic limit of a tomato or pepper organ was ever measured (facts: pollination 6). A breeze of 4 m/s gives the
    same plants 0.4 to 1.7 % in their pedicels and adds 3 g at the bases of their leaves, and fields stand it; a pedicel
    is probably elastic up to 1-3 %.

    Attributes:
        stem_strain: largest bending strain of the main stem [-].
        pedicel_strain: of pedicels [-].
        base_strain: of the bases of branches, petioles and peduncles on the main stem [-].
        leaf_load: largest torque at a leaf's base that a shake of up to `GUSTS` adds, in units of what 1 m/s2 gives
            [m/s2].
    """

    stem_strain: float = 0.01
    pedicel_strain: float = 0.01
    base_strain: float = 0.01
    leaf_load: float = 2.0 * GRAVITY

    def __post_init__(self) -> None:
        for name in ("stem_strain", "pedicel_strain", "base_strain"):
            check_range(name, getattr(self, name), 1e-9, 1.0)
        check_range("leaf_load", self.leaf_load, 1e-9, 1e4, "m/s2")

    def at(self, frequencies: ArrayLike) -> dict[str, float | Array]:
        """Return by kind (`PEAKS`) the limit at frequencies [Hz]; leaves' have their shape, infinite above `GUSTS`."""
        leaf = np.where(np.asarray(frequencies, dtype=np.float64) > GUSTS, np.inf, self.leaf_load)
        return dict(zip(PEAKS, (self.stem_strain, self.pedicel_strain, self.base_strain, leaf), strict=True))


Preset = Literal["gentle", "default", "bold", "paper"]
PRESETS = {
    "gentle": PlantLimits(0.005, 0.005, 0.005, 0.7 * GRAVITY),
    "default": PlantLimits(),
    "bold": PlantLimits(0.01, 0.02, 0.02, 3.0 * GRAVITY),
}
"""Starting limits by name; a judgement (facts: pollination 6)."""
PAPER = {"lowest": 1.9, "highest": 1.9, "most_amplitude": 0.012, "keeps_limits": False}
"""The strongest of the paper's own shakes: 12 mm at 1.9 Hz, the end of its 4-12 mm and 0.7-1.9 Hz. It keeps no limit of
the plant."""


@dataclass(frozen=True, slots=True)
class Params:
    """What to look for and what must not be passed.

    Attributes:
        lowest, highest: frequencies searched [Hz]; None: the actuator's band.
        frequencies: how many, evenly on a logarithmic scale.
        risk: share of shakes in which a load of the plant may pass its limit [-], one in forty: the one margin against
            what the model gets wrong. A load is taken as lognormal; scenarios and `LOAD_ERROR` say where and how wide.
        least_amplitude: of the grip [m]; None: what the actuator can be trusted with.
        most_amplitude: of the grip [m].
        plant: what the plant may be loaded with, see `PRESETS`.
        keeps_limits: whether `plant` is kept and slip prevented; if not, only the machine bounds a shake, and the table
            of limits tells how far they are passed.
        pads: what is believed of how far they give.
        pad_friction: of a soft pad on a stem [-]; no source found, an estimate on the safe side.
        duration: of the shake [s]; longer at low frequency, to have five cycles, up to `MOST_DURATION`.
    """

    lowest: float | None = None
    highest: float | None = None
    frequencies: int = 40
    risk: float = 0.025
    least_amplitude: float | None = None
    most_amplitude: float = 0.03
    plant: PlantLimits = PRESETS["default"]
    keeps_limits: bool = True
    pad_friction: float = 0.5
    pads: Pads = PADS
    duration: float = 3.0

    def __post_init__(self) -> None:
        for name in ("lowest", "highest"):
            if getattr(self, name) is not None:
                check_range(f"{name} frequency", getattr(self, name), 0.05, 500, "Hz")
        if self.lowest is not None and self.highest is not None:
            check_range("highest frequency", self.highest, self.lowest, 500, "Hz")
        check_range("number of frequencies", self.frequencies, 1, 2000)
        check_range("risk", self.risk, 1e-6, 0.5)
        check_range("most_amplitude", self.most_amplitude, 1e-7, 1.0, "m")
        if self.least_amplitude is not None:
            check_range("least_amplitude", self.least_amplitude, 1e-7, self.most_amplitude, "m")
        check_range("pad_friction", self.pad_friction, 1e-9, 1e6)
        check_range("duration", self.duration, 0.1, MOST_DURATION, "s")

    def held(self, press: float) -> float:
        """Return the pull that two pads hold against slip when each presses with `press` [N]."""
        return 2 * self.pad_friction * press

    def lasts(self, frequency: float) -> float:
        """Return how long a shake goes on [s]."""
        return float(np.clip(5 / frequency, self.duration, MOST_DURATION))


def with_preset(name: Preset, params: Params = Params()) -> Params:
    """Return the parameters of a preset: those of `PRESETS` say what the plant may bear, "paper" keeps no limit."""
    return replace(params, **PAPER) if name == "paper" else replace(params, plant=PRESETS[name])


Crop = Literal["tomato", "pepper"]
FLOWERS = "flower acceleration [m/s2]"
WIND = np.array([2.0, 4.0, 6.0])
"""Local wind about the plant [m/s]."""
BREEZE: dict[str, dict[Crop, Array]] = {
    FLOWERS: {"tomato": np.array([5.0, 20.5, 46.5]), "pepper": np.array([2.5, 12.5, 28.5])},
    PEAKS["joint_strain"]: {"tomato": np.array([0.00325, 0.013, 0.0285]), "pepper": np.array([0.002, 0.008, 0.018])},
    PEAKS["leaf_load"]: {
        "tomato": GRAVITY * np.array([0.85, 3.35, 7.5]),
        "pepper": GRAVITY * np.array([0.7, 2.9, 6.5]),
    },
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
