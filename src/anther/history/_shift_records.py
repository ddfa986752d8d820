"""Records of a shift: what it is to do and under which conditions, an order to a robot, and what became of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, time, timedelta
from typing import Annotated, NamedTuple

from anther.core.errors import bad_input
from anther.core.records import Range, Record, Stored
from anther.plant.visit import Visit

TOW = timedelta(minutes=30)
"""How long a robot that stopped blocks its row (a guess)."""
Seconds = Annotated[float, Range(1, 1e6, "s")]


@dataclass(frozen=True, slots=True)
class Robot(Record):
    """A robot of a shift.

    Attributes:
        name: as its visits say.
        battery: how long a full one lasts.
        charge: from empty to full.
        rows: names of the rows it may enter; () for all.
    """

    CALLED = "robot."
    name: str
    battery: Seconds = 19_800.0
    charge: Seconds = 5_400.0
    rows: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Block(Record):
    """A time when no robot may be in a row, e.g. because people work there."""

    row: str
    begin: datetime
    end: datetime
    reason: str = "people in the row"


@dataclass(frozen=True, slots=True)
class Climate(Record):
    """Measured or forecast air, which holds until the next one."""

    time: datetime
    temperature: Annotated[float, Range(-50, 80, "°C")]
    humidity: Annotated[float, Range(0, 100, "%")]

    @property
    def bad(self) -> str | None:
        """Why pollen is not shed in it; None if it is."""
        sheds = (18.0, 32.0)  # °C between which pollen is shed and germinates (facts: pollination, 1d)
        if not sheds[0] <= self.temperature <= sheds[1]:
            return f"{self.temperature:g} °C"
        dampest = 80.0  # %, above which pollen clumps (facts: pollination, 1d)
        return f"{self.humidity:g} % humidity" if self.humidity > dampest else None


@dataclass(frozen=True, slots=True)
class Shift(Stored):
    """A day's work of robots in a house.

    Attributes:
        house: as recorded.
        begin, end: of the shift, on one day of their time zone.
        robots: which take part.
        blocks: of rows.
        climate: in the order of time; () for unknown, which is taken as good.
        hours: of the day between which flowers are worth a visit [h].
        days: after how many days a stem is due again.
        chargers: how many robots can charge at once.
        stem: time a stem takes [s].
        entry: time that leaving one row and entering the next takes [s].
    """

    KIND, SCHEMA = "shift", 1
    house: str
    begin: datetime
    end: datetime
    robots: tuple[Robot, ...]
    blocks: tuple[Block, ...] = ()
    climate: tuple[Climate, ...] = ()
    hours: tuple[float, float] = (10.0, 16.0)
    days: Annotated[int, Range(1, 30)] = 2
    chargers: Annotated[int, Range(1, 1000)] = 1
    stem: Seconds = 12.0
    entry: Seconds = 120.0

    def _check(self) -> None:
        times = (
            self.begin,
            self.end,
            *(t for b in self.blocks for t in (b.begin, b.end)),
            *(c.time for c in self.climate),
        )
        if any(t.tzinfo is None for t in times):
            raise bad_input("shift", given="a time without zone", allowed="times with zone", do="State the zone.")
        if not self.begin < self.end or self.begin.date() != self.end.astimezone(self.begin.tzinfo).date():
            given = f"{self.begin:%Y-%m-%d %H:%M} to {self.end:%Y-%m-%d %H:%M}"
            raise bad_input("shift", given=given, allowed="a begin before an end on one day", do="Correct the times.")
        names = [robot.name for robot in self.robots]
        if not names or len(set(names)) < len(names):
            given = ", ".join(names) or "no robot"
            raise bad_input("shift", given=given, allowed="one robot or more, each name once", do="Name them.")
        least = self.stem + 3 * self.entry
        if weak := [robot for robot in self.robots if robot.battery < least]:
            given, allowed = f"{weak[0].battery:g} s", f"at least {least:g} s, for a stem and three entries"
            raise bad_input(f"battery of robot {weak[0].name}", given=given, allowed=allowed, do="Correct it.")
        if list(self.climate) != sorted(self.climate, key=lambda c: c.time):
            raise bad_input("climate", given="readings out of order", allowed="one after another", do="Sort them.")

    def closures(self, row: str) -> list[tuple[datetime, datetime, str]]:
        """Return when no robot may work in a row, and why."""
        day = datetime.combine(self.begin.date(), time(), self.begin.tzinfo)
        first, last = (day + timedelta(hours=h) for h in self.hours)
        found = [(b.begin, b.end, b.reason) for b in self.blocks if b.row == row]
        hours = f"not between {self.hours[0]:g} and {self.hours[1]:g} h"
        found += [(min(self.begin, first), first, hours), (last, max(self.end, last), hours)]
        ends = [*(c.time for c in self.climate[1:]), self.end]
        found += [(c.time, end, bad) for c, end in zip(self.climate, ends, strict=False) if (bad := c.bad)]
        return [(begin, end, reason) for begin, end, reason in found if begin < end]


class Order(NamedTuple):
    """One stem for one robot: hook and position say where to look for it; `begin` is when the robot sets out."""

    shift: int
    robot: str
    species: str
    plant: str
    house: str
    row: str
    side: str
    hook: int
    position: float
    begin: datetime
    enters: bool


class Report(NamedTuple):
    """What a robot did: its visit, when it was free again, and why it cannot go on, if so."""

    visit: Visit
    ended: datetime
    stopped: str | None = None


Work = Callable[[Order], Report]
"""A robot, or what is drawn in its place: visits one stem and reports."""


class StemResult(NamedTuple):
    """What became of a stem in a shift.

    Attributes:
        plant, row, side, hook: which.
        state: "waiting" or "working" while the shift lasts; at its end "visited", or "left".
        reason: why it was left, or in what the visit ended.
        robot, visit: whose visit, and its number; None without one.
    """

    plant: str
    row: str
    side: str
    hook: int
    state: str
    reason: str | None
    robot: str | None
    visit: int | None
