"""A shift: which stems of a house are due, which robot visits which when, and what became of every one of them.

`begin_shift` lists every stem of the house: those that are due in legs, parts of a row in the order in which a cart
drives in along the left and out along the right, the others with the reason why not. `run_shift` gives one stem after
another to robots and notes each visit in the same transaction as what it changes, so that after a kill at any moment it
is just called again. Several programs may run one shift, each some of its robots. OR-Tools assigns legs, windows and
charges (`_shift_plan`); it is asked again when a robot stops, or has nothing to do while others have. Whatever the plan
says, no robot enters a row that is closed or in which another one is, or without the battery to come out again.
"""

from __future__ import annotations

import time as clock
from collections.abc import Collection
from datetime import UTC, datetime, timedelta
from itertools import groupby
from math import ceil
from pathlib import Path
from typing import Any, cast

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session, selectinload

from anther.core.errors import bad_input
from anther.core.records import decode, encode
from anther.history._database import DEFAULT, open_reader, open_writer
from anther.history._row_records import SURE, Stem
from anther.history._shift_plan import CHARGE, Leg, RobotNow, assign_legs
from anther.history._shift_records import TOW, Order, Report, Shift, StemResult, Work
from anther.history._tables import RowSide, ShiftRobot, ShiftRow, ShiftStem, StemRow
from anther.history._trials import add
from anther.history.row_map import stems_of
from anther.plant.visit import result_words


def begin_shift(shift: Shift, where: Path | str = DEFAULT) -> int:
    """Add a shift with all stems of its house, and return its number.

    Raises:
        InputError: the house has no stem in the history, or a block or robot names a row that it does not have.
    """
    with open_writer(where) as session:
        stems = stems_of(session, shift.house)
        rows = {stem.row for stem in stems}
        asked = [*(block.row for block in shift.blocks), *(row for robot in shift.robots for row in robot.rows)]
        unknown = [row for row in asked if row not in rows]
        if unknown or not rows:
            given = f"row '{unknown[0]}'" if rows else f"house '{shift.house}'"
            allowed = f"of rows with stems: {', '.join(sorted(rows)) or 'none'}"
            raise bad_input("shift", given=given, allowed=allowed, do="Record the house and a pass along its rows.")
        row = ShiftRow(house=shift.house, asked=encode(shift))
        session.add(row)
        session.flush()
        for robot in shift.robots:
            stands = {"free": shift.begin, "battery": robot.battery, "charging": False, "steps": []}
            session.add(ShiftRobot(shift_id=row.id, name=robot.name, **stands))
        reasons = {stem.number: _why_not(stem, shift) for stem in stems}
        due = [stem for stem in stems if reasons[stem.number] is None]
        places = {n: (leg, k) for leg, part in enumerate(_legs(due, shift)) for k, n in enumerate(part)}
        for stem in stems:
            leg, place = places.get(stem.number, (None, None))
            reason = reasons[stem.number]
            state = {"state": "left" if reason else "waiting", "reason": reason, "tries": 0}
            session.add(ShiftStem(shift_id=row.id, stem_id=stem.number, row=stem.row, leg=leg, place=place, **state))
        return row.id


def _why_not(stem: Stem, shift: Shift) -> str | None:
    """Return why a stem is not due; None if it is. One that may be another has no dose that is known to be its own."""
    if stem.open_flowers == 0:
        return "no open flower"
    if stem.last_dose is None or stem.certainty < SURE:
        return None
    day = stem.last_dose.astimezone(shift.begin.tzinfo).date()
    return f"dosed on {day}" if (shift.begin.date() - day).days < shift.days else None


def _legs(stems: list[Stem], shift: Shift) -> list[list[int]]:
    """Return numbers of stems in the order of the work: in along the left, out along the right, in equal parts."""
    legs = []
    leg = 2_700.0  # s of work: short beside a battery's hours, long beside entering a row (a guess)
    for _, group in groupby(sorted(stems, key=lambda s: s.row), key=lambda s: s.row):
        way = sorted(group, key=lambda s: (s.side != "left", s.hook if s.side == "left" else -s.hook))
        size = ceil(len(way) / ceil(len(way) * shift.stem / leg))
        legs += [[s.number for s in way[k : k + size]] for k in range(0, len(way), size)]
    return legs


