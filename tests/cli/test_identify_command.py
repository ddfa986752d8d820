"""anther identify: the authors' number, a whole test from files, and one clear message for every bad file or option."""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_stem import Truth, nonlinear_trace, write_files
from matplotlib.image import imread

from anther.cli.main import main
from anther.core.errors import InputError
from anther.plant.bench import read_material
from anther.plant.bench.measurements import LEAVES, SAMPLES, TRACE, read_measurements

AUTHORS = ("--length", 0.292, "--radius", 0.003, "--frequency", 1.38, "--density", 1100)


def said(capsys, *words: object) -> str:
    assert main(["identify", *map(str, words)]) == 0
    return capsys.readouterr().out


def refused(capsys, *words: object) -> str:
    """Run a command that must fail with exit code 2 and one message; return it."""
    try:
        code = main(["identify", *map(str, words)])
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    assert code == 2
    assert "Traceback" not in out + err
    return re.sub(r"[\s│]+", " ", err + out)


def test_the_authors_number(capsys, tmp_path: Path) -> None:
    text = said(capsys, *AUTHORS, "--out", tmp_path)
    result = json.loads((tmp_path / "identify.json").read_text())
    assert result["youngs"]["value"] == pytest.approx(21.6e6, rel=2e-3)
    assert "say how the stem was held" in result["warnings"][0].lower()
    assert "anther plan SKELETON --youngs 2.16" in text


@pytest.fixture(scope="module")
def truth() -> Truth:
    return Truth()


@pytest.fixture(scope="module")
def files(tmp_path_factory, truth: Truth) -> dict[str, Path]:
    """A test whose trace the nonlinear simulator made, and which a camera with 0.2 mm of noise saw."""
    times, tip = nonlinear_trace(truth, seconds=4.0)
    noise = np.random.default_rng(1).normal(0, 2e-4, len(times))
    return write_files(tmp_path_factory.mktemp("stem"), truth, (times, tip + noise))


def words_of(files: dict[str, Path]) -> list[object]:
    return [word for name, path in files.items() for word in (f"--{name}", path)]


def test_a_stem_is_identified_from_its_files(capsys, tmp_path: Path, truth: Truth, files: dict[str, Path]) -> None:
    out = tmp_path / "result"
    text = said(capsys, *words_of(files), "--orientation", "upright", "--out", out)
    result = json.loads((out / "identify.json").read_text())
    assert result["warnings"] == []
    for method in ("vibration", "deflection"):
        estimate = result["youngs_by_method"][method]
        assert estimate["value"] == pytest.approx(truth.youngs, rel=0.03)  # no calliper was wrong here
        assert 0.05 < estimate["standard_error"] / estimate["value"] < 0.15
    found = result["vibration"]
    assert abs(found["damping_ratio"] - truth.damping_ratio) < 3 * found["damping_error"]
    assert result["density"]["value"] == pytest.approx(truth.density, rel=0.02)
    material = read_material(out / "material.json")
    assert material.youngs == result["youngs"]["value"]
    assert f"--youngs {material.youngs:.4g} --density {material.density:.4g}" in text
    picture = imread(out / "identify.png")
    assert picture.shape[0] > 400
    assert picture.std() > 0.05
    assert sorted(p.name for p in out.iterdir()) == ["identify.json", "identify.png", "material.json"]


def test_plucks_are_averaged_and_what_lies_before_the_release_is_cut(capsys, tmp_path, files) -> None:
    rows = files["trace"].read_text().splitlines()[2:]
    late = [f"{float(t) + 1:.6g},{x}" for t, x in (row.split(",") for row in rows)]
    held = tmp_path / "held.csv"
    held.write_text(
        "\n".join(["time_s,displacement_mm", *(f"{0.02 * k:g},{8 + 20 * (k % 7)}" for k in range(50)), *late])
    )
    stem = ("--density", 1080)
    once = json.loads(said(capsys, *stem, "--trace", files["trace"], "--json"))
    twice = json.loads(said(capsys, *stem, "--trace", files["trace"], held, "--start", 1, "--json"))
    assert (once["vibration"]["plucks"], twice["vibration"]["plucks"]) == (1, 2)
    assert twice["vibration"]["frequency"] == pytest.approx(once["vibration"]["frequency"], rel=1e-3)
    assert twice["vibration"]["frequency_error"] < once["vibration"]["frequency_error"]


