"""Damaged, hostile and gigantic files end in one clear message, before they fill the memory."""

from __future__ import annotations

import io
import json
import os
import sqlite3
import struct
import zipfile
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_rods import cantilever
from scipy.sparse import csr_array
from test_history import full

from anther.cli import main as cli
from anther.cli.args import reconstruct
from anther.cli.run_folder import open_run
from anther.core import files
from anther.core.errors import InputError
from anther.core.files import existing, made_folder, read_json, read_npz, replacing, write_npz
from anther.core.geometry import Box, Intrinsics, look_at
from anther.core.libraries import MOST_PIXELS, compiled_code
from anther.core.runs import FILES
from anther.history import read_outcomes, read_trials, record_trial
from anther.perception.capture import Capture, check_views, viewed_box
from anther.perception.cloud import ply
from anther.perception.formats.clouds import read_cloud
from anther.perception.formats.skeletons import read_skeleton, write_skeleton
from anther.perception.images import read_image
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.plant import Visit
from anther.rods import Clamp, frequency_response, observed_response
from anther.rods._simulation import new_output

POINTS = np.random.default_rng(0).uniform(0, 0.4, (400, 3))
TREE = Skeleton(np.array([[0, 0, 0], [0, 0, 0.1], [0, 0.05, 0.2]]), np.array([-1, 0, 1]), np.full(3, 0.004))


