"""A plant no longer keeps what it taught its crop: no next plant was shaken better by it."""

from alembic import op

revision, down_revision = "0004", "0003"


def upgrade() -> None:
    """Drop it."""
    op.drop_index("ix_plants_taught", "plants")
    op.drop_column("plants", "taught")
    op.drop_column("plants", "learned")
