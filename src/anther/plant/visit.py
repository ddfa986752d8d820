"""A visit of a robot to a plant: what was held, how it was shaken, how the flowers answered, and what came of it.

`trial.json`, the rows of the history and the tables for other programs are made from a `Visit` by one mapping, the
names and units of its fields (`anther.core.records.flat`). SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from anther.core.errors import bad_input
from anther.core.files import understood, write_json
from anther.core.geometry import Array
from anther.core.records import Flat, Range, Record, flat, read_tree, unflat
from anther.plant._material import Material

Result = Literal["pollinated", "held", "failed"]
"""What became of a visit: held, unharmed and its flowers moved; held and unharmed only; neither."""
Finite = Range(-1e9, 1e9)
Metres = Annotated[float, Range(-1e9, 1e9, "m")]
OfFlowers = Annotated[tuple[float, ...], Range(unit="m")]
"""One amplitude a flower; NaN where it is not known."""
Accelerations = Annotated[tuple[float, ...], Range(unit="m/s2")]
"""One acceleration a flower; NaN where it is not known."""
Acceleration = Annotated[float, Range(unit="m/s2")]


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
class GraspRecord(Record):
    """Where the plant was held.

    Attributes:
        arc_length: along the main stem above its root [m].
        stem_diameter: as measured [m].
        confidence: probability that it is the main stem.
        organ: what the pads held, as judged afterwards.
        pose7: flange pose: x, y, z [m], quaternion x, y, z, w.
    """

    CALLED = "grasp"
    arc_length: Metres | None = None
    stem_diameter: Metres | None = None
    confidence: Annotated[float, Finite] | None = None
    organ: str | None = None
    pose7: Annotated[tuple[float, ...], Finite] | None = None

    def _check(self) -> None:
        _numbers(self, "pose7", 7)


@dataclass(frozen=True, slots=True)
class ShakeRecord(Record):
    """How it was shaken, or was to be.

    Attributes:
        frequency: [Hz].
        amplitude: of the grip, half of peak to peak [m].
        duration: [s]; 0 if it was planned and never begun.
        waveform: e.g. "sine".
        direction: (3,) unit vector, world.
    """

    CALLED = "shake"
    frequency: Annotated[float, Range(-1e9, 1e9, "Hz")]
    amplitude: Metres
    duration: Annotated[float, Range(-1e9, 1e9, "s")] | None = None
    waveform: str | None = None
    direction: Annotated[tuple[float, ...], Finite] | None = None

    def _check(self) -> None:
        _numbers(self, "direction", 3)


@dataclass(frozen=True, slots=True)
class StepRecord(Record):
    """One step of a watched shake. F flowers, K frequencies.

    Attributes:
        begin, end: since the shake began [s].
        frequencies: (K,) [Hz].
        amplitudes: (K,) of the grip [m].
        flower_acceleration: (F,) peak that the side camera measured [m/s2]; NaN where it did not.
        share_of_limits: name of each limit of plant and grip -> share of it that was reached.
        decided: what comes next and why.
        deciding_seconds: that measuring and deciding took.
    """

    DERIVED: ClassVar = {
        "flower_acceleration_median_ms2": (float, lambda s: median(s.flower_acceleration)),
        "flower_acceleration_most_ms2": (
            float,
            lambda s: max(filter(np.isfinite, s.flower_acceleration), default=None),
        ),
    }
    begin: Annotated[float, Range(unit="s")]
    end: Annotated[float, Range(unit="s")]
    frequencies: Annotated[tuple[float, ...], Range(unit="Hz")]
    amplitudes: Annotated[tuple[float, ...], Range(unit="m")]
    flower_acceleration: Accelerations
    share_of_limits: dict[str, float]
    decided: str
    deciding_seconds: float

    @property
    def share_of_limit(self) -> float:
        """Largest share of a limit that was reached."""
        return max(self.share_of_limits.values(), default=0.0)

    @property
    def closest_limit(self) -> str:
        """The limit of which most was reached."""
        return max(self.share_of_limits, key=lambda name: self.share_of_limits[name], default="")


@dataclass(frozen=True, slots=True)
class GripRecord(Record):
    """What the gripper measured after closing: opening [m], force [N], and stress of the stem between the pads [Pa]."""

    opening: Annotated[float, Range(unit="m")]
    force: Annotated[float, Range(unit="N")]
    stem_stress: Annotated[float, Range(unit="Pa")]


@dataclass(frozen=True, slots=True)
class TruthRecord(Record):
    """The verdict of the simulator in numbers (docs/sim_cell.md); no real plant has one.

    Attributes:
        harm_probability: of a plant of which only the distribution of its tolerances is known.
        harmed: kinds of load that passed what this plant bears, by commas.
        true_flower_acceleration_peak: (F,) [m/s2].
        true_flower_acceleration_median, true_flower_acceleration_least: over the flowers [m/s2].
        share_above_5_ms2, share_above_10_ms2: share of the flowers whose acceleration passed it.
        pollen_freed_low, pollen_freed_median, pollen_freed_high: share of the pollen.
        true_flower_amplitude_median: [m].
        true_slip: of the stem between the pads [m].
        true_push_before_closing: largest force on the plant before the gripper closed [N].
        true_stem_strain, true_pedicel_strain, true_base_strain, true_leaf_acceleration: largest loads [-], [m/s2].
        borne_stem_strain, borne_pedicel_strain, borne_base_strain, borne_leaf_acceleration: what this plant bears.
        true_effort_share: largest share of a motor's torque limit.
        true_held_beside: other organs between the pads, by commas.
        flowers_lost: flowers on pedicels or peduncles that were bent further than this plant's bear.
    """

    harm_probability: float
    harmed: str
    true_flower_acceleration_peak: Accelerations
    true_flower_acceleration_median: Acceleration | None
    true_flower_acceleration_least: Acceleration | None
    share_above_5_ms2: float | None
    share_above_10_ms2: float | None
    pollen_freed_low: float
    pollen_freed_median: float
    pollen_freed_high: float
    true_flower_amplitude_median: Annotated[float, Range(unit="m")] | None
    true_slip: Annotated[float, Range(unit="m")]
    true_push_before_closing: Annotated[float, Range(unit="N")]
    true_stem_strain: float
    true_pedicel_strain: float
    true_base_strain: float
    true_leaf_acceleration: Acceleration
    borne_stem_strain: float
    borne_pedicel_strain: float
    borne_base_strain: float
    borne_leaf_acceleration: Acceleration
    true_effort_share: float
    true_held_beside: str
    flowers_lost: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Visit(Record):
    """One visit to a plant. F flowers; the motions have F entries each or none.

    The history keeps the fields up to `id` but `planned`; those after it are in the visit's trial.json alone.

    Attributes:
        species: "tomato", "pepper", or whatever the user calls the crop.
        plant: label of the plant: a row and number in the greenhouse, or the seed of a simulated one.
        held_unharmed: whether the plant was held through the shake and not harmed, however little its flowers moved.
        failure: kind of failure (`errors.FailureKind`), or None.
        grasp, shake: None where it never came to that; the shake as it was carried out.
        flowers_moved: whether they moved enough to be pollinated (`limits.moved`); None if none was measured.
        predicted_amplitude, measured_amplitude, measured_amplitude_std: (F,) [m]; NaN where not measurable.
        predicted_acceleration, measured_acceleration: (F,) peaks [m/s2]; measured after the shake or, where that could
            not be, at its last look; 0 where a flower was followed and moved less than can be told.
        believed: prior of the plant's material.
        material: its posterior. None if unknown.
        run: its run folder, or None.
        robot: which one visited; "" if it is not known.
        time: when it began, by the robot's clock. Plant, robot and time name a visit in every history it is in.
        id: the visit's number, given by the history; None before it is recorded.
        message: why it failed, or what was held.
        held, unharmed: the two parts of `held_unharmed`; of a real plant it is unknown whether it was harmed.
        planned: the shake before it was raised or lowered.
        execution: "finished", or why the shake stopped.
        plan_alone_because: why the plan alone was carried out; None where the shake was raised by what was seen.
        steps: of a shake that was watched.
        grip: what the gripper measured.
        pad_stiffness, pad_turning: posterior of the gripper's pads [N/m], [N m/rad].
        felt_flowers, felt_flower_acceleration_median: of a real plant, by the side camera [-], [m/s2].
        truth: of a simulated plant.
        material_source, material_reason: where the belief before the shake came from.
        simulated_as: of a simulated cell file, what was supposed.
        simulated_capture_seconds, simulated_execution_seconds: by the simulator's clock.
        seconds: stage -> time it took [s].
        log_messages, log_dropped, log_error: of log.mcap.
        parameters: what the run was asked for, with the versions.
    """

    KIND, SCHEMA = "visit", 1
    DERIVED: ClassVar = {
        "success": (bool, lambda v: v.success),
        "result": (str, lambda v: v.result),
        "acceleration_mean_ms2": (float, lambda v: v.acceleration_mean),
        "flowers": (int, lambda v: v.flowers),
        "flowers_measured": (int, lambda v: v.flowers_measured),
        "predicted_amplitude_median_m": (float, lambda v: median(v.predicted_amplitude)),
        "measured_amplitude_median_m": (float, lambda v: median(v.measured_amplitude)),
        "predicted_acceleration_median_ms2": (float, lambda v: median(v.predicted_acceleration)),
        "measured_acceleration_median_ms2": (float, lambda v: median(v.measured_acceleration)),
        "shake_steps": (int, lambda v: len(v.steps) if v.shaken else None),
        "step_flower_acceleration_median_ms2": (float, lambda v: v.last and median(v.last.flower_acceleration)),
        "step_share_of_limit": (float, lambda v: v.last and v.last.share_of_limit),
        "step_closest_limit": (str, lambda v: v.last and v.last.closest_limit),
        "shake_ended_by": (str, lambda v: v.ended_by),
    }
    species: str
    plant: str
    held_unharmed: bool
    failure: str | None = None
    grasp: Annotated[GraspRecord, Flat("grasp_")] | None = None
    shake: Annotated[ShakeRecord, Flat("shake_")] | None = None
    flowers_moved: bool | None = None
    predicted_amplitude: OfFlowers = ()
    measured_amplitude: OfFlowers = ()
    measured_amplitude_std: OfFlowers = ()
    predicted_acceleration: Accelerations = ()
    measured_acceleration: Accelerations = ()
    believed: Annotated[Material, Flat("material_before_")] | None = None
    material: Annotated[Material, Flat("material_after_")] | None = None
    run: str | None = None
    robot: str = ""
    time: datetime = field(default_factory=lambda: datetime.now(UTC))
    id: int | None = None
    message: str | None = None
    held: bool | None = None
    unharmed: bool | None = None
    planned: Annotated[ShakeRecord, Flat("planned_")] | None = None
    execution: str | None = None
    plan_alone_because: str | None = None
    steps: tuple[StepRecord, ...] = ()
    grip: Annotated[GripRecord, Flat("grip_")] | None = None
    pad_stiffness: Annotated[float, Range(unit="N/m")] | None = None
    pad_turning: Annotated[float, Range(unit="N m/rad")] | None = None
    felt_flowers: int | None = None
    felt_flower_acceleration_median: Acceleration | None = None
    truth: Annotated[TruthRecord, Flat()] | None = None
    material_source: str | None = None
    material_reason: str | None = None
    simulated_as: tuple[str, ...] = ()
    simulated_capture_seconds: float | None = None
    simulated_execution_seconds: float | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    log_messages: int = 0
    log_dropped: int = 0
    log_error: str | None = None
    parameters: dict[str, Any] = field(default_factory=dict)

    def _check(self) -> None:
        check_labels(self.species, self.plant)
        if len(self.robot) > 200:
            raise bad_input("robot", given=f"{len(self.robot)} characters", allowed="up to 200", do="Name it briefly.")
        if self.time.tzinfo is None:
            raise bad_input("time of a visit", given="a time without zone", allowed="a time with zone", do="Use UTC.")
        counts = {len(getattr(self, name)) for name in MOTIONS} - {0}
        if len(counts) > 1:
            raise bad_input("flowers", given=f"motions of {sorted(counts)} flowers", allowed="one number", do="Check.")

    @property
    def success(self) -> bool:
        """Held, not harmed as far as anybody knows, and its flowers moved; of a real plant: not seen to hardly move."""
        moved = bool(self.flowers_moved) if self.unharmed is not None else self.flowers_moved is not False
        return self.held_unharmed and moved

    @property
    def result(self) -> Result:
        """What became of the visit."""
        return result_of(self.held_unharmed, self.flowers_moved)

    @property
    def result_words(self) -> str:
        """The result in a few words."""
        return result_words(self.held_unharmed, self.flowers_moved, self.failure)

    @property
    def shaken(self) -> bool:
        """Whether the shake began; one that was planned and never begun gave the flowers nothing."""
        return self.shake is not None and self.shake.duration != 0

    @property
    def flowers(self) -> int:
        """How many flowers were predicted or measured."""
        return max(len(getattr(self, name)) for name in MOTIONS)

    @property
    def flowers_measured(self) -> int:
        """How many flowers' motion was measured."""
        return int(np.isfinite(self.measured_amplitude).sum())

    @property
    def taught(self) -> bool:
        """Whether it taught anything: a flower was measured, or seen to move less than could be measured."""
        learned = self.material != (self.believed or self.material)
        return self.material is not None and (self.flowers_measured > 0 or learned)

    @property
    def acceleration_mean(self) -> float | None:
        """Mean of `accelerations` [m/s2]."""
        known = self.accelerations()
        return None if known is None else float(known.mean())

    @property
    def last(self) -> StepRecord | None:
        """The last step of a watched shake."""
        return self.steps[-1] if self.steps else None

    @property
    def ended_by(self) -> str | None:
        """What the last two steps decided."""
        return " ".join(step.decided for step in self.steps[-2:]) if self.steps else None

    def motions(self) -> dict[str, tuple[float, ...]]:
        """Return name of `MOTIONS` -> (F,) values, NaN where unknown."""
        return {name: getattr(self, name) or (float("nan"),) * self.flowers for name in MOTIONS}

    def accelerations(self) -> Array | None:
        """Return each flower's peak acceleration (F,) [m/s2], as measured, else as predicted; None if it is not known.

        A visit whose shake never began gave nothing; one that failed and was not measured may have given anything.
        """
        if self.shake is None or not self.shaken or not (self.held_unharmed or self.flowers_measured):
            return None
        motions = {name: np.array(values) for name, values in self.motions().items()}
        square = (2 * np.pi * self.shake.frequency) ** 2
        best = np.full(self.flowers, np.nan)
        for kind in ("measured", "predicted"):
            for values in (motions[f"{kind}_acceleration"], square * motions[f"{kind}_amplitude"]):
                best = np.where(np.isfinite(best), best, values)
        known = best[np.isfinite(best)]
        return known if len(known) else None

    def flat(self) -> dict[str, Any]:
        """Return the visit as trial.json has it: flat but for the steps, units in the names, null where unknown."""
        return flat(self)

    @staticmethod
    def of(values: dict[str, Any]) -> Visit:
        """Return the visit of which `flat` made the values.

        Raises:
            InputError: a name is unknown, or a value cannot be.
        """
        with understood("record of a visit", "what a trial wrote"):
            return unflat(values, Visit)

    def save(self, path: Path | str) -> None:
        """Write trial.json."""
        write_json(path, {"kind": self.KIND, "schema": self.SCHEMA, **self.flat()})

    @staticmethod
    def load(path: Path | str) -> Visit:
        """Read a trial.json.

        Raises:
            InputError: missing, no visit, of another schema number, or with a value that cannot be.
        """
        with understood(path):
            return Visit.of(read_tree(path, Visit.KIND, Visit.SCHEMA))


