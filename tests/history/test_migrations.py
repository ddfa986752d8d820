"""A new history has the tables of the classes; one of a version that is not known is refused, and kept."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import create_engine, inspect, text

import anther.history.migrations as versions
from anther.core.errors import InputError
from anther.core.records import flat_columns
from anther.history import _database, read_trials, record_trial
from anther.history._tables import Base, GraspRow, ResponseRow, ShakeRow
from anther.history.migrations import HEAD
from anther.plant import GraspRecord, ShakeRecord, Visit
from anther.plant.visit import MOTIONS

VISIT = Visit("tomato", "a", True)


def engine_of(where: str) -> Any:
    url = where.replace("postgresql://", "postgresql+psycopg://") if "://" in where else f"sqlite:///{where}"
    if "://" not in where:
        Path(where).parent.mkdir(parents=True, exist_ok=True)
    return create_engine(url)


def test_a_database_with_other_tables_of_such_names_is_refused_and_kept(where: str) -> None:
    with engine_of(where).begin() as connection:
        connection.execute(text("CREATE TABLE sweeps (id INTEGER)"))
    with pytest.raises(InputError, match=r"trial history(.|\n)*sweeps"):
        record_trial(VISIT, where)
    with engine_of(where).connect() as connection:
        assert inspect(connection).get_table_names() == ["sweeps"], "the tables made before it are gone again"


def test_the_tables_are_those_of_the_classes(where: str) -> None:
    record_trial(VISIT, where)
    with engine_of(where).connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
        assert connection.execute(text("SELECT plant, held_unharmed FROM trials")).one() == ("a", True)


LATER = """
import sqlalchemy as sa
from alembic import op

revision, down_revision = "later", "{head}"


def upgrade():
    op.add_column("plants", sa.Column("note", sa.Text))
"""


def test_a_history_of_the_version_before_is_brought_up_with_all_that_is_in_it(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record_trial(VISIT, where)
    folder = tmp_path / "migrations"
    shutil.copytree(Path(versions.__file__).parent, folder)
    (folder / "versions" / "later.py").write_text(LATER.format(head=HEAD))
    monkeypatch.setattr(versions, "__file__", str(folder / "__init__.py"))
    monkeypatch.setattr(versions, "HEAD", "later")
    monkeypatch.setattr(_database, "HEAD", "later")
    assert [(trial.plant, trial.result_words) for trial in read_trials(where)] == [("a", "held, flowers not measured")]
    with engine_of(where).connect() as connection:
        assert connection.execute(text("SELECT label, note FROM plants")).one() == ("a", None)


def test_the_head_is_the_newest_version() -> None:
    assert ScriptDirectory(str(Path(versions.__file__).parent)).get_current_head() == HEAD


def test_a_history_of_another_version_is_refused(where: str) -> None:
    record_trial(VISIT, where)
    with engine_of(where).begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(InputError, match="another Anther"):
        read_trials(where)


def test_columns_are_called_as_in_trial_json() -> None:
    """A row's attribute is the field of a visit, its column the field's name with the unit."""
    flat = {GraspRow: GraspRecord, ShakeRow: ShakeRecord}
    for row, record in flat.items():
        names = {column.name for column in row.__table__.columns} - {"id", "visit_id"}
        assert names == set(flat_columns(record))
    names = {column.name for column in ResponseRow.__table__.columns} - {"id", "visit_id", "flower"}
    assert names == set(flat_columns(Visit, MOTIONS))
