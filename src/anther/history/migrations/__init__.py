"""The schema of the history: a new one gets the tables of the classes, an older one the versions that it lacks.

That happens in the transaction that first opens the database, behind a lock, so that two programs that start at once do
not both do it, and a program that dies half way leaves what was there. Whoever changes the classes adds a version for
Alembic (`versions/`), and names it in `HEAD`; never edit one that was released.
"""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import Connection, inspect, text

from anther.core.errors import bad_input
from anther.history._tables import Base

HEAD = "0007"
"""The newest version. It is written here so that Alembic is loaded only where there is something to do."""
VIEW = (
    "CREATE VIEW trials AS SELECT v.id, v.time, p.species, p.label AS plant, v.held_unharmed, v.failure, v.run, "
    "g.arc_length_m, s.frequency_hz, s.amplitude_m FROM visits v JOIN plants p ON p.id = v.plant_id "
    "LEFT JOIN grasps g ON g.visit_id = v.id LEFT JOIN shakes s ON s.visit_id = v.id"
)
"""For people who write SQL."""


def version(connection: Connection) -> str | None:
    """Return the version of a database; None for an empty one."""
    if not inspect(connection).has_table("alembic_version"):
        return None
    return connection.execute(text("SELECT version_num FROM alembic_version")).scalar()


def migrate(connection: Connection) -> None:
    """Bring the database to the newest version. Run it in a transaction that writes.

    Raises:
        InputError: the database has a version that is not known.
    """
    from alembic import command  # noqa: PLC0415
    from alembic.config import Config  # noqa: PLC0415
    from alembic.script import ScriptDirectory  # noqa: PLC0415

    lock = 0x616E7468  # PostgreSQL's advisory lock: "anth" in ASCII
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": lock})
    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    found = version(connection)
    if found is None:
        Base.metadata.create_all(connection, checkfirst=False)
        connection.execute(text(VIEW))
        command.stamp(config, HEAD)
        return
    known = {step.revision for step in ScriptDirectory.from_config(config).walk_revisions()}
    if found not in known:
        raise bad_input(
            "trial history",
            given=f"schema version {found[:40]}",
            allowed=", ".join(sorted(known)),
            do="It was written by another Anther: update this one, or name another history.",
        )
    command.upgrade(config, HEAD)
