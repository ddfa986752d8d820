"""Grasps and main stems on real, labelled plants: how often they lie on the stem system.

Clouds (read from --data; docs/skeleton.md says where they come from): 93 scans of tomato seedlings
(trackplant3d_tomato1a), one 26-day tomato (salk_tomato_D26), one maize (gavriel_maize). One parameter set for all.

Keys of the --json file: trackplant_grasp_on_stem and all_grasp_on_stem (share of plants whose best grasp has a point
labelled stem as its nearest point, within 2 stem radii), stem_on_label (share of the predicted main stem's length
within 2 radii of points labelled stem, mean over plants), stem_on_label_95 (share of plants with 95 % or more),
stem_distance_median_mm (main stem to the nearest stem-labelled point), single_trees, seconds_median, plants.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial import KDTree

from anther.cloud import Cloud
from anther.commands.skeletonize import best_grasps
from anther.errors import AntherError
from anther.files import write_json
from anther.formats.clouds import read_cloud
from anther.skeleton import Params, skeletonize
from anther.stem import find_stem

DATA = Path(os.environ.get("ANTHER_DATA", Path(__file__).parents[2] / "shared" / "data"))
TRACKPLANT = "trackplant3d_tomato1a"


@dataclass(frozen=True)
class Labelled:
    """A plant with the truth: which of its points are stem."""

    name: str
    cloud: Cloud
    is_stem: NDArray[np.bool_]


@dataclass(frozen=True)
class Outcome:
    """What one plant gave; failure is None or the error's text."""

    name: str
    grasp_on_stem: bool = False
    stem_share: float = 0.0
    distance: float = np.nan
    single_tree: bool = False
    seconds: float = np.nan
    failure: str | None = None


def labelled_plants(folder: Path, every: int) -> Iterator[Labelled]:
    """Yield the labelled plants, of trackplant3d every so many."""
    with np.load(folder / f"{TRACKPLANT}.npz") as stored:
        labels, offsets, names = stored["labels"], stored["offsets"], stored["names"]
    for k in range(0, len(names), every):
        cloud = read_cloud(folder / f"{TRACKPLANT}.npz", "mm", "y", plant=k)
        yield Labelled(str(names[k]), cloud, labels[offsets[k] : offsets[k + 1]] == 0)
    for name in ("salk_tomato_D26", "gavriel_maize_28.2.23_8"):
        with np.load(folder / f"{name}.npz") as stored:
            is_stem = stored["labels"] == stored["stem_label"]
        yield Labelled(name, read_cloud(folder / f"{name}.npz"), is_stem)


def judge(plant: Labelled, params: Params) -> Outcome:
    """Run one plant and compare with its labels."""
    begin = time.perf_counter()
    try:
        skeleton = skeletonize(plant.cloud, params)
        stem = find_stem(skeleton)
        grasp = best_grasps(stem, skeleton, plant.cloud)[0][0]
    except AntherError as error:
        return Outcome(plant.name, seconds=time.perf_counter() - begin, failure=str(error))
    seconds = time.perf_counter() - begin
    points = plant.cloud.points
    distance, nearest = KDTree(points).query(grasp.point)
    on_stem = bool(plant.is_stem[nearest]) and float(distance) <= grasp.stem_diameter
    away = np.asarray(KDTree(points[plant.is_stem]).query(skeleton.nodes[stem.node_ids])[0])
    near = away <= 2 * skeleton.radius[stem.node_ids]
    weight = np.gradient(stem.arc_length)
    return Outcome(
        plant.name,
        grasp_on_stem=on_stem,
        stem_share=float(near @ weight / weight.sum()),
        distance=float(np.median(away)),
        single_tree=_one_tree(skeleton.parent),
        seconds=seconds,
    )


def metrics(outcomes: list[Outcome]) -> dict[str, float]:
    """Return the numbers of the results contract."""
    of_trackplant = [o for o in outcomes if "tomato1" in o.name]
    return {
        "trackplant_grasp_on_stem": _mean([o.grasp_on_stem for o in of_trackplant]),
        "all_grasp_on_stem": _mean([o.grasp_on_stem for o in outcomes]),
        "stem_on_label": _mean([o.stem_share for o in outcomes]),
        "stem_on_label_95": _mean([o.stem_share >= 0.95 for o in outcomes]),
        "stem_distance_median_mm": float(np.nanmedian([o.distance for o in outcomes])) * 1e3,
        "single_trees": _mean([o.single_tree for o in outcomes]),
        "seconds_median": float(np.median([o.seconds for o in outcomes])),
        "plants": len(outcomes),
    }


def main() -> None:
    """Run, print a table, list what went wrong, write --json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA / "clouds", help="folder of the clouds")
    parser.add_argument("--json", type=Path, help="write the metrics here")
    parser.add_argument("--quick", action="store_true", help="every eighth seedling only")
    parser.add_argument("--seed", type=int, default=0, help="for uniformity; nothing here is random")
    parser.add_argument("--method", choices=("geodesic", "thinning"), default="geodesic")
    args = parser.parse_args()
    console = Console()
    plants = list(labelled_plants(args.data, every=8 if args.quick else 1))
    outcomes = [judge(plant, Params(method=args.method)) for plant in track(plants, "real plants", console=console)]
    _print(console, outcomes)
    if args.json:
        write_json(args.json, metrics(outcomes))


def _print(console: Console, outcomes: list[Outcome]) -> None:
    table = Table("metric", "value")
    for name, value in metrics(outcomes).items():
        table.add_row(name, f"{value:.4g}")
    console.print(table)
    for o in outcomes:
        if o.failure or not o.grasp_on_stem or o.stem_share < 0.95:
            what = o.failure or ("" if o.grasp_on_stem else "grasp off the stem; ")
            console.print(f"{o.name}: {what}{o.stem_share:.0%} of the main stem on stem points", highlight=False)


def _one_tree(parent: NDArray[Any]) -> bool:
    """Walk up from every node: in one rooted tree all walks end at node 0."""
    above = np.arange(len(parent))
    for _ in range(len(parent)):
        above = np.where(above > 0, parent[above], 0)
    return not above.any() and int((parent < 0).sum()) == 1


def _mean(values: list[Any]) -> float:
    return float(np.mean(values)) if values else float("nan")


if __name__ == "__main__":
    main()
