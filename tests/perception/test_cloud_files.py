"""Reading clouds: every format, units and axes, and what is refused with which words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from made_plants import simple_plant
from test_formats_pcd import write_pcd
from trimesh.exchange.ply import export_ply

from anther.core.errors import InputError
from anther.perception.formats.clouds import axis_notes, read_cloud

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(0, 0.4, (400, 3)).astype(np.float32)
COLORS = RNG.integers(0, 256, (400, 3)).astype(np.uint8)


def write_ply(path: Path, encoding: str = "binary") -> None:
    cloud = trimesh.PointCloud(POINTS, colors=COLORS)
    path.write_bytes(export_ply(cloud, encoding=encoding))


@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_ply(tmp_path: Path, encoding: str) -> None:
    write_ply(tmp_path / "a.ply", encoding)
    cloud = read_cloud(tmp_path / "a.ply")
    assert np.allclose(cloud.points, POINTS, atol=1e-6)
    assert cloud.colors is not None
    assert np.array_equal(cloud.colors, COLORS)


@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_a_mesh_is_read_as_its_vertices(tmp_path: Path, encoding: str) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    (tmp_path / "a.ply").write_bytes(export_ply(mesh, encoding=encoding))
    assert np.allclose(read_cloud(tmp_path / "a.ply", "m", "z").points, mesh.vertices, atol=1e-6)


@pytest.mark.parametrize("separator", [" ", ",", ";", "\t"])
@pytest.mark.parametrize("header", ["", "x y z r g b\n", "# made by hand\n", "400\n"])
def test_text(tmp_path: Path, separator: str, header: str) -> None:
    rows = "\n".join(
        separator.join([*(f"{v:.9g}" for v in p), *map(str, c)]) for p, c in zip(POINTS, COLORS, strict=True)
    )
    (tmp_path / "a.xyz").write_text(header + rows)
    cloud = read_cloud(tmp_path / "a.xyz")
    assert np.allclose(cloud.points, POINTS)
    assert cloud.colors is not None
    assert np.array_equal(cloud.colors, COLORS)


def test_npz_states_its_units_and_axis(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=POINTS * 1000, up=[0, 1.0, 0], units="mm", colors=COLORS)
    cloud = read_cloud(tmp_path / "a.npz")
    assert np.allclose(cloud.points[:, 2], POINTS[:, 1])
    assert np.allclose(read_cloud(tmp_path / "a.npz", up="z").points, POINTS, atol=1e-6)


def test_npz_of_several_plants(tmp_path: Path) -> None:
    whole = np.round(POINTS * 1e5).astype(np.int32)
    np.savez(tmp_path / "a.npz", points_x100=whole, offsets=[0, 100, 400])
    assert len(read_cloud(tmp_path / "a.npz", "mm", plant=0).points) == 100
    second = read_cloud(tmp_path / "a.npz", "mm", plant=1)
    assert np.allclose(second.points, POINTS[100:], atol=1e-5)
    with pytest.raises(InputError, match="0 <= plant <= 1"):
        read_cloud(tmp_path / "a.npz", "mm", plant=2)


@pytest.mark.parametrize(("up", "axis"), [("x", 0), ("y", 1), ("z", 2)])
def test_turning_z_up_keeps_handedness(tmp_path: Path, up: str, axis: int) -> None:
    np.savez(tmp_path / "a.npz", points=POINTS)
    turned = read_cloud(tmp_path / "a.npz", "m", up).points  # type: ignore[arg-type]
    assert np.allclose(turned[:, 2], POINTS[:, axis])
    turn = np.linalg.lstsq(POINTS - POINTS.mean(axis=0), turned - turned.mean(axis=0), rcond=None)[0]
    assert np.linalg.det(turn) == pytest.approx(1, abs=1e-3)


def test_a_few_broken_points_are_dropped_with_a_note(tmp_path: Path) -> None:
    points = POINTS.copy()
    points[:5, 1] = np.nan
    np.savez(tmp_path / "a.npz", points=points)
    cloud = read_cloud(tmp_path / "a.npz")
    assert len(cloud.points) == 395
    assert "5 of 400" in cloud.notes[0]


def broken(count: int) -> np.ndarray:
    points = POINTS.copy()
    points[:count] = np.inf
    return points


@pytest.mark.parametrize("far", [1e308, -1e20, 25.0])
def test_a_point_that_is_nowhere_near_the_plant_is_dropped_with_a_note(tmp_path: Path, far: float) -> None:
    points = POINTS.copy()
    points[7, 1] = far
    np.savez(tmp_path / "a.npz", points=points)
    cloud = read_cloud(tmp_path / "a.npz")
    assert len(cloud.points) == len(POINTS) - 1
    assert f"1 of {len(POINTS)} points" in cloud.notes[0]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (broken(100), "25%"),
        (POINTS[:2], "50 or more"),
        (POINTS[:0], "50 or more"),
        (POINTS * 1000, "--units mm"),
        (POINTS / 1000, "units"),
        (POINTS[:, :2], "shape"),
    ],
)
def test_bad_points_are_refused(tmp_path: Path, points: np.ndarray, message: str) -> None:
    np.savez(tmp_path / "a.npz", points=points)
    with pytest.raises(InputError, match=message):
        read_cloud(tmp_path / "a.npz")


@pytest.mark.parametrize(("scale", "units"), [(1, "m"), (100, "cm"), (1000, "mm"), (1e5, "0.01mm")])
def test_a_plant_in_the_wrong_units_is_told_which_would_fit(tmp_path: Path, scale: float, units: Any) -> None:
    np.savez(tmp_path / "a.npz", points=POINTS * scale)
    assert read_cloud(tmp_path / "a.npz", units, "z").points == pytest.approx(POINTS, abs=1e-6)
    for wrong in {"m", "cm", "mm", "0.01mm"} - {units}:
        try:
            cloud = read_cloud(tmp_path / "a.npz", wrong, "z")
            said, size = " ".join(cloud.notes), np.linalg.norm(np.ptp(cloud.points, axis=0))
        except InputError as error:
            said, size = str(error), 0.0
        assert f"--units {units}" in said or 0.03 < size < 5  # as good a plant


def test_what_a_file_leaves_open_is_said(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=POINTS)
    assert "--units" in read_cloud(tmp_path / "a.npz").notes[-1]
    assert "--up" in read_cloud(tmp_path / "a.npz").notes[-1]
    assert "--units" not in read_cloud(tmp_path / "a.npz", "m").notes[-1]
    assert read_cloud(tmp_path / "a.npz", "m", "z").notes == ()
    np.savez(tmp_path / "b.npz", points=POINTS, units="m", up=[0, 0, 1.0])
    assert read_cloud(tmp_path / "b.npz").notes == ()


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_axis_that_is_up_is_named_by_its_stem(tmp_path: Path, up: str) -> None:
    plant = simple_plant()
    in_file = plant[:, {"x": [2, 0, 1], "y": [1, 2, 0], "z": [0, 1, 2]}[up]]
    np.savez(tmp_path / "a.npz", points=in_file)
    said = " ".join(read_cloud(tmp_path / "a.npz", "m").notes)
    named = [axis for axis in "xyz" if f"try --up {axis}" in said]
    assert named == ([] if up == "z" else [up])
    assert "uncertain" not in said
    right = read_cloud(tmp_path / "a.npz", "m", up)
    assert np.allclose(right.points, plant)
    assert right.notes == (), "who says which is right is not contradicted"


def test_what_has_no_stem_leaves_the_axis_open() -> None:
    ball = RNG.normal(size=(4000, 3))
    ball *= 0.1 / np.linalg.norm(ball, axis=1, keepdims=True)
    (note,) = axis_notes(ball)
    assert "uncertain" in note


def test_missing_unknown_and_wrong_arrays(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_cloud(tmp_path / "none.ply")
    (tmp_path / "a.foo").write_bytes(b"LASF")
    with pytest.raises(InputError, match=r"\.pcd"):
        read_cloud(tmp_path / "a.foo")
    np.savez(tmp_path / "a.npz", vertices=POINTS)
    with pytest.raises(InputError, match="'points'"):
        read_cloud(tmp_path / "a.npz")


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz", "xyz"])
@settings(max_examples=12)
@given(share=st.floats(0, 0.9), junk=st.binary(max_size=40))
def test_truncated_files_are_refused_in_words(tmp_path_factory, suffix: str, share: float, junk: bytes) -> None:
    path = tmp_path_factory.mktemp("cut") / f"a.{suffix}"
    if suffix == "ply":
        write_ply(path)
    elif suffix == "pcd":
        write_pcd(path, "binary")
    elif suffix == "npz":
        np.savez(path, points=POINTS)
    else:
        path.write_bytes(b"0.1 0.2\n" * 100)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))] + junk)
    with pytest.raises(InputError, match="allowed"):
        read_cloud(path)
