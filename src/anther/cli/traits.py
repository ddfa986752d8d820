"""A folder of point clouds -> tables of plants and limbs, a picture of every plant; goes on after a stop."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from anther.cli.args.traits import Args
from anther.core.errors import AntherError, bad_input
from anther.core.files import existing, made_folder, read_object, write_json
from anther.core.tables import write_table
from anther.perception.flowers import flower_centres
from anther.perception.formats.clouds import SUFFIXES, read_cloud
from anther.perception.skeleton import Params, skeletonize
from anther.perception.stem import Params as StemParams
from anther.perception.stem import find_stem
from anther.perception.stem.confidence import doubt
from anther.perception.supports import find_supports
from anther.perception.traits import LEVELS, CloudTraits, Limb, measure, measure_cloud, organs_of
from anther.plant.imported import with_known_places
from anther.show.pictures import save_figure
from anther.show.pictures.plant import draw_plant

COUNTED = ("branch", "truss", "leaf")
COLUMNS: dict[str, type] = {
    "plant": str,
    "plant_id": str,
    "date": str,
    "plant_height_m": float,
    **dict.fromkeys(CloudTraits._fields, float),
    "stem_length_m": float,
    "stem_lean_deg": float,
    **{f"stem_radius_{share}{spread}_m": float for share in LEVELS for spread in ("", "_spread")},
    "internodes": int,
    "internode_median_m": float,
    "limbs": int,
    "tips": int,
    **{f"{organ}_count": int for organ in COUNTED},
    "limb_length_median_m": float,
    "limb_length_most_m": float,
    "leaf_angle_median_deg": float,
    "leaf_width_median_m": float,
    "leaf_area_m2": float,
    "leaf_coverage": float,
    "total_length_m": float,
    "points": int,
    "stem_confidence": float,
    "stem_doubt": str,
    "notes": str,
    "failure": str,
}
"""Of plants: one line each. stem_radius_50_m is that half-way up."""
GROWING = (
    "plant_height_m", "plant_width_m", "stem_length_m", "total_length_m", "projected_area_m2", "hull_volume_m3",
    "leaf_area_m2",
)  # fmt: skip
GROWTH: dict[str, type] = {
    "plant_id": str,
    "from": str,
    "to": str,
    "days": int,
    **{f"{name}_per_day": float for name in GROWING},
}
"""Of plants with clouds of several days: a line from each day to the next."""
DATE = re.compile(r"(?<!\d)(20\d\d)([-_.]?)(\d\d)\2(\d\d)(?!\d)")
"""A day in a file's name or folder: 2026-05-03, 2026_05_03, 20260503."""
LIMB_COLUMNS = {"plant": str, **dict.fromkeys(Limb._fields, float), "organ": str}


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
        rows.append(_measure_plant(args, path, name))
        row = rows[-1]
        told = f"not measured: {row['failure']}"
        if not row["failure"]:
            counts = ", ".join(f"{row[f'{organ}_count']} {organ}" for organ in COUNTED)
            told = f"stem {row['stem_length_m']:.3f} m, {row['limbs']} limbs ({counts}), {row['tips']} tips"
        console.print(f"{row['plant']}: {told}")
    suffix = "parquet" if args.parquet else "csv"
    limbs = ({"plant": row["plant"]} | limb for row in rows for limb in row["limb_rows"])
    write_table(args.out / f"plants.{suffix}", COLUMNS, ({n: row.get(n) for n in COLUMNS} for row in rows))
    write_table(args.out / f"limbs.{suffix}", LIMB_COLUMNS, limbs)
    if grown := list(growth(rows)):
        write_table(args.out / f"growth.{suffix}", GROWTH, grown)
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


def named(name: str) -> tuple[str, str]:
    """Return (plant, day) of a cloud by its name, "" without one: row3/p14_2026-05-03.ply is row3/p14, 2026-05-03."""
    stem = str(Path(name).with_suffix(""))
    for found in DATE.finditer(stem):
        try:
            day = date(int(found[1]), int(found[3]), int(found[4]))
        except ValueError:
            continue
        rest = re.sub(r"[-_. ]*/[-_. ]*", "/", stem[: found.start()] + stem[found.end() :])
        return rest.strip("-_. /") or stem, str(day)
    return stem, ""


