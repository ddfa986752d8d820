"""The history as flat tables for other programs: CSV, or Parquet through pyarrow. Units are in the columns' names.

A history into another: what a robot kept while it was offline goes into the fleet's, once, whatever its clock says.

A visit is named by its plant, its robot and the time by that robot's own clock; times of different robots are never
compared. So a merge that was cut off is simply done again, and clocks that disagree neither double nor hide a visit.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from datetime import date, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from anther.errors import bad_input
from anther.formats.tables import write_table
from anther.history._database import DEFAULT, FruitSetRow, Note, Plant, Visit, reading, shown, writing
from anther.history._records import Outcome, TrialRecord
from anther.history._trials import BATCH, add, plant_of, trial_of, visit_of

_VISIT = {"visit": int, "time": datetime, "species": str, "plant": str}
TABLES: dict[str, dict[str, type]] = {
    "visits": {
        **_VISIT,
        "held_unharmed": bool,
        "failure": str,
        "run": str,
        "robot": str,
        "acceleration_mean_ms2": float,
        "grasp_arc_length_m": float,
        "grasp_stem_diameter_m": float,
        "grasp_confidence": float,
        "organ_grasped": str,
        "shake_frequency_hz": float,
        "shake_amplitude_m": float,
        "shake_duration_s": float,
        "flowers": int,
        "flowers_measured": int,
        "predicted_amplitude_median_m": float,
        "measured_amplitude_median_m": float,
        "youngs_before_pa": float,
        "youngs_after_pa": float,
        "youngs_spread_after": float,
        "damping_ratio_after": float,
        "damping_spread_after": float,
    },
    "flowers": {
        **_VISIT,
        "flower": int,
        "predicted_amplitude_m": float,
        "measured_amplitude_m": float,
        "measured_amplitude_std_m": float,
        "predicted_acceleration_ms2": float,
        "measured_acceleration_ms2": float,
    },
    "outcomes": {
        "outcome": int,
        "date": date,
        "species": str,
        "plant": str,
        "visit": int,
        "flowers": int,
        "fruit": int,
        "note": str,
    },
}
"""Table -> column -> type. "visits": one line a visit; "flowers": one a flower and visit; "outcomes": one a count."""


def export(path: Path, table: str, trials: Iterable[TrialRecord], outcomes: Iterable[Outcome]) -> int:
    """Write one of `TABLES` to a .csv or .parquet, whole or not at all, and return how many lines it has.

    The trials are taken one after another, so that an iterator of more than the memory holds is written as well.

    Raises:
        InputError: unknown table or suffix.
        MissingExtra: Parquet without pyarrow.
    """
    if table not in TABLES:
        raise bad_input("table", given=f"'{table}'", allowed=", ".join(TABLES), do="Choose one.")
    if table == "outcomes":
        lines: Iterator[dict[str, Any]] = ({**asdict(o), "outcome": o.id} for o in outcomes)
    elif table == "flowers":
        lines = (line for trial in trials for line in _flowers(trial))
    else:
        lines = (_visit(trial) for trial in trials)
    columns = TABLES[table]
    count = itertools.count()
    lines = ({name: _plain(line.get(name)) for name in columns} for line, _ in zip(lines, count, strict=False))
    write_table(path, columns, lines)
    return next(count)


def _visit(trial: TrialRecord) -> dict[str, Any]:
    grasp, shake, before, after = trial.grasp, trial.shake, trial.believed, trial.material
    line = _of(trial) | {
        "held_unharmed": trial.held_unharmed,
        "failure": trial.failure,
        "run": trial.run,
        "robot": trial.robot,
    }
    felt = trial.accelerations()
    line["acceleration_mean_ms2"] = None if felt is None else float(felt.mean())
    if grasp is not None:
        line |= {f"grasp_{name}_m": getattr(grasp, name) for name in ("arc_length", "stem_diameter")}
        line |= {"grasp_confidence": grasp.confidence, "organ_grasped": grasp.organ}
    if shake is not None:
        line |= {"shake_frequency_hz": shake.frequency, "shake_amplitude_m": shake.amplitude}
        line["shake_duration_s"] = shake.duration
    if after is not None:
        line |= {f"{name}_after": getattr(after, name) for name in ("youngs_spread", "damping_ratio", "damping_spread")}
        line["youngs_after_pa"] = after.youngs
    return line | {
        "flowers": trial.flowers,
        "flowers_measured": int(np.isfinite(trial.measured_amplitude).sum()),
        "predicted_amplitude_median_m": _median(trial.predicted_amplitude),
        "measured_amplitude_median_m": _median(trial.measured_amplitude),
        "youngs_before_pa": None if before is None else before.youngs,
    }


def _flowers(trial: TrialRecord) -> list[dict[str, Any]]:
    motions = trial.motions()
    unit = {name: "ms2" if name.endswith("acceleration") else "m" for name in motions}
    return [
        {**_of(trial), "flower": k, **{f"{name}_{unit[name]}": values[k] for name, values in motions.items()}}
        for k in range(trial.flowers)
    ]


def _of(trial: TrialRecord) -> dict[str, Any]:
    return {"visit": trial.id, "time": trial.time, "species": trial.species, "plant": trial.plant}


def _median(values: Sequence[float]) -> float | None:
    finite = np.array(values)[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else None


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value


class Merged(NamedTuple):
    """How many visits, counts and notes were new, and how many were there already."""

    new: int
    known: int


def merge(source: Path | str, where: Path | str = DEFAULT) -> Merged:
    """Take the visits, counts of fruit set and notes of another history into this one.

    Args:
        source: the history to take from; nothing of it changes, but for its schema's version.
        where: the history to add to.

    Raises:
        InputError: one of them is no history, cannot be read, or cannot be written. What was taken until then stays.
    """
    with reading(source) as session:
        if session is None:
            given = f"{shown(source)}, which is not there"
            raise bad_input("history to merge", given=given, allowed="a history", do="Check the path.")
    new = total = 0
    for batch in _visits(source):
        with writing(where) as session:
            # in the order of plants, so that two merges at once lock them in the same order
            ordered = sorted(batch, key=lambda record: (record.species, record.plant, record.time))
            new += sum(add(session, record)[1] for record in ordered)
        total += len(batch)
    with reading(source) as here, writing(where) as there:
        assert here is not None
        for added in (*_counts(here, there), *_notes(here, there)):
            new, total = new + added, total + 1
    return Merged(new, total - new)


def _visits(source: Path | str) -> Iterator[Sequence[TrialRecord]]:
    last = 0
    while True:
        with reading(source) as session:
            rows = session.scalars(select(Visit).where(Visit.id > last).order_by(Visit.id).limit(BATCH)).all()  # type: ignore[union-attr]
            batch = [trial_of(row) for row in rows]
        if not batch:
            return
        yield batch
        last = rows[-1].id


def _counts(here: Session, there: Session) -> Iterator[bool]:
    """Add each count that is not there; yield whether it was new."""
    query = select(FruitSetRow).join(FruitSetRow.plant).order_by(Plant.species, Plant.label, FruitSetRow.id)
    for count in here.scalars(query):
        plant = plant_of(there, count.plant.species, count.plant.label).id
        same = select(FruitSetRow.id).where(FruitSetRow.plant_id == plant, FruitSetRow.recorded == count.recorded)
        new = there.scalar(same) is None
        if new:
            visit = None if count.visit_id is None else _number(here, there, count.visit_id)
            values = {name: getattr(count, name) for name in ("date", "flowers", "fruit", "note", "recorded")}
            there.add(FruitSetRow(plant_id=plant, visit_id=visit, **values))
        yield new


def _notes(here: Session, there: Session) -> Iterator[bool]:
    for note in here.scalars(select(Note).order_by(Note.id)):
        visit = _number(here, there, note.visit_id)
        same = select(Note.id).where(Note.visit_id == visit, Note.recorded == note.recorded)
        new = there.scalar(same) is None
        if new:
            there.add(Note(visit_id=visit, recorded=note.recorded, text=note.text))
        yield new


def _number(here: Session, there: Session, visit_id: int) -> int | None:
    """Return the number that a visit has in the other history."""
    visit = here.get_one(Visit, visit_id)
    plant = there.scalar(select(Plant.id).where(Plant.species == visit.plant.species, Plant.label == visit.plant.label))
    return None if plant is None else visit_of(there, plant, visit.robot, visit.time)
