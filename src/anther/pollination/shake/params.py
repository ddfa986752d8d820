"""Parameters of the shake planner: what to look for, and how sure a modelled load is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from anther.core.checks import check_range
from anther.core.choices import Preset
from anther.core.geometry import Array
from anther.core.records import Range, Record
from anther.plant.limits import PRESETS, PlantLimits
from anther.pollination.shake.pads import PADS, Pads

FAST = 14.0
"""Up to here an arm's readings tell what its gripper does, and loads err as they do at slow tones [Hz]."""
RINGING = 20.5
"""From `FAST` up to here single pedicels ring [Hz], and errors blend: on 61 plants pedicels err at 14 to 15 Hz as at
slower tones, at 20 Hz as at faster ones (docs/reports/limits.md)."""

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


PAPER = {"lowest": 1.9, "highest": 1.9, "most_amplitude": 0.012, "keeps_limits": False}
"""The strongest of the paper's own shakes: 12 mm at 1.9 Hz, the end of its 4-12 mm and 0.7-1.9 Hz. It keeps no limit of
the plant."""


@dataclass(frozen=True, slots=True)
class Params(Record):
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

    lowest: Annotated[float, Range(0.05, 500, "Hz")] | None = None
    highest: Annotated[float, Range(0.05, 500, "Hz")] | None = None
    frequencies: Annotated[int, Range(1, 2000)] = 40
    risk: Annotated[float, Range(1e-6, 0.5)] = 0.025
    least_amplitude: Annotated[float, Range(1e-7, 1, "m")] | None = None
    most_amplitude: Annotated[float, Range(1e-7, 1, "m")] = 0.03
    plant: PlantLimits = PRESETS["default"]
    keeps_limits: bool = True
    pad_friction: Annotated[float, Range(1e-9, 1e6)] = 0.5
    pads: Pads = PADS
    duration: Annotated[float, Range(0.1, MOST_DURATION, "s")] = 3.0

    def _check(self) -> None:
        if self.lowest is not None and self.highest is not None:
            check_range("highest frequency", self.highest, self.lowest, 500, "Hz")
        if self.least_amplitude is not None:
            check_range("least_amplitude", self.least_amplitude, 1e-7, self.most_amplitude, "m")

    def held(self, press: float) -> float:
        """Return the pull that two pads hold against slip when each presses with `press` [N]."""
        return 2 * self.pad_friction * press

    def lasts(self, frequency: float) -> float:
        """Return how long a shake goes on [s]."""
        return float(np.clip(5 / frequency, self.duration, MOST_DURATION))


def with_preset(name: Preset, params: Params = Params()) -> Params:
    """Return the parameters of a preset: those of `PRESETS` say what the plant may bear, "paper" keeps no limit."""
    return replace(params, **PAPER) if name == "paper" else replace(params, plant=PRESETS[name])