MOTIONS = (
    "predicted_amplitude", "measured_amplitude", "measured_amplitude_std", "predicted_acceleration",
    "measured_acceleration",
)  # fmt: skip
"""Fields of a `Visit` that have one value a flower, NaN where unknown."""


def median(values: Any) -> float | None:
    """Return the median of what is finite; None if nothing is."""
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    return float(np.median(finite)) if len(finite) else None


def check_labels(species: str, plant: str) -> None:
    """Check the names of a crop and a plant.

    Raises:
        InputError: one is no text of 1 to 200 characters.
    """
    for name, value in (("species", species), ("plant", plant)):
        if not isinstance(value, str) or not 0 < len(value) <= 200:
            given = f"{len(value)} characters" if isinstance(value, str) else repr(value)[:40]
            raise bad_input(name, given=given, allowed="a text of 1 to 200 characters", do="Name it briefly.")


def _numbers(record: Any, name: str, count: int) -> None:
    """Make a field's numbers a tuple of `count` floats."""
    values = getattr(record, name)
    if values is not None and len(values) != count:
        given, allowed = f"{len(values)} numbers", f"{count} numbers"
        raise bad_input(f"{record.CALLED} {name}", given=given, allowed=allowed, do="Check them.")
    if values is not None:
        object.__setattr__(record, name, tuple(float(value) for value in values))