def run_shift(
    number: int,
    work: Work,
    where: Path | str = DEFAULT,
    *,
    robots: Collection[str] | None = None,
    simulated: bool = False,
) -> list[StemResult]:
    """Give orders to robots until every stem is visited or left with its reason; return what became of each.

    A stem at which a program was killed is tried again, twice in all.

    Args:
        number: of the shift.
        work: carries out one order and returns its report; with several real robots, run a program for each.
        where: the history.
        robots: of which robots; None for all of the shift.
        simulated: the reports' times are the clock, and nothing is waited for.

    Raises:
        InputError: no such shift or robot.
        MissingExtra: OR-Tools is not installed.
    """
    names, asked = _resume(number, where, robots)
    pause = 5.0  # s that a program which waits sleeps at a time
    while True:
        order = _advance(number, where, names, None if simulated else datetime.now(UTC))
        if order is None:
            break
        if isinstance(order, Order):
            note_report(number, order, work(order), where)
        elif order is _Replan:
            _plan(number, where)
        elif not simulated:
            clock.sleep(pause)
    _close(number, where, late=not simulated and datetime.now(UTC) >= asked.end)
    return read_shift(number, where)


class _Replan:
    """What `_advance` returns where somebody is idle while there is work for others, and at the begin."""


class _Wait:
    """What `_advance` returns where nobody can do anything yet."""


def read_shift(number: int, where: Path | str = DEFAULT) -> list[StemResult]:
    """Return what became of every stem of a shift, by row, side and hook.

    Raises:
        InputError: no such shift.
    """
    query = select(ShiftStem, StemRow, RowSide).join(StemRow, StemRow.id == ShiftStem.stem_id)
    query = query.join(RowSide, RowSide.id == StemRow.row_side_id).where(ShiftStem.shift_id == number)
    with open_reader(where) as session:
        found = [] if session is None else session.execute(query.order_by(RowSide.id, StemRow.order)).all()
        if not found:
            raise _no_shift(number)
        return [
            StemResult(s.plant.label, of.row, of.side, s.order, w.state, w.reason, w.robot, w.visit_id)
            for w, s, of in found
        ]


def find_unfinished_shift(house: str, where: Path | str = DEFAULT) -> int | None:
    """Return the number of the last shift in a house that still has stems to visit, to go on with it; None: none."""
    query = select(func.max(ShiftRow.id)).join(ShiftStem, ShiftStem.shift_id == ShiftRow.id)
    query = query.where(ShiftRow.house == house, ShiftStem.state.in_(("waiting", "working")))
    with open_reader(where) as session:
        return None if session is None else session.scalar(query)


def stop_robot(
    number: int, robot: str, reason: str, where: Path | str = DEFAULT, *, time: datetime | None = None
) -> None:
    """Say that a robot takes no further part in a shift; its row is blocked for a while, its legs go to others.

    Args:
        number: of the shift.
        robot: its name.
        reason: why it stopped.
        where: the history.
        time: since when people know, who are to fetch it: its row is blocked until `TOW` later. By default now; of a
            shift that is simulated, by its clock.

    Raises:
        InputError: no such shift or robot.
    """
    with open_writer(where) as session:
        _, _, robots = _state(session, number)
        _check_robots([robot], robots)
        robots[robot].free = max(robots[robot].free, time or datetime.now(UTC))
        _stop(session, robots[robot], reason)


def _check_robots(names: Collection[str], robots: Collection[str]) -> None:
    if unknown := sorted(set(names) - set(robots)):
        raise bad_input("robot", given=f"'{unknown[0]}'", allowed=", ".join(robots), do="Name one of the shift's.")


def _stop(session: Session, robot: ShiftRobot, reason: str) -> None:
    robot.stopped, robot.steps = reason[:200] or "stopped", []
    for stem in _working(session, robot.shift_id):
        if stem.robot == robot.name:
            _try_again(stem, "interrupted")
    session.get_one(ShiftRow, robot.shift_id).planned = None


def _no_shift(number: int) -> Exception:
    return bad_input("shift", given=f"{number}", allowed="the number of a shift", do="Begin one first.")


