"""Read somebody's point cloud: PLY, PCD, XYZ/TXT or NPZ, in millimetres or metres, any axis up. N points."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from anther.cloud import Cloud
from anther.errors import bad_input
from anther.files import existing
from anther.formats.points import Axis, RawPoints, Units, read_npz_points, read_pcd, read_ply, read_text

_METRES = {"m": 1.0, "mm": 1e-3}
_TO_Z_UP = {"x": [1, 2, 0], "y": [2, 0, 1], "z": [0, 1, 2]}
_FEWEST = 50
_MOST_BROKEN = 0.05
_SMALLEST, _LARGEST = 0.005, 20.0  # [m]: a seedling; a 0.6 m plant in mm, read as metres, measures 600 m


def read_cloud(
    path: Path | str, units: Units | None = None, up: Axis | None = None, *, plant: int | None = None
) -> Cloud:
    """Return the cloud in a file, in metres with z up.

    Args:
        path: .ply, .pcd, .xyz, .txt, .csv, .asc or .npz.
        units: of the file; None takes what the file states, else metres.
        up: axis that points up in the file; None takes what the file states, else z.
        plant: which plant of an .npz that holds several; None: it must hold one.

    Raises:
        InputError: missing, truncated, of an unknown format, several plants and none chosen, too few points, more
            than 5 % broken points, or a size no plant has (wrong units).
    """
    path = existing(path)
    raw = _read(path, plant)
    units, up = units or raw.units or "m", up or raw.up or "z"
    upright = np.ascontiguousarray(raw.points[:, _TO_Z_UP[up]]) * _METRES[units]
    return checked_cloud(path, RawPoints(upright, raw.colors), units)


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
    _check_size(path, points, units)
    near = np.abs(points - np.median(points, axis=0)).max(axis=1) <= _LARGEST
    kept = np.flatnonzero(finite)[near]
    broken, why = len(finite) - len(kept), f"NaN, infinite or more than {_LARGEST:g} m away"
    notes = (f"{path.name}: {broken} of {len(finite)} points were {why} and dropped",) if broken else ()
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
    raise bad_input(
        str(path),
        given=f"suffix '{path.suffix}'",
        allowed=".ply, .pcd, .xyz, .txt, .csv, .asc, .npz",
        do="Export it to one of these.",
    )


def _check_enough(path: Path, finite: np.ndarray) -> None:
    if len(finite) and (~finite).mean() > _MOST_BROKEN:
        raise bad_input(
            str(path),
            given=f"{(~finite).mean():.0%} of the points NaN or infinite",
            allowed=f"at most {_MOST_BROKEN:.0%}",
            do="Repair the export.",
        )
    if np.count_nonzero(finite) < _FEWEST:
        raise bad_input(
            str(path),
            given=f"{np.count_nonzero(finite)} points",
            allowed=f"{_FEWEST} or more",
            do="Is it the right file?",
        )


def _check_size(path: Path, points: np.ndarray, units: str) -> None:
    size = float(np.linalg.norm(np.subtract(*np.quantile(points, [0.995, 0.005], axis=0))))
    if not _SMALLEST <= size <= _LARGEST:
        other = "mm" if size > _LARGEST else "m"
        raise bad_input(
            str(path),
            given=f"a plant of {size:g} m (read in {units})",
            allowed=f"{_SMALLEST:g} <= size <= {_LARGEST:g} m",
            do=f"Wrong units? Try --units {other}." if units in _METRES else "Wrong scale?",
        )
