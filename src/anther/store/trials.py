"""Writing and reading: trials and outcomes, each in one transaction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Select, select
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from anther.errors import bad_input
from anther.store.database import DEFAULT, reading, writing
from anther.store.records import MOTIONS, GraspRecord, Outcome, ShakeRecord, TrialRecord, material_of
from anther.store.tables import FruitSet, Grasp, Plant, Response, Shake, Visit

_COLUMNS = {name: f"{name}_{'ms2' if name.endswith('acceleration') else 'm'}" for name in MOTIONS}


def record_trial(record: TrialRecord, where: Path | str = DEFAULT) -> int:
    """Add one trial to the history and return the number of its visit. A SQLite file is made when it is missing.

    The write is one transaction: after a crash all of it is there or nothing. Writers wait for each other.

    Args:
        record: the trial.
        where: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE.

    Raises:
        InputError: no history of Anther's, or it cannot be written.
    """
    with writing(where) as session:
        visit = _visit(record, _plant(session, record.species, record.plant))
        session.add(visit)
        session.flush()
        return visit.id


def add_missing(record: TrialRecord, where: Path | str = DEFAULT) -> int | None:
    """Add a trial that could not be recorded when it ended; None if the history has it already.

    Raises:
        InputError: see `record_trial`.
    """
    with writing(where) as session:
        plant = _plant(session, record.species, record.plant)
        if session.scalar(select(Visit.id).where(Visit.plant_id == plant, Visit.time == record.time)) is not None:
            return None
        visit = _visit(record, plant)
        session.add(visit)
        session.flush()
        return visit.id


def read_trials(
    where: Path | str = DEFAULT,
    *,
    species: str | None = None,
    plant: str | None = None,
    since: date | None = None,
    until: date | None = None,
    result: str | None = None,
) -> list[TrialRecord]:
    """Return the recorded trials, oldest first; none when the file does not exist.

    Args:
        where: a SQLite file, or a PostgreSQL URL.
        species, plant: only trials with these labels.
        since, until: only trials of these days and between them (UTC).
        result: only "success", "failure", or one kind of failure.

    Raises:
        InputError: no history of Anther's, or it cannot be read.
    """
    query = _of_plant(select(Visit).join(Visit.plant), species, plant).order_by(Visit.time, Visit.id)
    if since is not None:
        query = query.where(Visit.time >= datetime.combine(since, time(), UTC))
    if until is not None:
        query = query.where(Visit.time < datetime.combine(until + timedelta(days=1), time(), UTC))
    if result in ("success", "failure"):
        query = query.where(Visit.success.is_(result == "success"))
    elif result is not None:
        query = query.where(Visit.failure == result)
    with reading(where) as session:
        return [] if session is None else [_trial(visit) for visit in session.scalars(query)]


def record_outcome(outcome: Outcome, where: Path | str = DEFAULT) -> int:
    """Add a count of fruit set and return its number. A plant that was never visited is added: it is a control.

    Counting the same plant (and visit) again on the same day replaces the earlier count in what is read; the earlier
    one stays in the table.

    Raises:
        InputError: the visit is not one of this plant; or see `record_trial`.
    """
    with writing(where) as session:
        plant = _plant(session, outcome.species, outcome.plant)
        if outcome.visit is not None:
            visit = session.get(Visit, outcome.visit)
            if visit is None or visit.plant_id != plant:
                raise bad_input(
                    "visit",
                    given=f"{outcome.visit}",
                    allowed=f"a visit to {outcome.species} '{outcome.plant}'",
                    do="`anther history` lists them.",
                )
        row = asdict(outcome)
        values = {name: row[name] for name in ("date", "flowers", "fruit", "note")}
        counted = FruitSet(plant_id=plant, visit_id=outcome.visit, recorded=datetime.now(UTC), **values)
        session.add(counted)
        session.flush()
        return counted.id


def read_outcomes(
    where: Path | str = DEFAULT, *, species: str | None = None, plant: str | None = None
) -> list[Outcome]:
    """Return the counts that hold, by date; none when the file does not exist.

    Raises:
        InputError: no history of Anther's, or it cannot be read.
    """
    query = _of_plant(select(FruitSet).join(FruitSet.plant), species, plant).order_by(FruitSet.date, FruitSet.id)
    with reading(where) as session:
        rows = [] if session is None else list(session.scalars(query))
        last = {(row.plant_id, row.visit_id, row.date): row for row in rows}
        return [_outcome(row) for row in last.values()]


def find_plants(label: str, where: Path | str = DEFAULT, *, species: str | None = None) -> list[tuple[str, str]]:
    """Return (species, label) of every plant in the history with this label.

    Raises:
        InputError: no history of Anther's, or it cannot be read.
    """
    query = _of_plant(select(Plant), species, label).order_by(Plant.species)
    with reading(where) as session:
        return [] if session is None else [(p.species, p.label) for p in session.scalars(query)]


def find_visit(number: int, where: Path | str = DEFAULT) -> TrialRecord | None:
    """Return one visit, or None.

    Raises:
        InputError: no history of Anther's, or it cannot be read.
    """
    with reading(where) as session:
        visit = None if session is None else session.get(Visit, number)
        return None if visit is None else _trial(visit)


def _of_plant(query: Select[Any], species: str | None, plant: str | None) -> Select[Any]:
    query = query if species is None else query.where(Plant.species == species)
    return query if plant is None else query.where(Plant.label == plant)


def _plant(session: Session, species: str, label: str) -> int:
    """Return the plant's number; it is added if it is new, also when another program adds it at the same time."""
    dialect = postgresql if session.get_bind().dialect.name == "postgresql" else sqlite
    session.execute(dialect.insert(Plant).values(species=species, label=label).on_conflict_do_nothing())
    return session.execute(select(Plant.id).where(Plant.species == species, Plant.label == label)).scalar_one()


