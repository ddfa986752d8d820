"""Writing and reading: trials and outcomes, each in one transaction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import func, select, tuple_
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from anther.errors import bad_input
from anther.history._database import DEFAULT, reading, writing
from anther.history._records import MOTIONS, GraspRecord, Outcome, ShakeRecord, TrialRecord, material_of
from anther.history._tables import FruitSetRow, GraspRow, Note, Plant, ResponseRow, ShakeRow, Visit

_COLUMNS = {name: f"{name}_{'ms2' if name.endswith('acceleration') else 'm'}" for name in MOTIONS}


BATCH = 500
"""Visits that are read or written at a time."""


def record_trial(record: TrialRecord, where: Path | str = DEFAULT) -> int:
    """Add one trial to the history and return the number of its visit. A SQLite file is made when it is missing.

    The write is one transaction: after a crash all of it is there or nothing. Writers wait for each other. A trial
    that is there already, by its plant, robot and time, is not added again: who does not know whether it was recorded
    may record it again.

    Args:
        record: the trial.
        where: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE.

    Raises:
        InputError: no history of Anther's, or it cannot be written.
    """
    with writing(where) as session:
        return add(session, record)[0]


def add_missing(record: TrialRecord, where: Path | str = DEFAULT) -> int | None:
    """Add a trial that could not be recorded when it ended; None if the history has it already.

    Raises:
        InputError: see `record_trial`.
    """
    with writing(where) as session:
        number, new = add(session, record)
        return number if new else None


def add(session: Session, record: TrialRecord) -> tuple[int, bool]:
    """Add a trial within a transaction; return the number of its visit and whether it is new."""
    plant = plant_of(session, record.species, record.plant)
    number = visit_of(session, plant.id, record.robot, record.time)
    if number is not None:
        return number, False
    visit = _visit(record, plant.id)
    session.add(visit)
    session.flush()
    return visit.id, True


def visit_of(session: Session, plant: int, robot: str, time: datetime) -> int | None:
    """Return the number of a robot's visit to a plant, or None."""
    return session.scalar(select(Visit.id).where(Visit.plant_id == plant, Visit.robot == robot, Visit.time == time))


def read_trials(
    where: Path | str = DEFAULT,
    *,
    species: str | None = None,
    plant: str | None = None,
    since: date | None = None,
    until: date | None = None,
    result: str | None = None,
    last: int | None = None,
) -> list[TrialRecord]:
    """Return the recorded trials, oldest first; none when the file does not exist.

    Args:
        where: a SQLite file, or a PostgreSQL URL.
        species, plant: only trials with these labels.
        since, until: only trials of these days and between them (UTC).
        result: only "held_unharmed", "failure", or one kind of failure.
        last: only so many, the last ones.

    Raises:
        InputError: no history of Anther's, or it cannot be read.
    """
    query = chosen(select(Visit).join(Visit.plant), species, plant, since, until, result)
    query = query.order_by(Visit.time.desc(), Visit.id.desc()).limit(last)
    with reading(where) as session:
        return [] if session is None else [trial_of(visit) for visit in session.scalars(query)][::-1]


def each_trial(
    where: Path | str = DEFAULT,
    *,
    species: str | None = None,
    plant: str | None = None,
    since: date | None = None,
    until: date | None = None,
    result: str | None = None,
) -> Iterator[TrialRecord]:
    """Yield the trials as `read_trials` returns them, however many there are, `BATCH` at a time.

    Every batch is read by itself: nothing is held while whoever asked is busy with the last one.
    """
    query = chosen(select(Visit).join(Visit.plant), species, plant, since, until, result)
    query, place = query.order_by(Visit.time, Visit.id).limit(BATCH), None
    while True:
        further = query if place is None else query.where(tuple_(Visit.time, Visit.id) > place)
        with reading(where) as session:
            batch = [] if session is None else [trial_of(visit) for visit in session.scalars(further)]
        yield from batch
        if len(batch) < BATCH:
            return
        place = batch[-1].time, batch[-1].id


def count_trials(
    where: Path | str = DEFAULT,
    *,
    species: str | None = None,
    plant: str | None = None,
    since: date | None = None,
    until: date | None = None,
    result: str | None = None,
) -> int:
    """Return how many trials `read_trials` would.

    Raises:
        InputError: no history of Anther's, or it cannot be read.
    """
    query = chosen(select(func.count(Visit.id)).join(Visit.plant), species, plant, since, until, result)
    with reading(where) as session:
        return 0 if session is None else session.scalar(query) or 0


def chosen(
    query: Any,
    species: str | None = None,
    plant: str | None = None,
    since: date | None = None,
    until: date | None = None,
    result: str | None = None,
) -> Any:
    """Ask a query, which joins visits and plants, only of some visits; see `read_trials`."""
    query = _of_plant(query, species, plant)
    if since is not None:
        query = query.where(Visit.time >= datetime.combine(since, time(), UTC))
    if until is not None:
        query = query.where(Visit.time < datetime.combine(until + timedelta(days=1), time(), UTC))
    if result in ("held_unharmed", "failure"):
        query = query.where(Visit.held_unharmed.is_(result == "held_unharmed"))
    elif result is not None:
        query = query.where(Visit.failure == result)
    return query


