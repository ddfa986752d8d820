"""Where the history lives: one SQLite file, or a PostgreSQL server; how it is opened, locked, and what can go wrong."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Engine, create_engine, event, make_url
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import ArgumentError, SQLAlchemyError
from sqlalchemy.orm import Session
from sqlalchemy.pool import NullPool

from anther.core.errors import AntherError, InputError, MissingExtra, bad_input
from anther.core.files import understood
from anther.history.migrations import HEAD, migrate, version

DEFAULT = Path("runs/history.sqlite")
PATIENCE = 30.0
"""How long a writer waits for another one to finish [s]."""
INSTALL = "pip install 'anther[postgresql]'"


@contextmanager
def open_reader(where: Path | str) -> Iterator[Session | None]:
    """Yield a session that reads the history, brought to the newest version; None when there is no such file.

    The database itself refuses it to write. Readers never wait for writers, nor writers for readers.
    """
    url = _url(where)
    if url.database is not None and url.drivername == "sqlite" and not Path(url.database).exists():
        yield None
        return
    with _open_session(url, write=False) as session, _cells_understood(url):
        yield session


@contextmanager
def open_writer(where: Path | str) -> Iterator[Session]:
    """Yield a session that writes, and commit at the end: all or, on an error or a crash, nothing of it is there.

    A SQLite file and its folder are made when they are missing. Writers wait for each other, up to `PATIENCE` seconds.
    """
    url = _url(where)
    with _open_session(url, write=True) as session:
        yield session
        session.commit()


def insert(session: Session, table: Any) -> Any:
    """Return an INSERT that can pass over what is there already."""
    return (postgresql if session.get_bind().dialect.name == "postgresql" else sqlite).insert(table)


def hide_password(where: Path | str) -> str:
    """Return the history's place for people and files: without a password."""
    return _place(_url(where))


def _url(where: Path | str) -> URL:
    """Return the database's URL: a path is a SQLite file."""
    if isinstance(where, Path) or "://" not in where:
        return _file(URL.create("sqlite", database=str(where)))
    try:
        url = make_url(where)
    except (ArgumentError, ValueError) as error:  # ValueError: a port that is no number
        raise _address_error("history", where.split(":")[0] + "://...", "Check the address.") from error
    if url.get_backend_name() not in ("postgresql", "postgres", "sqlite"):
        raise _address_error("history", url.render_as_string(), "Other databases were never tested.")
    return _file(url) if url.get_backend_name() == "sqlite" else url.set(drivername="postgresql+psycopg")


def _file(url: URL) -> URL:
    """Return the URL of a SQLite file: not one in memory, a folder or a pipe, which would be waited for."""
    name = url.database or ""
    if not name or name.startswith(":") or (Path(name).exists() and not Path(name).is_file()):
        raise _address_error("history", f"'{name}'", "Name a file, e.g. runs/history.sqlite.")
    return url.set(drivername="sqlite")


def _address_error(what: str, given: str, do: str) -> InputError:
    return bad_input(what, given=given, allowed="a SQLite file, or postgresql://USER:PASSWORD@HOST/DATABASE", do=do)


@contextmanager
def _open_session(url: URL, *, write: bool) -> Iterator[Session]:
    try:
        engine = _engine(_anchor_path(url), PATIENCE)
        with Session(engine.execution_options(write=write), expire_on_commit=False) as session:
            with _cells_understood(url):
                if version(session.connection()) != HEAD:
                    session.rollback()
                    with engine.execution_options(write=True).begin() as connection:
                        migrate(connection)
            yield session
    except (SQLAlchemyError, OSError) as error:
        if isinstance(error, AntherError):
            raise
        raise _explain(url, error) from error


def _anchor_path(url: URL) -> URL:
    """Return the address with a SQLite file's whole path, its folder made: an engine outlives a change of folder."""
    if url.drivername != "sqlite" or not url.database:
        return url
    path = Path(url.database).absolute()
    path.parent.mkdir(parents=True, exist_ok=True)
    if os.statvfs(path.parent).f_flag & os.ST_RDONLY and not path.with_name(f"{path.name}-wal").exists():
        # nobody can write there, and a write-ahead log could not even be read
        return url.set(database=path.as_uri()).update_query_dict({"immutable": "1", "uri": "true"})
    return url.set(database=str(path))


def _cells_understood(url: URL) -> AbstractContextManager[None]:
    """Whoever edits a database by hand can put anything into its cells."""
    return understood(f"trial history {_place(url)}", do="Correct the cell, or restore a copy of the database.")


def _place(url: URL) -> str:
    """Return the database's place without a password."""
    return str(url.database) if url.drivername == "sqlite" else url.render_as_string(hide_password=True)


@cache
def _engine(url: URL, patience: float) -> Engine:
    """Return the database's engine. It keeps what SQL was compiled, half of the time of a query, and no connection."""
    write = partial(json.dumps, allow_nan=False)
    if url.drivername != "sqlite":
        options = f"{url.query.get('options', '')} -c lock_timeout={patience:.0f}s"  # added to those of the address
        arguments = {"connect_timeout": 10, "options": options}
        try:
            engine = create_engine(url, poolclass=NullPool, connect_args=arguments, json_serializer=write)
        except ImportError as error:
            raise MissingExtra(f"history: PostgreSQL needs psycopg. Install it with: {INSTALL}") from error
        event.listen(engine, "begin", _begin_postgresql)
        return engine
    arguments = {"timeout": patience, "isolation_level": None}  # it begins no transactions itself: see _begin_sqlite
    engine = create_engine(url, poolclass=NullPool, connect_args=arguments, json_serializer=write)
    if "immutable" not in url.query:
        event.listen(engine, "connect", _configure_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _configure_sqlite(connection: Any, _: Any) -> None:
    """Write-ahead log, flushed to the disk at every commit, and references that are checked."""
    deadline = time.monotonic() + PATIENCE
    while connection.execute("PRAGMA journal_mode").fetchone()[0] != "wal":
        try:
            connection.execute("PRAGMA journal_mode=WAL")
        except connection.OperationalError:
            if time.monotonic() > deadline:
                raise
        if time.monotonic() > deadline:
            raise connection.OperationalError("this file system keeps no write-ahead log")
        time.sleep(0.02)
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("PRAGMA foreign_keys=ON")


def _begin_sqlite(connection: Any) -> None:
    """A writer takes its lock at once: two that had both read first could not both go on, whatever their patience."""
    write = connection.get_execution_options().get("write", False)
    connection.exec_driver_sql(f"PRAGMA query_only={'OFF' if write else 'ON'}")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")


def _begin_postgresql(connection: Any) -> None:
    if not connection.get_execution_options().get("write", False):
        connection.exec_driver_sql("SET TRANSACTION READ ONLY")


def _explain(url: URL, error: Exception) -> InputError:
    cause = " ".join(str(getattr(error, "orig", None) or error).split())
    held = f"Another program has held it for more than {PATIENCE:.0f} s. Nothing was changed: try again."
    space = "Nothing was changed: free some space and try again."
    advice = {
        "locked": held,
        "lock timeout": held,
        "full": space,
        "No space left": space,
        "readonly": "Nothing was changed: ask for the right to write there.",
        "connection": "Is the server running, and does it accept you?",
    }
    do = next((text for word, text in advice.items() if word in cause), "Check path, free space and rights.")
    return _address_error(f"trial history {_place(url)}", cause, do)
