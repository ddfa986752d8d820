"""Trial history: every trial, kept in one SQLite file that several processes may write at once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import JSON, Boolean, Engine, String, create_engine, event, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column
from sqlalchemy.schema import CreateIndex, CreateTable

from anther.errors import AntherError, bad_input
from anther.plant import Material

DEFAULT = Path("runs/history.sqlite")
PATIENCE = 30.0
"""How long a writer waits for another one to finish [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class TrialRecord:
    """One trial as the history keeps it.

    Attributes:
        species: "tomato", "pepper", or whatever the user calls the crop.
        plant: label of the plant: a row and number in the greenhouse, or the seed of a simulated one.
        success: whether the shake was carried out and no limit was passed.
        failure: kind of failure (`errors.FailureKind`), or None.
        grasp: what was grasped, e.g. pose7 and arc_length [m].
        shake: what was planned, e.g. frequency [Hz], amplitude [m], direction.
        predicted_amplitude, measured_amplitude: of each flower [m]; NaN where not measurable.
        material: what was believed of the plant after the trial, or None.
        run: its run folder, or None.
        time: when it began, UTC.
        id: given by the history; None before it is recorded.
    """

    species: str
    plant: str
    success: bool
    failure: str | None = None
    grasp: dict[str, Any] = field(default_factory=dict)
    shake: dict[str, Any] = field(default_factory=dict)
    predicted_amplitude: tuple[float, ...] = ()
    measured_amplitude: tuple[float, ...] = ()
    material: Material | None = None
    run: str | None = None
    time: datetime = field(default_factory=lambda: datetime.now(UTC))
    id: int | None = None

    def __post_init__(self) -> None:
        for name in ("species", "plant"):
            value = getattr(self, name)
            if not 0 < len(value) <= 200:
                raise bad_input(name, given=f"{len(value)} characters", allowed="1 to 200", do="Name it briefly.")
        if self.time.tzinfo is None:
            raise bad_input("trial time", given="a time without zone", allowed="a time with zone", do="Use UTC.")


class _Base(DeclarativeBase):
    pass


class _Trial(_Base):
    __tablename__ = "trials"
    id: Mapped[int] = mapped_column(primary_key=True)
    time: Mapped[str] = mapped_column(String, index=True)
    species: Mapped[str] = mapped_column(String, index=True)
    plant: Mapped[str] = mapped_column(String, index=True)
    success: Mapped[bool] = mapped_column(Boolean)
    failure: Mapped[str | None] = mapped_column(String)
    run: Mapped[str | None] = mapped_column(String)
    grasp: Mapped[Any] = mapped_column(JSON)
    shake: Mapped[Any] = mapped_column(JSON)
    predicted_amplitude: Mapped[Any] = mapped_column(JSON)
    measured_amplitude: Mapped[Any] = mapped_column(JSON)
    material: Mapped[Any] = mapped_column(JSON(none_as_null=True), nullable=True)


def record_trial(record: TrialRecord, path: Path | str = DEFAULT) -> int:
    """Add one trial to the history and return its id. The file is made when it is missing.

    The write is one transaction: after a crash it is either there or not. Writers wait for each other, up to
    `PATIENCE` seconds.

    Raises:
        InputError: the file is no trial history, or cannot be written.
    """
    row = asdict(record)
    row.pop("id")
    row["time"] = record.time.astimezone(UTC).isoformat(timespec="microseconds")
    for name in ("predicted_amplitude", "measured_amplitude"):
        row[name] = [float(v) if np.isfinite(v) else None for v in row[name]]
    with _session(Path(path)) as session:
        trial = _Trial(**row)
        session.add(trial)
        session.commit()
        return trial.id


def read_trials(
    path: Path | str = DEFAULT, *, species: str | None = None, plant: str | None = None
) -> list[TrialRecord]:
    """Return the recorded trials, oldest first; none when the file does not exist.

    Args:
        path: the history's file.
        species, plant: only trials with these labels.

    Raises:
        InputError: the file is no trial history.
    """
    if not Path(path).exists():
        return []
    query = select(_Trial).order_by(_Trial.time, _Trial.id)
    query = query.where(_Trial.species == species) if species is not None else query
    query = query.where(_Trial.plant == plant) if plant is not None else query
    with _session(Path(path)) as session:
        return [_record(trial) for trial in session.scalars(query)]


def _record(trial: _Trial) -> TrialRecord:
    return TrialRecord(
        species=trial.species,
        plant=trial.plant,
        success=trial.success,
        failure=trial.failure,
        grasp=trial.grasp,
        shake=trial.shake,
        predicted_amplitude=_numbers(trial.predicted_amplitude),
        measured_amplitude=_numbers(trial.measured_amplitude),
        material=None if trial.material is None else Material(**trial.material),
        run=trial.run,
        time=datetime.fromisoformat(trial.time),
        id=trial.id,
    )


def _numbers(values: list[float | None]) -> tuple[float, ...]:
    return tuple(float("nan") if v is None else float(v) for v in values)


@contextmanager
def _session(path: Path) -> Iterator[Session]:
    engine = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        engine = _engine(path)
        _make_tables(engine)
        with Session(engine) as session:
            yield session
    except (SQLAlchemyError, OSError) as error:
        if isinstance(error, AntherError):
            raise
        cause = getattr(error, "orig", None) or error
        raise bad_input(
            f"trial history {path}",
            given=f"{cause}",
            allowed="a SQLite file of Anther's in a folder that can be written",
            do="Check the path, free space and rights, or whether another process holds it.",
        ) from error
    finally:
        if engine is not None:
            engine.dispose()


def _make_tables(engine: Engine) -> None:
    """Make what is missing. SQL itself says "if not exists": asking first would race with another process."""
    with engine.begin() as connection:
        for table in _Base.metadata.sorted_tables:
            connection.execute(CreateTable(table, if_not_exists=True))
            for index in table.indexes:
                connection.execute(CreateIndex(index, if_not_exists=True))


def _engine(path: Path) -> Engine:
    write = partial(json.dumps, allow_nan=False, default=lambda value: value.tolist())  # numpy as numbers and lists
    engine = create_engine(f"sqlite:///{path}", connect_args={"timeout": PATIENCE}, json_serializer=write)

    @event.listens_for(engine, "connect")
    def configure(connection: Any, _: Any) -> None:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")

    return engine
