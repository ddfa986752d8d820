"""Tables and texts as spreadsheets and editors save them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from anther.core.errors import InputError
from anther.core.files import named_file, number, read_json, read_rows, read_text
from anther.history.sweep import read_table
from anther.plant.bench.measurements import SAMPLES, read_measurements
from anther.robot.calibration import read_poses

NUMBERS = [(2.66331, 4.0924, 45.7221), (0.720151, 3.17447, 21.0076), (0.5, 2.5, 30.0)]


def table(separator: str = ";", comma: bool = True, quoted: bool = False) -> str:
    cells = [[str(v).replace(".", ",") if comma else str(v) for v in row] for row in NUMBERS]
    cells = [[f'"{c}"' for c in row] for row in cells] if quoted else cells
    return "\r\n".join(separator.join(row) for row in [["mass_g", "radius_mm", "length_mm"], *cells]) + "\r\n"


def with_columns(text: str) -> str:
    return text.replace("\r\n", ";;\r\n")


PLAIN = table()
DIALECTS = {
    "points": table(",", comma=False).encode(), "semicolons": PLAIN.encode(), "tabs": table("\t").encode(),
    "quoted": table(",", quoted=True).encode(), "sep": b"sep=;\r\n" + PLAIN.encode(),
    "sep quoted": b'"sep=;"\r\n' + PLAIN.encode(), "sep |": b"sep=|\r\n" + table("|").encode(),
    "empty columns": with_columns(PLAIN).encode(), "empty rows": (PLAIN + ";;\r\n;;\r\n\r\n").encode(),
    "mark": PLAIN.encode("utf-8-sig"), "mark and sep": ("sep=;\r\n" + PLAIN).encode("utf-8-sig"),
    "UTF-16": PLAIN.encode("utf-16"), "UTF-16 big": b"\xfe\xff" + PLAIN.encode("utf-16-be"),
    "UTF-16 unmarked": PLAIN.encode("utf-16-le"), "UTF-16 big, unmarked": PLAIN.encode("utf-16-be"),
    "cp1252": ("# Gewächshaus Süd\r\n" + PLAIN).encode("cp1252"), "old Mac": PLAIN.replace("\r\n", "\r").encode(),
    "comments": ("# a\r\n" + PLAIN + "# b\r\n").encode(),
}  # fmt: skip


@pytest.mark.parametrize("dialect", DIALECTS)
def test_measurements_in_every_dialect(tmp_path: Path, dialect: str) -> None:
    (tmp_path / "a.csv").write_bytes(DIALECTS[dialect])
    read = read_measurements(tmp_path / "a.csv", SAMPLES)
    np.testing.assert_allclose(read["mass"], [1e-3 * row[0] for row in NUMBERS])
    np.testing.assert_allclose(read["length"], [1e-3 * row[2] for row in NUMBERS])


def test_a_note_with_a_separator_in_quotes_is_one_cell(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text('mass_g,radius_mm,length_mm,note\n2,4,40,"cut, then ""dried"""\n', encoding="utf-8")
    assert read_rows(tmp_path / "a.csv")[1].cells[3] == 'cut, then "dried"'
    assert read_measurements(tmp_path / "a.csv", SAMPLES)["mass"] == pytest.approx([2e-3])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('mass_g,radius_mm,length_mm\n"1,234","2,345","3,456"\n', "decimal point"),
        ("mass_g;radius_mm;length_mm\n1.234,5;2;3\n", "'1.234,5'"),
        ("mass_g;radius_mm;length_mm\n1;2;3;4\n", "4 cells"),
        ('mass_g;radius_mm;length_mm\n1;2;"3\n', "line 2"),
    ],
)
def test_what_could_be_read_in_two_ways_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        read_measurements(tmp_path / "a.csv", SAMPLES)


def test_lines_keep_their_numbers(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("sep=;\n\n# a\na;b\n;;\n1,5;2\n\n3;x,y\n")
    assert [(row.line, row.cells) for row in read_rows(tmp_path / "a.csv")] == [
        (4, ["a", "b"]), (6, ["1.5", "2"]), (8, ["3", "x,y"]),
    ]  # fmt: skip


@pytest.mark.parametrize("cell", ["", "x", "1.234,5", "1,2,3", "nan", "inf", "1_000"])
def test_what_is_no_number(cell: str) -> None:
    assert number(cell) is None


@pytest.mark.parametrize(("cell", "value"), [("1,5", 1.5), ("-,5", -0.5), ("2", 2.0), ("1,5e-3", 1.5e-3), ("1.5", 1.5)])
def test_numbers_with_points_or_commas(cell: str, value: float) -> None:
    assert number(cell) == value


@pytest.mark.parametrize(
    "data",
    [
        "plant;seed;viewpoint\r\ntomato;0;0,5\r\n".encode("utf-8-sig"),
        b"plant,seed,viewpoint,,\r\ntomato,0,0.5,,\r\n,,,,\r\n",
        "sep=\t\nplant\tseed\tviewpoint\ntomato\t0\t0,5\n".encode("utf-16"),
    ],
)  # fmt: skip
def test_sweeps(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.csv").write_bytes(data)
    assert read_table(tmp_path / "a.csv") == [{"plant": "tomato", "seed": "0", "viewpoint": "0.5"}]


def test_a_sweep_keeps_lists_and_rows_that_begin_with_a_hash(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text('plant,places\n#1,"0,1"\n')
    assert read_table(tmp_path / "a.csv") == [{"plant": "#1", "places": "0,1"}]


@pytest.mark.parametrize("separator", ["\t", ";"])
def test_poses_with_decimal_commas(tmp_path: Path, separator: str) -> None:
    names = ["image", "x", "y", "z", "qx", "qy", "qz", "qw"]
    row = ["a.png", "0,5", "-0,25", "1", "0", "0", "0", "1"]
    (tmp_path / "a.csv").write_text("\n".join(separator.join(r) for r in (names, row)))
    np.testing.assert_allclose(read_poses(tmp_path / "a.csv")["a.png"][:3, 3], [0.5, -0.25, 1])


def test_json_with_a_mark_and_in_utf_16(tmp_path: Path) -> None:
    for encoding in ("utf-8-sig", "utf-16", "utf-16-le"):
        (tmp_path / "a.json").write_text(json.dumps({"ä": 1}, ensure_ascii=False), encoding=encoding)
        assert read_json(tmp_path / "a.json") == {"ä": 1}


@pytest.mark.parametrize("data", [b"\x00\x01\x02\x81", b"abc\x81\x8d", b"\xff\xfea", b"caf\xe9\x00\x01"])
def test_what_is_no_text_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.txt").write_bytes(data)
    with pytest.raises(InputError, match="no text"):
        read_text(tmp_path / "a.txt")


def test_files_named_as_windows_names_them(tmp_path: Path) -> None:
    (tmp_path / "Images").mkdir()
    (tmp_path / "Images/A.PNG").touch()
    assert named_file(tmp_path, "Images\\A.PNG") == tmp_path / "Images/A.PNG"
    assert named_file(tmp_path, "Images/a.png") == tmp_path / "Images/A.PNG"
    assert named_file(tmp_path, "9" * 400) == tmp_path / ("9" * 400), "no disk bears it: it is not there"
    (tmp_path / "Images/a.PNG").touch()
    assert named_file(tmp_path, "Images/a.png") == tmp_path / "Images/a.png"  # which of both?
    assert named_file(tmp_path, "no/such.png") == tmp_path / "no/such.png"
