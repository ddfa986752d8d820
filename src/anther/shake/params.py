"""Parameters of the shake planner: what to look for, and what must not be passed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from anther.checks import check_range
from anther.errors import bad_input
from anther.geometry import Array
from anther.shake.pads import PADS, Pads
from anther.shake.plant_limits import DEFAULT, FAST, PRESETS, PlantLimits

FLOWER_SPREAD = 0.65
"""Standard deviation of ln(true over modelled amplitude) of a flower about its plant's mean, measured by us on 16
simulated plants at 5 and 10 Hz (docs/reports/identification.md): how far one flower differs from its plant whatever
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

FAST_LOAD_ERROR = LOAD_ERROR | {"joint_strain": (0.4, 0.8), "base_strain": (0.9, 0.95)}
"""The same from `RINGING` on: 24 plants (seeds 500-511), two grips, 17 to 38 Hz (docs/reports/loads.md)."""

RINGING = 20.5
"""From `FAST` up to here single pedicels ring [Hz], and errors blend: on 61 plants pedicels err at 14 to 15 Hz as at
slower tones, at 20 Hz as at faster ones (docs/reports/loads.md)."""

MOST_DURATION = 5.0
"""Of a visit [s]."""

Objective = Literal["acceleration", "amplitude"]


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


@dataclass(frozen=True, slots=True)
class Params:
    """What to look for and what must not be passed.

    The plant's limits are a judgement (facts: pollination 6); no measured abscission acceleration exists.

    Attributes:
        objective: "acceleration": of the flowers, see `choice.ROBUST`; "amplitude": their mean amplitude, as in the
            paper.
        lowest, highest: frequencies searched [Hz]; None: the actuator's band.
        frequencies: how many, evenly on a logarithmic scale.
        directions: how many, over half a turn of the horizontal plane.
        heights: grip heights of the response map, beside the grasps.
        draws: scenarios drawn from the material's spread, beside the best guess.
        risk: share of shakes in which a load of the plant may pass its limit [-], one in forty: the one margin against
            what the model gets wrong. A load is taken as lognormal; scenarios and `LOAD_ERROR` say where and how wide.
        least_amplitude: of the grip [m]; None: what the actuator can be trusted with.
        most_amplitude: of the grip [m].
        plant: what the plant may be loaded with, see `PRESETS`.
        keeps_limits: whether `plant` is kept and slip prevented; if not, only the machine bounds a shake, and the table
            of limits tells how far they are passed.
        least_press: with which the pads press at least, if the stem bears it [N]. On 24 sides of peppers 10-15 and
            30-35 gentle pads that met a petiole beside the stem held that instead: one at 2 N, none from 4 N on.
        pads: what is believed of how far they give.
        pad_friction: of a soft pad on a stem [-]; no source found, an estimate on the safe side.
        duration: of the shake [s]; longer at low frequency, to have five cycles, up to `MOST_DURATION`.
    """

    objective: Objective = "acceleration"
    lowest: float | None = None
    highest: float | None = None
    frequencies: int = 40
    directions: int = 8
    heights: int = 8
    draws: int = 6
    risk: float = 0.025
    least_amplitude: float | None = None
    most_amplitude: float = 0.03
    plant: PlantLimits = DEFAULT
    keeps_limits: bool = True
    least_press: float = 8.0
    pad_friction: float = 0.5
    pads: Pads = PADS
    duration: float = 3.0

    def __post_init__(self) -> None:
        if self.objective not in ("acceleration", "amplitude"):
            raise bad_input(
                "objective", given=f"'{self.objective}'", allowed="acceleration or amplitude", do="Choose one."
            )
        for name in ("lowest", "highest"):
            if getattr(self, name) is not None:
                check_range(f"{name} frequency", getattr(self, name), 0.05, 500, "Hz")
        if self.lowest is not None and self.highest is not None:
            check_range("highest frequency", self.highest, self.lowest, 500, "Hz")
        check_range("number of frequencies", self.frequencies, 1, 2000)
        check_range("number of directions", self.directions, 1, 360)
        check_range("number of heights", self.heights, 0, 500)
        check_range("number of draws", self.draws, 0, 1000)
        check_range("risk", self.risk, 1e-6, 0.5)
        check_range("most_amplitude", self.most_amplitude, 1e-7, 1.0, "m")
        if self.least_amplitude is not None:
            check_range("least_amplitude", self.least_amplitude, 1e-7, self.most_amplitude, "m")
        for name in ("least_press", "pad_friction"):
            check_range(name, getattr(self, name), 1e-9, 1e6)
        check_range("duration", self.duration, 0.1, MOST_DURATION, "s")

    def held(self, press: float) -> float:
        """Return the pull that two pads hold against slip when each presses with `press` [N]."""
        return 2 * self.pad_friction * press


Preset = Literal["gentle", "default", "bold", "paper"]
PAPER = {"lowest": 1.9, "highest": 1.9, "most_amplitude": 0.012, "keeps_limits": False}
"""The strongest of the paper's own shakes: 12 mm at 1.9 Hz, the end of its 4-12 mm and 0.7-1.9 Hz. It keeps no limit of
the plant."""


def with_preset(name: Preset, params: Params = Params()) -> Params:
    """Return the parameters of a preset: those of `PRESETS` say what the plant may bear, "paper" keeps no limit."""
    return replace(params, **PAPER) if name == "paper" else replace(params, plant=PRESETS[name])