def _state(session: Session, number: int) -> tuple[ShiftRow, Shift, dict[str, ShiftRobot]]:
    """Return a shift, locked for this transaction, and its robots by name."""
    row = session.get(ShiftRow, number, with_for_update=True)
    if row is None:
        raise _no_shift(number)
    robots = session.scalars(select(ShiftRobot).where(ShiftRobot.shift_id == number).order_by(ShiftRobot.id))
    return row, decode(row.asked, Shift), {robot.name: robot for robot in robots}


def _resume(number: int, where: Path | str, names: Collection[str] | None) -> tuple[list[str], Shift]:
    """Take up a shift: what its robots had begun and not reported waits again, or is left after two tries."""
    with open_writer(where) as session:
        _, shift, robots = _state(session, number)
        _check_robots(names or (), robots)
        mine = list(names if names is not None else robots)
        for stem in _working(session, number):
            if stem.robot in mine:
                _try_again(stem, "interrupted")
        return mine, shift


def _working(session: Session, number: int) -> list[ShiftStem]:
    query = select(ShiftStem).where(ShiftStem.shift_id == number, ShiftStem.state == "working")
    return list(session.scalars(query))


def _try_again(stem: ShiftStem, why: str) -> None:
    tries = 2  # a stem at which a robot stopped may have been shaken
    stem.state = "waiting" if stem.tries < tries else "left"
    stem.reason, stem.robot = (None, None) if stem.state == "waiting" else (f"{why} {stem.tries} times", stem.robot)


def _advance(number: int, where: Path | str, names: list[str], now: datetime | None) -> Order | type | None:
    """Let the robot that is free first do its next step; return its order, that it waits, that a plan is due, or None.

    Args:
        number, where, names: see `run_shift`.
        now: None: each robot's own time.
    """
    with open_writer(where) as session:
        row, shift, robots = _state(session, number)
        mine = [robots[name] for name in names if not robots[name].stopped and robots[name].free < shift.end]
        waiting = _waiting(session, number)
        if not mine or (now is not None and now >= shift.end):
            return None
        if not waiting:  # what another program works at may come back
            return _Wait if any(_working(session, number)) else None
        if row.planned is None:
            return _Replan
        robot = min(mine, key=lambda r: r.free)
        if now is not None and robot.free > now:
            return _Wait
        robot.free = max(robot.free, now or robot.free)
        order = _next_step(session, shift, robot, robots, waiting)
        if order is None and not robot.charging:
            return _idle(shift, row.planned, robot, robots, waiting)
        return order or _Wait


def _idle(
    shift: Shift, planned: datetime, robot: ShiftRobot, robots: dict[str, ShiftRobot], waiting: dict[int, Any]
) -> type:
    """Let a robot wait that can do nothing; a plan is due if it could do what others are to do later."""
    others = {n for r in robots.values() if r is not robot for n in r.steps if n in waiting and n != r.leg}
    replan_every = timedelta(minutes=10)  # a plan is not made anew more often because somebody is idle
    if robot.free >= planned + replan_every and any(
        _may_enter(shift, robot, robots, waiting[leg][0]) for leg in others
    ):
        return _Replan
    robot.leg, robot.free = None, _wait_until(shift, robot, robots, waiting)  # out of the row
    return _Wait


def _waiting(session: Session, number: int) -> dict[int, tuple[str, int]]:
    """Return leg -> row and number of the stems that wait in it."""
    query = select(ShiftStem.leg, ShiftStem.row, func.count()).group_by(ShiftStem.leg, ShiftStem.row)
    query = query.where(ShiftStem.shift_id == number, ShiftStem.state == "waiting").order_by(ShiftStem.leg)
    return {cast(int, leg): (row, count) for leg, row, count in session.execute(query)}


