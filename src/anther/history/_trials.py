"""Writing and reading: trials, outcomes and notes, each in one transaction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
from sqlalchemy import func, select, tuple_
from sqlalchemy.orm import Session

from anther.core.errors import bad_input
from anther.history._database import DEFAULT, insert, open_reader, open_writer
from anther.history._records import Outcome, material_of, numbers
from anther.history._tables import FruitSetRow, GraspRow, Note, Plant, ResponseRow, ShakeRow, VisitRow, with_result
from anther.plant.visit import MOTIONS, GraspRecord, ShakeRecord, Visit

BATCH = 500
"""Visits that are read or written at a time."""


def record_trial(record: Visit, where: Path | str = DEFAULT) -> int:
    """Add one trial to the history and return the number of its visit. A SQLite file is made when it is missing.

    The write is one transaction: after a crash all of it is there or nothing. Writers wait for each other. A trial
    that is there already, by its plant, robot and time, is not added again: who does not know whether it was recorded
    may record it again.

    Args:
        record: the visit.
        where: a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE.
    """
    with open_writer(where) as session:
        return add(session, record)[0]


def add_missing(record: Visit, where: Path | str = DEFAULT) -> int | None:
    """Add a trial that could not be recorded when it ended; None if the history has it already."""
    with open_writer(where) as session:
        number, new = add(session, record)
        return number if new else None


def add(session: Session, record: Visit) -> tuple[int, bool]:
    """Add a trial within a transaction; return the number of its visit and whether it is new."""
    plant = plant_of(session, record.species, record.plant)
    number = number_of(session, plant.id, record.robot, record.time)
    if number is not None:
        return number, False
    row = _row_of(record, plant.id)
    session.add(row)
    session.flush()
    return row.id, True


def number_of(session: Session, plant: int, robot: str, time: datetime) -> int | None:
    """Return the number of a robot's visit to a plant, or None."""
    return session.scalar(
        select(VisitRow.id).where(VisitRow.plant_id == plant, VisitRow.robot == robot, VisitRow.time == time)
    )


class Which(TypedDict, total=False):
    """Only some trials; None: of any.

    Attributes:
        species, plant: with these labels.
        since, until: of these days and between them (UTC).
        result: only with this result (`Result`), or one kind of failure.
    """

    species: str | None
    plant: str | None
    since: date | None
    until: date | None
    result: str | None


def read_trials(where: Path | str = DEFAULT, *, last: int | None = None, **which: Unpack[Which]) -> list[Visit]:
    """Return the recorded trials, oldest first; none when the file does not exist.

    Args:
        where: a SQLite file, or a PostgreSQL URL.
        last: only so many, the last ones.
        which: see `Which`.
    """
    query = _filter_visits(select(VisitRow), which).order_by(VisitRow.time.desc(), VisitRow.id.desc()).limit(last)
    with open_reader(where) as session:
        return [] if session is None else [visit_of(visit) for visit in session.scalars(query)][::-1]


def each_trial(where: Path | str = DEFAULT, **which: Unpack[Which]) -> Iterator[Visit]:
    """Yield the trials as `read_trials` returns them, however many there are, `BATCH` at a time.

    Every batch is read by itself: nothing is held while whoever asked is busy with the last one.
    """
    query, place = _filter_visits(select(VisitRow), which).order_by(VisitRow.time, VisitRow.id).limit(BATCH), None
    while True:
        further = query if place is None else query.where(tuple_(VisitRow.time, VisitRow.id) > place)
        with open_reader(where) as session:
            batch = [] if session is None else [visit_of(visit) for visit in session.scalars(further)]
        yield from batch
        if len(batch) < BATCH:
            return
        place = batch[-1].time, batch[-1].id


def count_trials(where: Path | str = DEFAULT, **which: Unpack[Which]) -> int:
    """Return how many trials `read_trials` would."""
    query = _filter_visits(select(func.count(VisitRow.id)), which)
    with open_reader(where) as session:
        return 0 if session is None else session.scalar(query) or 0


def _filter_visits(query: Any, which: Which) -> Any:
    """Ask a query of visits only of some."""
    query = _of_plant(query.join(VisitRow.plant), which.get("species"), which.get("plant"))
    since, until, result = (which.get(name) for name in ("since", "until", "result"))
    if since is not None:
        query = query.where(VisitRow.time >= datetime.combine(since, time(), UTC))
    if until is not None:
        query = query.where(VisitRow.time < datetime.combine(until + timedelta(days=1), time(), UTC))
    return query if result is None else query.where(with_result(result))


