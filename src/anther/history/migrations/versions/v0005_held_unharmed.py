"""What a visit's `success` meant has its own name: held and unharmed, whether its flowers moved or not."""

from alembic import op

from anther.history.migrations.versions.v0003_history import VIEW

revision, down_revision = "0005", "0004"


def upgrade() -> None:
    """Rename it, in the view as well."""
    op.execute("DROP VIEW trials")
    op.execute("ALTER TABLE visits RENAME COLUMN success TO held_unharmed")
    op.execute(VIEW.replace("success", "held_unharmed"))