def _visit(record: TrialRecord, plant: int) -> Visit:
    grasp, shake = record.grasp, record.shake
    return Visit(
        plant_id=plant,
        time=record.time,
        success=record.success,
        failure=record.failure,
        run=record.run,
        material_before=None if record.believed is None else asdict(record.believed),
        material_after=None if record.material is None else asdict(record.material),
        grasp=grasp
        and Grasp(
            arc_length_m=grasp.arc_length,
            stem_diameter_m=grasp.stem_diameter,
            confidence=grasp.confidence,
            organ=grasp.organ,
            pose7=grasp.pose7,
        ),
        shake=shake
        and Shake(
            frequency_hz=shake.frequency,
            amplitude_m=shake.amplitude,
            duration_s=shake.duration,
            waveform=shake.waveform,
            direction=shake.direction,
        ),
        responses=[
            Response(flower=k, **{_COLUMNS[name]: _null(values[k]) for name, values in record.motions().items()})
            for k in range(record.flowers)
        ],
    )


def _null(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _trial(visit: Visit) -> TrialRecord:
    grasp, shake = visit.grasp, visit.shake
    record = TrialRecord(
        species=visit.plant.species,
        plant=visit.plant.label,
        success=visit.success,
        failure=visit.failure,
        grasp=grasp
        and GraspRecord(grasp.arc_length_m, grasp.stem_diameter_m, grasp.confidence, grasp.organ, grasp.pose7),
        shake=shake
        and ShakeRecord(shake.frequency_hz, shake.amplitude_m, shake.duration_s, shake.waveform, shake.direction),
        believed=material_of(visit.material_before),
        material=material_of(visit.material_after),
        run=visit.run,
        time=visit.time,
        id=visit.id,
    )
    return replace(record, **{name: _column(visit.responses, column) for name, column in _COLUMNS.items()})


def _column(responses: Sequence[Response], name: str) -> tuple[float, ...]:
    values = [getattr(response, name) for response in responses]
    return tuple(float("nan") if v is None else float(v) for v in values)


def _outcome(row: FruitSet) -> Outcome:
    return Outcome(
        species=row.plant.species,
        plant=row.plant.label,
        flowers=row.flowers,
        fruit=row.fruit,
        date=row.date,
        visit=row.visit_id,
        note=row.note,
        id=row.id,
    )
