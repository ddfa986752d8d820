"""Read somebody's point cloud: PLY, PCD, XYZ/TXT or NPZ, in the units and with the axis up that it has. N points.

Which axis is up its stem tells, as far as it can: right, it begins thick, round and upright, and rises far.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from small_gicp import voxelgrid_sampling

from anther.cloud import Cloud
from anther.errors import AntherError, bad_input
from anther.files import existing
from anther.formats.points import Axis, RawPoints, Units, read_npz_points, read_pcd, read_ply, read_text
from anther.geometry import Array
from anther.skeleton import skeletonize
from anther.stem import find_stem

_METRES: dict[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "0.01mm": 1e-5}
_FEWEST = 50
_MOST_BROKEN = 0.05
_SMALLEST, _LARGEST = 0.005, 20.0
"""What is smaller or larger is no plant [m]: a 0.6 m plant in mm, read as metres, measures 600 m."""
_LIKELY = (0.03, 5.0)
"""From a seedling to a vine in a greenhouse [m]. Two units can both be likely: then it is for the person to say."""

TO_Z_UP: dict[Axis, list[int]] = {"x": [1, 2, 0], "y": [2, 0, 1], "z": [0, 1, 2]}
"""Axis that is up -> in which order a file's axes are x, y, z with z up."""
DOUBT = 2.0
"""An axis whose stem is not so many times worse than the best may be up (docs/formats.md)."""
_COARSE = 120
_BASE, _SURE = 0.25, 0.5
"""The cloud is thinned to one point per cube of plant size / 120; a base is the lowest quarter, likelier a stem
than not."""


def read_cloud(
    path: Path | str, units: Units | None = None, up: Axis | None = None, *, plant: int | None = None
) -> Cloud:
    """Return the cloud in a file, in metres with z up.

    Args:
        path: .ply, .pcd, .xyz, .txt, .csv, .asc or .npz.
        units: of the file; None takes what the file states, else metres, with a note.
        up: axis that points up in the file; None takes what the file states, else z, with a note, which names another
            axis where its stem is the better one (`axis_notes`, 0.2 s).
        plant: which plant of an .npz that holds several; None: it must hold one.

    Raises:
        InputError: missing, truncated, of an unknown format, several plants and none chosen, too few points, more
            than 5 % broken points, or a size no plant has (wrong units).
    """
    path = existing(path)
    raw = _read(path, plant)
    units, up = units or raw.units, up or raw.up
    taken = [] if units else ["in metres (--units)"]
    taken += [] if up else ["with z up (--up)"]
    upright = np.ascontiguousarray(raw.points[:, TO_Z_UP[up or "z"]]) * _METRES[units or "m"]
    cloud = checked_cloud(path, RawPoints(upright, raw.colors), units or "m")
    notes = (f"the file does not say all: it is read {' and '.join(taken)}",) if taken else ()
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
    near = np.abs(points - np.median(points, axis=0)).max(axis=1) <= _LARGEST
    kept = np.flatnonzero(finite)[near]
    broken, why = len(finite) - len(kept), f"NaN, infinite or more than {_LARGEST:g} m away"
    notes = (f"{path.name}: {broken} of {len(finite)} points were {why} and dropped",) if broken else ()
    notes += unlikely
    return Cloud(points[near], colors=None if raw.colors is None else raw.colors[kept], notes=notes)


def _read(path: Path, plant: int | None) -> RawPoints:
    match path.suffix.lower():
        case ".ply":
            return read_ply(path)
        case ".pcd":
            return read_pcd(path)
        case ".xyz" | ".txt" | ".csv" | ".asc":
            return read_text(path)
        case ".npz":
            return read_npz_points(path, plant)
    allowed, do = ".ply, .pcd, .xyz, .txt, .csv, .asc, .npz", "Export it to one of these."
    raise bad_input(str(path), given=f"suffix '{path.suffix}'", allowed=allowed, do=do)


def _check_enough(path: Path, finite: np.ndarray) -> None:
    if len(finite) and (~finite).mean() > _MOST_BROKEN:
        given, allowed = f"{(~finite).mean():.0%} of the points NaN or infinite", f"at most {_MOST_BROKEN:.0%}"
        raise bad_input(str(path), given=given, allowed=allowed, do="Repair the export.")
    if np.count_nonzero(finite) < _FEWEST:
        given, allowed = f"{np.count_nonzero(finite)} points", f"{_FEWEST} or more"
        raise bad_input(str(path), given=given, allowed=allowed, do="Is it the right file?")


def _check_size(path: Path, points: np.ndarray, units: str) -> tuple[str, ...]:
    """Return a note if the plant has an unlikely size [m]; refuse what has none of a plant."""
    size = float(np.linalg.norm(np.subtract(*np.quantile(points, [0.995, 0.005], axis=0))))
    given = f"a plant of {size:.3g} m (read in {units})"
    do = _other_units(size, units)
    if not _SMALLEST <= size <= _LARGEST:
        raise bad_input(str(path), given=given, allowed=f"{_SMALLEST:g} <= size <= {_LARGEST:g} m", do=do)
    return () if _LIKELY[0] <= size <= _LIKELY[1] else (f"{path.name}: {given}. {do}",)


def _other_units(size: float, units: str) -> str:
    """Return which units would make a plant of what measures `size` [m] in these."""
    if units not in _METRES:
        return "Wrong scale?"
    sizes = {other: size / _METRES[units] * metres for other, metres in _METRES.items() if other != units}
    likely = [f"--units {other} ({s:.2g} m)" for other, s in sizes.items() if _LIKELY[0] <= s <= _LIKELY[1]]
    return (
        f"Wrong units? Try {' or '.join(likely)}."
        if likely
        else f"In none of {', '.join(_METRES)} is it one: are the units others?"
    )


def axis_notes(points: Array) -> tuple[str, ...]:
    """Return a note where another axis than z is as likely up of points (N, 3) as they stand in the file [m]."""
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    thin = np.asarray(voxelgrid_sampling(points, size / _COARSE).points())[:, :3]
    worth = {axis: stem_worth(thin[:, order]) for axis, order in TO_Z_UP.items()}
    likely = [axis for axis, value in worth.items() if DOUBT * value >= max(worth.values())]
    if len(likely) > 1:
        return (f"which axis is up is hard to tell ({' or '.join(likely)}): look, and say --up",)
    return () if likely == ["z"] else (f"it looks as if {likely[0]} were up: try --up {likely[0]}",)


def stem_worth(points: Array) -> float:
    """Return how good a stem the points (N, 3) have if z is up; 0 without one, or if its base is likelier none.

    It is the product of how thick the stem's base is over the plant's size, how sure its axis there, how upright the
    stem, and what share of the plant's height it rises.
    """
    try:
        tree = skeletonize(Cloud(np.ascontiguousarray(points)))
        stem = find_stem(tree)
    except AntherError:
        return 0.0
    line, length = tree.nodes[stem.node_ids], float(stem.arc_length[-1])
    base = stem.node_ids[stem.arc_length <= max(_BASE * length, stem.arc_length[1])]
    extent = np.ptp(tree.nodes, axis=0)
    rise = max(float(line[-1, 2] - line[0, 2]), 0.0)
    sure = 0.0 if tree.confidence is None else float(tree.confidence[base].mean())
    if sure < _SURE:
        return 0.0
    thick = float(np.median(tree.radius[base])) / float(np.linalg.norm(extent))
    return thick * sure * rise / length * rise / float(extent[2])