def record_outcome(outcome: Outcome, where: Path | str = DEFAULT) -> int:
    """Add a count of fruit set and return its number. A plant that was never visited is added: it is a control.

    Counting the same plant (and visit) again on the same day replaces the earlier count in what is read; the earlier
    one stays in the table.

    Raises:
        InputError: the visit is not one of this plant; or see `record_trial`.
    """
    with writing(where) as session:
        plant = plant_of(session, outcome.species, outcome.plant).id
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
        values = {name: row[name] for name in ("date", "flowers", "fruit", "note", "recorded")}
        counted = FruitSetRow(plant_id=plant, visit_id=outcome.visit, **values)
        session.add(counted)
        session.flush()
        return counted.id


def record_note(visit: int, words: str, where: Path | str = DEFAULT) -> int:
    """Add a note to a visit and return its number.

    Raises:
        InputError: no such visit, no text or more than 2000 characters; or see `record_trial`.
    """
    if not 0 < len(words.strip()) <= 2000:
        raise bad_input("note", given=f"{len(words)} characters", allowed="a text of 1 to 2000", do="Say it briefly.")
    with writing(where) as session:
        if session.get(Visit, visit) is None:
            raise bad_input(
                "visit", given=f"{visit}", allowed="a visit of the history", do="`anther history` lists them."
            )
        note = Note(visit_id=visit, recorded=datetime.now(UTC), text=words.strip())
        session.add(note)
        session.flush()
        return note.id


def read_outcomes(
    where: Path | str = DEFAULT, *, species: str | None = None, plant: str | None = None
) -> list[Outcome]:
    """Return the counts that hold, by date; none when the file does not exist.

    Raises:
        InputError: no history of Anther's, or it cannot be read.
    """
    query = _of_plant(select(FruitSetRow).join(FruitSetRow.plant), species, plant).order_by(FruitSetRow.date)
    query = query.order_by(FruitSetRow.recorded, FruitSetRow.id)
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
        return None if visit is None else trial_of(visit)


def _of_plant(query: Any, species: str | None, plant: str | None) -> Any:
    query = query if species is None else query.where(Plant.species == species)
    return query if plant is None else query.where(Plant.label == plant)


def plant_of(session: Session, species: str, label: str) -> Plant:
    """Return the plant, locked for this transaction; it is added if it is new, also when two add it at once."""
    query = select(Plant).where(Plant.species == species, Plant.label == label).with_for_update()
    query = query.execution_options(populate_existing=True)
    plant = session.scalar(query)
    if plant is None:
        dialect = postgresql if session.get_bind().dialect.name == "postgresql" else sqlite
        new = dialect.insert(Plant).values(species=species, label=label)
        session.execute(new.on_conflict_do_nothing(index_elements=["species", "label"]))
        plant = session.scalars(query).one()
    return plant


def _visit(record: TrialRecord, plant: int) -> Visit:
    grasp, shake, felt = record.grasp, record.shake, record.accelerations()
    return Visit(
        plant_id=plant,
        robot=record.robot,
        time=record.time,
        taught=record.taught,
        acceleration_ms2=None if felt is None else float(felt.mean()),
        held_unharmed=record.held_unharmed,
        failure=record.failure,
        run=record.run,
        material_before=None if record.believed is None else asdict(record.believed),
        material_after=None if record.material is None else asdict(record.material),
        grasp=grasp
        and GraspRow(
            arc_length_m=grasp.arc_length,
            stem_diameter_m=grasp.stem_diameter,
            confidence=grasp.confidence,
            organ=grasp.organ,
            pose7=grasp.pose7,
        ),
        shake=shake
        and ShakeRow(
            frequency_hz=shake.frequency,
            amplitude_m=shake.amplitude,
            duration_s=shake.duration,
            waveform=shake.waveform,
            direction=shake.direction,
        ),
        responses=[
            ResponseRow(flower=k, **{_COLUMNS[name]: _null(values[k]) for name, values in record.motions().items()})
            for k in range(record.flowers)
        ],
    )


def _null(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def trial_of(visit: Visit) -> TrialRecord:
    """Return a row of the table as a record."""
    grasp, shake = visit.grasp, visit.shake
    record = TrialRecord(
        species=visit.plant.species,
        plant=visit.plant.label,
        held_unharmed=visit.held_unharmed,
        failure=visit.failure,
        grasp=grasp
        and GraspRecord(grasp.arc_length_m, grasp.stem_diameter_m, grasp.confidence, grasp.organ, grasp.pose7),
        shake=shake
        and ShakeRecord(shake.frequency_hz, shake.amplitude_m, shake.duration_s, shake.waveform, shake.direction),
        believed=material_of(visit.material_before),
        material=material_of(visit.material_after),
        run=visit.run,
        robot=visit.robot,
        time=visit.time,
        id=visit.id,
    )
    return replace(record, **{name: _column(visit.responses, column) for name, column in _COLUMNS.items()})


def _column(responses: Sequence[ResponseRow], name: str) -> tuple[float, ...]:
    values = [getattr(response, name) for response in responses]
    return tuple(float("nan") if v is None else float(v) for v in values)


def _outcome(row: FruitSetRow) -> Outcome:
    return Outcome(
        species=row.plant.species,
        plant=row.plant.label,
        flowers=row.flowers,
        fruit=row.fruit,
        date=row.date,
        visit=row.visit_id,
        note=row.note,
        recorded=row.recorded,
        id=row.id,
    )
