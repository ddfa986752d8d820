"""Skeletons, materials and folders as other people's programs leave them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anther.cli.main import main
from anther.cli.traits import clouds_in
from anther.core.errors import InputError, StageFailure
from anther.perception.formats.skeletons import read_skeleton, write_skeleton
from anther.perception.skeleton import Skeleton
from anther.plant.imported import read_source
from anther.plant.source import Properties, read_plant

HEIGHT = np.linspace(0, 0.3, 16)


def rows(scale: float = 1.0, *, tip: float = 0.002, first_parent: int = -1, lead: tuple[str, ...] = ()) -> list[str]:
    """A stem of 16 nodes along z, a branch of 4 at its node 9; ids from 1."""
    radius = np.linspace(0.004, 0.002, 16)
    radius[-1] = tip
    out = [
        f"{i + 1} 2 0 0 {scale * z:.9g} {scale * r:.9g} {i if i else first_parent}"
        for i, (z, r) in enumerate(zip(HEIGHT, radius, strict=True))
    ]
    out += [
        f"{17 + k} 3 {scale * x:.9g} 0 {scale * (0.15 + x / 4):.9g} {scale * 0.0015:.9g} {16 + k if k else 9}"
        for k, x in enumerate((0.02, 0.04, 0.06, 0.08))
    ]
    return [*lead, *out]


def write(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join([*lines, ""]))
    return path


@pytest.mark.parametrize(("units", "scale"), [("cm", 100.0), ("mm", 1000.0), ("m", 1.0)])
@pytest.mark.parametrize("stated", [True, False])
def test_lengths_in_other_units(tmp_path: Path, units: str, scale: float, stated: bool) -> None:
    wanted = read_skeleton(write(tmp_path / "m.swc", rows()))
    lead = (f"# units: {units}",) if stated else ()
    path = write(tmp_path / "a.swc", rows(scale, lead=lead))
    read = read_skeleton(path, None if stated else units)  # type: ignore[arg-type]
    np.testing.assert_allclose(read.nodes, wanted.nodes, atol=1e-9)
    assert read.radius is not None
    np.testing.assert_allclose(read.radius, wanted.radius, atol=1e-9)
    if not stated and units != "m":
        with pytest.raises(InputError, match=f"--units {units} .0.31 m"):
            read_skeleton(path)


def test_a_tall_plant_is_taken_where_its_units_are_said(tmp_path: Path) -> None:
    path = write(tmp_path / "a.swc", rows(30.0))
    with pytest.raises(InputError, match="If it is right: --units m"):
        read_skeleton(path)
    assert read_skeleton(path, "m").nodes[:, 2].max() == pytest.approx(9.0)
    with pytest.raises(InputError, match="a plant of 310 m"):
        read_skeleton(write(tmp_path / "b.swc", rows(1000.0)), "m")


def test_units_that_contradict_the_file_are_said(tmp_path: Path) -> None:
    path = write(tmp_path / "a.swc", rows(100.0, lead=("# units: mm",)))
    assert any("states mm and is read in cm" in note for note in read_skeleton(path, "cm").notes)


@pytest.mark.parametrize("marks", [0, 1])
def test_the_root_may_hang_on_nothing_or_on_itself(tmp_path: Path, marks: int) -> None:
    wanted = read_skeleton(write(tmp_path / "m.swc", rows()))
    read = read_skeleton(write(tmp_path / "a.swc", rows(first_parent=marks)))
    np.testing.assert_array_equal(read.parent, wanted.parent)
    np.testing.assert_array_equal(read.nodes, wanted.nodes)


def test_a_branch_may_begin_with_a_copy_of_the_point_it_leaves(tmp_path: Path) -> None:
    wanted = read_skeleton(write(tmp_path / "m.swc", rows()))
    lines = rows()
    copy = "30 3 0 0 0.16 0.0015 9"
    hung = [line.rsplit(" ", 1)[0] + " 30" if line.startswith("17 ") else line for line in lines]
    read = read_skeleton(write(tmp_path / "a.swc", [*hung[:16], copy, *hung[16:]]))
    np.testing.assert_allclose(read.nodes, wanted.nodes)
    np.testing.assert_array_equal(read.parent, wanted.parent)
    np.testing.assert_array_equal(read.numbers, wanted.numbers)
    assert read.node(30) == read.node(9)
    assert any("left out: 30" in note for note in read.notes)
    assert read.rooted_at(16).node(30) == read.rooted_at(16).node(9)


def test_a_tip_may_taper_to_nothing(tmp_path: Path) -> None:
    path = write(tmp_path / "a.swc", rows(tip=0.0))
    source, skeleton = read_source(path)
    assert skeleton.radius.min() == pytest.approx(0.0005)
    assert any("tips of radius 0" in note for note in source.notes)
    assert read_source(path, least=0.003)[1].radius.min() == pytest.approx(0.003)


def test_a_hollow_stem_is_named(tmp_path: Path) -> None:
    lines = [line.replace(line.split()[5], "0") if line.startswith("5 ") else line for line in rows()]
    path = write(tmp_path / "a.swc", lines)
    with pytest.raises(InputError, match=r"radius 0 at node 5.*--radius.*--least-radius"):
        read_source(path)
    assert read_source(path, least=0.001)[1].radius.min() == pytest.approx(0.001)


def test_radii_that_are_all_zero_are_not_known(tmp_path: Path) -> None:
    lines = [" ".join([*line.split()[:5], "0", line.split()[6]]) for line in rows()]
    source, skeleton = read_source(write(tmp_path / "a.swc", lines))
    assert source.radius is None
    assert skeleton.radius[0] == pytest.approx(0.005)  # a tomato's
    assert any("not known" in note for note in source.notes)


@pytest.mark.parametrize(
    ("options", "words"),
    [({"density": 1.05}, "1.05 g/cm3 are 1050"), ({"density": 9000.0}, "10 to 5000"), ({"youngs": 1e13}, "youngs")],
)
def test_a_material_in_other_units_is_refused(tmp_path: Path, options: dict[str, float], words: str) -> None:
    path = write(tmp_path / "a.swc", rows())
    with pytest.raises(InputError, match=words):
        read_plant(path, Properties(changes=options))


def test_the_stiffness_that_would_hold_a_plant_is_told_however_far_off(tmp_path: Path) -> None:
    path = write(tmp_path / "a.swc", rows())
    stated = set()
    for youngs in (1e4, 3e4, 1e5):
        with pytest.raises(StageFailure, match=r"would stand from E = [0-9.e+]+ Pa.*100 MPa is 100e6") as failure:
            read_plant(path, Properties(changes={"youngs": youngs}), bare=True)
        stated.add(str(failure.value).split("E = ")[2].split(" Pa")[0])
    assert len({f"{float(value):.1e}" for value in stated}) == 1


@pytest.mark.parametrize(
    ("lead", "factor", "words"),
    [
        ("# units: um", 1e6, ""), ("# units: µm", 1e6, ""), ("# units: inch", 1 / 0.0254, ""), ("# UNIT cm", 100, ""),
        ("# All coordinates are in millimeters", 1000, ""), ("# id type x(mm) y(mm) z(mm) r(mm) parent", 1000, ""),
        ("# SCALE 0.01 0.01 0.01", 1, "its SCALE 0.01 0.01 0.01 is not applied"), ("# SCALE 1 1 1", 1, ""),
        ("# units: m, y up", 1, "y is up and is read with z up"),
    ],
)  # fmt: skip
def test_what_comments_state_is_used_or_told(tmp_path: Path, lead: str, factor: float, words: str) -> None:
    read = read_skeleton(write(tmp_path / "a.swc", rows(factor, lead=(lead,))))
    np.testing.assert_allclose(read.nodes, read_skeleton(write(tmp_path / "m.swc", rows())).nodes, atol=1e-9)
    assert any(words in note for note in read.notes) if words else not read.notes


def test_units_in_the_comments_of_other_skeletons(tmp_path: Path) -> None:
    source, skeleton = read_source(write(tmp_path / "m.swc", rows()))
    for suffix, mark in ((".txt", "# "), (".ply", "comment ")):
        path = tmp_path / f"a{suffix}"
        write_skeleton(path, Skeleton(100 * skeleton.nodes, skeleton.parent, 100 * skeleton.radius))
        data = path.read_bytes()
        data = data.replace(b"comment anther skeleton, metres, z up", b"comment made elsewhere")
        at = data.find(b"\n") + 1 if suffix == ".ply" else 0
        path.write_bytes(data[:at] + f"{mark}units: cm\n".encode() + data[at:])
        assert np.ptp(read_skeleton(path).nodes[:, 2]) == pytest.approx(np.ptp(source.nodes[:, 2]))


@pytest.mark.parametrize("name", ["D", "diam", "diameter", "Diameter"])
def test_a_column_of_diameters_is_halved(tmp_path: Path, name: str) -> None:
    thick = [" ".join([*line.split()[:5], f"{2 * float(line.split()[5]):g}", line.split()[6]]) for line in rows()]
    read = read_skeleton(write(tmp_path / "a.swc", [f"# n T x y z {name} P", *thick]))
    wanted = read_skeleton(write(tmp_path / "m.swc", ["# n T x y z R P", *rows()]))
    assert read.radius is not None
    assert wanted.radius is not None
    np.testing.assert_allclose(read.radius, wanted.radius, rtol=1e-5)
    assert any("diameter" in note for note in read.notes)


def test_points_that_draw_the_soma_are_no_branches(tmp_path: Path) -> None:
    cell = ["101 1 0 0 0 0.004 -1", "102 1 0 0.004 0 0.004 101", "103 1 0 -0.004 0 0.004 101"]
    read = read_skeleton(write(tmp_path / "a.swc", [*cell, *rows(first_parent=101)]))
    np.testing.assert_allclose(read.nodes, read_skeleton(write(tmp_path / "m.swc", rows())).nodes)
    assert any("2 points that only draw the soma" in note for note in read.notes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda cells: [*cells[:5], f"{1000 * float(cells[5]):g}", cells[6]], "radius 4 m on a plant of 0.31 m"),
        (lambda cells: [*cells[:5], "1", cells[6]], "radius 1 m on a plant"),
        (lambda cells: [*cells[:5], f"-{cells[5]}", cells[6]], "radius -0.004 at node 1"),
        (lambda cells: [f"{cells[0]}.5", *cells[1:]], "an id 1.5"),
    ],
)  # fmt: skip
def test_radii_and_ids_that_no_plant_has_are_refused(tmp_path: Path, change: Any, words: str) -> None:
    path = write(tmp_path / "a.swc", [" ".join(change(line.split())) for line in rows()])
    with pytest.raises(InputError, match=words):
        read_source(path)


def test_hidden_files_are_left_out_and_links_are_followed(tmp_path: Path) -> None:
    clouds, other, out = tmp_path / "clouds", tmp_path / "other", tmp_path / "clouds" / "out"
    for folder in (clouds / "day 1", other, out, clouds / "__MACOSX", clouds / ".cache"):
        folder.mkdir(parents=True)
    for path in (
        clouds / "day 1/a.ply", clouds / "day 1/._a.ply", other / "b.ply", out / "plants.csv", clouds / ".c.xyz",
        clouds / "__MACOSX/a.ply", clouds / ".cache/a.ply",
    ):  # fmt: skip
        path.write_text("x")
    (clouds / "day 2").symlink_to(other)
    (other / "circle").symlink_to(clouds)
    (clouds / "again.ply").symlink_to(clouds / "day 1/a.ply")
    (clouds / "lost.ply").symlink_to(clouds / "nowhere.ply")
    found, left_out = clouds_in(clouds, out)
    assert sorted(path.resolve().name for path in found) == ["a.ply", "b.ply"]
    assert sorted(left_out) == ["._a.ply", ".c.xyz", "__MACOSX", "lost.ply"]


def test_export_tells_what_it_left_out(tmp_path: Path, capsys) -> None:
    path = write(tmp_path / "a.swc", rows(100.0, tip=0.0))
    assert main(["view", str(path), "--units", "cm", "--to", str(tmp_path / "b.ply")]) == 0
    assert "note: 1 tips of radius 0" in capsys.readouterr().out