def growth(rows: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the rows of `GROWTH`: of each plant, what changed a day from one dated cloud to the next."""
    plants = defaultdict[str, list[dict[str, Any]]](list)
    for row in rows:
        if row.get("date") and not row["failure"]:
            plants[row["plant_id"]].append(row)
    for name, seen in sorted(plants.items()):
        seen.sort(key=lambda row: row["date"])
        for old, new in zip(seen, seen[1:], strict=False):
            days = (date.fromisoformat(new["date"]) - date.fromisoformat(old["date"])).days
            if days:
                known = [trait for trait in GROWING if None not in (old[trait], new[trait])]
                change = {f"{trait}_per_day": (new[trait] - old[trait]) / days for trait in known}
                yield {"plant_id": name, "from": old["date"], "to": new["date"], "days": days} | change


def _measure_plant(args: Args, path: Path, name: str) -> dict[str, Any]:
    """Return what is known of one plant, measured now unless it was before, from this file with these options."""
    place = args.out / "plants" / name
    kept = place / "traits.json"
    version = 3  # of the columns: rows of another are measured again
    asked = {
        "size": path.stat().st_size,
        "changed": path.stat().st_mtime,
        "options": repr((args.units, args.up, args.root, args.stem_tip, args.species, *_stages(args), version)),
    }
    if kept.is_file() and not args.overwrite:
        before = read_object(kept)
        row = before.get("row")
        if before.get("of") == asked and isinstance(row, dict) and not row.get("failure"):
            return row
    try:
        row = _row(args, path, place) | {"failure": ""}
    except AntherError as error:
        row = {"failure": str(error), "limb_rows": []}
    row |= dict(zip(("plant", "plant_id", "date"), (name, *named(name)), strict=True))
    write_json(kept, {"of": asked, "row": row})
    return row


def _row(args: Args, path: Path, place: Path) -> dict[str, Any]:
    cloud = find_supports(read_cloud(path, args.units, args.up))
    params, known = _stages(args)
    skeleton = skeletonize(cloud, params)
    stem = organs_of(find_stem(skeleton, known, flowers_at=flower_centres(cloud)), args.species)
    traits = measure(skeleton, stem, cloud)
    skeleton.save(place / "skeleton.npz")
    stem.save(place / "stem.npz")
    save_figure(draw_plant(cloud, skeleton, stem), place / "overview.png")
    lengths = [limb.length_m for limb in traits.limbs]
    angles = [limb.angle_deg for limb in traits.limbs if limb.organ == "leaf"]
    widths = [limb.width_m for limb in traits.limbs if np.isfinite(limb.width_m)]
    row = {
        "points": len(cloud.points),
        "notes": "; ".join((*cloud.notes, *skeleton.notes, *stem.notes, *traits.notes)),
        "limb_rows": [_drop_unknown(limb._asdict()) for limb in traits.limbs],
        "limbs": len(traits.limbs),
        "tips": traits.tips,
        **measure_cloud(cloud)._asdict(),
        "plant_height_m": traits.plant_height_m,
        "stem_length_m": traits.stem_length_m,
        "stem_lean_deg": traits.stem_lean_deg,
        **{f"stem_radius_{share}_m": float(r) for share, r in zip(LEVELS, traits.radius_m, strict=True)},
        **{f"stem_radius_{share}_spread_m": float(r) for share, r in zip(LEVELS, traits.radius_spread_m, strict=True)},
        "internodes": len(traits.internode_m),
        "internode_median_m": float(np.median(traits.internode_m)) if len(traits.internode_m) else None,
        **{f"{organ}_count": traits.count(organ) for organ in COUNTED},
        "limb_length_median_m": float(np.median(lengths)) if lengths else None,
        "limb_length_most_m": max(lengths, default=None),
        "leaf_angle_median_deg": float(np.median(angles)) if angles else None,
        "leaf_width_median_m": float(np.median(widths)) if widths else None,
        "leaf_area_m2": traits.leaf_area_m2,
        "leaf_coverage": traits.leaf_coverage,
        "total_length_m": traits.total_length_m,
        "stem_confidence": traits.stem_confidence,
        "stem_doubt": "; ".join(doubt(stem.confidence)),
    }
    return _drop_unknown(row)


def _drop_unknown(row: dict[str, Any]) -> dict[str, Any]:
    return {name: None if isinstance(value, float) and np.isnan(value) else value for name, value in row.items()}


def _stages(args: Args) -> tuple[Params, StemParams]:
    return with_known_places(args.root, args.stem_tip, args.params or Params(), args.stem or StemParams())


def _print(console: Console, rows: list[dict[str, Any]], path: Path) -> None:
    measured = sum(not row["failure"] for row in rows)
    table = Table("trait", "median", "5 %", "95 %", title=f"{measured} of {len(rows)} plants")
    for name, kind in COLUMNS.items():
        values = [row[name] for row in rows if kind is not str and row.get(name) is not None]
        if values:
            table.add_row(name, *(f"{value:.3g}" for value in np.quantile(values, [0.5, 0.05, 0.95])))
    console.print(table)
    console.print(f"{path}, and limbs beside it; a picture of every plant in {path.parent / 'plants'}")
