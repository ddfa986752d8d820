"""The tables of the trial history, for SQLAlchemy. Units are in the names of the columns.

One plant has many visits; a visit has at most one grasp and one shake, a response of every flower, and links to its run
folder; outcomes belong to a plant, and to one of its visits where the grower says so. A sweep has many jobs, which
have no visits. A side of a row has many stems, each a plant on a hook; a shift has many stems and robots. Visits,
responses, outcomes and notes are never changed. What a `Visit` or `Outcome` has too is called here as there; its
column is called as in trial.json, with the unit in its name.
"""

from __future__ import annotations

from datetime import UTC, date, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    CheckConstraint,
    ColumnElement,
    DateTime,
    Double,
    ForeignKey,
    Index,
    Text,
    TypeDecorator,
    UniqueConstraint,
    and_,
    false,
    func,
    not_,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship


class Utc(TypeDecorator[datetime]):
    """A moment: timestamptz in PostgreSQL; UTC without its zone in SQLite, which has no zones."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Any) -> datetime | None:
        """Return the moment as the database takes it."""
        if value is None:
            return None
        moment = value.astimezone(UTC)
        return moment.replace(tzinfo=None) if dialect.name == "sqlite" else moment

    def process_result_value(self, value: datetime | None, dialect: Any) -> datetime | None:
        """Return the moment in UTC."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Base(DeclarativeBase):
    """Common base of the tables."""

    type_annotation_map = {float: Double, str: Text, datetime: Utc, Any: JSON(none_as_null=True)}  # noqa: RUF012


