"""The map of a house, by rows, sides, hooks and stems; and shifts of robots in it."""

import sqlalchemy as sa
from alembic import op

revision, down_revision = "0007", "0006"

TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Make the tables."""
    _map()
    _shifts()


def _map() -> None:
    op.create_table(
        "row_sides",
        _number(),
        *_needed(sa.Text, "house", "row", "side", "species"),
        *_needed(sa.JSON, "posts"),
        *_columns(sa.Double, "begin_m", "end_m"),
        *_columns(TIME, "passed"),
        *_needed(sa.Integer, "labels"),
        sa.UniqueConstraint("house", "row", "side"),
    )
    op.create_table(
        "stems",
        _number(),
        _of("row_sides"),
        _of("plants", unique=True),
        *_needed(sa.Integer, "hook"),
        *_needed(sa.Double, "position_m", "position_std_m", "certainty", "gone"),
        *_columns(sa.JSON, "appearance", "appearance_std"),
        *_columns(sa.Integer, "open_flowers", "fruit"),
        *_needed(TIME, "first_seen", "last_seen"),
        *_columns(TIME, "removed"),
    )
    op.create_index("ix_stems_row_side", "stems", ["row_side_id", "removed", "hook"])


def _shifts() -> None:
    op.create_table(
        "shifts", _number(), *_needed(sa.Text, "house"), *_needed(sa.JSON, "asked"), *_columns(TIME, "planned")
    )
    op.create_table(
        "shift_robots",
        _number(),
        _of("shifts"),
        *_needed(sa.Text, "name"),
        *_needed(TIME, "free"),
        *_needed(sa.Double, "battery_s"),
        *_columns(sa.Integer, "leg"),
        *_needed(sa.Boolean, "charging"),
        *_needed(sa.JSON, "steps"),
        *_columns(sa.Text, "row", "stopped"),
        sa.UniqueConstraint("shift_id", "name"),
    )
    op.create_table(
        "shift_stems",
        _number(),
        _of("shifts"),
        _of("stems"),
        *_columns(sa.Integer, "leg", "place"),
        *_needed(sa.Text, "row", "state"),
        *_needed(sa.Integer, "tries"),
        *_columns(sa.Text, "robot", "reason"),
        sa.Column("visit_id", sa.Integer, sa.ForeignKey("visits.id")),
        sa.UniqueConstraint("shift_id", "stem_id"),
    )
    op.create_index("ix_shift_stems", "shift_stems", ["shift_id", "state", "leg"])


def _number() -> sa.Column[int]:
    return sa.Column("id", sa.Integer, primary_key=True)


def _of(table: str, *, unique: bool = False) -> sa.Column[int]:
    return sa.Column(f"{table[:-1]}_id", sa.Integer, sa.ForeignKey(f"{table}.id"), nullable=False, unique=unique)


def _columns(kind: sa.types.TypeEngine | type, *names: str, nullable: bool = True) -> list[sa.Column]:
    return [sa.Column(name, kind, nullable=nullable) for name in names]


def _needed(kind: sa.types.TypeEngine | type, *names: str) -> list[sa.Column]:
    return _columns(kind, *names, nullable=False)
