"""A history into another: what a robot kept while it was offline goes into the fleet's, once, whatever its clock says.

A visit is named by its plant, its robot and the time by that robot's own clock; times of different robots are never
compared. So a merge that was cut off is simply done again, and clocks that disagree neither double nor hide a visit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import select
from sqlalchemy.orm import Session

from anther.errors import bad_input
from anther.history._database import DEFAULT, reading, shown, writing
from anther.history._records import TrialRecord
from anther.history._tables import FruitSetRow, Note, Plant, Visit
from anther.history._trials import BATCH, add, plant_of, trial_of, visit_of


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