def _next_step(
    session: Session, shift: Shift, robot: ShiftRobot, robots: dict[str, ShiftRobot], waiting: dict[int, Any]
) -> Order | None:
    """Return the next order of a robot, or None: it charges, which sets `charging`, or can do nothing now."""
    full = _of(shift, robot)
    robot.charging = False
    robot.steps = [n for n in robot.steps if n == CHARGE or n in waiting]
    planned = {n for r in robots.values() if not r.stopped for n in (*r.steps, r.leg)}
    spare = [leg for leg in waiting if leg not in planned]
    for step in (*([robot.leg] if robot.leg in waiting else []), *robot.steps, *spare):
        if step == CHARGE:
            if robot.battery < 0.95 * full.battery and _charge(shift, robot, robots):
                return None
            continue
        row, enters = waiting[step][0], step != robot.leg
        if not _may_enter(shift, robot, robots, row):
            continue
        if robot.battery < shift.stem + 2 * shift.entry:
            _charge(shift, robot, robots)
            return None
        robot.leg = step
        return _begin(session, shift, robot, step, enters)
    return None


def _of(shift: Shift, robot: ShiftRobot) -> Any:
    return next(r for r in shift.robots if r.name == robot.name)


def _charge(shift: Shift, robot: ShiftRobot, robots: dict[str, ShiftRobot]) -> bool:
    """Send a robot to a charger, if one is free, until it is full."""
    busy = sum(r.charging and r.free > robot.free for r in robots.values())
    if busy >= shift.chargers:
        return False
    full = _of(shift, robot)
    seconds = full.charge * max(1 - robot.battery / full.battery, 0.0) + shift.entry
    robot.free += timedelta(seconds=seconds)
    robot.battery, robot.charging, robot.leg = full.battery, True, None
    first = robot.steps.index(CHARGE) if CHARGE in robot.steps else len(robot.steps)
    robot.steps = [n for k, n in enumerate(robot.steps) if k != first]
    return True


def _closed(shift: Shift, robots: dict[str, ShiftRobot], row: str) -> list[tuple[datetime, datetime, str]]:
    """Return when a row is closed, also by robots that stand in it: until they are fetched, whenever they stopped."""
    standing = [r for r in robots.values() if r.stopped and r.leg is not None and r.row == row]
    stopped = [(shift.begin, r.free + TOW, f"robot {r.name} stands in it: {r.stopped}") for r in standing]
    return shift.closures(row) + stopped


def _may_enter(shift: Shift, robot: ShiftRobot, robots: dict[str, ShiftRobot], row: str) -> bool:
    """Return whether a robot, from when it is free, has time for a stem in a row and for its way in or out."""
    begin, end = robot.free, robot.free + timedelta(seconds=shift.stem + shift.entry)
    allowed = _of(shift, robot).rows
    if (allowed and row not in allowed) or end > shift.end:
        return False
    if any(r.row == row and r.leg is not None and not r.stopped for r in robots.values() if r is not robot):
        return False
    return not any(b < end and begin < e for b, e, _ in _closed(shift, robots, row))


def _begin(session: Session, shift: Shift, robot: ShiftRobot, leg: int, enters: bool) -> Order:
    """Mark the next stem of a leg as being worked on, and return the order."""
    query = select(ShiftStem).where(ShiftStem.shift_id == robot.shift_id, ShiftStem.leg == leg)
    query = query.where(ShiftStem.state == "waiting").order_by(ShiftStem.place).limit(1)
    following = session.scalars(query.options(selectinload(ShiftStem.stem))).one()
    stem, plant = following.stem, following.stem.plant
    side = session.get_one(RowSide, stem.row_side_id)
    following.state, following.robot, following.tries = "working", robot.name, following.tries + 1
    robot.row = following.row
    where = side.house, side.row, side.side, stem.order, stem.position
    return Order(robot.shift_id, robot.name, plant.species, plant.label, *where, robot.free, enters)


def _wait_until(shift: Shift, robot: ShiftRobot, robots: dict[str, ShiftRobot], waiting: dict[int, Any]) -> datetime:
    """Return when to look again: a row opens or closes, or another robot is free; at last the shift's end."""
    times = [
        t for row in {row for row, _ in waiting.values()} for b, e, _ in _closed(shift, robots, row) for t in (b, e)
    ]
    busy = [r for r in robots.values() if r is not robot and not r.stopped and (r.leg is not None or r.charging)]
    look_every = timedelta(minutes=1)  # a robot that can do nothing looks whether others left a row or charger
    times += [max(r.free, robot.free) + look_every for r in busy]
    return min((t for t in times if t > robot.free), default=shift.end)


