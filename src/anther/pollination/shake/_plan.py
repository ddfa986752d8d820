"""The shake plan as a document: what to do, what it is expected to do, and why. F flowers, G heights, Q frequencies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from anther.core.checks import check_array, check_range
from anther.core.errors import bad_input
from anther.core.files import read_json, write_json
from anther.core.geometry import Array
from anther.pollination.grasp import Grasp, grasp_of, grasp_row
from anther.pollination.shake.pads import PADS, Pads

SCHEMA = 7
"""Of the files written."""

LimitRow = tuple[str, float, float, float]
"""(name, value, limit, share of the limit that is used)."""


def _to_arrays(record: ResponseMap | Tones | ShakePlan, what: str, shapes: dict[str, tuple[int, ...]]) -> None:
    """Check fields of a record, which is called so in errors, and make them read-only arrays."""
    for name, shape in shapes.items():
        told = f"{what}{name.replace('_', ' ')}"
        object.__setattr__(record, name, check_array(told, getattr(record, name), shape))


@dataclass(frozen=True, slots=True, eq=False)
class ResponseMap:
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

    frequencies: Array
    arc_length: Array
    acceleration: Array
    per_metre: Array
    amplitude: Array

    def __post_init__(self) -> None:
        q, g = len(self.frequencies), len(self.arc_length)
        shapes = {"frequencies": (q,), "arc_length": (g,)}
        _to_arrays(self, "map ", shapes | dict.fromkeys(("acceleration", "per_metre", "amplitude"), (g, q)))


@dataclass(frozen=True, slots=True, eq=False)
class Tones:
    """The frequencies and lines most worth trying at the plan's grip; the plan's own come first. K tones, D lines.

    Attributes:
        frequencies: (K,) [Hz].
        directions: (D, 3) unit, world: lines across the stem, in turn over half a circle; or the plan's own alone.
        amplitudes: (K, D) of the grip, that all limits allow by the model [m].
        reach: (K, D) that the actuator manages [m].
    """

    frequencies: Array
    directions: Array
    amplitudes: Array
    reach: Array

    def __post_init__(self) -> None:
        k, d = len(self.frequencies), len(self.directions)
        shapes = {"frequencies": (k,), "directions": (d, 3), "amplitudes": (k, d), "reach": (k, d)}
        _to_arrays(self, "tones ", shapes)

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
class RunnerUp:
    """The best shake at another grasp or another frequency (a fifth away or more).

    Attributes:
        grasp_index: into the ranked grasps.
        frequency, amplitude: [Hz], [m].
        score: as `ShakePlan.score`, perhaps not checked by the nonlinear solver.
    """

    grasp_index: int
    frequency: float
    amplitude: float
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class ShakePlan:
    """One shake: hold `grasp`, move it to and fro along `direction` in a sine, and what that does.

    Attributes:
        grasp_index: into the ranked grasps it was chosen from.
        grasp: the grasp itself.
        direction: (3,) unit vector, world.
        amplitude: half of peak to peak [m].
        frequency: [Hz].
        duration: of the whole motion, `anther.robot.swing.whole_shake` [s].
        press: how hard the pads are to press the stem [N].
        predicted_amplitude: (F,) of each flower in steady shaking, semi-major axis of its path [m].
        predicted_amplitude_interval: (F, 2) nine flowers in ten stay between, by the spreads of the material, of
            the gain, and of one flower about its plant [m].
        predicted_acceleration: (F,) peak [m/s2].
        predicted_acceleration_interval: (F, 2) [m/s2].
        score: by linear theory over the scenarios, what three flowers of four should feel [m/s2].
        limits: (name, value, limit, share used) each; values of the plant are those of the cautious scenario by linear
            theory, or of the plant as believed by the nonlinear solver where these are larger.
        runner_up: the next best, or None.
        reason: why this one, for people.
        response_map: for the picture.
        tones: other frequencies worth trying, for a shake that is watched.
        pads: what was believed of them.
        notes: what the stage wants the user to know.
    """

    grasp_index: int
    grasp: Grasp
    direction: Array
    amplitude: float
    frequency: float
    duration: float
    press: float
    predicted_amplitude: Array
    predicted_amplitude_interval: Array
    predicted_acceleration: Array
    predicted_acceleration_interval: Array
    score: float
    limits: Sequence[LimitRow]
    runner_up: RunnerUp | None
    reason: str
    response_map: ResponseMap
    tones: Tones
    pads: Pads = PADS
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        f = len(self.predicted_amplitude)
        shapes = {"direction": (3,), "predicted_amplitude": (f,), "predicted_acceleration": (f,)}
        _to_arrays(
            self, "", shapes | {"predicted_amplitude_interval": (f, 2), "predicted_acceleration_interval": (f, 2)}
        )
        check_range("shake amplitude", self.amplitude, 0, 1, "m")
        check_range("shake frequency", self.frequency, 1e-3, 1e4, "Hz")
        check_range("shake duration", self.duration, 1e-3, 3600, "s")
        check_range("pressing force", self.press, 0, 1000, "N")
        object.__setattr__(self, "limits", tuple((str(n), float(v), float(m), float(s)) for n, v, m, s in self.limits))
        object.__setattr__(self, "notes", tuple(self.notes))

    def save(self, path: Path | str) -> None:
        """Write JSON (kind 'shake plan')."""
        row = {name: getattr(self, name) for name in self.__dataclass_fields__}
        row |= {name: asdict(row[name]) for name in _PARTS if row[name] is not None}
        row["grasp"] = grasp_row(self.grasp)
        write_json(path, {"kind": "shake plan", "schema": SCHEMA} | row)

    @classmethod
    def load(cls, path: Path | str) -> ShakePlan:
        """Read what `save` wrote.

        Raises:
            InputError: missing, not JSON, or not a shake plan of this schema.
        """
        row = read_json(path)
        if not isinstance(row, dict) or (row.get("kind"), row.get("schema")) != ("shake plan", SCHEMA):
            raise bad_input(str(path), given="another file", allowed=f"a shake plan, schema {SCHEMA}", do="Plan again.")
        try:
            none = row["runner_up"] is None  # all others there must be
            row |= {name: part(**row[name]) for name, part in _PARTS.items() if not (none and name == "runner_up")}
            row["grasp"] = grasp_of(row["grasp"])
            return cls(**{name: row[name] for name in cls.__dataclass_fields__})
        except (KeyError, TypeError) as error:
            raise bad_input(
                str(path), given=f"a broken shake plan ({error!r})", allowed="what save wrote", do="Plan again."
            ) from error


_PARTS = {"runner_up": RunnerUp, "response_map": ResponseMap, "tones": Tones, "pads": Pads}