def test_density_alone_and_damping_without_a_shape(capsys, files) -> None:
    alone = json.loads(said(capsys, "--samples", files["samples"], "--json"))
    assert alone["youngs"] is None
    assert alone["samples"]["count"] == 12
    damped = json.loads(said(capsys, "--density", 1000, "--trace", files["trace"], "--json"))
    assert damped["material"]["damping_ratio"] == pytest.approx(0.04, abs=0.003)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "nothing to identify"),
        (("--density", 1100, "--frequency", 1.4), "shape is missing"),
        (("--length", 0.3, "--frequency", 1.4, "--density", 1000), "incomplete"),
        ((*AUTHORS[:-1], 9), "10 <= density <= 5000"),
        ((*AUTHORS, "--orientation", "sideways"), "sideways"),
        ((*AUTHORS, "--frequency-error", "nan"), "frequency_error: got nan"),
        ((*AUTHORS, "--errors.radius", 0.002), "half the thinnest radius"),
        ((*AUTHORS, "--errors.length", -1), "errors.length"),
        (("--length", 0.3, "--radius", 3, "--frequency", 1.4, "--density", 1000), "radius: got 3 m"),
        (
            ("--length", 0.6, "--radius", 0.003, "--frequency", 0.5, "--density", 900, "--orientation", "hanging"),
            "gravity",
        ),
        (("--density", 1000, "--samples", __file__), "give one of them"),
        (("--samples", "nowhere.csv"), "nowhere.csv: no such file"),
        (("--density", 1000, "--orientation", "upright"), "--orientation has no effect without --trace"),
        ((*AUTHORS, "--start", 1), "--start has no effect without --trace"),
    ],
)
def test_bad_options_are_refused(capsys, words, message: str) -> None:
    assert message in refused(capsys, *words)


GOOD = "mass_g,radius_mm,length_mm\n1.2,3.0,40\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no line"),
        ("# only a comment\n\n", "no line"),
        ("mass_g,radius_mm,length_mm\n", "no row below"),
        (GOOD.replace("mass_g", "weight_g"), "line 1, column 1: got 'weight_g'; allowed: columns mass_g"),
        (GOOD.replace("mass_g", "mass"), "line 1, column 1: got 'mass'"),
        (GOOD.replace("mass_g", "mass_lb"), "line 1, column 1: got 'mass_lb'"),
        ("mass_g,length_mm\n1,2\n", "line 1: got no column for radius; allowed: radius_m, radius_cm"),
        (GOOD.replace("length_mm", "diameter_mm"), "'diameter_mm' and 'radius_mm'"),
        (GOOD + "1.2,3.0\n", "line 3: got 2 cells; allowed: 3"),
        (GOOD + "1.2,three,40\n", "line 3, column radius_mm: got 'three'; allowed: a number"),
        (GOOD + "1.2,,40\n", "line 3, column radius_mm: got an empty cell"),
        (GOOD + "nan,3,40\n", "line 3, column mass_g: got 'nan'"),
        (GOOD + "1_2,3,40\n", "line 3, column mass_g: got '1_2'"),
        (GOOD + "1.2,3000,40\n", "0.01 <= radius_mm <= 50"),
        (GOOD + "-1.2,3,40\n", "<= mass_g <= 1000"),
        ("#c\n\n" + GOOD + "\n1.2,x,40\n", "line 6, column radius_mm"),
    ],
)
def test_bad_tables_say_file_line_and_column(capsys, tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "samples.csv"
    path.write_text(text)
    told = refused(capsys, "--samples", path)
    assert message in told
    assert "samples.csv" in told


def test_bad_bytes_folders_orders_and_places_are_refused(capsys, tmp_path: Path, files) -> None:
    path = tmp_path / "samples.csv"
    path.write_bytes(b"\xff\xfe\x00mass")
    assert "a CSV file, UTF-8" in refused(capsys, "--samples", path)
    assert "got a folder; allowed: a file" in refused(capsys, "--samples", tmp_path)
    path.write_text("time_s,displacement_mm\n0,1\n0.1,2\n0.1,3\n")
    assert "line 4, column time_s: got '0.1'; allowed: more than" in refused(capsys, "--density", 1000, "--trace", path)
    path.write_text("time_s,displacement_mm\n0,1\n0.1,2\n")
    assert "16 or more" in refused(capsys, "--density", 1000, "--trace", path)
    path.write_text("distance_mm,mass_g\n310,2\n")
    stem = ("--profile", files["profile"], "--density", 1000, "--frequency", 4, "--leaves", path)
    assert "0 to 300 mm" in refused(capsys, *stem)


def test_units_diameters_semicolons_and_decimal_commas_are_understood(tmp_path: Path) -> None:
    path = tmp_path / "samples.csv"
    path.write_text(
        '\ufeff# cut on Monday\nnote;length_cm;diameter_mm;mass_kg\n"a; b";4,0;6,0;0,0012\n', encoding="utf-8"
    )
    table = read_measurements(path, SAMPLES)
    assert {k: v.tolist() for k, v in table.items()} == {
        "mass": [0.0012],
        "radius": [pytest.approx(3e-3)],
        "length": [pytest.approx(0.04)],
    }
    path.write_text("mass_g\tdistance_m\n0.5\t0.1\n0\t0\n")
    assert read_measurements(path, LEAVES)["mass"].tolist() == [5e-4, 0]


cell = st.one_of(st.floats(width=32).map(str), st.text(alphabet="0123456789.,;eE+-x \t\"'#é\x00", max_size=8))


@settings(max_examples=60)
@given(
    st.lists(st.tuples(cell, cell), max_size=4), st.sampled_from(["time_s,displacement_mm", "time_ms;displacement_m"])
)
def test_any_table_is_read_or_refused(tmp_path_factory, rows, header: str) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_text("\n".join([header, *(",".join(row) for row in rows)]), encoding="utf-8")
    table = {}
    with contextlib.suppress(InputError):
        table = read_measurements(path, TRACE)
    assert all(np.isfinite(column).all() and len(column) for column in table.values())
    assert np.all(np.diff(table.get("time", [])) > 0)
