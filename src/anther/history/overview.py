"""What a page shows of a history, however long it is: every question reads a part of an index, never all visits.

All take a session of `reading`. A day is UTC's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from typing import Any, NamedTuple

from sqlalchemy import Integer, cast, func, select, tuple_
from sqlalchemy.orm import Session

from anther.core.records import decode
from anther.history._row_records import SURE
from anther.history._shift_records import Shift
from anther.history._tables import (
    FruitSetRow,
    Note,
    Plant,
    RowSide,
    ShakeRow,
    ShiftRow,
    ShiftStem,
    StemRow,
    Sweep,
    SweepJob,
    VisitRow,
    pollinated,
    with_result,
)
from anther.plant.visit import Result, result_of, result_words

PAGE = 50
"""Visits of a page."""


class Tally(NamedTuple):
    """Visits that have something in common.

    Attributes:
        name: what: a day, a robot, a kind of failure.
        visits: how many.
        held: how many of them held the plant and did not harm it.
        pollinated: at how many of these its flowers moved.
        acceleration: mean over the visits of what their flowers felt [m/s2]; None where it is not known.
        last: the last one's time.
    """

    name: Any
    visits: int
    held: int
    pollinated: int
    acceleration: float | None
    last: datetime


@dataclass(frozen=True, slots=True)
class SweepTally:
    """A sweep at a glance: jobs by state."""

    folder: str
    function: str
    began: datetime
    jobs: dict[str, int]


class StemDay(NamedTuple):
    """What became of a stem of a house on a day.

    Attributes:
        plant, label: number and label of its plant.
        row, side, hook: where it hangs; hooks count from 0.
        unsure: whether it may be another stem than before.
        state: "pollinated", "held", "failed" by its last visit of the day; else as the shift of that day has it,
            "waiting", "working" or "left"; else "none".
        why: the result in words, or why it was left; "" for none.
    """

    plant: int
    label: str
    row: str
    side: str
    hook: int
    unsure: bool
    state: str
    why: str


_TALLY = (
    func.count(),
    func.sum(cast(VisitRow.held_unharmed, Integer)),
    func.sum(cast(pollinated(), Integer)),
    func.avg(VisitRow.acceleration_ms2),
    func.max(VisitRow.time),
)


def days(session: Session, since: date, until: date) -> list[Tally]:
    """Return the visits of each of some days that has any.

    One question a day: the index holds a day's visits side by side, while grouping by day would sort them all.
    """
    found = []
    for k in range((until - since).days + 1):
        day = since + timedelta(days=k)
        row = session.execute(_filter_dates(select(*_TALLY), day, day)).one()
        if row[0]:
            found.append(Tally(day, *row))
    return found


def robots(session: Session, since: date, until: date) -> list[Tally]:
    """Return the visits of each robot on some days, by the robots' names."""
    query = (
        _filter_dates(select(VisitRow.robot, *_TALLY), since, until).group_by(VisitRow.robot).order_by(VisitRow.robot)
    )
    return [Tally(*row) for row in session.execute(query)]


def failures(session: Session, since: date, until: date) -> list[Tally]:
    """Return the visits that failed on some days by the kind of failure, "" where none was named, most first."""
    kind = func.coalesce(VisitRow.failure, "")
    query = _filter_dates(select(kind, *_TALLY), since, until).where(VisitRow.held_unharmed.is_(False)).group_by(kind)
    return [Tally(*row) for row in session.execute(query.order_by(func.count().desc(), kind))]


def _filter_dates(query: Any, since: date, until: date) -> Any:
    begin, end = (datetime.combine(day, time(), UTC) for day in (since, until + timedelta(days=1)))
    return query.where(VisitRow.time >= begin, VisitRow.time < end)


def visits(
    session: Session,
    *,
    day: date | None = None,
    plant: int | None = None,
    result: Result | None = None,
    before: int | None = None,
) -> Sequence[Any]:
    """Return at most PAGE + 1 visits, the last one first: one more than is shown says that there are more.

    Each has id, time, robot, held_unharmed, flowers_moved, failure, acceleration_ms2, species, label, plant_id, and
    amplitude, frequency, duration of its shake.

    Args:
        session: that reads.
        day, plant: only of this day, of the plant with this number.
        result: only with this result.
        before: only those before the visit with this number.
    """
    of_visit = (
        VisitRow.id,
        VisitRow.time,
        VisitRow.robot,
        VisitRow.held_unharmed,
        VisitRow.flowers_moved,
        VisitRow.failure,
    )
    shake = ShakeRow.amplitude, ShakeRow.frequency, ShakeRow.duration
    query = select(*of_visit, VisitRow.acceleration_ms2, VisitRow.plant_id, Plant.species, Plant.label, *shake)
    query = query.join(Plant, Plant.id == VisitRow.plant_id).outerjoin(ShakeRow, ShakeRow.visit_id == VisitRow.id)
    if day is not None:
        query = _filter_dates(query, day, day)
    if plant is not None:
        query = query.where(VisitRow.plant_id == plant)
    if result is not None:
        query = query.where(with_result(result))
    if before is not None:
        moment = session.scalar(select(VisitRow.time).where(VisitRow.id == before))
        query = query.where(tuple_(VisitRow.time, VisitRow.id) < (moment, before))
    return session.execute(query.order_by(VisitRow.time.desc(), VisitRow.id.desc()).limit(PAGE + 1)).all()


