"""What the history keeps, as plain records: a trial with its grasp, shake and flowers, and an outcome. SI units."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from anther.core.checks import check_array, check_range
from anther.core.errors import bad_input
from anther.core.files import read_object, understood
from anther.core.geometry import Array
from anther.plant.model import Material

MOTIONS = {
    "predicted_amplitude": "predicted_amplitude_m",
    "measured_amplitude": "measured_amplitude_m",
    "measured_amplitude_std": "measured_amplitude_std_m",
    "predicted_acceleration": "predicted_acceleration_ms2",
    "measured_acceleration": "measured_acceleration_ms2",
}
"""What is kept of every flower, NaN where unknown -> its column in tables."""


Result = Literal["pollinated", "held", "failed"]
"""What became of a visit: held, unharmed and its flowers moved; held and unharmed only; neither."""


def result_of(held_unharmed: bool, flowers_moved: bool | None) -> Result:
    """Return the result of a visit. `flowers_moved` is None where no flower was measured."""
    if not held_unharmed:
        return "failed"
    return "pollinated" if flowers_moved else "held"


def result_words(held_unharmed: bool, flowers_moved: bool | None, failure: str | None) -> str:
    """Return the result of a visit in a few words, the same in the terminal, the report and the pages."""
    match result_of(held_unharmed, flowers_moved):
        case "failed":
            return f"failed: {(failure or 'not held, or harmed').replace('_', ' ')}"
        case "held":
            return "held, flowers hardly moved" if flowers_moved is False else "held, flowers not measured"
        case result:
            return result


@dataclass(frozen=True, slots=True)
class GraspRecord:
    """Where the plant was held.

    Attributes:
        arc_length: along the main stem above its root [m].
        stem_diameter: as measured [m].
        confidence: probability that it is the main stem.
        organ: what the pads held, as judged afterwards.
        pose7: flange pose: x, y, z [m], quaternion x, y, z, w.
    """

    arc_length: float | None = None
    stem_diameter: float | None = None
    confidence: float | None = None
    organ: str | None = None
    pose7: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        _finite(self, "grasp", ("arc_length", "stem_diameter", "confidence"))
        _of_type(self, organ=str | None)
        if self.pose7 is not None:
            object.__setattr__(self, "pose7", _tuple("pose7", self.pose7, 7))


@dataclass(frozen=True, slots=True)
class ShakeRecord:
    """How it was shaken.

    Attributes:
        frequency: [Hz].
        amplitude: of the grip, half of peak to peak [m].
        duration: [s].
        waveform: e.g. "sine".
        direction: (3,) unit vector, world.
    """

    frequency: float
    amplitude: float
    duration: float | None = None
    waveform: str | None = None
    direction: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        _finite(self, "shake", ("frequency", "amplitude", "duration"))
        _of_type(self, waveform=str | None)
        if self.direction is not None:
            object.__setattr__(self, "direction", _tuple("shake direction", self.direction, 3))


@dataclass(frozen=True, slots=True, eq=False)
class TrialRecord:
    """One visit to a plant as the history keeps it. F flowers; the motions have F entries each or none.

    Attributes:
        species: "tomato", "pepper", or whatever the user calls the crop.
        plant: label of the plant: a row and number in the greenhouse, or the seed of a simulated one.
        held_unharmed: whether the plant was held through the shake and not harmed, however little its flowers moved.
        failure: kind of failure (`errors.FailureKind`), or None.
        grasp, shake: None where it never came to that.
        flowers_moved: whether they moved enough to be pollinated (`response.moved`); None if none was measured.
        predicted_amplitude, measured_amplitude, measured_amplitude_std: (F,) [m]; NaN where not measurable.
        predicted_acceleration, measured_acceleration: (F,) peaks [m/s2].
        believed: of the plant's material before the shake.
        material: what was believed of it afterwards. None if unknown.
        run: its run folder, or None.
        robot: which one visited; "" if it is not known.
        time: when it began, by the robot's clock. Plant, robot and time name a visit in every history it is in.
        id: the visit's number, given by the history; None before it is recorded.
    """

    species: str
    plant: str
    held_unharmed: bool
    failure: str | None = None
    grasp: GraspRecord | None = None
    shake: ShakeRecord | None = None
    flowers_moved: bool | None = None
    predicted_amplitude: tuple[float, ...] = ()
    measured_amplitude: tuple[float, ...] = ()
    measured_amplitude_std: tuple[float, ...] = ()
    predicted_acceleration: tuple[float, ...] = ()
    measured_acceleration: tuple[float, ...] = ()
    believed: Material | None = None
    material: Material | None = None
    run: str | None = None
    robot: str = ""
    time: datetime = field(default_factory=lambda: datetime.now(UTC))
    id: int | None = None

    def __post_init__(self) -> None:
        _labels(self.species, self.plant)
        _of_type(self, held_unharmed=bool, flowers_moved=bool | None, failure=str | None, run=str | None, robot=str)
        if len(self.robot) > 200:
            raise bad_input("robot", given=f"{len(self.robot)} characters", allowed="up to 200", do="Name it briefly.")
        if self.time.tzinfo is None:
            raise bad_input("trial time", given="a time without zone", allowed="a time with zone", do="Use UTC.")
        counts = {len(getattr(self, name)) for name in MOTIONS} - {0}
        if len(counts) > 1:
            raise bad_input("flowers", given=f"motions of {sorted(counts)} flowers", allowed="one number", do="Check.")

    @property
    def result(self) -> Result:
        """What became of the visit."""
        return result_of(self.held_unharmed, self.flowers_moved)

    @property
    def result_words(self) -> str:
        """The result in a few words."""
        return result_words(self.held_unharmed, self.flowers_moved, self.failure)

    @property
    def flowers(self) -> int:
        """How many flowers were predicted or measured."""
        return max(len(getattr(self, name)) for name in MOTIONS)

    @property
    def measured(self) -> bool:
        """Whether any flower's motion was measured."""
        return any(np.isfinite(self.measured_amplitude))

    @property
    def taught(self) -> bool:
        """Whether it taught anything: a flower was measured, or seen to move less than could be measured."""
        return self.material is not None and (self.measured or self.material != (self.believed or self.material))

    def motions(self) -> dict[str, tuple[float, ...]]:
        """Return name of `MOTIONS` -> (F,) values, NaN where unknown."""
        return {name: getattr(self, name) or (float("nan"),) * self.flowers for name in MOTIONS}

    def accelerations(self) -> Array | None:
        """Return each flower's peak acceleration (F,) [m/s2], as measured, else as predicted; None if it is not known.

        A visit whose shake never began gave nothing; one that failed and was not measured may have given anything.
        """
        if self.shake is None or not (self.held_unharmed or self.measured):
            return None
        motions = {name: np.array(values) for name, values in self.motions().items()}
        square = (2 * np.pi * self.shake.frequency) ** 2
        best = np.full(self.flowers, np.nan)
        for kind in ("measured", "predicted"):
            for values in (motions[f"{kind}_acceleration"], square * motions[f"{kind}_amplitude"]):
                best = np.where(np.isfinite(best), best, values)
        known = best[np.isfinite(best)]
        return known if len(known) else None

    def plain(self) -> dict[str, Any]:
        """Return the record as JSON can hold it; `TrialRecord.of` reads it back."""
        return {**asdict(self), "time": self.time.isoformat()}

    @staticmethod
    def of(plain: dict[str, Any]) -> TrialRecord:
        """Read `plain` back."""
        with understood("record of a trial", "what a trial wrote"):
            values: dict[str, Any] = dict(plain) | {name: numbers(plain.get(name) or ()) for name in MOTIONS}
            values["time"] = datetime.fromisoformat(plain["time"])
            for name, kind in (("grasp", GraspRecord), ("shake", ShakeRecord)):
                values[name] = None if plain.get(name) is None else kind(**plain[name])
            for name in ("believed", "material"):
                values[name] = material_of(plain.get(name))
            return TrialRecord(**values)


