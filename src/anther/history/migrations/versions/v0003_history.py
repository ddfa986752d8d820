"""Plants, their visits and what was counted, sweeps, and a view for people who write SQL. None before was released."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision, down_revision = "0003", None

TIME = sa.DateTime(timezone=True)
VIEW = (
    "CREATE VIEW trials AS SELECT v.id, v.time, p.species, p.label AS plant, v.success, v.failure, v.run, "
    "g.arc_length_m, s.frequency_hz, s.amplitude_m FROM visits v JOIN plants p ON p.id = v.plant_id "
    "LEFT JOIN grasps g ON g.visit_id = v.id LEFT JOIN shakes s ON s.visit_id = v.id"
)


def upgrade() -> None:
    """Make the tables."""
    _visits()
    _beside()
    op.create_index("ix_visits_plant", "visits", ["plant_id", "time", "robot"], unique=True)
    op.create_index("ix_visits_time", "visits", ["time", "robot", "success", "failure", "acceleration_ms2"])
    op.create_index("ix_plants_taught", "plants", ["species", "taught"])
    op.create_index("ix_outcomes_plant", "outcomes", ["plant_id", "recorded"])
    op.create_index("ix_notes_visit", "notes", ["visit_id", "recorded"])
    op.execute(VIEW)


def _visits() -> None:
    op.create_table(
        "plants",
        _number(),
        sa.Column("species", sa.Text, nullable=False),
        sa.Column("label", sa.Text, nullable=False),
        sa.Column("taught", TIME),
        sa.Column("learned", sa.JSON),
        sa.UniqueConstraint("species", "label"),
    )
    op.create_table(
        "visits",
        _number(),
        _of("plants"),
        sa.Column("robot", sa.Text, nullable=False, server_default=""),
        sa.Column("time", TIME, nullable=False),
        sa.Column("success", sa.Boolean, nullable=False),
        sa.Column("taught", sa.Boolean, nullable=False, server_default=sa.false()),
        sa.Column("acceleration_ms2", sa.Double),
        sa.Column("failure", sa.Text),
        sa.Column("run", sa.Text),
        sa.Column("material_before", sa.JSON),
        sa.Column("material_after", sa.JSON),
    )
    op.create_table(
        "grasps",
        _number(),
        _of("visits", unique=True),
        *(sa.Column(name, sa.Double) for name in ("arc_length_m", "stem_diameter_m", "confidence")),
        sa.Column("organ", sa.Text),
        sa.Column("pose7", sa.JSON),
    )
    op.create_table(
        "shakes",
        _number(),
        _of("visits", unique=True),
        sa.Column("frequency_hz", sa.Double, nullable=False),
        sa.Column("amplitude_m", sa.Double, nullable=False),
        sa.Column("duration_s", sa.Double),
        sa.Column("waveform", sa.Text),
        sa.Column("direction", sa.JSON),
    )
    motions = ("predicted_amplitude_m", "measured_amplitude_m", "measured_amplitude_std_m")
    motions += ("predicted_acceleration_ms2", "measured_acceleration_ms2")
    op.create_table(
        "responses",
        _number(),
        _of("visits"),
        sa.Column("flower", sa.Integer, nullable=False),
        *(sa.Column(name, sa.Double) for name in motions),
        sa.UniqueConstraint("visit_id", "flower"),
    )


def _beside() -> None:
    op.create_table(
        "outcomes",
        _number(),
        _of("plants"),
        sa.Column("visit_id", sa.Integer, sa.ForeignKey("visits.id")),
        sa.Column("date", sa.Date, nullable=False),
        sa.Column("flowers", sa.Integer, nullable=False),
        sa.Column("fruit", sa.Integer, nullable=False),
        sa.Column("note", sa.Text, nullable=False),
        sa.Column("recorded", TIME, nullable=False),
        sa.CheckConstraint("0 <= fruit AND fruit <= flowers"),
    )
    op.create_table(
        "notes",
        _number(),
        _of("visits"),
        sa.Column("recorded", TIME, nullable=False),
        sa.Column("text", sa.Text, nullable=False),
    )
    op.create_table(
        "sweeps",
        _number(),
        sa.Column("uid", sa.Text, nullable=False, unique=True),
        *(sa.Column(name, sa.Text, nullable=False) for name in ("folder", "function")),
        sa.Column("began", TIME, nullable=False),
    )
    op.create_table(
        "sweep_jobs",
        _number(),
        _of("sweeps"),
        sa.Column("key", sa.Text, nullable=False),
        sa.Column("row", sa.JSON, nullable=False),
        sa.Column("state", sa.Text, nullable=False),
        sa.Column("tries", sa.Integer, nullable=False),
        sa.Column("reason", sa.Text),
        sa.Column("result", sa.JSON),
        sa.Column("seconds", sa.Double),
        sa.Column("ended", TIME),
        sa.UniqueConstraint("sweep_id", "key"),
    )


def _number() -> sa.Column[int]:
    return sa.Column("id", sa.Integer, primary_key=True)


def _of(table: str, **more: Any) -> sa.Column[int]:
    return sa.Column(f"{table[:-1]}_id", sa.Integer, sa.ForeignKey(f"{table}.id"), nullable=False, **more)