def record_outcome(outcome: Outcome, where: Path | str = DEFAULT) -> int:
    """Add a count of fruit set and return its number. A plant that was never visited is added: it is a control.

    Counting the same plant (and visit) again on the same day replaces the earlier count in what is read; the earlier
    one stays in the table.

    Raises:
        InputError: the visit is not one of this plant; or see `record_trial`.
    """
    with open_writer(where) as session:
        plant = plant_of(session, outcome.species, outcome.plant).id
        if outcome.visit is not None:
            visit = session.get(VisitRow, outcome.visit)
            if visit is None or visit.plant_id != plant:
                allowed, do = f"a visit to {outcome.species} '{outcome.plant}'", "`anther history` lists them."
                raise bad_input("visit", given=f"{outcome.visit}", allowed=allowed, do=do)
        counted = FruitSetRow(plant_id=plant, visit_id=outcome.visit, **values_of(outcome, COUNTED))
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
    with open_writer(where) as session:
        if session.get(VisitRow, visit) is None:
            do = "`anther history` lists them."
            raise bad_input("visit", given=f"{visit}", allowed="a visit of the history", do=do)
        note = Note(visit_id=visit, recorded=datetime.now(UTC), text=words.strip())
        session.add(note)
        session.flush()
        return note.id


def read_outcomes(
    where: Path | str = DEFAULT, *, species: str | None = None, plant: str | None = None
) -> list[Outcome]:
    """Return the counts that hold, by date; none when the file does not exist."""
    query = _of_plant(select(FruitSetRow).join(FruitSetRow.plant), species, plant).order_by(FruitSetRow.date)
    query = query.order_by(FruitSetRow.recorded, FruitSetRow.id)
    with open_reader(where) as session:
        rows = [] if session is None else list(session.scalars(query))
        last = {(row.plant_id, row.visit_id, row.date): row for row in rows}
        return [
            Outcome(species=r.plant.species, plant=r.plant.label, visit=r.visit_id, **values_of(r, ("id", *COUNTED)))
            for r in last.values()
        ]


def read_plants(label: str, where: Path | str = DEFAULT, *, species: str | None = None) -> list[tuple[str, str]]:
    """Return (species, label) of every plant in the history with this label."""
    query = _of_plant(select(Plant), species, label).order_by(Plant.species)
    with open_reader(where) as session:
        return [] if session is None else [(p.species, p.label) for p in session.scalars(query)]


def find_visit(number: int, where: Path | str = DEFAULT) -> Visit | None:
    """Return one visit, or None."""
    with open_reader(where) as session:
        visit = None if session is None else session.get(VisitRow, number)
        return None if visit is None else visit_of(visit)


def _of_plant(query: Any, species: str | None, plant: str | None) -> Any:
    query = query if species is None else query.where(Plant.species == species)
    return query if plant is None else query.where(Plant.label == plant)


def plant_of(session: Session, species: str, label: str) -> Plant:
    """Return the plant, locked for this transaction; it is added if it is new, also when two add it at once."""
    query = select(Plant).where(Plant.species == species, Plant.label == label).with_for_update()
    query = query.execution_options(populate_existing=True)
    plant = session.scalar(query)
    if plant is None:
        new = insert(session, Plant).values(species=species, label=label)
        session.execute(new.on_conflict_do_nothing(index_elements=["species", "label"]))
        plant = session.scalars(query).one()
    return plant


_OF_VISIT = ("robot", "time", "held_unharmed", "flowers_moved", "failure", "run")
COUNTED = ("date", "flowers", "fruit", "note", "recorded")
"""What records and rows of visits, and of counts, both have."""


def values_of(thing: Any, names: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(thing, name) for name in names}


def _row_of(visit: Visit, plant: int) -> VisitRow:
    motions = visit.motions()
    return VisitRow(
        plant_id=plant,
        taught=visit.taught,
        acceleration_ms2=visit.acceleration_mean,
        believed=visit.believed and asdict(visit.believed),
        material=visit.material and asdict(visit.material),
        grasp=visit.grasp and GraspRow(**asdict(visit.grasp)),
        shake=ShakeRow(**asdict(visit.shake)) if visit.shake and visit.shaken else None,
        responses=[
            ResponseRow(flower=k, **{name: float(v[k]) if np.isfinite(v[k]) else None for name, v in motions.items()})
            for k in range(visit.flowers)
        ],
        **values_of(visit, _OF_VISIT),
    )


def visit_of(row: VisitRow) -> Visit:
    grasp, shake = row.grasp, row.shake
    return Visit(
        species=row.plant.species,
        plant=row.plant.label,
        grasp=grasp and GraspRecord(**values_of(grasp, [f.name for f in fields(GraspRecord)])),
        shake=shake and ShakeRecord(**values_of(shake, [f.name for f in fields(ShakeRecord)])),
        believed=material_of(row.believed),
        material=material_of(row.material),
        **{name: numbers([getattr(r, name) for r in row.responses]) for name in MOTIONS},
        **values_of(row, ("id", *_OF_VISIT)),
    )