def read_record(path: Path) -> TrialRecord:
    """Read a visit.json."""
    with understood(path):
        return TrialRecord.of(read_object(path))


@dataclass(frozen=True, slots=True)
class Outcome:
    """Fruit set, counted later by the grower.

    Attributes:
        species, plant: as in the trials.
        flowers: flowers that were open when the plant was visited, and could have set.
        fruit: how many of them did.
        date: of the count.
        visit: the one visit it belongs to; None: all visits of the plant since its previous count.
        note: anything.
        recorded: when it was entered; of two counts of the same plant, visit and day, the later entered holds.
        id: given by the history.
    """

    species: str
    plant: str
    flowers: int
    fruit: int
    date: date
    visit: int | None = None
    note: str = ""
    recorded: datetime = field(default_factory=lambda: datetime.now(UTC))
    id: int | None = None

    def __post_init__(self) -> None:
        _labels(self.species, self.plant)
        _of_type(self, flowers=int, fruit=int, note=str)
        check_range("flowers", self.flowers, 1, 100_000)
        check_range("fruit", self.fruit, 0, self.flowers)


def material_of(values: dict[str, Any] | None) -> Material | None:
    """Return a stored material; what this version does not know of is left out."""
    known = {f.name for f in fields(Material)}
    return None if values is None else Material(**{name: v for name, v in values.items() if name in known})


def numbers(values: Any) -> tuple[float, ...]:
    """Return stored numbers; NaN where there is none."""
    return tuple(float("nan") if v is None else float(v) for v in values)


def _labels(species: str, plant: str) -> None:
    for name, value in (("species", species), ("plant", plant)):
        if not isinstance(value, str) or not 0 < len(value) <= 200:
            given = f"{len(value)} characters" if isinstance(value, str) else repr(value)[:40]
            raise bad_input(name, given=given, allowed="a text of 1 to 200 characters", do="Name it briefly.")


def _of_type(record: Any, **kinds: Any) -> None:
    """Refuse other types, which files and databases that were changed by hand can hold."""
    for name, kind in kinds.items():
        value = getattr(record, name)
        if not isinstance(value, kind):
            allowed = getattr(kind, "__name__", str(kind))
            raise bad_input(name, given=repr(value)[:40], allowed=allowed, do="Correct it.")


def _finite(record: Any, what: str, names: tuple[str, ...]) -> None:
    for name in names:
        value = getattr(record, name)
        if value is not None:
            object.__setattr__(record, name, check_range(f"{what} {name}", value, -1e9, 1e9))


def _tuple(name: str, values: Any, count: int) -> tuple[float, ...]:
    return tuple(check_array(name, values, (count,)).tolist())
