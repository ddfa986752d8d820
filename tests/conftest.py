"""Shared fixtures. Real data is read from the folder ANTHER_DATA, by default ../shared/data beside the checkout."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import postgresql_server
import pytest
from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does
settings.register_profile("default", deadline=None, max_examples=40)  # an example that takes long is no failure
settings.register_profile("thorough", deadline=None, max_examples=400)  # pytest --hypothesis-profile=thorough
settings.load_profile("default")

DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real plants and reference trajectories; tests that need it are skipped without it."""
    if not DATA.is_dir():
        pytest.skip(f"real data not found at {DATA}; set ANTHER_DATA to its folder")
    return DATA


@pytest.fixture(scope="session", autouse=True)
def locks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of arms' locks: each worker has its own, so that tests do not wait for each other's arms."""
    folder = tmp_path_factory.mktemp("locks")
    folder.chmod(0o1777)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("anther.robot.cells._lock.FOLDERS", (folder,))
        yield folder


@pytest.fixture(scope="session")
def server() -> Iterator[postgresql_server.Server]:
    """A real PostgreSQL server, where its programs are installed."""
    pytest.importorskip("psycopg", reason="psycopg is not installed: pip install 'anther[postgresql]'")
    started = postgresql_server.start()
    if isinstance(started, str):
        pytest.skip(started)
    yield started
    started.remove()


@pytest.fixture(params=["sqlite", "postgresql"])
def where(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A new history: a SQLite file, or a schema of a real PostgreSQL server."""
    if request.param == "sqlite":
        return str(tmp_path / "deep" / "history.sqlite")
    return request.getfixturevalue("server").new()
