"""Read an imported point cloud: PLY, PCD, LAS, E57, text or NPZ, in the units and with the axis up that it has.

If the up axis is not given, it is checked: with the right one, the plant starts with a thick, round, vertical stem.
N points.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured
from numpy.typing import NDArray
from small_gicp import voxelgrid_sampling

from anther.core.checks import check_array
from anther.core.choices import Axis, Units
from anther.core.errors import AntherError, bad_input
from anther.core.files import existing, load_npz, understood, whole_file
from anther.core.geometry import TO_Z_UP, Array
from anther.perception.cloud import Cloud, ply
from anther.perception.formats._cloud_text import read_text
from anther.perception.formats._raw_points import (  # fmt: skip
    LIKELY,
    METRES,
    MOST_POINTS,
    RawPoints,
    other_units,
    stated,
    unused_note,
)
from anther.perception.formats._scans import read_e57, read_las
from anther.perception.skeleton import FEWEST_POINTS, LARGEST, SMALLEST, skeletonize
from anther.perception.stem import find_stem

__all__ = [
    "SUFFIXES",
    "Axis",
    "RawPoints",
    "Units",
    "axis_notes",
    "checked_cloud",
    "lzf_decompress",
    "read_cloud",
    "read_npz_points",
    "read_pcd",
    "read_ply",
    "stem_worth",
]

SUFFIXES = (".ply", ".pcd", ".las", ".laz", ".e57", ".xyz", ".txt", ".csv", ".asc", ".pts", ".npz")

_CUT = "Is it truncated, or another format?"


def read_cloud(
    path: Path | str, units: Units | None = None, up: Axis | None = None, *, plant: int | None = None
) -> Cloud:
    """Return the cloud in a file, in metres with z up.

    Args:
        path: .ply, .pcd, .las, .laz, .e57, .xyz, .txt, .csv, .asc, .pts or .npz.
        units: of the file; None takes what the file states, else metres, with a note.
        up: axis that points up in the file; None takes what the file states, else z, with a note, which names another
            axis where its stem is the better one (`axis_notes`, 0.2 s).
        plant: which plant of an .npz that holds several; None: it must hold one.

    Raises:
        MissingExtra: laspy, lazrs or pye57 is not installed.
        InputError: missing, truncated, of an unknown format, several plants and none chosen, too few points, more
            than 5 % broken points, or a size no plant has (wrong units).
    """
    path = existing(path)
    raw = _read(path, plant)
    other = f"it states {raw.units} and is read in {units}" if units and raw.units and units != raw.units else ""
    units, up = units or raw.units, up or raw.up
    taken = [] if units else ["in metres (--units)"]
    taken += [] if up else ["with z up (--up)"]
    upright = np.ascontiguousarray(raw.points[:, TO_Z_UP[up or "z"]]) * METRES[units or "m"]
    cloud = checked_cloud(path, RawPoints(upright, raw.colors), units or "m")
    notes = (f"the file does not state all: it is read {' and '.join(taken)}",) if taken else ()
    notes = (*raw.notes, *([f"{path.name}: {other}"] if other else []), *notes)
    axis = () if up else axis_notes(cloud.points)
    return replace(cloud, notes=(*cloud.notes, *axis, *notes))


def checked_cloud(path: Path, raw: RawPoints, units: str) -> Cloud:
    """Return points that are in metres with z up as a cloud, without the few that may be broken.

    Args:
        path: where they come from, for messages.
        raw: the points [m] and colours.
        units: how they were scaled, for messages.

    Raises:
        InputError: too few points, more than 5 % broken points, or a size no plant has.
    """
    finite = np.asarray(np.isfinite(raw.points).all(axis=1))
    _check_enough(path, finite)
    points = raw.points[finite]
    unlikely = _check_size(path, points, units)
    near = np.abs(points - np.median(points, axis=0)).max(axis=1) <= LARGEST
    kept = np.flatnonzero(finite)[near]
    broken, why = len(finite) - len(kept), f"NaN, infinite or more than {LARGEST:g} m away"
    notes = (f"{path.name}: {broken} of {len(finite)} points were {why} and dropped",) if broken else ()
    notes += unlikely
    flat = [axis for axis, extent in zip("xyz", np.ptp(points, axis=0), strict=True) if extent == 0]
    if flat:
        given, do = f"{', '.join(flat)} the same in all points", "Are the columns x, y, z? Name them in line 1."
        raise bad_input(str(path), given=given, allowed="a plant with width, depth and height", do=do)
    return Cloud(points[near], colors=None if raw.colors is None else raw.colors[kept], notes=notes)


def _read(path: Path, plant: int | None) -> RawPoints:
    match path.suffix.lower():
        case ".ply":
            return read_ply(path)
        case ".pcd":
            return read_pcd(path)
        case ".xyz" | ".txt" | ".csv" | ".asc" | ".pts":
            return read_text(path)
        case ".las" | ".laz":
            return read_las(path)
        case ".e57":
            return read_e57(path)
        case ".npz":
            return read_npz_points(path, plant)
    allowed = ", ".join(SUFFIXES)
    do = f"Export it to one of these: CloudCompare -SILENT -O {path.name} -C_EXPORT_FMT PLY -SAVE_CLOUDS."
    raise bad_input(str(path), given=f"suffix '{path.suffix}'", allowed=allowed, do=do)


def _check_enough(path: Path, finite: np.ndarray) -> None:
    if len(finite) and (~finite).mean() > 0.05:
        given, allowed = f"{(~finite).mean():.0%} of the points NaN or infinite", "at most 5%"
        raise bad_input(str(path), given=given, allowed=allowed, do="Repair the export.")
    if np.count_nonzero(finite) < FEWEST_POINTS:
        given, allowed = f"{np.count_nonzero(finite)} points", f"{FEWEST_POINTS} or more"
        raise bad_input(str(path), given=given, allowed=allowed, do="Is it the right file?")


def _check_size(path: Path, points: np.ndarray, units: str) -> tuple[str, ...]:
    """Return a note if the plant has an unlikely size [m]; refuse what has none of a plant."""
    size = float(np.linalg.norm(np.subtract(*np.quantile(points, [0.995, 0.005], axis=0))))
    given = f"a plant of {size:.3g} m (read in {units})"
    do = other_units(size, units)
    if not SMALLEST <= size <= LARGEST:
        raise bad_input(str(path), given=given, allowed=f"{SMALLEST:g} <= size <= {LARGEST:g} m", do=do)
    return () if LIKELY[0] <= size <= LIKELY[1] else (f"{path.name}: {given}. {do}",)


def axis_notes(points: Array) -> tuple[str, ...]:
    """Return a note where another axis than z is as likely up of points (N, 3) as stored [m]."""
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    thin = np.asarray(voxelgrid_sampling(points, size / 120).points())[:, :3]
    worth = {axis: stem_worth(thin[:, order]) for axis, order in TO_Z_UP.items()}
    doubt = 2.0  # an axis whose stem is at most this many times worse may be up (docs/formats.md)
    likely = [axis for axis, value in worth.items() if doubt * value >= max(worth.values())]
    if len(likely) > 1:
        return (f"the up axis is uncertain ({' or '.join(likely)}): check it, and set --up",)
    return () if likely == ["z"] else (f"{likely[0]} seems to be up: try --up {likely[0]}",)


def stem_worth(points: Array) -> float:
    """Return how good a stem the points (N, 3) have if z is up; 0 without one.

    It is 0 too where the stem's base, its lowest quarter, is likelier none. Else it is the product of how thick the
    stem's base is over the plant's size, how sure its axis there, how upright the stem, and what share of the plant's
    height it rises.
    """
    try:
        tree = skeletonize(Cloud(np.ascontiguousarray(points)))
        stem = find_stem(tree)
    except AntherError:
        return 0.0
    line, length = tree.nodes[stem.node_ids], float(stem.arc_length[-1])
    base = stem.node_ids[stem.arc_length <= max(0.25 * length, stem.arc_length[1])]
    extent = np.ptp(tree.nodes, axis=0)
    rise = max(float(line[-1, 2] - line[0, 2]), 0.0)
    sure = 0.0 if tree.confidence is None else float(tree.confidence[base].mean())
    if sure < 0.5:
        return 0.0
    thick = float(np.median(tree.radius[base])) / float(np.linalg.norm(extent))
    return thick * sure * rise / length * rise / float(extent[2])


def read_ply(path: Path) -> RawPoints:
    """Read a PLY, ASCII or binary; of a mesh, its vertices."""
    stored = ply.read_ply(path)
    unused = [
        "nx, ny, nz" if name == "normals" else "label" for name in ("normals", "labels") if stored[name] is not None
    ]
    return RawPoints(
        stored["points"], stored["colors"], *stated(stored["comments"]), notes=unused_note([*unused, *stored["unused"]])
    )


def read_npz_points(path: Path, plant: int | None) -> RawPoints:
    """Read an NPZ with `points` (N, 3), or `points_x100` (N, 3) integers, and `offsets` where it has several plants.

    `colors` (N, 3), `units` and `up` (3,) are used when they are there. Of several plants one must be chosen.
    """
    held = load_npz(path, "an .npz with points (N, 3)", _NPZ_KEYS)
    stored, per_unit = (held["points_x100"], 100.0) if "points_x100" in held else (held.get("points"), 1.0)
    if stored is None:
        raise bad_input(str(path), given="no array 'points'", allowed="points (N, 3)", do="Rename the array.")
    if stored.ndim != 2 or stored.shape[1] != 3 or len(stored) > MOST_POINTS:
        allowed = f"shape (N, 3), N <= {MOST_POINTS:,}"
        raise bad_input(f"{path}: points", given=f"shape {stored.shape}", allowed=allowed, do="Thin out the cloud.")
    with understood(path, "numbers in points, colors, offsets and up", "Write the arrays again."):
        part = _plant_part(path, held.get("offsets"), len(stored), plant)
        points = check_array(f"{path}: points", stored[part], (None, 3), finite=False) / per_unit
        colors = next((held[name] for name in _NPZ_COLORS if name in held), None)
        if colors is not None and (colors.ndim != 2 or colors.shape[1] < 3 or len(colors) != len(stored)):
            colors = None
        seen = None if colors is None else ply.color_bytes(colors[part, :3])
        return RawPoints(points, seen, _units(path, held), _up(held))


def plants_stored(path: Path | str) -> int:
    """Return how many plants a file holds apart: an .npz with `offsets` several, every other one."""
    path = existing(path)
    if path.suffix.lower() != ".npz":
        return 1
    offsets = load_npz(path, "an .npz with points (N, 3)", ("offsets",)).get("offsets")
    return 1 if offsets is None else max(np.size(offsets) - 1, 1)


def read_pcd(path: Path) -> RawPoints:
    """Read a PCD (ASCII, binary or binary_compressed) with fields x, y, z and, optionally, rgb."""
    content = whole_file(path).read_bytes()
    header, body = _pcd_header(path, content)
    with understood(path, "a PCD with as many points as its header says", _CUT):
        record = _pcd_record(header)
        size = int(header["WIDTH"][0]) * int(header["HEIGHT"][0]) if "POINTS" not in header else header["POINTS"][0]
        count, kind = int(size), header["DATA"][0]
        rows = _PCD_BODIES[kind](body, record, count)
    missing = {"x", "y", "z"} - set(record.names or ())
    if missing:
        raise bad_input(str(path), given=f"no field {sorted(missing)}", allowed="fields x y z", do="Export x, y, z.")
    points = structured_to_unstructured(rows[["x", "y", "z"]], dtype=np.float64)
    names = [name for name in record.names or () if not record[name].shape]
    colors, taken = ply.find_colors(names, lambda name: rows[name])
    unused = [name for name in record.names or () if name not in {*"xyz", *taken} and not name.startswith("_")]
    posed = [float(n) for n in header.get("VIEWPOINT", [])] not in ([], [0, 0, 0, 1, 0, 0, 0])
    notes = [f"its VIEWPOINT {' '.join(header['VIEWPOINT'])} is not applied"] if posed else []
    seen = ~np.isnan(points).all(axis=1)
    if not seen.all():
        notes.append(f"{np.sum(~seen)} of {count} points hold no reading (NaN) and are left out")
        points, colors = points[seen], None if colors is None else colors[seen]
    units, up = stated([line for line in content[:2000].decode("ascii", "replace").splitlines() if line[:1] == "#"])
    return RawPoints(points, colors, units, up, notes=(*unused_note(unused), *notes))


_NPZ_COLORS = ("colors", "colours", "rgb", "color")
_NPZ_KEYS = {"points", "points_x100", "offsets", "units", "up", *_NPZ_COLORS}


def _plant_part(path: Path, offsets: NDArray[Any] | None, count: int, plant: int | None) -> slice:
    """Return where the points of one plant lie among the `count` of all."""
    starts = np.array([0, count]) if offsets is None else check_array(f"{path}: offsets", offsets, (None,), dtype=int)
    if len(starts) < 2 or starts[0] < 0 or starts[-1] > count or np.any(np.diff(starts) < 0):
        allowed = f"rising numbers from 0 to {count}, where each plant's points begin and the last one's end"
        raise bad_input(f"{path}: offsets", given=f"{starts[:5]}", allowed=allowed, do="Write them again.")
    last = len(starts) - 2
    if plant is None and last > 0:
        allowed, do = f"one of them, 0 to {last}", "Choose it with --plant NUMBER."
        raise bad_input(str(path), given=f"a file of {last + 1} plants", allowed=allowed, do=do)
    plant = plant or 0
    if not 0 <= plant <= last:
        raise bad_input(str(path), given=f"plant {plant}", allowed=f"0 <= plant <= {last}", do="Choose another.")
    return slice(int(starts[plant]), int(starts[plant + 1]))


def _units(path: Path, held: dict[str, NDArray[Any]]) -> Units | None:
    """Return the units that the file states; whoever wrote it may have been unsure ("mm?")."""
    stated = str(held.get("units", "")).strip().rstrip("?")
    known = {str(name): name for name in get_args(Units)}
    if stated and stated not in known:
        allowed = ", ".join(f"'{name}'" for name in known)
        raise bad_input(f"{path}: units", given=f"'{stated[:40]}'", allowed=allowed, do="Scale the points.")
    return known.get(stated)


def _up(held: dict[str, NDArray[Any]]) -> Axis | None:
    up = np.asarray(held.get("up", (0, 0, 0)), dtype=np.float64)
    return ("x", "y", "z")[int(np.argmax(up))] if up.shape == (3,) and up.max() > 0.9 else None


def _pcd_header(path: Path, content: bytes) -> tuple[dict[str, list[str]], bytes]:
    header: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in header:
        end = content.find(b"\n", at)
        if end < 0:
            raise bad_input(str(path), given="no complete header", allowed="a PCD file", do="Is it truncated?")
        words = content[at:end].decode("ascii", errors="replace").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
    if " ".join(header["DATA"]) not in _PCD_BODIES:
        given = f"DATA {' '.join(header['DATA'])}"
        raise bad_input(str(path), given=given, allowed=", ".join(_PCD_BODIES), do="Save it again.")
    return header, content[at:]


def _pcd_record(header: dict[str, list[str]]) -> np.dtype[Any]:
    kinds = {"F": "f", "I": "i", "U": "u"}
    counts = header.get("COUNT", ["1"] * len(header["FIELDS"]))
    columns = zip(header["FIELDS"], header["SIZE"], header["TYPE"], counts, strict=True)
    fields = []
    for i, (name, size, kind, count) in enumerate(columns):
        shape = () if count == "1" else (int(count),)
        name = name.lower() if name in ("X", "Y", "Z") else name  # noqa: PLW2901
        fields.append((name if name != "_" else f"_{i}", f"<{kinds[kind]}{size}", shape))
    return np.dtype(fields)


def _pcd_ascii(body: bytes, record: np.dtype[Any], count: int) -> NDArray[Any]:
    rows = np.loadtxt(body.decode("ascii").splitlines(), dtype=np.float64, ndmin=2)
    if len(rows) != count:
        raise ValueError(f"{len(rows)} rows instead of {count}")
    out = np.zeros(count, record)
    column = 0
    for name in record.names or ():
        width = int(np.prod(record[name].shape, dtype=int))
        values = rows[:, column] if width == 1 else rows[:, column : column + width]
        with np.errstate(over="ignore"):  # infinite, and dropped with a note
            out[name] = values
        column += width
    return out


def _pcd_compressed(body: bytes, record: np.dtype[Any], count: int) -> NDArray[Any]:
    """Decompress PCL's layout: sizes (two uint32), then LZF of all x, all y, ... one field after another."""
    packed, size = (int(n) for n in np.frombuffer(body, "<u4", 2))
    if size != record.itemsize * count or len(body) < 8 + packed:
        raise ValueError(f"{size} bytes announced for {count} points of {record.itemsize}, {len(body) - 8} there")
    data = lzf_decompress(body[8 : 8 + packed], size)
    out, at = np.zeros(count, record), 0
    for name in record.names or ():
        field = record[name]
        out[name] = np.frombuffer(data, field.base, count * (field.itemsize // field.base.itemsize), at).reshape(
            count, *field.shape
        )
        at += field.itemsize * count
    return out


def lzf_decompress(data: bytes, size: int) -> bytes:
    """Return the `size` bytes that LZF (M. Lehmann's LibLZF, as PCL uses it) packed into `data`.

    A control byte below 32 is followed by that many literals plus one; else its upper three bits (and, where they are
    7, the next byte) give a length less 2, its lower five and the next byte how far back to copy from, less 1.
    """
    out, at = bytearray(), 0
    while at < len(data):
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[at]
            at += 1
        start = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        if start < 0 or len(out) > size:
            raise ValueError("damaged LZF data")
        piece = out[start : start + length + 2]
        repeats = -(-(length + 2) // len(piece)) if piece else 0  # it may reach into what it writes: then it repeats
        out += (piece * repeats)[: length + 2]
    if len(out) != size:
        raise ValueError(f"damaged LZF data: {len(out)} of {size} bytes")
    return bytes(out)


def _pcd_binary(body: bytes, record: np.dtype[Any], count: int) -> NDArray[Any]:
    return np.frombuffer(body, record, count)


_PCD_BODIES = {"ascii": _pcd_ascii, "binary": _pcd_binary, "binary_compressed": _pcd_compressed}
