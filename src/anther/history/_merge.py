"""One history into another.

What a robot kept while it was offline goes into the fleet's history once, whatever its clock says: a visit is named by
its plant, its robot and the time by that robot's own clock; times of different robots are never compared. So a merge
that was cut off is simply done again, and clocks that disagree neither double nor hide a visit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from sqlalchemy import inspect, select
from sqlalchemy.orm import Session

from anther.core.errors import bad_input
from anther.history._database import DEFAULT, hide_password, open_reader, open_writer
from anther.history._tables import (
    FruitSetRow,
    Note,
    Plant,
    RowSide,
    ShiftRobot,
    ShiftRow,
    ShiftStem,
    StemRow,
    VisitRow,
)
from anther.history._trials import BATCH, COUNTED, add, number_of, plant_of, values_of, visit_of
from anther.plant.visit import Visit


class Merged(NamedTuple):
    """How many visits, counts, notes, sides of rows and shifts were new or told something new; how many were known."""

    new: int
    known: int


def merge(source: Path | str, where: Path | str = DEFAULT) -> Merged:
    """Take the visits, counts of fruit set, notes, maps and shifts of another history into this one.

    A side of a row is as the history has it that passed it last; stems that only the other one knows are taken out of
    the map. A shift is the same if it was asked for alike: a stem that was visited or left in one of the two is so.

    Args:
        source: the history to take from; nothing of it changes but for its schema's version.
        where: the history to add to.

    Raises:
        InputError: one of them is no history, cannot be read, or cannot be written; or a row has another crop in the
            other one. Visits that were taken until then stay.
    """
    with open_reader(source) as session:
        if session is None:
            given = f"{hide_password(source)}, which is not there"
            raise bad_input("history to merge", given=given, allowed="a history", do="Check the path.")
    new = total = 0
    for batch in _batches(source):
        with open_writer(where) as session:
            # in the order of plants, so that two merges at once lock them in the same order
            ordered = sorted(batch, key=lambda record: (record.species, record.plant, record.time))
            new += sum(add(session, record)[1] for record in ordered)
        total += len(batch)
    with open_reader(source) as here, open_writer(where) as there:
        assert here is not None
        for added in (*_counts(here, there), *_notes(here, there), *_sides(here, there), *_shifts(here, there)):
            new, total = new + added, total + 1
    return Merged(new, total - new)


def _batches(source: Path | str) -> Iterator[Sequence[Visit]]:
    last = 0
    while True:
        with open_reader(source) as session:
            rows = session.scalars(select(VisitRow).where(VisitRow.id > last).order_by(VisitRow.id).limit(BATCH)).all()  # type: ignore[union-attr]
            batch = [visit_of(row) for row in rows]
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
            there.add(FruitSetRow(plant_id=plant, visit_id=visit, **values_of(count, COUNTED)))
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
    visit = here.get_one(VisitRow, visit_id)
    plant = there.scalar(select(Plant.id).where(Plant.species == visit.plant.species, Plant.label == visit.plant.label))
    return None if plant is None else number_of(there, plant, visit.robot, visit.time)


def _columns(row: Any, *but: str) -> dict[str, Any]:
    """Return the columns of a row by their names, but for its own number and some others."""
    return {at.key: getattr(row, at.key) for at in inspect(type(row)).column_attrs if at.key not in ("id", *but)}


def _set(row: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        setattr(row, name, value)


def _sides(here: Session, there: Session) -> Iterator[bool]:
    """Bring each side of a row up to the pass that was later; yield whether anything was new."""
    for side in here.scalars(select(RowSide).order_by(RowSide.id)):
        same = RowSide.house == side.house, RowSide.row == side.row, RowSide.side == side.side
        known = there.scalar(select(RowSide).where(*same).with_for_update())
        if known is not None and known.species != side.species:
            given = f"{side.species} in house '{side.house}', row '{side.row}'"
            raise bad_input("history to merge", given=given, allowed=known.species, do="Is it another house?")
        newer = known is None or (side.passed is not None and (known.passed is None or known.passed < side.passed))
        values = _columns(side)
        if known is None:
            there.add(known := RowSide(**values))
            there.flush()
        elif newer:
            _set(known, {**values, "labels": max(known.labels, side.labels)})
        yield _stems(here, there, side, known, newer=newer) or newer


def _stems(here: Session, there: Session, side: RowSide, known: RowSide, *, newer: bool) -> bool:
    """Take the stems of a side along; return whether one was not known. The newer map says which ones hang there."""
    own = {s.plant_id: s for s in there.scalars(select(StemRow).where(StemRow.row_side_id == known.id))}
    newly = 0
    for stem in here.scalars(select(StemRow).where(StemRow.row_side_id == side.id).order_by(StemRow.id)):
        plant = plant_of(there, stem.plant.species, stem.plant.label).id
        values = _columns(stem, "row_side_id", "plant_id")
        match = own.pop(plant, None)
        if match is None:
            gone = stem.removed or (None if newer else known.passed or stem.last_seen)
            there.add(StemRow(row_side_id=known.id, plant_id=plant, **{**values, "removed": gone}))
            newly += 1
        elif newer:
            _set(match, values)
    for left in own.values() if newer else ():
        left.removed = left.removed or side.passed
    there.flush()
    return newly > 0


def _shifts(here: Session, there: Session) -> Iterator[bool]:
    """Take each shift along, and what became of its stems; yield whether anything was new."""
    for shift in here.scalars(select(ShiftRow).order_by(ShiftRow.id)):
        of_house = select(ShiftRow).where(ShiftRow.house == shift.house).order_by(ShiftRow.id).with_for_update()
        known = next((other for other in there.scalars(of_house) if other.asked == shift.asked), None)
        new = known is None
        if known is None:
            there.add(known := ShiftRow(**_columns(shift)))
            there.flush()
        changed = _shift_stems(here, there, shift.id, known.id)
        _shift_robots(here, there, shift.id, known.id)
        if changed:
            known.planned = None  # what is left is planned anew
        yield new or changed


def _shift_stems(here: Session, there: Session, shift: int, known: int) -> bool:
    """Add the stems of a shift; what was visited or left there is so here too. Return whether anything was new."""
    own = {s.stem_id: s for s in there.scalars(select(ShiftStem).where(ShiftStem.shift_id == known))}
    changed = False
    query = select(ShiftStem, StemRow).join(StemRow, StemRow.id == ShiftStem.stem_id)
    for done, stem in here.execute(query.where(ShiftStem.shift_id == shift).order_by(ShiftStem.id)):
        plant = plant_of(there, stem.plant.species, stem.plant.label).id
        number = there.scalars(select(StemRow.id).where(StemRow.plant_id == plant)).one()
        values = _columns(done, "shift_id", "stem_id")
        values["visit_id"] = None if done.visit_id is None else _number(here, there, done.visit_id)
        match, ended = own.get(number), ("visited", "left")
        if match is None:
            there.add(ShiftStem(shift_id=known, stem_id=number, **values))
        elif done.state in ended and match.state not in ended:
            _set(match, values)
        else:
            continue
        changed = True
    return changed


def _shift_robots(here: Session, there: Session, shift: int, known: int) -> None:
    """Let each robot of a shift stand as the history has it that heard from it last."""
    own = {robot.name: robot for robot in there.scalars(select(ShiftRobot).where(ShiftRobot.shift_id == known))}
    for robot in here.scalars(select(ShiftRobot).where(ShiftRobot.shift_id == shift).order_by(ShiftRobot.id)):
        values, match = _columns(robot, "shift_id"), own.get(robot.name)
        if match is None:
            there.add(ShiftRobot(shift_id=known, **values))
        elif match.free < robot.free:
            _set(match, values)
