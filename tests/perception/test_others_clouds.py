"""Point clouds as other people's programs write them: decimal commas, named columns, colours of many kinds, lists."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pye57
import pytest
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError, MissingExtra
from anther.core.files import write_text
from anther.perception.cloud.ply import read_elements
from anther.perception.formats.clouds import read_cloud

RNG = np.random.default_rng(0)
POINTS = np.round(RNG.uniform(-0.2, 0.4, (300, 3)), 4)
COLORS = RNG.integers(0, 256, (300, 3)).astype(np.uint8)
INTENSITY = RNG.integers(0, 256, 300)


def rows(*columns: np.ndarray, separator: str = " ", form: Callable[[float], str] = "{:g}".format) -> list[str]:
    table = np.column_stack(columns)
    return [separator.join(form(value) for value in row) for row in table]


def german(value: float) -> str:
    return f"{value:.2f}".replace(".", ",")


@pytest.mark.parametrize("separator", [" ", ";", "\t", "; ", "   ", ", "])
@pytest.mark.parametrize("head", ["", "x{0}y{0}z\n", "# exported\n"])
def test_decimal_commas(tmp_path: Path, separator: str, head: str) -> None:
    lines = rows(1e3 * POINTS, separator=separator, form=german)
    (tmp_path / "a.txt").write_text(head.format(separator) + "\n".join(lines) + "\n")
    np.testing.assert_allclose(read_cloud(tmp_path / "a.txt", "mm", "z").points, POINTS, atol=1e-5)


def test_decimal_commas_in_quotes(tmp_path: Path) -> None:
    lines = [",".join(f'"{german(v)}"' for v in point) for point in 1e3 * POINTS]
    (tmp_path / "a.csv").write_text("\n".join(["x,y,z", *lines]))
    np.testing.assert_allclose(read_cloud(tmp_path / "a.csv", "mm", "z").points, POINTS, atol=1e-5)


def test_commas_that_could_be_both_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(rows(1e3 * POINTS, separator=",", form=german)))
    with pytest.raises(InputError, match="decimal commas"):
        read_cloud(tmp_path / "a.csv", "mm", "z")
    (tmp_path / "a.xyz").write_text("\n".join(rows(1e5 + 1e6 * POINTS, form="{:,.2f}".format)))
    with pytest.raises(InputError, match="thousands"):
        read_cloud(tmp_path / "a.xyz", "mm", "z")


@pytest.mark.parametrize(
    "line",
    ["0.1,0.2,0.3", "0.1, 0.2, 0.3", "0.1 0.2 0.3", "0.1\t0.2\t0.3", "0.1;0.2;0.3;", "0.1,0.2 0.3", "1e-1 2e-1 3e-1"],
)
def test_decimal_points_between_any_marks(tmp_path: Path, line: str) -> None:
    (tmp_path / "a.txt").write_text("\n".join([line] * 30 + [line.translate(str.maketrans("123", "456"))] * 30))
    points = read_cloud(tmp_path / "a.txt", "m", "z").points
    np.testing.assert_allclose(points[0], [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("names", "units"),
    [
        ("x y z", None), ("X Y Z", None), ('"x" "y" "z"', None), ("x_mm y_mm z_mm", "mm"), ("pos_x pos_y pos_z", None),
        ("Points:0 Points:1 Points:2", None), ("x[mm] y[mm] z[mm]", "mm"), ("x_coord y_coord z_coord", None),
    ],
)  # fmt: skip
@pytest.mark.parametrize("lead", ["", "//", "# "])
def test_columns_are_taken_by_their_names(tmp_path: Path, names: str, units: str | None, lead: str) -> None:
    x, y, z = names.split()
    head = ",".join(["intensity", z, x, y, "label"])
    table = rows(INTENSITY, 1e3 * POINTS[:, [2, 0, 1]], INTENSITY, separator=",")
    (tmp_path / "a.csv").write_text("\n".join([lead + head, *table]))
    cloud = read_cloud(tmp_path / "a.csv", None if units else "mm", "z")
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-4)
    assert any("not used of the file: intensity, label" in note for note in cloud.notes)


def test_a_line_of_units_below_the_names(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(["i,x,y,z", ",mm,mm,mm", *rows(INTENSITY, 1e3 * POINTS, separator=",")]))
    np.testing.assert_allclose(read_cloud(tmp_path / "a.csv", None, "z").points, POINTS, atol=1e-4)


def test_units_that_contradict_the_names_are_said(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(["x_cm,y_cm,z_cm", *rows(1e3 * POINTS, separator=",")]))
    assert any("states cm and is read in mm" in note for note in read_cloud(tmp_path / "a.csv", "mm", "z").notes)


def test_names_without_x_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(["east,north,up,i", *rows(POINTS, INTENSITY, separator=",")]))
    with pytest.raises(InputError, match="columns east, north, up, i; allowed: x, y and z"):
        read_cloud(tmp_path / "a.csv", "m", "z")


@pytest.mark.parametrize("head", ["", '"" X Y Z R G B', "X Y Z R G B"])
def test_a_first_column_that_counts_is_no_coordinate(tmp_path: Path, head: str) -> None:
    table = rows(np.arange(300), POINTS, COLORS)
    (tmp_path / "a.xyz").write_text("\n".join([head, *table]))
    cloud = read_cloud(tmp_path / "a.xyz", "m", "z")
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-4)
    np.testing.assert_array_equal(cloud.colors, COLORS)
    assert any("not used" in note for note in cloud.notes)


def test_a_count_before_the_points(tmp_path: Path) -> None:
    table = rows(POINTS, INTENSITY, COLORS)
    (tmp_path / "a.pts").write_text("\n".join(["300", *table]))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.pts", "m", "z").colors, COLORS)
    (tmp_path / "a.pts").write_text("\n".join(["500", *table]))
    with pytest.raises(InputError, match="300 points"):
        read_cloud(tmp_path / "a.pts", "m", "z")


@pytest.mark.parametrize("head", ["organ,x,y,z", ""])
def test_a_column_of_words_is_no_number(tmp_path: Path, head: str) -> None:
    table = [f"leaf,{line}" for line in rows(POINTS, separator=",")]
    (tmp_path / "a.csv").write_text("\n".join([head, *table]))
    cloud = read_cloud(tmp_path / "a.csv", "m", "z")
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-4)
    assert any("not used of the file" in note for note in cloud.notes)


NORMALS = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)


@pytest.mark.parametrize(
    "columns",
    [
        (COLORS,), (COLORS, NORMALS), (NORMALS, COLORS), (COLORS, np.full(300, 255)), (np.full(300, 7), COLORS),
        (np.round(COLORS / 255, 6),), (INTENSITY - 500.0, COLORS), (NORMALS, np.round(COLORS / 255, 6)),
    ],
)  # fmt: skip
def test_colours_without_names(tmp_path: Path, columns: tuple[np.ndarray, ...]) -> None:
    (tmp_path / "a.txt").write_text("\n".join(rows(POINTS, *columns, form="{:.9g}".format)))
    cloud = read_cloud(tmp_path / "a.txt", "m", "z")
    np.testing.assert_array_equal(cloud.colors, COLORS)


def test_colours_that_cannot_be_told_are_left_out_and_named(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("\n".join(rows(POINTS, INTENSITY, COLORS)))
    cloud = read_cloud(tmp_path / "a.txt", "m", "z")
    assert cloud.colors is None
    assert any("columns 4, 5, 6, 7" in note and "r, g, b" in note for note in cloud.notes)
    (tmp_path / "a.txt").write_text("\n".join(rows(POINTS, NORMALS)))
    assert read_cloud(tmp_path / "a.txt", "m", "z").colors is None


@pytest.mark.parametrize(
    "names", ["R G B", "red green blue", "Rf Gf Bf", "r g b", "diffuse_red diffuse_green diffuse_blue"]
)
@pytest.mark.parametrize("factor", [1.0, 257.0, 1 / 255])
def test_colours_by_name_in_text(tmp_path: Path, names: str, factor: float) -> None:
    table = rows(POINTS, INTENSITY, factor * COLORS.astype(float), form="{:.9g}".format)
    (tmp_path / "a.txt").write_text("\n".join([f"//X Y Z Intensity {names}", *table]))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.txt", "m", "z").colors, COLORS)


def ply(kinds: dict[str, str], values: list[np.ndarray], more: str = "", tail: bytes = b"") -> bytes:
    types = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}
    table = np.zeros(300, [(name, "<" + kind) for name, kind in kinds.items()])
    for name, column in zip(kinds, np.column_stack(values).T, strict=True):
        table[name] = column
    properties = "".join(f"property {types[kind]} {name}\n" for name, kind in kinds.items())
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex 300\n{properties}{more}end_header\n"
    return head.encode() + table.tobytes() + tail


@pytest.mark.parametrize(
    ("names", "kind", "values"),
    [
        ("red green blue", "f4", COLORS / 255), ("red green blue", "u2", COLORS * 257.0), ("r g b", "u1", COLORS),
        ("diffuse_red diffuse_green diffuse_blue", "u1", COLORS), ("Red Green Blue", "i4", COLORS),
        ("red green blue", "f4", COLORS), ("f_dc_0 f_dc_1 f_dc_2", "f4", (COLORS / 255 - 0.5) / 0.28209479177387814),
    ],
)  # fmt: skip
def test_colours_of_a_ply(tmp_path: Path, names: str, kind: str, values: np.ndarray) -> None:
    kinds = dict.fromkeys("xyz", "f8") | dict.fromkeys(names.split(), kind) | {"quality": "f4"}
    (tmp_path / "a.ply").write_bytes(ply(kinds, [POINTS, values, POINTS[:, :1]]))
    cloud = read_cloud(tmp_path / "a.ply", "m", "z")
    np.testing.assert_array_equal(cloud.colors, COLORS)
    assert any("not used of the file: quality" in note for note in cloud.notes)


PACKED = (COLORS.astype(np.uint32) << np.array([16, 8, 0], np.uint32)).sum(axis=1).astype(np.uint32)


@pytest.mark.parametrize(
    ("fields", "kinds", "columns"),
    [
        ("rgba", "U", [PACKED + (255 << 24)]), ("rgb", "U", [PACKED]), ("rgb", "F", [PACKED.astype(float)]),
        ("rgb", "F", [PACKED.view(np.float32).astype(float)]), ("r g b", "U U U", [COLORS]),
    ],
)  # fmt: skip
def test_colours_of_a_pcd(tmp_path: Path, fields: str, kinds: str, columns: list[np.ndarray]) -> None:
    more = len(fields.split())
    head = (
        f"VERSION 0.7\nFIELDS x y z {fields}\nSIZE 4 4 4{' 4' * more}\nTYPE F F F {kinds}\nCOUNT 1 1 1{' 1' * more}\n"
        "WIDTH 300\nHEIGHT 1\nVIEWPOINT 0 0 1 1 0 0 0\nPOINTS 300\nDATA ascii\n"
    )
    (tmp_path / "a.pcd").write_text(head + "\n".join(rows(POINTS, *columns, form="{:.17g}".format)))
    cloud = read_cloud(tmp_path / "a.pcd", "m", "z")
    np.testing.assert_array_equal(cloud.colors, COLORS)
    assert any("VIEWPOINT" in note for note in cloud.notes)


@pytest.mark.parametrize("values", [COLORS / 255, COLORS, COLORS * 257.0, COLORS.astype(np.uint16) * 257])
def test_colours_of_an_npz(tmp_path: Path, values: np.ndarray) -> None:
    np.savez(tmp_path / "a.npz", points=POINTS, rgb=values)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npz", "m", "z").colors, COLORS)


@pytest.mark.parametrize("order", ["<", ">", "ascii"])
def test_lists_in_and_before_the_vertices_of_a_ply(tmp_path: Path, order: str) -> None:
    kind = {"<": "binary_little_endian", ">": "binary_big_endian", "ascii": "ascii"}[order]
    head = (
        f"ply\nformat {kind} 1.0\nelement camera 2\nproperty list ushort float pose\nproperty int id\n"
        "element vertex 300\nproperty float x\nproperty list uchar int view\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    lists = [list(range(k % 4)) for k in range(300)]
    if order == "ascii":
        body = ["2 0.5 0.5 7", "0 8"]
        body += [f"{x} {len(v)} {' '.join(map(str, v))} {y} {z}" for (x, y, z), v in zip(POINTS, lists, strict=True)]
        (tmp_path / "a.ply").write_text(head + "\n".join([*body, "3 0 1 2", ""]))
    else:
        data = np.array([2], order + "u2").tobytes() + np.array([0.5, 0.5], order + "f4").tobytes()
        data += np.array([7], order + "i4").tobytes() + np.array([0], order + "u2").tobytes()
        data += np.array([8], order + "i4").tobytes()
        for (x, y, z), v in zip(POINTS, lists, strict=True):
            data += np.array([x], order + "f4").tobytes() + bytes([len(v)]) + np.array(v, order + "i4").tobytes()
            data += np.array([y, z], order + "f4").tobytes()
        (tmp_path / "a.ply").write_bytes(head.encode() + data)
        (tmp_path / "cut.ply").write_bytes((head.encode() + data)[:-5])
        with pytest.raises(InputError, match="rows of vertex"):
            read_cloud(tmp_path / "cut.ply")
    cloud = read_cloud(tmp_path / "a.ply", "m", "z")
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-6)
    assert any("not used of the file: view" in note for note in cloud.notes)
    assert set(read_elements(tmp_path / "a.ply")) == {"vertex"}


def test_a_ply_without_vertices_is_told_what_it_has(tmp_path: Path) -> None:
    write_text(tmp_path / "a.ply", "ply\nformat ascii 1.0\nelement face 0\nproperty list uchar int i\nend_header\n")
    with pytest.raises(InputError, match="no element 'vertex', only face"):
        read_cloud(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("comment", "factor"),
    [
        ("units: mm", 1e-3),
        ("Unit: centimeters", 1e-2),
        ("lengths in inches", 0.0254),
        ("coordinates are in feet", 0.3048),
    ],
)
@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".xyz"])
def test_units_and_axis_that_comments_state_are_used(tmp_path: Path, suffix: str, comment: str, factor: float) -> None:
    body = rows(POINTS[:, [0, 2, 1]] * [1, 1, -1] / factor, form="{:.9g}".format)
    pcd = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {len(body)}\nHEIGHT 1\nDATA ascii"
    heads = {
        ".ply": ply({"x": "f4", "y": "f4", "z": "f4"}, [POINTS]).decode("latin-1").partition("end_header")[0]
        + "end_header",
        ".pcd": f"# {comment}, y up\n{pcd}",
        ".xyz": f"# {comment}, y up",
    }
    head = heads[suffix].replace("binary_little_endian 1.0", f"ascii 1.0\ncomment {comment}, y up")
    (tmp_path / f"a{suffix}").write_text("\n".join([head, *body]))
    cloud = read_cloud(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(cloud.points, np.column_stack([-POINTS[:, 1], POINTS[:, 0], POINTS[:, 2]]), atol=1e-4)
    assert cloud.notes == ()


def test_blank_lines_in_a_ply_lose_no_points(tmp_path: Path) -> None:
    head = (
        "ply\nformat ascii 1.0\nelement vertex 300\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    (tmp_path / "a.ply").write_text(head + "\n\n".join(rows(POINTS)))
    np.testing.assert_allclose(read_cloud(tmp_path / "a.ply", "m", "z").points, POINTS)


def test_what_a_ply_holds_beside_is_told(tmp_path: Path) -> None:
    kinds = dict.fromkeys(["x", "y", "z", "nx", "ny", "nz"], "f4") | {"label": "u1", "X": "f4"}
    (tmp_path / "a.ply").write_bytes(ply(kinds, [POINTS, NORMALS, INTENSITY, 99 + INTENSITY]))
    cloud = read_cloud(tmp_path / "a.ply", "m", "z")
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-6)
    assert "not used of the file: nx, ny, nz, label" in cloud.notes


def test_an_organised_pcd_may_hold_no_reading_in_most_places(tmp_path: Path) -> None:
    points = np.where(np.arange(300)[:, None] < 200, np.nan, POINTS)
    head = "VERSION .7\nFIELDS X Y Z\nSIZE 8 8 8\nTYPE F F F\nWIDTH 20\nHEIGHT 15\nDATA binary\n"
    (tmp_path / "a.pcd").write_bytes(head.encode() + points.tobytes())
    cloud = read_cloud(tmp_path / "a.pcd", "m", "z")
    np.testing.assert_array_equal(cloud.points, POINTS[200:])
    assert "200 of 300 points hold no reading (NaN) and are left out" in cloud.notes


@pytest.mark.parametrize("first", [np.full(300, 4), INTENSITY, np.arange(300) % 3])
def test_a_first_column_that_is_no_coordinate_is_refused_where_no_name_says_so(
    tmp_path: Path, first: np.ndarray
) -> None:
    (tmp_path / "a.xyz").write_text("\n".join(rows(first, POINTS)))
    with pytest.raises(InputError, match=r"whole numbers in column 1, not in the others.*Name the columns"):
        read_cloud(tmp_path / "a.xyz", "mm", "z")
    (tmp_path / "a.xyz").write_text("\n".join(["class x y z", *rows(first, POINTS)]))
    np.testing.assert_allclose(read_cloud(tmp_path / "a.xyz", "m", "z").points, POINTS)


@pytest.mark.parametrize("rank", [3 * np.arange(300), np.arange(300)[::-1]])
def test_numbers_of_rows_may_have_gaps_or_fall(tmp_path: Path, rank: np.ndarray) -> None:
    (tmp_path / "a.xyz").write_text("\n".join(rows(rank, 1e3 * POINTS)))
    np.testing.assert_allclose(read_cloud(tmp_path / "a.xyz", "mm", "z").points, POINTS, atol=1e-6)


def test_columns_in_several_units_and_colours_in_words_are_not_guessed(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(["x [m],y [mm],z [m]", *rows(POINTS, separator=",")]))
    with pytest.raises(InputError, match="x, y and z in one unit"):
        read_cloud(tmp_path / "a.csv")
    table = [f"{line},0x3c8c32" for line in rows(POINTS, separator=",")]
    (tmp_path / "a.csv").write_text("\n".join(["x,y,z,rgb", *table]))
    cloud = read_cloud(tmp_path / "a.csv", "m", "z")
    assert cloud.colors is None
    assert "not used of the file: rgb" in cloud.notes


def test_a_flat_cloud_is_no_plant(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("\n".join(rows(POINTS * [1, 0, 1])))
    with pytest.raises(InputError, match="y the same in all points"):
        read_cloud(tmp_path / "a.xyz", "m", "z")


FOOT = 'PROJCS["x",GEOGCS["g",UNIT["degree",0.0174]],UNIT["foot",0.3048]]'


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize(("form", "factor", "wkt"), [(3, 257, ""), (7, 1, ""), (7, 257, FOOT), (1, 0, ""), (6, 0, "")])
def test_las(tmp_path: Path, suffix: str, form: int, factor: int, wkt: str) -> None:
    header = laspy.LasHeader(point_format=form, version="1.4" if form > 5 else "1.2")
    header.scales, header.offsets = [1e-5] * 3, np.array([454_000.0, 5_412_000.0, 300.0])
    metres = 0.3048 if wkt else 1.0
    if wkt:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    las = laspy.LasData(header)
    las.x, las.y, las.z = (POINTS / metres + header.offsets).T
    las.intensity, las.withheld = INTENSITY, np.arange(300) < 10
    if factor:
        las.red, las.green, las.blue = (factor * COLORS.astype(np.uint16)).T
    las.write(str(tmp_path / f"a{suffix}"))
    cloud = read_cloud(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(cloud.points - metres * header.offsets, POINTS[10:], atol=1e-5)
    assert (cloud.colors is None) == (not factor)
    if factor:
        np.testing.assert_array_equal(cloud.colors, COLORS[10:])
    assert {"10 points marked as withheld are left out", "not used of the file: intensity"} <= set(cloud.notes)
    assert any("in metres (--units)" in note for note in cloud.notes) == (not wkt)
    data = (tmp_path / f"a{suffix}").read_bytes()
    for cut in (data[:-30], data[:-34], data[:100], b"LASF"):
        (tmp_path / f"b{suffix}").write_bytes(cut)
        with pytest.raises(InputError, match="LAS or LAZ"):
            read_cloud(tmp_path / f"b{suffix}")


def e57(path: Path) -> None:
    """Two scans, the second from another place and with points that are none; as pye57 writes them."""
    file = pye57.E57(str(path), mode="w")
    turn, shift = Rotation.from_euler("z", 0.6), np.array([1.0, 2.0, 3.0])
    for i, own in enumerate((POINTS[:200], (POINTS[200:] - shift) @ turn.as_matrix())):
        part = slice(200 * i, 200 * i + len(own))
        held = {f"cartesian{axis}": own[:, k].copy() for k, axis in enumerate("XYZ")}
        held |= {f"color{name}": COLORS[part, k].copy() for k, name in enumerate(("Red", "Green", "Blue"))}
        held |= {
            "intensity": INTENSITY[part] / 255,
            "cartesianInvalidState": (np.arange(len(own)) < 5 * i).astype(np.int8),
        }
        pose = {"rotation": turn.as_quat()[[3, 0, 1, 2]], "translation": shift} if i else {}
        file.write_scan_raw(held, **pose)
    file.close()


def test_e57(tmp_path: Path) -> None:
    path = tmp_path / "a.e57"
    e57(path)
    cloud = read_cloud(path)
    kept = np.r_[0:200, 205:300]
    np.testing.assert_allclose(cloud.points, POINTS[kept], atol=1e-6)
    np.testing.assert_array_equal(cloud.colors, COLORS[kept])
    wanted = {"5 points marked as invalid are left out", "2 scans are joined by their poses"}
    assert wanted | {"not used of the file: intensity"} <= set(cloud.notes)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(InputError, match="an E57 file"):
        read_cloud(path)
    assert path.exists()  # the library deletes what it cannot write


@pytest.mark.parametrize(("suffix", "module"), [("las", "laspy"), ("laz", "lazrs"), ("e57", "pye57")])
def test_what_reads_scans_is_named_where_it_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, module: str
) -> None:
    (tmp_path / f"a.{suffix}").write_bytes(b"")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtra, match=rf"needs {module}.*pip install 'anther\[scans\]'"):
        read_cloud(tmp_path / f"a.{suffix}")
