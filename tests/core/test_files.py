"""Files are written whole or not at all, and bad ones are refused with one clear message."""

from __future__ import annotations

import os

import numpy as np
import pytest

from anther.core.errors import InputError
from anther.core.files import read_json, read_npz, read_rows, replacing, write_json, write_npz


def test_npz_round_trip(tmp_path) -> None:
    path = tmp_path / "deep" / "x.npz"
    write_npz(path, "thing", 2, a=np.arange(3), b=None, name="tomato")
    arrays = read_npz(path, "thing", 2)
    assert arrays["a"].tolist() == [0, 1, 2]
    assert str(arrays["name"]) == "tomato"
    assert "b" not in arrays


@pytest.mark.parametrize(("kind", "schema"), [("other", 1), ("thing", 2)])
def test_npz_of_another_kind_or_schema_is_refused(tmp_path, kind, schema) -> None:
    write_npz(tmp_path / "x.npz", "thing", 1, a=[1])
    with pytest.raises(InputError, match=f"allowed: kind '{kind}', schema {schema}"):
        read_npz(tmp_path / "x.npz", kind, schema)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path) -> None:
    path = tmp_path / "x.txt"
    path.write_text("old")

    def write_half() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_half()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["x.txt"]


@pytest.mark.parametrize(("mask", "mode"), [(0o077, 0o600), (0o022, 0o644), (0o002, 0o664)])
def test_a_written_file_is_as_private_as_its_writer_wants(tmp_path, mask, mode) -> None:
    before = os.umask(mask)
    try:
        write_json(tmp_path / "x.json", {})
        write_npz(tmp_path / "x.npz", "thing", 1, a=np.zeros(3))
    finally:
        os.umask(before)
    assert {path.stat().st_mode & 0o777 for path in tmp_path.iterdir()} == {mode}


def test_json_holds_numpy_and_turns_nan_into_null(tmp_path) -> None:
    value = {"a": np.float64(1.5), "b": np.array([1, np.nan]), "c": (True, None), "d": np.int64(3), "e": tmp_path}
    write_json(tmp_path / "x.json", value)
    assert read_json(tmp_path / "x.json") == {
        "a": 1.5,
        "b": [1.0, None],
        "c": [True, None],
        "d": 3,
        "e": str(tmp_path),
    }
    assert "NaN" not in (tmp_path / "x.json").read_text()


@pytest.mark.parametrize("begin", [b"PK\x03\x04", b"\xd0\xcf\x11\xe0"])
def test_a_workbook_is_named(tmp_path, begin):
    (tmp_path / "a.csv").write_bytes(begin + bytes(200))
    with pytest.raises(InputError, match=r"a workbook.*Save it from the spreadsheet as CSV"):
        read_rows(tmp_path / "a.csv")


@pytest.mark.parametrize("fault", ["#DIV/0!", "#REF!", "#N/A", "#WERT!", "#####"])
def test_a_row_that_begins_with_a_fault_is_no_comment(tmp_path, fault):
    (tmp_path / "a.csv").write_text(f"# of bed 3\na,b\n1,2\n{fault},3\n#4,5\n# last\n")
    assert [row.cells for row in read_rows(tmp_path / "a.csv")] == [["a", "b"], ["1", "2"], [fault, "3"]]
