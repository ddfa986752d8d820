"""A PostgreSQL server of the tests' own."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path

from sqlalchemy import create_engine


class Server:
    """A PostgreSQL server of the tests' own, in a temporary folder, reached by a socket in it."""

    def __init__(self, binaries: Path, user: list[str]) -> None:
        self._as, self.binaries = user, binaries
        self.folder = Path(self.run("mktemp", "-d", "/tmp/anther-postgresql-XXXXXX").strip())
        self._control = (str(binaries / "pg_ctl"), "-w", "-D", str(self.folder / "data"))
        self.run(str(binaries / "initdb"), "-D", str(self.folder / "data"), "-U", "anther", "-A", "trust", "-N")
        self.start()

    def run(self, *words: str) -> str:
        return subprocess.run([*self._as, *words], check=True, stdout=subprocess.PIPE, text=True, cwd="/").stdout

    def start(self) -> None:
        options = f"-c listen_addresses='' -c unix_socket_directories={self.folder}"
        options += " -c recovery_init_sync_method=syncfs"  # else every file is flushed by itself, which takes seconds
        log = str(self.folder / "log")
        subprocess.run([*self._as, *self._control, "-o", options, "-l", log, "start"], check=True, cwd="/",
                       stdout=subprocess.DEVNULL)  # fmt: skip

    def crash(self) -> None:
        """Stop without writing anything more: what counts is what was flushed at every commit."""
        self.run(*self._control, "-m", "immediate", "stop")

    def address(self) -> str:
        return f"postgresql://anther:secret@/postgres?host={self.folder}"

    def new(self) -> str:
        """Return the address of a new, empty history: a schema of its own."""
        name = f"t{time.monotonic_ns()}"
        admin = create_engine(self.address().replace("://", "+psycopg://"))
        with admin.begin() as connection:
            connection.exec_driver_sql(f"CREATE SCHEMA {name}")
        admin.dispose()
        return self.address() + f"&options=-csearch_path%3D{name}"

    def remove(self) -> None:
        """Stop and delete it."""
        self.crash()
        shutil.rmtree(self.folder)


def start() -> Server | str:
    """Return a running server, or why there can be none."""
    folders = [*sorted(Path("/usr/lib/postgresql").glob("*/bin")), Path(shutil.which("initdb") or "/none").parent]
    binaries = next((folder for folder in folders if (folder / "initdb").exists()), None)
    if binaries is None:
        return "no PostgreSQL programs (initdb, pg_ctl): apt install postgresql"
    if os.geteuid() != 0:
        return Server(binaries, [])
    if subprocess.run(["runuser", "-u", "postgres", "true"], capture_output=True, check=False).returncode:
        return "running as root, and PostgreSQL needs another user: there is no user postgres"
    return Server(binaries, ["runuser", "-u", "postgres", "--"])
