"""The schema of the history, version by version, for Alembic.

A database runs the versions it lacks in the transaction that first opens it, behind a lock, so that two programs that
start at once do not both run them, and a program that dies half way leaves the old version. Never edit a version that
was released: add one (`versions/`), and name it in `HEAD`.
"""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import Connection, inspect, text

from anther.core.errors import bad_input

HEAD = "0007"
"""The newest version. It is written here so that Alembic is loaded only where there is something to do."""


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
    known = {step.revision for step in ScriptDirectory.from_config(config).walk_revisions()}
    if found is not None and found not in known:
        raise bad_input(
            "trial history",
            given=f"schema version {found[:40]}",
            allowed=", ".join(sorted(known)),
            do="It was written by another Anther: update this one, or name another history.",
        )
    command.upgrade(config, HEAD)