def last_day(session: Session, before: date) -> date | None:
    """Return the last day up to `before` with a visit, or None."""
    query = _filter_dates(select(VisitRow.time), date(1970, 1, 1), before).order_by(VisitRow.time.desc()).limit(1)
    moment = session.scalar(query)
    return None if moment is None else moment.date()


def plants(session: Session, part: str) -> Sequence[Any]:
    """Return id, species, label of at most PAGE plants whose label contains a text."""
    found = Plant.label.icontains(part, autoescape=True)
    query = select(Plant.id, Plant.species, Plant.label).where(found).order_by(Plant.label, Plant.species)
    return session.execute(query.limit(PAGE)).all()


def plant(session: Session, number: int) -> Plant | None:
    """Return the plant with this number, or None."""
    return session.get(Plant, number)


def counts(session: Session, number: int) -> Sequence[FruitSetRow]:
    """Return the counts of fruit set of a plant, the last one first."""
    newest = FruitSetRow.date.desc(), FruitSetRow.recorded.desc()
    return session.scalars(select(FruitSetRow).where(FruitSetRow.plant_id == number).order_by(*newest)).all()


def houses(session: Session) -> Sequence[str]:
    """Return the names of the houses that have a map."""
    return session.scalars(select(RowSide.house).distinct().order_by(RowSide.house)).all()


def house_day(session: Session, house: str, day: date) -> list[StemDay]:
    """Return what became of every stem of a house on a day, in the order of rows, sides and hooks."""
    of_house = RowSide.house == house, StemRow.removed.is_(None)
    query = select(StemRow, RowSide.row, RowSide.side).join(RowSide, RowSide.id == StemRow.row_side_id)
    stems = session.execute(query.where(*of_house).order_by(RowSide.id, StemRow.order)).all()
    columns = VisitRow.plant_id, VisitRow.held_unharmed, VisitRow.flowers_moved, VisitRow.failure
    visited = select(*columns).join(StemRow, StemRow.plant_id == VisitRow.plant_id)
    visited = visited.join(RowSide, RowSide.id == StemRow.row_side_id).where(*of_house)
    last = {v.plant_id: tuple(v)[1:] for v in session.execute(_filter_dates(visited, day, day).order_by(VisitRow.time))}
    shift = _shift_stems(session, house, day)
    found = []
    for stem, row, side in stems:
        state, why = shift.get(stem.id, ("none", None))
        if (visit := last.get(stem.plant_id)) is not None:
            state, why = result_of(*visit[:2]), result_words(*visit)
        unsure = stem.certainty < SURE
        found.append(StemDay(stem.plant_id, stem.plant.label, row, side, stem.order, unsure, state, why or ""))
    return found


def _shift_stems(session: Session, house: str, day: date) -> dict[int, tuple[str, str | None]]:
    """Return stem -> state and reason in the last shift of a house, if that was on this day."""
    shift = session.scalar(select(ShiftRow).where(ShiftRow.house == house).order_by(ShiftRow.id.desc()).limit(1))
    if shift is None:
        return {}
    asked = decode(shift.asked, Shift)
    if not asked.begin.astimezone(UTC).date() <= day <= asked.end.astimezone(UTC).date():
        return {}
    rows = session.execute(
        select(ShiftStem.stem_id, ShiftStem.state, ShiftStem.reason).where(ShiftStem.shift_id == shift.id)
    )
    return {stem: ("none" if state == "visited" else state, reason) for stem, state, reason in rows}


def last_run(session: Session, number: int) -> Any:
    """Return id and run of the last visit to a plant that has a run folder, or None."""
    query = select(VisitRow.id, VisitRow.run, VisitRow.time).where(
        VisitRow.plant_id == number, VisitRow.run.is_not(None)
    )
    return session.execute(query.order_by(VisitRow.time.desc()).limit(1)).first()


def visit(session: Session, number: int) -> VisitRow:
    """Return the visit with this number, which is there."""
    return session.get_one(VisitRow, number)


def notes(session: Session, visit: int) -> Sequence[Note]:
    """Return the notes on a visit, the first one first."""
    return session.scalars(select(Note).where(Note.visit_id == visit).order_by(Note.recorded)).all()


def sweeps(session: Session) -> list[SweepTally]:
    """Return the sweeps whose jobs this history keeps, the last one first."""
    query = select(Sweep, SweepJob.state, func.count(SweepJob.id)).join(SweepJob, isouter=True)
    found: dict[int, SweepTally] = {}
    for sweep, state, count in session.execute(query.group_by(Sweep.id, SweepJob.state)):
        tally = found.setdefault(sweep.id, SweepTally(sweep.folder, sweep.function, sweep.began, {}))
        if state is not None:
            tally.jobs[state] = count
    return [found[number] for number in sorted(found, reverse=True)]
