"""Records: what their fields state is checked, and what they hold survives a file."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pytest
from alike import same
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from anther.core.errors import InputError
from anther.core.geometry import Array
from anther.core.records import UNSAVED, Flat, Range, Record, Shape, Share, Stored, flat, flat_columns, unflat

NAN = float("nan")


class Error(NamedTuple):
    name: str
    size: float


@dataclass(frozen=True, slots=True)
class Part(Record):
    CALLED = "part"
    size: Annotated[float, Range(0, 10, "m")]
    sure: Share | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Whole(Stored):
    KIND, SCHEMA, CALLED = "whole", 3, "whole"
    points: Annotated[Array, Shape("N", 3), Range(unit="m")]
    nearest: Annotated[NDArray[np.int64], Shape("N")]
    pose: Annotated[Array, Shape(4, 4, rigid=True)] = field(default_factory=lambda: np.eye(4))
    swing: Annotated[Array, Shape("N", missing=True)] | None = None
    seen: Annotated[NDArray[np.bool_], Shape(None)] | None = None
    way: Literal["there", "back"] = "there"
    count: Annotated[int, Range(1, 9)] = 1
    parts: tuple[Part, ...] = ()
    part: Part | None = None
    errors: tuple[Error, ...] = ()
    loads: dict[str, float] = field(default_factory=dict)
    far: float = 1.0
    when: datetime | None = None
    limits: tuple[tuple[str, float], ...] = ()
    pictures: Annotated[tuple[Any, ...], UNSAVED] = ()

    def _check(self) -> None:
        if self.count > 5 and self.way == "back":
            raise InputError("whole: too many")


def whole(**values: Any) -> Whole:
    n = 4
    made = {"points": np.arange(3.0 * n).reshape(n, 3), "nearest": np.arange(n)}
    return Whole(**made | values)


FULL = {
    "swing": np.array([0.1, NAN, 0.3, 0.4]),
    "seen": [True, False],
    "way": "back",
    "count": 3,
    "parts": (Part(1.0), Part(2.0, 0.5)),
    "part": Part(3.0, 1.0),
    "errors": (Error("tsai", NAN),),
    "loads": {"slip": 0.5},
    "far": float("inf"),
    "when": datetime(2026, 5, 1, tzinfo=UTC),
    "limits": (("stem", 0.1), ("slip", NAN)),
}


@pytest.mark.parametrize("name", ["a.npz", "a.json"])
@pytest.mark.parametrize("values", [{}, FULL], ids=["least", "full"])
def test_what_is_saved_is_read_back(tmp_path: Path, name: str, values: dict[str, Any]) -> None:
    record = whole(**values, pictures=(1, 2))
    record.save(tmp_path / name)
    assert same(Whole.load(tmp_path / name), replace(record, pictures=()))


def test_arrays_are_read_only_and_of_the_stated_dtype() -> None:
    record = whole(nearest=[0.0, 1.0, 2.0, 3.0], seen=[1, 0])
    kinds = [array.dtype for array in (record.points, record.nearest, record.seen)]
    assert kinds == [np.float64, np.int64, np.bool_]
    with pytest.raises(ValueError, match="read-only"):
        record.points[0, 0] = 1


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"points": np.zeros((4, 2))}, r"whole points: got shape \(4, 2\)"),
        ({"nearest": np.arange(3)}, r"whole nearest: got shape \(3,\); allowed: shape \(4\)"),
        ({"points": np.full((4, 3), NAN)}, r"whole points: got 12 NaN"),
        ({"nearest": ["a"] * 4}, "whole nearest"),
        ({"swing": np.zeros(5)}, "whole swing"),
        ({"pose": 2 * np.eye(4)}, "whole pose: got a matrix that is not a rigid transform"),
        ({"way": "up"}, "whole way: got 'up'; allowed: 'there', 'back'"),
        ({"count": 10}, "whole count: got 10; allowed: 1 <= whole count <= 9"),
        ({"count": 1.5}, "whole count: got 1.5; allowed: a value of type int"),
        ({"count": True}, "whole count: got True"),
        ({"count": None}, "whole count: got None"),
        ({"far": "wide"}, "whole far: got 'wide'; allowed: a value of type float"),
        ({"parts": 5}, "whole parts: got 5; allowed: a list"),
        ({"count": 6, "way": "back"}, "too many"),
    ],
)
def test_what_cannot_be_is_refused_by_name(values: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        whole(**values)


@given(st.floats(allow_nan=True))
def test_a_number_is_in_its_range(size: float) -> None:
    if 0 <= size <= 10:
        assert Part(size).size == size
    else:
        with pytest.raises(InputError, match=r"part size.* m"):
            Part(size)


CHANGES = {
    "another kind": lambda tree: tree | {"kind": "half"},
    "another schema": lambda tree: tree | {"schema": 2},
    "a field that is not known": lambda tree: tree | {"colour": 1},
    "a field that is missing": lambda tree: {k: v for k, v in tree.items() if k != "way"},
    "a part that is missing": lambda tree: tree | {"part": {"size": 1.0}},
    "a part that is a list": lambda tree: tree | {"part": [1.0]},
    "parts that are a number": lambda tree: tree | {"parts": 3},
    "a list of texts": lambda tree: tree | {"points": ["a"]},
    "a value out of range": lambda tree: tree | {"count": 70},
    "a time": lambda tree: tree | {"when": "noon"},
    "a text that is a number": lambda tree: tree | {"way": 5},
    "loads that are a list": lambda tree: tree | {"loads": [1]},
    "a load that is a text": lambda tree: tree | {"loads": {"slip": "all"}},
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_file_that_was_changed_is_refused_by_its_name(tmp_path: Path, change: str) -> None:
    whole(**FULL).save(tmp_path / "a.json")
    tree = json.loads((tmp_path / "a.json").read_text())
    (tmp_path / "a.json").write_text(json.dumps(CHANGES[change](tree)))
    with pytest.raises(InputError, match=r"a\.json"):
        Whole.load(tmp_path / "a.json")


@pytest.mark.parametrize("name", ["a.npz", "a.json"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_file_cut_short_is_refused(tmp_path: Path, name: str, share: float) -> None:
    path = tmp_path / name
    whole(**FULL).save(path)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(InputError, match=name):
        Whole.load(path)
    with pytest.raises(InputError, match="no such file"):
        Whole.load(tmp_path / "b.npz")


@dataclass(frozen=True, slots=True)
class Row(Record):
    DERIVED: ClassVar = {"double_ms2": (float, lambda row: 2 * row.length)}
    length: Annotated[float, Range(unit="m")]
    stiffness: Annotated[float, Range(unit="N m/rad")] = NAN
    part: Annotated[Part, Flat("part_")] | None = None
    steps: tuple[Part, ...] = ()
    name: str | None = None


@given(st.floats(-1e6, 1e6), st.one_of(st.none(), st.floats(0, 1)), st.integers(0, 3), st.booleans())
def test_a_flat_table_has_units_in_its_names_and_is_read_back(
    length: float, sure: float | None, steps: int, inside: bool
) -> None:
    row = Row(length, part=Part(1.0, sure) if inside else None, steps=(Part(2.0),) * steps)
    values = flat(row)
    assert (values["length_m"], values["double_ms2"], values["stiffness_nm_rad"]) == (length, 2 * length, None)
    assert ("part_size_m" in values) == inside
    assert [step["size_m"] for step in values["steps"]] == [2.0] * steps
    assert same(unflat(json.loads(json.dumps(values)), Row), row)
    assert set(values) <= set(flat_columns(Row))
    assert flat_columns(Row, ("part", "double_ms2")) == {"part_size_m": float, "part_sure": float, "double_ms2": float}
    with pytest.raises(InputError, match="length_mm"):
        unflat(values | {"length_mm": 1.0}, Row)
