"""A strict rule on labelled plants, as scanned and disturbed: was the grasp right, and if not, was it doubted?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from anther.core import Array
from anther.perception import Cloud
from anther.perception.stem.confidence import DOUBTFUL
from anther.pollination import Grasp
from evaluation.perception.real.answers import NoAnswer, anther
from evaluation.perception.real.judge import STEPS, sampled
from evaluation.perception.real.plants import HARD, LABELLED, Labelled, develops, labelled_plants, plant_size
from evaluation.tables import markdown

NEIGHBOURS, RADII = 10, 1.5
"""A place is on the stem when most of so many nearest points are, and the stem's nearest is within so many radii."""
INTO_LEAF = 0.05
"""A main stem is in a leaf when more than this share of its length is."""
AT_BASE = 0.06
"""A root is at the base when it is within this of it, relative to the plant's size."""
LOWEST = 0.01
"""The base is the middle of this share of the stem's points, the lowest ones."""
TILTS, AZIMUTHS = (20, 40), 4
"""Degrees, each towards so many sides."""
KINDS = (
    "as scanned",
    "tilted by 20",
    "tilted by 40",
    "10 % of the points",
    "half cut away",
    "one side",
    "noise",
    "outliers",
)


@dataclass(frozen=True)
class Judged:
    """What became of one plant under one disturbance.

    Attributes:
        plant, kind: which.
        on_stem: whether the grasp is.
        into_leaf: whether the main stem is.
        root_ok: whether the root is at the base.
        confidence: of the grasp; 0 where there was no answer.
        refused: whether there was no answer.
    """

    plant: str
    kind: str
    on_stem: bool = False
    into_leaf: bool = False
    root_ok: bool = False
    confidence: float = 0.0
    refused: bool = True


