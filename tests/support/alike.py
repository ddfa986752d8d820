"""Whether what was read back from a file is what was saved in it."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from anther.core.records import Stored, fields_of


def same(one: Any, other: Any) -> bool:
    """Whether two values hold the same, of the same types; NaN is NaN."""
    if type(one) is not type(other):
        return False
    if is_dataclass(one):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other or repr(one) == repr(other) == "nan"


def check_kept(record: Stored, path: Path) -> None:
    """Fail where a record is another one after it was saved and read."""
    record.save(path)
    again = type(record).load(path)
    for f in fields_of(type(record)):
        assert not f.saved or same(getattr(again, f.name), getattr(record, f.name)), f.name
