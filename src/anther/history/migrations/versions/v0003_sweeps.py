"""The jobs of sweeps: one row each."""

import sqlalchemy as sa
from alembic import op

revision, down_revision = "0003", "0002"

TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "sweeps",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("uid", sa.Text, nullable=False, unique=True),
        sa.Column("folder", sa.Text, nullable=False),
        sa.Column("function", sa.Text, nullable=False),
        sa.Column("began", TIME, nullable=False),
    )
    op.create_table(
        "sweep_jobs",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("sweep_id", sa.Integer, sa.ForeignKey("sweeps.id"), nullable=False),
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
