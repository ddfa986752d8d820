"""Files a user writes for a calibration: flange poses by image name (CSV or JSON), the camera's intrinsics (JSON)."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

from anther.errors import InputError, bad_input
from anther.files import existing, read_json, read_lines, understood
from anther.geometry import Array, Intrinsics, transform_from_pose7

COLUMNS = ("image", "x", "y", "z", "qx", "qy", "qz", "qw")
REACH = 10.0
"""A flange farther than this from its base [m] was not given in metres."""
_NAMES = {"width": "w", "height": "h", "fx": "fl_x", "fy": "fl_y", "cx": "cx", "cy": "cy"}  # Anther's, nerfstudio's
_DISTORTION = ("k1", "k2", "p1", "p2", "k3")


def read_poses(path: Path | str) -> dict[str, Array]:
    """Return T_base_flange (4, 4) by image name.

    CSV: a first line `image,x,y,z,qx,qy,qz,qw` in any order, then one line per image; `#` starts a comment, and commas,
    semicolons or tabs separate. JSON: `{"image.png": [x, y, z, qx, qy, qz, qw], ...}`. Metres, base frame, `qw` last.

    Raises:
        InputError: the file is missing or unusable; the message names the line.
    """
    path = existing(path)
    rows = _json_rows(path) if path.suffix.lower() == ".json" else _csv_rows(path)
    poses: dict[str, Array] = {}
    for where, name, numbers in rows:
        if name in poses:
            raise bad_input(where, given=f"image '{name}' again", allowed="each image once", do="Remove one.")
        try:
            pose = [float(number) for number in numbers]
            T = transform_from_pose7(pose)
        except (TypeError, ValueError) as error:
            reason = error if isinstance(error, InputError) else f"{numbers} is not 7 numbers"
            raise InputError(f"{where}: {reason}") from error
        if max(map(abs, pose[:3])) > REACH:
            raise bad_input(
                where, given=f"a flange at {pose[:3]}", allowed=f"within {REACH:g} m", do="Give positions in metres."
            )
        poses[name] = T
    if not poses:
        raise bad_input(str(path), given="no poses", allowed="a line per image", do=f"Columns: {', '.join(COLUMNS)}.")
    return poses


def _json_rows(path: Path) -> list[tuple[str, str, Any]]:
    stored = read_json(path)
    if not isinstance(stored, dict) or not all(isinstance(numbers, list) for numbers in stored.values()):
        raise bad_input(
            str(path),
            given=f"JSON that is a {type(stored).__name__} of something else",
            allowed='{"image.png": [x, y, z, qx, qy, qz, qw], ...}',
            do="See docs/calibration.md.",
        )
    return [(f"{path}, '{name}'", name, numbers) for name, numbers in stored.items()]


def _csv_rows(path: Path) -> list[tuple[str, str, Any]]:
    lines = [(n, line) for n, line in enumerate(read_lines(path), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        return []
    with understood(path, "CSV or JSON", "Export it again."):
        return _csv_cells(path, lines)


def _csv_cells(path: Path, lines: list[tuple[int, str]]) -> list[tuple[str, str, Any]]:
    header = lines[0][1]
    separator = next((mark for mark in (";", "\t") if mark in header), ",")
    names = [word.strip().lower() for word in next(csv.reader([header], delimiter=separator))]
    if sorted(names) != sorted(COLUMNS):
        raise bad_input(
            f"{path}, line {lines[0][0]}",
            given=f"columns {', '.join(names)}",
            allowed=", ".join(COLUMNS),
            do="Name each column once, in any order.",
        )
    rows = []
    for number, line in lines[1:]:
        words = [word.strip() for word in next(csv.reader([line], delimiter=separator))]
        where = f"{path}, line {number}"
        if len(words) != len(names):
            raise bad_input(where, given=f"{len(words)} entries", allowed=str(len(names)), do="Complete the line.")
        entry = dict(zip(names, words, strict=True))
        if separator == ";":
            entry = {key: word if key == "image" else word.replace(",", ".") for key, word in entry.items()}
        rows.append((where, entry["image"], [entry[name] for name in COLUMNS[1:]]))
    return rows


def read_intrinsics(path: Path | str) -> tuple[Intrinsics, Array]:
    """Return intrinsics and distortion (5,) k1, k2, p1, p2, k3 from a JSON file.

    It holds width, height, fx, fy, cx, cy, and perhaps k1 ... k3; or it is a `transforms.json` (docs/capture.md), or
    an earlier `calibration.json`.

    Raises:
        InputError: the file is missing, or an entry is missing or unusable.
    """
    stored = read_json(path)
    inner = stored.get("intrinsics") if isinstance(stored, dict) else None
    if isinstance(stored, dict) and isinstance(inner, dict):
        bent = stored.get("distortion")
        stored = inner | (dict(zip(_DISTORTION, bent, strict=False)) if isinstance(bent, list) else {})
    if not isinstance(stored, dict):
        raise bad_input(str(path), given=type(stored).__name__, allowed=f"{{{', '.join(_NAMES)}}}", do="Correct it.")
    values = {name: _number(path, stored.get(name, stored.get(other)), name) for name, other in _NAMES.items()}
    distortion = np.array([_number(path, stored.get(name, 0.0), name) for name in _DISTORTION])
    width, height = int(values.pop("width")), int(values.pop("height"))
    return Intrinsics(width, height, **values), distortion


def _number(path: Path | str, value: Any, name: str) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not number:
        raise bad_input(
            f"{path} '{name}'",
            given="nothing" if value is None else repr(value),
            allowed=f"a number; the file holds {', '.join(_NAMES)}",
            do="Add it.",
        )
    return float(value)