def disturbed(plant: Labelled) -> Iterator[tuple[str, Labelled, Array]]:
    """Yield the plant as scanned and in each way disturbed, (kind, plant, its base (3,) [m])."""
    points, rng = plant.cloud.points, np.random.default_rng(0)
    stem = np.flatnonzero(plant.is_stem)
    lowest = stem[np.argsort(points[stem, 2])[: max(round(LOWEST * len(stem)), NEIGHBOURS)]]
    base, middle, size = points[lowest].mean(axis=0), points.mean(axis=0), plant_size(points)
    everything = np.arange(len(points))
    yield KINDS[0], plant, base
    for kind, degrees in zip(KINDS[1:3], TILTS, strict=True):
        for azimuth in 2 * np.pi * (np.arange(AZIMUTHS) + 0.3) / AZIMUTHS:
            turn = Rotation.from_rotvec(np.radians(degrees) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
            yield kind, _of(plant, turn.apply(points - base) + base, everything), base
    yield KINDS[3], _of(plant, points, rng.permutation(everything)[: len(points) // 10]), base
    yield KINDS[4], _of(plant, points, np.flatnonzero(points[:, 0] > middle[0])), base
    yield KINDS[5], _of(plant, points, _facing(points, size)), base
    yield KINDS[6], _of(plant, points + rng.normal(0, size / STEPS, points.shape), everything), base
    far = rng.uniform(points.min(axis=0), points.max(axis=0), (len(points) // 50, 3))
    labels = np.concatenate([plant.is_stem, np.zeros(len(far), bool)])
    yield KINDS[7], replace(plant, cloud=Cloud(np.concatenate([points, far])), is_stem=labels), base


def _of(plant: Labelled, points: Array, kept: NDArray[np.int64]) -> Labelled:
    return replace(plant, cloud=Cloud(points[kept]), is_stem=plant.is_stem[kept])


def _facing(points: Array, size: float) -> NDArray[np.int64]:
    """Return which points a camera far away along x sees: the first in each cell of the picture, and what is near."""
    cell = np.floor(points[:, 1:] / (size / STEPS)).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    first = np.full(number.max() + 1, np.inf)
    np.minimum.at(first, number.ravel(), points[:, 0])
    return np.flatnonzero(points[:, 0] <= first[number.ravel()] + size / STEPS)


def reported(folder: Path, *, quick: bool) -> list[Labelled]:
    """Return the plants that are reported: every second scan (quick: every 31st) but those the fits have seen."""
    return [p for p in labelled_plants(folder, 31 if quick else 2, LABELLED + HARD) if not develops(p)]


def judged_all(plants: Iterable[Labelled]) -> list[Judged]:
    """Return what becomes of plants, each as scanned and in each way disturbed."""
    return [judged(plant, kind, base) for one in plants for kind, plant, base in disturbed(one)]


def judged(plant: Labelled, kind: str, base: Array) -> Judged:
    """Return what Anther makes of a plant disturbed in one of `KINDS`, whose stem's base (3,) [m] is known."""
    try:
        seen = anther(plant.cloud)
    except NoAnswer:
        return Judged(plant.name, kind)
    size, tree = plant_size(plant.cloud.points), KDTree(plant.cloud.points)
    line = sampled(seen.answer.nodes, seen.answer.stem, size / STEPS)
    in_leaf = plant.is_stem[tree.query(line, NEIGHBOURS)[1]].mean(axis=1) < 0.5
    return Judged(
        plant.name,
        kind,
        on_stem=on_stem(plant, seen.grasp),
        into_leaf=bool(in_leaf.mean() > INTO_LEAF),
        root_ok=bool(np.linalg.norm(seen.skeleton.nodes[0] - base) <= AT_BASE * size),
        confidence=1.0 if seen.grasp.confidence is None else seen.grasp.confidence,
        refused=False,
    )


def on_stem(plant: Labelled, grasp: Grasp) -> bool:
    """Return whether a grasp is on the stem system: most points around it are, and the nearest is near enough."""
    away = np.linalg.norm(plant.cloud.points - grasp.point, axis=1)
    around = plant.is_stem[np.argpartition(away, NEIGHBOURS)[:NEIGHBOURS]]
    gap = float(away[plant.is_stem].min(initial=np.inf))
    return bool(around.mean() >= 0.5) and gap <= RADII * grasp.stem_diameter / 2


def table(rows: Sequence[Judged]) -> Table:
    """Return what became of the plants by way of disturbance."""
    heads = ("clouds", "grasp on the stem", "main stem in a leaf", "root at the base")
    found = markdown(["seen", *heads, "wrong grasps that are doubted", "right grasps that are doubted"])
    for kind in (*KINDS, "all"):
        mine = [row for row in rows if kind in (row.kind, "all")]
        wrong, right = ([row for row in mine if row.on_stem == good] for good in (False, True))
        counts = ([row.on_stem for row in mine], [row.into_leaf for row in mine], [row.root_ok for row in mine])
        doubted = [f"{sum(row.confidence < DOUBTFUL for row in part)} of {len(part)}" for part in (wrong, right)]
        found.add_row(kind, str(len(mine)), *(f"{sum(count)}" for count in counts), *doubted)
    return found


def metrics(rows: Sequence[Judged]) -> dict[str, float]:
    """Return the numbers of the results contract; a refusal counts as a grasp that is wrong and doubted."""

    def share(of: Sequence[bool]) -> float:
        return float(np.mean(of)) if len(of) else float("nan")

    scanned = [row for row in rows if row.kind == KINDS[0]]
    wrong, right = ([row for row in rows if row.on_stem == good] for good in (False, True))
    return {
        "strict_grasp_on_stem": share([row.on_stem for row in scanned]),
        "into_leaf": share([row.into_leaf for row in scanned]),
        "root_ok": share([row.root_ok for row in scanned]),
        "tilt20": share([row.on_stem for row in rows if row.kind == KINDS[1]]),
        "tilt40": share([row.on_stem for row in rows if row.kind == KINDS[2]]),
        "flagged_wrong": share([row.confidence < DOUBTFUL for row in wrong]),
        "false_flags": share([row.confidence < DOUBTFUL for row in right]),
        "strict_cases": float(len(rows)),
        "strict_wrong": float(len(wrong)),
    }
