"""The shake plan as a document: what to do, what it is expected to do, and why. F flowers, G heights, Q frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from anther.core.geometry import Array
from anther.core.records import Range, Record, Shape, Stored
from anther.pollination.decision import WorthCurve
from anther.pollination.grasp import Grasp
from anther.pollination.shake.pads import PADS, Pads

LimitRow = tuple[str, float, float, float]
"""(name, value, limit, share of the limit that is used)."""


@dataclass(frozen=True, slots=True, eq=False)
class ResponseMap(Record):
    """How the flowers answer, by grip height and frequency, in the best direction and within the limits.

    Means are over flowers and over the scenarios of the plant's material.

    Attributes:
        frequencies: (Q,) [Hz].
        arc_length: (G,) grip height along the stem, rising [m].
        acceleration: (G, Q) mean peak acceleration of the flowers at the largest allowed shake [m/s2]; 0 where that is
            below the least amplitude the arm can be trusted with.
        per_metre: (G, Q) mean flower amplitude over grip amplitude [m/m].
        amplitude: (G, Q) largest allowed grip amplitude [m].
    """

    CALLED = "map"
    frequencies: Annotated[Array, Shape("Q"), Range(unit="Hz")]
    arc_length: Annotated[Array, Shape("G"), Range(unit="m")]
    acceleration: Annotated[Array, Shape("G", "Q"), Range(unit="m/s2")]
    per_metre: Annotated[Array, Shape("G", "Q")]
    amplitude: Annotated[Array, Shape("G", "Q"), Range(unit="m")]


@dataclass(frozen=True, slots=True, eq=False)
class CandidateShakes(Record):
    """The frequencies and lines most worth trying at the plan's grip; the plan's own come first. K tones, D lines.

    Attributes:
        frequencies: (K,) [Hz].
        directions: (D, 3) unit, world: lines across the stem, in turn over half a circle; or the plan's own alone.
        amplitudes: (K, D) of the grip, that all limits allow by the model [m].
        reach: (K, D) that the actuator manages [m].
    """

    CALLED = "tones"
    frequencies: Annotated[Array, Shape("K"), Range(unit="Hz")]
    directions: Annotated[Array, Shape("D", 3)]
    amplitudes: Annotated[Array, Shape("K", "D"), Range(unit="m")]
    reach: Annotated[Array, Shape("K", "D"), Range(unit="m")]

    @property
    def probed(self) -> tuple[int, ...]:
        """The lines of which a shake along any other is a sum: the plan's own, and the one most nearly across it."""
        across = np.abs(self.directions @ self.directions[0])
        return (0,) if len(across) == 1 else (0, int(across.argmin()))

    def parts(self, line: int) -> Array:
        """Return how much of a shake along each of the probed lines one along a line is."""
        found = np.linalg.lstsq(self.directions[list(self.probed)].T, self.directions[line], rcond=None)[0]
        return np.asarray(found, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class RunnerUp(Record):
    """The best shake at another grasp or another frequency (a fifth away or more).

    Attributes:
        grasp_index: into the ranked grasps.
        frequency, amplitude: [Hz], [m].
        score: as `ShakePlan.score`.
    """

    grasp_index: int
    frequency: float
    amplitude: float
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class ShakePlan(Stored):
    """One shake: hold `grasp`, move it to and fro along `direction` in a sine, and what that does.

    Attributes:
        grasp_index: into the ranked grasps it was chosen from.
        grasp: the grasp itself.
        direction: (3,) unit vector, world.
        amplitude: half of peak to peak [m].
        frequency: [Hz].
        duration: of the whole motion, `anther.robot.swing.whole_shake` [s].
        press: how hard the pads are to press the stem [N].
        predicted_amplitude: (F,) of each flower in steady shaking, semi-major axis of its path, the median of what is
            expected [m].
        predicted_amplitude_interval: (F, 2) nine flowers in ten stay between, by what is believed of plant, model and
            actuator [m].
        predicted_acceleration: (F,) peak [m/s2].
        predicted_acceleration_interval: (F, 2) [m/s2].
        score: what it is worth, share of all pollen less what may be lost (`decision.Worth.net`).
        limits: (name, value, limit, share used) each; of the plant what is expected beside what nineteen organs of
            twenty bear.
        runner_up: the next best, or None.
        regret: measure of motion -> how much more another shake would be worth if that is what frees pollen.
        reason: why this one, for people.
        response_map, weighed: for the pictures.
        tones: other frequencies worth trying, for a shake that is watched.
        pads: what was believed of them.
        notes: what the stage wants the user to know.
    """

    KIND, SCHEMA, CALLED = "shake plan", 9, "shake"
    grasp_index: int
    grasp: Grasp
    direction: Annotated[Array, Shape(3)]
    amplitude: Annotated[float, Range(0, 1, "m")]
    frequency: Annotated[float, Range(1e-3, 1e4, "Hz")]
    duration: Annotated[float, Range(1e-3, 3600, "s")]
    press: Annotated[float, Range(0, 1000, "N")]
    predicted_amplitude: Annotated[Array, Shape("F"), Range(unit="m")]
    predicted_amplitude_interval: Annotated[Array, Shape("F", 2), Range(unit="m")]
    predicted_acceleration: Annotated[Array, Shape("F"), Range(unit="m/s2")]
    predicted_acceleration_interval: Annotated[Array, Shape("F", 2), Range(unit="m/s2")]
    score: float
    limits: tuple[LimitRow, ...]
    runner_up: RunnerUp | None
    regret: tuple[tuple[str, float], ...]
    reason: str
    response_map: ResponseMap
    tones: CandidateShakes
    pads: Pads = PADS
    weighed: WorthCurve | None = None
    notes: tuple[str, ...] = ()
