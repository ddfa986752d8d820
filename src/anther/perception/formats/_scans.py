"""Clouds of laser scanners and photogrammetry: LAS and LAZ (laspy, lazrs), E57 (pye57); the extra `anther[scans]`.

LAS 1.4 (https://github.com/ASPRSorg/LAS) has z up and its unit in a coordinate system, if at all; E57 (ASTM E2807) is
in metres, each scan with a pose of its own. N points.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from anther.core.choices import Units
from anther.core.errors import AntherError, MissingExtra, bad_input
from anther.core.files import understood, whole_file
from anther.core.geometry import Array
from anther.perception.cloud import ply
from anther.perception.formats._raw_points import MOST_POINTS, RawPoints, unit_of, unused_note

INSTALL = "pip install 'anther[scans]'"
_RGB, _XYZ = ("red", "green", "blue"), ("X", "Y", "Z")


def read_las(path: Path) -> RawPoints:
    """Read a LAS or LAZ: x, y, z, colours, unit of its coordinate system; points marked as withheld are left out."""
    laspy = _module("laspy", path)
    if path.suffix.lower() == ".laz":
        _module("lazrs", path)
    with _readable(whole_file(path), "a LAS or LAZ file"):
        with laspy.open(path) as reader:
            _check_count(path, reader.header.point_count)
            las = reader.read()
        if len(las.points) != reader.header.point_count:
            raise ValueError(f"{len(las.points)} of {reader.header.point_count} points")
        names = list(las.point_format.dimension_names)
        kept = ~np.asarray(las["withheld"], bool) if "withheld" in names else np.ones(len(las.points), bool)
        colors = np.stack([las[name] for name in _RGB], axis=1) if set(_RGB) <= set(names) else None
        seen = ply.color_bytes(colors[kept]) if colors is not None and colors.any() else None
        unused = [n for n in names if n not in (*_XYZ, *_RGB, "withheld") and np.asarray(las[n]).any()]
        notes = (f"{np.sum(~kept)} points marked as withheld are left out",) if not kept.all() else ()
        return RawPoints(las.xyz[kept], seen, _las_unit(las.vlrs), "z", (*notes, *unused_note(unused)))


def _las_unit(vlrs: Any) -> Units | None:
    """Return the unit that a LAS file's coordinate system states."""
    linear_unit = 3076  # GeoTIFF's key
    names = {9001: "m", 9002: "ft", 9003: "ft"}  # EPSG's codes; US survey feet are feet to 2e-6
    for vlr in vlrs:
        for key in getattr(vlr, "geo_keys", ()):
            if key.id == linear_unit:
                return unit_of(names.get(key.value_offset, ""))
        stated = re.findall(r'UNIT\["(?:US survey )?(\w+)"', str(getattr(vlr, "string", "")), re.IGNORECASE)
        units: set[Units] = {unit for word in stated if (unit := unit_of(word.lower().replace("_us", "")))}
        if len(units) == 1:
            return units.pop()
    return None


def read_e57(path: Path) -> RawPoints:
    """Read all scans of an E57, each brought to the file's frame by its pose; invalid points are left out."""
    pye57 = _module("pye57", path)
    points, colors, unused, invalid = list[Array](), list[Any](), dict[str, None](), 0
    with _readable(whole_file(path), "an E57 file"):
        file = pye57.E57(str(path))
        try:
            headers = [file.get_header(i) for i in range(file.scan_count)]
            _check_count(path, sum(header.point_count for header in headers))
            for i, header in enumerate(headers):
                held = file.read_scan(i, colors=True, ignore_missing_fields=True)
                points.append(np.stack([held[f"cartesian{axis}"] for axis in _XYZ], axis=1))
                rgb = [held.get(f"color{name.capitalize()}") for name in _RGB]
                colors.append(None if any(c is None for c in rgb) else np.stack(rgb, axis=1))  # type: ignore[arg-type]
                invalid += header.point_count - len(points[-1])
                unused |= dict.fromkeys(n for n in header.point_fields if not re.match("cartesian|spherical|color", n))
        finally:
            file.close()
    if not points:
        raise bad_input(str(path), given="no scan", allowed="points", do="Images alone are no cloud: export points.")
    whole = all(c is not None for c in colors)
    notes = [f"{invalid} points marked as invalid are left out"] if invalid else []
    notes += [f"{len(points)} scans are joined by their poses"] if len(points) > 1 else []
    notes += [] if whole or all(c is None for c in colors) else ["colours: not all scans have some"]
    seen = ply.color_bytes(np.concatenate(colors)) if whole else None
    return RawPoints(np.concatenate(points), seen, "m", None, (*notes, *unused_note([*unused])))


def _module(name: str, path: Path) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise MissingExtra(f"{path}: it needs {name}. Install it with: {INSTALL}") from error


def _check_count(path: Path, count: int) -> None:
    if count > MOST_POINTS:
        allowed = f"at most {MOST_POINTS:,}"
        raise bad_input(
            str(path), given=f"{count:,} points", allowed=allowed, do="Thin out the cloud, or cut the plant."
        )


@contextmanager
def _readable(path: Path, allowed: str) -> Iterator[None]:
    """Turn what a library raises, each errors of its own, into one clear error."""
    with understood(path, allowed, "Is it truncated? CloudCompare can export it again, or as PLY."):
        try:
            yield
        except AntherError:
            raise
        except Exception as error:
            raise ValueError(str(error).partition("\n")[0]) from error