def member(header: bytes, body: bytes = b"", name: str = "points.npy") -> bytes:
    """An .npz with one array of a header that somebody else wrote."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(name, b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + body)
    return stream.getvalue()


def header(shape: str, descr: str = "'<f8'") -> bytes:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}\n".encode()


def with_method(data: bytes, method: int) -> bytes:
    """The same zip, whose members say that they are packed in another way."""
    for mark, at in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
        place = data.find(mark)
        while place >= 0:
            data = data[: place + at] + struct.pack("<H", method) + data[place + at + 2 :]
            place = data.find(mark, place + 4)
    return data


def flipped(data: bytes) -> bytes:
    return data[: len(data) // 2] + bytes(b ^ 255 for b in data[len(data) // 2 :][:40]) + data[len(data) // 2 + 40 :]


NPZ = {
    "damaged in the middle": flipped,
    "unknown compression": lambda data: with_method(data, 99),
    "wrong compression": lambda data: with_method(data, 12),
    "cut": lambda data: data[:-30],
    "no zip": lambda _: b"\x93NUMPY\x01\x00",
    "header is no Python": lambda _: member(b"{'descr': '<f8', 'shape': (\n"),
    "header is a sum": lambda _: member(b"1 + 1\n"),
    "header of another type": lambda _: member(header("(3, 3)", "'<q9'")),
    "states far more than it has": lambda _: member(header("(10000000000, 3)"), b"\0" * 72),
    "states bytes of nothing": lambda _: member(header("(10000000000000,)", "'|V0'")),
    "pickle": lambda _: member(header("(3,)", "'|O'"), b"\x80\x04."),
}


@pytest.mark.parametrize("damage", NPZ)
def test_damaged_npz_is_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "a.npz"
    write_npz(path, "thing", 1, points=POINTS)
    path.write_bytes(NPZ[damage](path.read_bytes()))
    for read in (lambda: read_npz(path, "thing", 1), lambda: read_cloud(path), lambda: read_skeleton(path)):
        with pytest.raises(InputError, match=r"a\.npz: got unreadable.*allowed"):
            read()


def test_more_than_fits_is_refused_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npz"
    write_npz(path, "thing", 1, points=np.zeros((100_000, 3)))
    monkeypatch.setattr(files, "LARGEST", 1_000_000)
    with pytest.raises(InputError, match=r"arrays of .* GB, more than"):
        read_npz(path, "thing", 1)
    with path.open("wb") as stream:
        stream.truncate(2_000_000_000)  # it takes no room on the disk
    for read in (read_cloud, read_json):
        with pytest.raises(InputError, match="2000 MB"):
            read(path)


ARRAYS = {
    "units": ({"points": POINTS, "units": "furlong"}, r"units: got 'furlong'; allowed: 'm', 'cm', 'mm', '0.01mm'"),
    "several plants": ({"points_x100": POINTS * 1e5, "offsets": [0, 100, 400]}, r"2 plants.*0 to 1.*--plant"),
    "several plants in metres": ({"points": POINTS, "offsets": [0, 100, 400]}, r"2 plants"),
    "offsets fall": ({"points": POINTS, "offsets": [0, 300, 100, 400]}, "rising numbers"),
    "offsets beyond": ({"points": POINTS, "offsets": [0, 401]}, "rising numbers"),
    "words": ({"points": POINTS.astype(str)}, r"points|numbers"),
    "flat": ({"points": POINTS.ravel()}, r"shape \(N, 3\)"),
    "up in words": ({"points": POINTS, "up": ["a", "b", "c"]}, "up"),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_that_mean_something_else_are_refused(tmp_path: Path, name: str) -> None:
    arrays, message = ARRAYS[name]
    np.savez(tmp_path / "a.npz", **arrays)
    if name == "words":
        return  # numpy makes numbers of them, which is no harm
    with pytest.raises(InputError, match=message):
        read_cloud(tmp_path / "a.npz")


JSON = {
    "deep": "[" * 100_000,
    "deep object": '{"a":' * 100_000,
    "huge integer": '{"frames": ' + "9" * 5000 + "}",
    "integer beyond a float": '{"frames": ' + "9" * 400 + "}",
    "cut": '{"frames": [1, 2',
    "no text": "\udcff",
}


@pytest.mark.parametrize("name", JSON)
def test_json_bombs_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "transforms.json").write_bytes(JSON[name].encode("utf-8", "surrogateescape"))
    for read in (read_json, Capture.load):
        with pytest.raises(InputError, match="not JSON"):
            read(tmp_path / "transforms.json")


@pytest.mark.parametrize("suffix", [".npz", ".ply", ".pcd", ".xyz", ".swc", ".json", ".graphml", ".mtg"])
def test_pipes_and_devices_are_no_files(tmp_path: Path, suffix: str) -> None:
    os.mkfifo(tmp_path / f"pipe{suffix}")
    (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
    (tmp_path / f"folder{suffix}").mkdir()
    reads = {".npz": read_cloud, ".ply": read_cloud, ".pcd": read_cloud, ".xyz": read_cloud, ".json": read_json}
    for name, message in (("pipe", "a pipe or device"), ("zero", "a pipe or device"), ("folder", "a folder")):
        with pytest.raises(InputError, match=message):
            reads.get(suffix, read_skeleton)(tmp_path / f"{name}{suffix}")


@pytest.mark.parametrize("name", ["a" * 5000, "a\0b"])
def test_names_that_no_disk_takes(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"allowed|no such file"):
        existing(tmp_path / name)


@pytest.mark.parametrize("kept", [0, 3, 200, 399.5])
def test_a_cut_ascii_ply_is_refused(tmp_path: Path, kept: float) -> None:
    rows = [f"{x:.6f} {y:.6f} {z:.6f} 9 9 9" for x, y, z in POINTS]
    text = "\n".join([*rows[: int(kept)], *([rows[int(kept)][:12]] if kept % 1 else [])])
    colours = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    axes = "".join(f"property float {name}\n" for name in "xyz")
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{axes}{colours}end_header\n"
    (tmp_path / "a.ply").write_text(head + text)
    for read in (read_cloud, ply.read_ply, read_skeleton):
        with pytest.raises(InputError, match=r"a\.ply: got (an unreadable|unreadable|no element 'edge')"):
            read(tmp_path / "a.ply")


def test_a_cut_skeleton_is_refused(tmp_path: Path) -> None:
    for suffix in (".swc", ".txt", ".ply", ".graphml", ".mtg", ".npz"):
        path = tmp_path / f"a{suffix}"
        write_skeleton(path, TREE)
        path.write_bytes(path.read_bytes()[:-14])
        with pytest.raises(InputError, match=f"a{suffix}"):
            read_skeleton(path)
    (tmp_path / "tabs.mtg").write_text("ENTITY-CODE\tXX\tYY\tZZ\nx\n" + "\t\t\x0b\n")
    with pytest.raises(InputError, match=r"tabs\.mtg"):
        read_skeleton(tmp_path / "tabs.mtg")


def png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")


def test_images_that_state_a_gigantic_size_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png(30_000, 30_000))
    with pytest.raises(InputError, match=r"30000 x 30000 px; allowed: 64 x 48 px"):
        read_image(tmp_path / "a.png", cv2.IMREAD_UNCHANGED, (64, 48))
    with pytest.raises(InputError, match=r"a\.png: got"):
        read_image(tmp_path / "a.png", cv2.IMREAD_UNCHANGED)
    assert int(os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"]) == MOST_PIXELS
    with pytest.raises(InputError, match="million pixels"):
        check_views(100, Intrinsics(20_000, 20_000, 1e3, 1e3, 1e4, 1e4))


CAMERA = Intrinsics(32, 24, 30, 30, 15.5, 11.5)


def test_views_from_one_place_are_refused(tmp_path: Path) -> None:
    poses = np.tile(look_at([0, 0, 0.5], [1, 0, 0.5]), (3, 1, 1))
    Capture(np.full((3, 24, 32), 0.8), CAMERA, poses).save(tmp_path / "c")
    with pytest.raises(InputError, match="3 views with one and the same pose"):
        Capture.load(tmp_path / "c")


def test_a_workspace_of_too_many_cells_is_refused() -> None:
    far = viewed_box(Capture(np.full((1, 24, 32), 3.0), CAMERA, look_at([0, 0, 0.5], [1, 0, 0.5])[None]))
    assert far.cells(0.005, 4e8).prod() > 6e7
    for box in (far, Box(np.full(3, -1e12), np.full(3, 1e12))):
        with pytest.raises(InputError, match=r"workspace.*do their poses differ"):
            box.cells(0.005, 6e7)


def test_rods_too_finely_divided_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    rods = cantilever(40)
    operator = csr_array(np.eye(3, 4 * 41))
    args = (rods, Clamp.root(rods), [np.array([20, 21, 22])], operator, np.array([10.0]))
    observed_response(*args)
    monkeypatch.setattr("anther.core.checks.MOST_BYTES", 1e3)
    asks = {
        "a skeleton of 41 nodes": lambda: observed_response(*args),
        "of 41 nodes": lambda: frequency_response(rods, Clamp.root(rods), 20, [1, 0, 0], np.array([10.0])),
        "a record of 100 moments of 41 nodes": lambda: new_output(100, 41),
    }
    for what, ask in asks.items():
        with pytest.raises(InputError, match=what):
            ask()


def written_capture(path: Path) -> None:
    Capture(np.full((1, 24, 32), 0.8), CAMERA, look_at([0, 0, 0.5], [1, 0, 0.5])[None]).save(path)


def opened_run(path: Path) -> None:
    with open_run(path, reconstruct.Args(path, overwrite=True), ()):
        pass


WRITES = {
    "folder": made_folder,
    "capture": written_capture,
    "run": opened_run,
    "skeleton": lambda path: TREE.save(path / "a.npz"),
    "text": lambda path: write_skeleton(path / "deep" / "a.swc", TREE),
}


@pytest.mark.parametrize("name", WRITES)
def test_a_file_where_a_folder_is_wanted(tmp_path: Path, name: str) -> None:
    (tmp_path / "there").write_text("mine")
    for out in (tmp_path / "there", tmp_path / "there" / "below", tmp_path / ("a" * 300)):
        with pytest.raises(InputError, match="allowed"):
            WRITES[name](out)
    assert (tmp_path / "there").read_text() == "mine"


@pytest.mark.parametrize("number", [28, 30, 13])  # ENOSPC, EROFS, EACCES
def test_a_disk_that_takes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    def fails(*_, **__) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("anther.core.files.secrets.token_hex", fails)
    monkeypatch.setattr("anther.perception.capture.tempfile.mkdtemp", fails)
    for write in (written_capture, lambda path: TREE.save(path / "a.npz")):
        with pytest.raises(InputError, match=os.strerror(number)):
            write(tmp_path / "c")
    with pytest.raises(InputError, match=os.strerror(number)), replacing(tmp_path / "d"):
        pass


@pytest.mark.parametrize(
    "error", [OSError(5, "Input/output error", "/mnt/x"), MemoryError("7 GB"), IsADirectoryError()]
)
def test_what_reaches_the_top_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys, error: Exception) -> None:
    def run(_) -> None:
        raise error

    monkeypatch.setattr("anther.cli.view.run", run)
    assert cli.main(["view", "."]) == 2
    said = capsys.readouterr().err
    assert said.startswith("anther view: ")
    assert said.count("\n") == 1


CELLS = [
    ("visits", "time", "yesterday"),
    ("visits", "material_after", "{"),
    ("visits", "material_after", '"soft"'),
    ("visits", "material_after", '{"youngs": "soft"}'),
    ("visits", "material_before", "[[[[1]]]]"),
    ("visits", "failure", b"\x01\xff"),
    ("visits", "run", b"\x01\xff"),
    ("plants", "label", b"\x01\xff"),
    ("plants", "label", ""),
    ("grasps", "pose7", "[1, 2"),
    ("grasps", "pose7", '"x"'),
    ("grasps", "arc_length_m", "high"),
    ("grasps", "organ", b"\xff"),
    ("shakes", "frequency_hz", "fast"),
    ("shakes", "direction", "{}"),
    ("shakes", "direction", "[1, null, 2]"),
    ("responses", "measured_amplitude_m", "large"),
]


@pytest.mark.parametrize(("table", "column", "value"), CELLS)
def test_a_history_edited_by_hand(tmp_path: Path, capsys, table: str, column: str, value: object) -> None:
    path = tmp_path / "history.sqlite"
    record_trial(full(), path)
    with sqlite3.connect(path) as connection:
        connection.execute(f"UPDATE {table} SET {column} = ?", (value,))
    with pytest.raises(InputError, match=r"history\.sqlite"):
        read_trials(path)
    assert cli.main(["history", str(path)]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_an_outcome_edited_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "history.sqlite"
    record_trial(full(), path)
    with sqlite3.connect(path) as connection:
        values = "(1, '2026-05-01', 'many', 3, '', '2026-05-01 12:00:00.000000')"
        connection.execute(f"INSERT INTO outcomes (plant_id, date, flowers, fruit, note, recorded) VALUES {values}")
    with pytest.raises(InputError, match=r"history\.sqlite"):
        read_outcomes(path)


VISITS = [
    ("species", 5), ("species", ["t"]), ("plant", None), ("plant", {}), ("held_unharmed", "yes"),
    ("held_unharmed", None), ("failure", 3), ("run", ["a"]), ("time", 5), ("time", "noon"), ("grasp", 5),
    ("grasp_nose", 1), ("grasp_organ", 5), ("grasp_pose7", [1, 2]), ("shake", []), ("shake_frequency_hz", "fast"),
    ("shake_amplitude_m", None), ("material_after_youngs_pa", "soft"), ("material_after_youngs_pa", -1),
    ("material_before_density_kg_m3", [1]), ("measured_amplitude_m", 5), ("measured_amplitude_m", ["a", "b"]),
    ("measured_amplitude_m", [[1], [2]]), ("predicted_amplitude_m", {"a": 1}), ("steps", 5),
    ("steps", [{"begin_s": 1}]),
    ("true_slip_m", "far"), ("seconds", [1]), ("predicted_acceleration_ms2", [1.0] * 9),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), VISITS)
def test_a_visit_of_wrong_types(tmp_path: Path, capsys, name: str, value: object) -> None:
    (tmp_path / "trial.json").write_text(json.dumps({"kind": "visit", "schema": 1, **full().flat(), name: value}))
    with pytest.raises(InputError, match="record of a visit"):
        Visit.of({**full().flat(), name: value})
    assert cli.main(["history", str(tmp_path / "h.sqlite"), "--add", str(tmp_path)]) == 2
    assert "trial.json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("organ", "nodes", "said"),
    [
        ([0, 7, 0], [0, 1], "organ: got kind 7"),
        ([0, 0, 0], [0, 9], "stem nodes: got node 9"),
        ([], [0, 1], "stem nodes"),
    ],
)
def test_a_stem_of_no_organ_or_node_there_is(organ: list[int], nodes: list[int], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Stem(np.array(nodes), np.array([0, 0.1]), np.zeros(0, int), np.array(organ, dtype=np.uint8), 1)


def test_a_run_whose_stem_is_of_another_skeleton(tmp_path: Path, capsys) -> None:
    (tmp_path / "00_params.json").write_text("{}")
    TREE.save(tmp_path / FILES["skeleton"])
    Stem(np.array([0, 1]), np.array([0, 0.1]), np.zeros(0, int), np.zeros(5, np.uint8), 1).save(
        tmp_path / FILES["stem"]
    )
    assert cli.main(["view", str(tmp_path), "--to", str(tmp_path / "o.html")]) == 2
    assert "organs of 5 nodes; allowed: of the 3" in capsys.readouterr().err


def test_a_visit_that_is_no_object(tmp_path: Path, capsys) -> None:
    (tmp_path / "trial.json").write_text("[1, 2]")
    assert cli.main(["history", str(tmp_path / "h.sqlite"), "--add", str(tmp_path)]) == 2
    assert "allowed: a JSON object" in capsys.readouterr().err


def test_compiled_code_has_a_place_where_nothing_may_be_written(tmp_path: Path, monkeypatch) -> None:
    nowhere = (Path("/proc/nowhere"), Path("/proc/nowhere/deep"))
    monkeypatch.setattr("anther.core.libraries.tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr("anther.core.libraries.tempfile.tempdir", str(tmp_path))
    assert compiled_code((*nowhere, tmp_path / "cache")) is None
    own = compiled_code(nowhere)
    assert own == str(tmp_path / f"anther-numba-{os.getuid()}")
    assert Path(own).stat().st_mode & 0o077 == 0
    assert compiled_code(nowhere) == own
    Path(own).chmod(0o777)  # code that others may have put there is not loaded
    assert compiled_code(nowhere) != own
