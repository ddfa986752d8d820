"""A visit keeps whether its flowers moved: unknown of the visits before."""

import sqlalchemy as sa
from alembic import op

revision, down_revision = "0006", "0005"


def upgrade() -> None:
    """Add it, to the index that trends read as well."""
    op.add_column("visits", sa.Column("flowers_moved", sa.Boolean()))
    op.drop_index("ix_visits_time", "visits")
    columns = ["time", "robot", "held_unharmed", "flowers_moved", "failure", "acceleration_ms2"]
    op.create_index("ix_visits_time", "visits", columns)
