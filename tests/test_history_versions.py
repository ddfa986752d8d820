"""A new history has its tables, however many begin it; one of a version that is not known is refused, and kept."""

from __future__ import annotations

import multiprocessing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import create_engine, inspect, text

from anther.errors import InputError
from anther.history import TrialRecord, read_trials, record_trial

VISIT = TrialRecord("tomato", "a", True)


def engine_of(where: str) -> Any:
    url = where.replace("postgresql://", "postgresql+psycopg://") if "://" in where else f"sqlite:///{where}"
    if "://" not in where:
        Path(where).parent.mkdir(parents=True, exist_ok=True)
    return create_engine(url)


def write(where: str, plant: str) -> None:
    record_trial(replace(VISIT, plant=plant), where)


def test_processes_that_begin_a_history_at_once_all_write_to_it(where: str) -> None:
    processes = [multiprocessing.get_context("fork").Process(target=write, args=(where, plant)) for plant in "abcd"]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60)
    assert [process.exitcode for process in processes] == [0] * 4
    assert len(read_trials(where)) == 4


def test_a_database_with_other_tables_of_such_names_is_refused_and_kept(where: str) -> None:
    with engine_of(where).begin() as connection:
        connection.execute(text("CREATE TABLE sweeps (id INTEGER)"))
    with pytest.raises(InputError, match=r"trial history(.|\n)*sweeps"):
        record_trial(VISIT, where)
    with engine_of(where).connect() as connection:
        assert inspect(connection).get_table_names() == ["sweeps"], "the tables made before it are gone again"


def test_people_who_write_sql_have_a_view(where: str) -> None:
    record_trial(VISIT, where)
    with engine_of(where).connect() as connection:
        assert connection.execute(text("SELECT plant, held_unharmed FROM trials")).one() == ("a", True)


def test_a_history_of_another_version_is_refused(where: str) -> None:
    record_trial(VISIT, where)
    with engine_of(where).begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(InputError, match="another Anther"):
        read_trials(where)
