"""The tables of the trial history, for SQLAlchemy. Units are in the names of the columns.

One plant has many visits; a visit has at most one grasp and one shake, a response of every flower, and links to its run
folder; outcomes belong to a plant, and to one of its visits where the grower says so. The tables themselves are made by
`migrations`, which a test holds equal to these classes.
"""

from __future__ import annotations

from datetime import UTC, date, datetime
from typing import Any

from sqlalchemy import JSON, DateTime, Double, ForeignKey, Text, TypeDecorator, UniqueConstraint
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


class Visit(Base):
    """One trial at a plant. The materials are `plant.Material` as JSON, so that a new property needs no new column."""

    __tablename__ = "visits"
    id: Mapped[int] = mapped_column(primary_key=True)
    plant_id: Mapped[int] = mapped_column(ForeignKey("plants.id"), index=True)
    time: Mapped[datetime] = mapped_column(index=True)
    success: Mapped[bool]
    failure: Mapped[str | None]
    run: Mapped[str | None]
    material_before: Mapped[Any] = mapped_column(nullable=True)
    material_after: Mapped[Any] = mapped_column(nullable=True)
    plant: Mapped[Plant] = relationship(lazy="joined", innerjoin=True)
    grasp: Mapped[Grasp | None] = relationship(lazy="selectin", uselist=False)
    shake: Mapped[Shake | None] = relationship(lazy="selectin", uselist=False)
    responses: Mapped[list[Response]] = relationship(lazy="selectin", order_by="Response.flower")


class Grasp(Base):
    """Where the plant was held."""

    __tablename__ = "grasps"
    id: Mapped[int] = mapped_column(primary_key=True)
    visit_id: Mapped[int] = mapped_column(ForeignKey("visits.id"), unique=True)
    arc_length_m: Mapped[float | None]
    stem_diameter_m: Mapped[float | None]
    confidence: Mapped[float | None]
    organ: Mapped[str | None]
    pose7: Mapped[Any] = mapped_column(nullable=True)


class Shake(Base):
    """How it was shaken."""

    __tablename__ = "shakes"
    id: Mapped[int] = mapped_column(primary_key=True)
    visit_id: Mapped[int] = mapped_column(ForeignKey("visits.id"), unique=True)
    frequency_hz: Mapped[float]
    amplitude_m: Mapped[float]
    duration_s: Mapped[float | None]
    waveform: Mapped[str | None]
    direction: Mapped[Any] = mapped_column(nullable=True)


class Response(Base):
    """How one flower answered; null where it was not predicted or not measurable."""

    __tablename__ = "responses"
    __table_args__ = (UniqueConstraint("visit_id", "flower"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    visit_id: Mapped[int] = mapped_column(ForeignKey("visits.id"))
    flower: Mapped[int]
    predicted_amplitude_m: Mapped[float | None]
    measured_amplitude_m: Mapped[float | None]
    measured_amplitude_std_m: Mapped[float | None]
    predicted_acceleration_ms2: Mapped[float | None]
    measured_acceleration_ms2: Mapped[float | None]


class FruitSet(Base):
    """How many flowers of a plant set fruit, as the grower counted; nothing is ever overwritten."""

    __tablename__ = "outcomes"
    id: Mapped[int] = mapped_column(primary_key=True)
    plant_id: Mapped[int] = mapped_column(ForeignKey("plants.id"), index=True)
    visit_id: Mapped[int | None] = mapped_column(ForeignKey("visits.id"))
    date: Mapped[date]
    flowers: Mapped[int]
    fruit: Mapped[int]
    note: Mapped[str]
    recorded: Mapped[datetime]
    plant: Mapped[Plant] = relationship(lazy="joined", innerjoin=True)