def note_report(number: int, order: Order, report: Report, where: Path | str = DEFAULT) -> None:
    """Note what a robot reported, with its visit, in one transaction.

    Raises:
        InputError: the visit is of another plant than the order.
    """
    visit = report.visit
    if (visit.species, visit.plant) != (order.species, order.plant):
        given, allowed = f"a visit to {visit.species} '{visit.plant}'", f"{order.species} '{order.plant}'"
        raise bad_input("report", given=given, allowed=allowed, do="Report on the plant that was ordered.")
    with open_writer(where) as session:
        _, _, robots = _state(session, number)
        robot = robots[order.robot]
        (visited,) = (stem for stem in _working(session, number) if stem.robot == robot.name)
        visited.visit_id = add(session, visit)[0]
        if visit.failure in ("device_fault", "interrupted"):
            _try_again(visited, visit.failure.replace("_", " "))
        else:
            visited.state = "visited"
            visited.reason = result_words(visit.held_unharmed, visit.flowers_moved, visit.failure)
        robot.battery = max(robot.battery - (report.ended - order.begin).total_seconds(), 0.0)
        robot.free = max(report.ended, robot.free)
        session.flush()
        if report.stopped is not None:
            _stop(session, robot, report.stopped)
        elif robot.leg not in _waiting(session, number):
            robot.leg = None


def _plan(number: int, where: Path | str) -> None:
    """Plan what is left. The plan is made outside any transaction: it only says what robots should do first."""
    with open_writer(where) as session:
        row, shift, robots = _state(session, number)
        live = [robot for robot in robots.values() if not robot.stopped]
        now = min((robot.free for robot in live), default=shift.end)
        row.planned, waiting = now, _waiting(session, number)
        closed = {of: _closed(shift, robots, of) for of, _ in waiting.values()}
        legs = [
            Leg(leg, of, n, ceil(n * shift.stem + shift.entry), _free_spans(shift, closed[of]))
            for leg, (of, n) in waiting.items()
        ]
        stands = [_robot_now(shift, robot) for robot in live]
    steps = assign_legs(legs, stands, shift.chargers)
    with open_writer(where) as session:
        for name, robot in _state(session, number)[2].items():
            robot.steps = [] if robot.stopped else steps.get(name, [])


def _robot_now(shift: Shift, robot: ShiftRobot) -> RobotNow:
    of = _of(shift, robot)
    free = ceil((robot.free - shift.begin).total_seconds())
    return RobotNow(
        robot.name, free, max(int(robot.battery - shift.entry), 0), int(of.battery - shift.entry), ceil(of.charge),
        of.rows, robot.leg,
    )  # fmt: skip


def _free_spans(shift: Shift, closed: list[tuple[datetime, datetime, str]]) -> tuple[tuple[int, int], ...]:
    """Return when a row is open, since the shift's begin [s]."""
    at, spans = shift.begin, []
    for begin, end, _ in sorted(closed):
        if begin > at:
            spans.append((at, min(begin, shift.end)))
        at = max(at, end)
    spans.append((at, shift.end))
    seconds = (tuple(int((t - shift.begin).total_seconds()) for t in span) for span in spans if span[0] < span[1])
    return tuple((begin, end) for begin, end in seconds)


def _close(number: int, where: Path | str, *, late: bool) -> None:
    """When all robots are done, give each stem that still waits its reason."""
    with open_writer(where) as session:
        _, shift, robots = _state(session, number)
        if any(not robot.stopped and robot.free < shift.end and not late for robot in robots.values()):
            return
        stopped = [f"{robot.name}: {robot.stopped}" for robot in robots.values() if robot.stopped]
        for row in {row for row, _ in _waiting(session, number).values()}:
            spans = _free_spans(shift, closed := _closed(shift, robots, row))
            if sum(end - begin for begin, end in spans) < shift.entry + shift.stem:
                reason = max(closed, key=lambda c: c[1] - c[0])[2]
            elif len(stopped) == len(robots):
                reason = f"no robot was left ({'; '.join(stopped)})"
            else:
                reason = f"not reached by {shift.end:%H:%M}"
            of_row = update(ShiftStem).where(ShiftStem.shift_id == number, ShiftStem.row == row)
            session.execute(of_row.where(ShiftStem.state == "waiting").values(state="left", reason=reason))