class Plant(Base):
    """A plant, known by its species and label."""

    __tablename__ = "plants"
    __table_args__ = (UniqueConstraint("species", "label"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    species: Mapped[str]
    label: Mapped[str]


class VisitRow(Base):
    """One trial at a plant. The materials are `plant.Material` as JSON, so that a new property needs no new column.

    Plant, time (by the robot's own clock) and robot name a visit in every history it is in.
    """

    __tablename__ = "visits"
    __table_args__ = (
        Index("ix_visits_plant", "plant_id", "time", "robot", unique=True),
        # trends read this index alone
        Index("ix_visits_time", "time", "robot", "held_unharmed", "flowers_moved", "failure", "acceleration_ms2"),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    plant_id: Mapped[int] = mapped_column(ForeignKey("plants.id"))
    robot: Mapped[str] = mapped_column(server_default="")
    time: Mapped[datetime]
    held_unharmed: Mapped[bool]
    flowers_moved: Mapped[bool | None]
    taught: Mapped[bool] = mapped_column(server_default=false())
    acceleration_ms2: Mapped[float | None]
    failure: Mapped[str | None]
    run: Mapped[str | None]
    believed: Mapped[Any] = mapped_column("material_before", nullable=True)
    material: Mapped[Any] = mapped_column("material_after", nullable=True)
    plant: Mapped[Plant] = relationship(lazy="joined", innerjoin=True)
    grasp: Mapped[GraspRow | None] = relationship(lazy="selectin", uselist=False)
    shake: Mapped[ShakeRow | None] = relationship(lazy="selectin", uselist=False)
    responses: Mapped[list[ResponseRow]] = relationship(lazy="selectin", order_by="ResponseRow.flower")


def pollinated() -> ColumnElement[bool]:
    """Return the condition that a visit held the plant, did not harm it, and moved its flowers."""
    return and_(VisitRow.held_unharmed, func.coalesce(VisitRow.flowers_moved, false()))


def with_result(result: str) -> ColumnElement[bool]:
    """Return the condition that a visit has a `Result`, or failed in one way (`errors.FailureKind`)."""
    match result:
        case "pollinated":
            return pollinated()
        case "held":
            return and_(VisitRow.held_unharmed, not_(pollinated()))
        case "failed":
            return not_(VisitRow.held_unharmed)
        case _:
            return VisitRow.failure == result


class GraspRow(Base):
    """Where the plant was held."""

    __tablename__ = "grasps"
    id: Mapped[int] = mapped_column(primary_key=True)
    visit_id: Mapped[int] = mapped_column(ForeignKey("visits.id"), unique=True)
    arc_length: Mapped[float | None] = mapped_column("arc_length_m")
    stem_diameter: Mapped[float | None] = mapped_column("stem_diameter_m")
    confidence: Mapped[float | None]
    organ: Mapped[str | None]
    pose7: Mapped[Any] = mapped_column(nullable=True)


class ShakeRow(Base):
    """How it was shaken."""

    __tablename__ = "shakes"
    id: Mapped[int] = mapped_column(primary_key=True)
    visit_id: Mapped[int] = mapped_column(ForeignKey("visits.id"), unique=True)
    frequency: Mapped[float] = mapped_column("frequency_hz")
    amplitude: Mapped[float] = mapped_column("amplitude_m")
    duration: Mapped[float | None] = mapped_column("duration_s")
    waveform: Mapped[str | None]
    direction: Mapped[Any] = mapped_column(nullable=True)


class ResponseRow(Base):
    """How one flower answered; null where it was not predicted or not measurable."""

    __tablename__ = "responses"
    __table_args__ = (UniqueConstraint("visit_id", "flower"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    visit_id: Mapped[int] = mapped_column(ForeignKey("visits.id"))
    flower: Mapped[int]
    predicted_amplitude: Mapped[float | None] = mapped_column("predicted_amplitude_m")
    measured_amplitude: Mapped[float | None] = mapped_column("measured_amplitude_m")
    measured_amplitude_std: Mapped[float | None] = mapped_column("measured_amplitude_std_m")
    predicted_acceleration: Mapped[float | None] = mapped_column("predicted_acceleration_ms2")
    measured_acceleration: Mapped[float | None] = mapped_column("measured_acceleration_ms2")


class FruitSetRow(Base):
    """How many flowers of a plant set fruit, as the grower counted; nothing is ever overwritten."""

    __tablename__ = "outcomes"
    __table_args__ = (
        Index("ix_outcomes_plant", "plant_id", "recorded"),
        CheckConstraint("0 <= fruit AND fruit <= flowers"),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    plant_id: Mapped[int] = mapped_column(ForeignKey("plants.id"))
    visit_id: Mapped[int | None] = mapped_column(ForeignKey("visits.id"))
    date: Mapped[date]
    flowers: Mapped[int]
    fruit: Mapped[int]
    note: Mapped[str]
    recorded: Mapped[datetime]
    plant: Mapped[Plant] = relationship(lazy="joined", innerjoin=True)


class Sweep(Base):
    """Many runs of one function over the rows of a table (`anther.history.sweep`); `uid` is kept in its folder too."""

    __tablename__ = "sweeps"
    id: Mapped[int] = mapped_column(primary_key=True)
    uid: Mapped[str] = mapped_column(unique=True)
    folder: Mapped[str]
    function: Mapped[str]
    began: Mapped[datetime]


class SweepJob(Base):
    """One row of a sweep's table and what became of it; `row` and `result` are JSON objects."""

    __tablename__ = "sweep_jobs"
    __table_args__ = (UniqueConstraint("sweep_id", "key"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    sweep_id: Mapped[int] = mapped_column(ForeignKey("sweeps.id"))
    key: Mapped[str]
    row: Mapped[Any]
    state: Mapped[str]
    tries: Mapped[int]
    reason: Mapped[str | None]
    result: Mapped[Any] = mapped_column(nullable=True)
    seconds: Mapped[float | None]
    ended: Mapped[datetime | None]


class Note(Base):
    """What somebody wrote about a visit afterwards."""

    __tablename__ = "notes"
    __table_args__ = (Index("ix_notes_visit", "visit_id", "recorded"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    visit_id: Mapped[int] = mapped_column(ForeignKey("visits.id"))
    recorded: Mapped[datetime]
    text: Mapped[str]


class RowSide(Base):
    """One side of a row, and the section of it that was passed last. `posts` are tag -> position [m]."""

    __tablename__ = "row_sides"
    __table_args__ = (UniqueConstraint("house", "row", "side"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    house: Mapped[str]
    row: Mapped[str]
    side: Mapped[str]
    species: Mapped[str]
    posts: Mapped[Any]
    begin: Mapped[float | None] = mapped_column("begin_m")
    end: Mapped[float | None] = mapped_column("end_m")
    passed: Mapped[datetime | None]
    labels: Mapped[int]
    stems: Mapped[list[StemRow]] = relationship(
        lazy="raise",
        order_by="StemRow.order",
        primaryjoin="and_(RowSide.id == StemRow.row_side_id, StemRow.removed.is_(None))",
        viewonly=True,
    )


class StemRow(Base):
    """A stem and the hook that its string hangs from: a hook has one stem as long as it lives.

    The plant's visits and counts are those of the stem.
    """

    __tablename__ = "stems"
    __table_args__ = (Index("ix_stems_row_side", "row_side_id", "removed", "hook"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    row_side_id: Mapped[int] = mapped_column(ForeignKey("row_sides.id"))
    plant_id: Mapped[int] = mapped_column(ForeignKey("plants.id"), unique=True)
    order: Mapped[int] = mapped_column("hook")
    position: Mapped[float] = mapped_column("position_m")
    position_std: Mapped[float] = mapped_column("position_std_m")
    appearance: Mapped[Any] = mapped_column(nullable=True)
    appearance_std: Mapped[Any] = mapped_column(nullable=True)
    certainty: Mapped[float]
    gone: Mapped[float]
    open_flowers: Mapped[int | None]
    fruit: Mapped[int | None]
    first_seen: Mapped[datetime]
    last_seen: Mapped[datetime]
    removed: Mapped[datetime | None]
    plant: Mapped[Plant] = relationship(lazy="joined", innerjoin=True)


class ShiftRow(Base):
    """A shift in a house; `asked` is the `Shift` as JSON."""

    __tablename__ = "shifts"
    id: Mapped[int] = mapped_column(primary_key=True)
    house: Mapped[str]
    asked: Mapped[Any]
    planned: Mapped[datetime | None]


class ShiftRobot(Base):
    """How a robot of a shift stands. `steps` are the legs that it is to go, -1 for the charger, in their order."""

    __tablename__ = "shift_robots"
    __table_args__ = (UniqueConstraint("shift_id", "name"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    shift_id: Mapped[int] = mapped_column(ForeignKey("shifts.id"))
    name: Mapped[str]
    free: Mapped[datetime]
    battery: Mapped[float] = mapped_column("battery_s")
    leg: Mapped[int | None]
    row: Mapped[str | None]
    charging: Mapped[bool]
    steps: Mapped[Any]
    stopped: Mapped[str | None]


class ShiftStem(Base):
    """A stem of a shift: its place in the work, and what became of it."""

    __tablename__ = "shift_stems"
    __table_args__ = (UniqueConstraint("shift_id", "stem_id"), Index("ix_shift_stems", "shift_id", "state", "leg"))
    id: Mapped[int] = mapped_column(primary_key=True)
    shift_id: Mapped[int] = mapped_column(ForeignKey("shifts.id"))
    stem_id: Mapped[int] = mapped_column(ForeignKey("stems.id"))
    row: Mapped[str]
    leg: Mapped[int | None]
    place: Mapped[int | None]
    state: Mapped[str]
    tries: Mapped[int]
    robot: Mapped[str | None]
    visit_id: Mapped[int | None] = mapped_column(ForeignKey("visits.id"))
    reason: Mapped[str | None]
    stem: Mapped[StemRow] = relationship(lazy="raise")
