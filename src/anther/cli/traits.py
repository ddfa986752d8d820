"""A folder of point clouds -> tables of plants and limbs, a picture of every plant; goes on after a stop."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from anther.core.errors import AntherError, bad_input
from anther.core.files import existing, made_folder, read_object, write_json
from anther.core.tables import write_table
from anther.perception.flowers import flower_centres
from anther.perception.formats.clouds import SUFFIXES, Axis, Units, read_cloud
from anther.perception.skeleton import Params, skeletonize
from anther.perception.stem import Params as StemParams
from anther.perception.stem import find_stem
from anther.perception.traits import LEVELS, Limb, measure
from anther.show.pictures import save_figure
from anther.show.pictures.plant import draw_plant

COUNTED = ("branch", "truss", "leaf")
COLUMNS: dict[str, type] = {
    "plant": str,
    "plant_height_m": float,
    "stem_length_m": float,
    "stem_lean_deg": float,
    **{f"stem_radius_{share}_m": float for share in LEVELS},
    "internodes": int,
    "internode_median_m": float,
    **{f"{organ}_count": int for organ in COUNTED},
    "leaf_angle_median_deg": float,
    "total_length_m": float,
    "points": int,
    "stem_confidence": float,
    "notes": str,
    "failure": str,
}
"""Of plants: one line each. stem_radius_50_m is that half-way up."""
LIMB_COLUMNS = {"plant": str, **dict.fromkeys(Limb._fields, float), "organ": str}


@dataclass(frozen=True)
class Args:
    """Attributes: the clouds, what their numbers mean, and where the tables go."""

    clouds: Annotated[Path, tyro.conf.Positional]
    """Folder of point clouds (.ply, .pcd, .xyz, .txt, .csv, .asc, .npz), one plant each; its subfolders too."""
    out: Path
    """Folder for the tables and, by plant, picture and numbers. What is there already is not measured again."""
    units: Units | None = None
    """Units of the files; by default what a file states, else metres."""
    up: Axis | None = None
    """Axis that points up in the files; by default what a file states, else z."""
    parquet: bool = False
    """Write plants.parquet and limbs.parquet instead of CSV."""
    again: bool = False
    """Measure all plants again."""
    params: Params = field(default_factory=Params)
    """How a cloud becomes a skeleton."""
    stem: StemParams = field(default_factory=StemParams)
    """How the main stem is found."""


def run(args: Args) -> int:
    """Measure what is not measured yet, write the tables; return 1 if a plant could not be measured."""
    folder = existing(args.clouds)
    found, left_out = clouds_in(folder, args.out)
    if not folder.is_dir() or not found:
        allowed = f"a folder with clouds: {', '.join(SUFFIXES)}"
        raise bad_input(str(folder), given="none in it", allowed=allowed, do="For one cloud: `anther skeletonize`.")
    made_folder(args.out)
    console, rows = Console(markup=False, highlight=False), list[dict[str, Any]]()
    if left_out:
        console.print(f"not read: {', '.join(left_out[:5])}{' ...' if len(left_out) > 5 else ''}")
    for path in found:
        name = str(path.relative_to(folder))
        rows.append(_measured(args, path, name))
        row = rows[-1]
        told = f"not measured: {row['failure']}"
        if not row["failure"]:
            limbs = ", ".join(f"{row[f'{organ}_count']} {organ}" for organ in COUNTED)
            told = f"stem {row['stem_length_m']:.3f} m, {limbs}"
        console.print(f"{row['plant']}: {told}")
    suffix = "parquet" if args.parquet else "csv"
    limbs = ({"plant": row["plant"]} | limb for row in rows for limb in row["limbs"])
    write_table(args.out / f"plants.{suffix}", COLUMNS, ({n: row.get(n) for n in COLUMNS} for row in rows))
    write_table(args.out / f"limbs.{suffix}", LIMB_COLUMNS, limbs)
    _print(console, rows, args.out / f"plants.{suffix}")
    return int(any(row["failure"] for row in rows))


def clouds_in(folder: Path, out: Path) -> tuple[list[Path], list[str]]:
    """Return the clouds in a folder and those below it, also behind links, each once; and the names of those left out.

    What lies in `out` does not count, which may lie among the clouds and holds .csv and .npz. Left out is what programs
    hide (a Mac's ._NAME and __MACOSX, Excel's ~$NAME), and a link that leads nowhere.
    """
    own, found, seen, left_out = out.resolve(), dict[Path, Path](), set[Path](), list[str]()
    for place, below, names in os.walk(folder, followlinks=True):
        real = Path(place).resolve()
        if real in seen or real.is_relative_to(own):  # a link may lead into a circle
            below.clear()
            continue
        seen.add(real)
        left_out += [name for name in below if name.startswith("__MACOSX")]
        below[:] = sorted(name for name in below if not name.startswith((".", "__MACOSX")))
        for path in (Path(place) / name for name in sorted(names) if Path(name).suffix.lower() in SUFFIXES):
            if path.name.startswith((".", "~$")) or not path.is_file():
                left_out.append(path.name)
            else:
                found.setdefault(path.resolve(), path)
    return sorted(found.values()), left_out


def _measured(args: Args, path: Path, name: str) -> dict[str, Any]:
    """Return what is known of one plant, measured now unless it was before, from this file with these options."""
    place = args.out / "plants" / name
    kept = place / "traits.json"
    asked = {
        "size": path.stat().st_size,
        "changed": path.stat().st_mtime,
        "options": repr((args.units, args.up, args.params, args.stem)),
    }
    if kept.is_file() and not args.again:
        before = read_object(kept)
        row = before.get("row")
        if before.get("of") == asked and isinstance(row, dict) and not row.get("failure"):
            return row
    try:
        row = _row(args, path, place) | {"plant": name, "failure": ""}
    except AntherError as error:
        row = {"plant": name, "failure": str(error), "limbs": []}
    write_json(kept, {"of": asked, "row": row})
    return row


def _row(args: Args, path: Path, place: Path) -> dict[str, Any]:
    cloud = read_cloud(path, args.units, args.up)
    skeleton = skeletonize(cloud, args.params)
    stem = find_stem(skeleton, args.stem, flowers_at=flower_centres(cloud))
    traits = measure(skeleton, stem)
    skeleton.save(place / "skeleton.npz")
    stem.save(place / "stem.npz")
    save_figure(draw_plant(cloud, skeleton, stem), place / "overview.png")
    angles = [limb.angle_deg for limb in traits.limbs if limb.organ == "leaf"]
    return {
        "points": len(cloud.points),
        "notes": "; ".join((*cloud.notes, *skeleton.notes, *stem.notes)),
        "limbs": [limb._asdict() for limb in traits.limbs],
        "plant_height_m": traits.plant_height_m,
        "stem_length_m": traits.stem_length_m,
        "stem_lean_deg": traits.stem_lean_deg,
        **{f"stem_radius_{share}_m": float(r) for share, r in zip(LEVELS, traits.radius_m, strict=True)},
        "internodes": len(traits.internode_m),
        "internode_median_m": float(np.median(traits.internode_m)) if len(traits.internode_m) else None,
        **{f"{organ}_count": traits.count(organ) for organ in COUNTED},
        "leaf_angle_median_deg": float(np.median(angles)) if angles else None,
        "total_length_m": traits.total_length_m,
        "stem_confidence": traits.stem_confidence,
    }


def _print(console: Console, rows: list[dict[str, Any]], path: Path) -> None:
    measured = sum(not row["failure"] for row in rows)
    table = Table("trait", "median", "5 %", "95 %", title=f"{measured} of {len(rows)} plants")
    for name, kind in COLUMNS.items():
        values = [row[name] for row in rows if kind is not str and row.get(name) is not None]
        if values:
            table.add_row(name, *(f"{value:.3g}" for value in np.quantile(values, [0.5, 0.05, 0.95])))
    console.print(table)
    console.print(f"{path}, and limbs beside it; a picture of every plant in {path.parent / 'plants'}")
