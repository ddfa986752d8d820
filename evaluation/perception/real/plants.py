"""The real plants: where their clouds lie, and what is known of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anther.core import Array
from anther.perception import Cloud, read_cloud

TRACKPLANT = "trackplant3d_tomato1a"
LABELLED = ("salk_tomato_D26", "gavriel_maize_28.2.23_8")
HARD = ("salk_benthi_D18", "gavriel_maize_28.2.23_2")
"""Labelled too, and hard: where the stem of broad leaves ends; a leaf's tip below the stem's base."""
WITH_REFERENCE = ("pheno4d_tomato_03-05", "pheno4d_tomato_03-08", "pheno4d_maize_03-13")
UNLABELLED = ("sice_robot_cloud0", "sorghum_kinect_fused", "adtree_tree1")

DEVELOPMENT = (
    "tomato1_heat_plant1",
    "tomato1_control1_plant1",
    "tomato1_drought_plant1",
    "tomato1_drought_plant2",
    "tomato1_control2_plant1",
    "gavriel_maize_28.2.23_8",
)
"""Plants on which confidences are fitted (fit_confidence.py); the strict rule reports the others."""

_METRES = {"m": 1.0, "mm": 1e-3}


@dataclass(frozen=True, eq=False)
class Labelled:
    """A plant whose points people have labelled.

    Attributes:
        name: of the scan.
        cloud: its N points, z up [m].
        is_stem: (N,) which points belong to the stem system (stem, petioles and rachises).
        leaves: how many leaves are labelled; 0 where leaves are not told apart.
    """

    name: str
    cloud: Cloud
    is_stem: NDArray[np.bool_]
    leaves: int

    @property
    def stem_points(self) -> Array:
        """The points labelled stem [m]."""
        return self.cloud.points[self.is_stem]


@dataclass(frozen=True, eq=False)
class Reference:
    """A plant with a published skeleton graph: nodes (K, 3) [m] and edges (E, 2)."""

    name: str
    cloud: Cloud
    nodes: Array
    edges: NDArray[Any]


def labelled_plants(folder: Path, every: int, others: tuple[str, ...] = LABELLED) -> Iterator[Labelled]:
    """Yield the labelled plants: of the 93 seedlings every so many, and the others that are named."""
    with np.load(folder / f"{TRACKPLANT}.npz") as stored:
        labels, offsets, names = stored["labels"], stored["offsets"], stored["names"]
    for k in range(0, len(names), every):
        cloud = read_cloud(folder / f"{TRACKPLANT}.npz", "mm", "y", plant=k)
        of_plant = labels[offsets[k] : offsets[k + 1]]
        yield Labelled(str(names[k]), cloud, of_plant == 0, len(np.unique(of_plant[of_plant > 0])))
    for name in others:
        with np.load(folder / f"{name}.npz") as stored:
            labels, stem = stored["labels"], int(stored["stem_label"])
        yield Labelled(name, read_cloud(folder / f"{name}.npz"), labels == stem, len(np.unique(labels[labels != stem])))


def develops(plant: Labelled) -> bool:
    """Return whether a plant is one of those on which confidences are fitted."""
    return any(f"{name}_" in f"{plant.name}_" for name in DEVELOPMENT)


def references(folder: Path) -> Iterator[Reference]:
    """Yield the plants with a published graph (all of them z up)."""
    for name in WITH_REFERENCE:
        with np.load(folder / f"{name}.npz") as stored:
            nodes, edges, unit = stored["ref_nodes"], stored["ref_edges"], str(stored["units"])
        yield Reference(name, read_cloud(folder / f"{name}.npz"), nodes * _METRES[unit], edges.astype(np.int64))


def unlabelled(folder: Path) -> Iterator[tuple[str, Cloud]]:
    """Yield (name, cloud) of the plants nobody has labelled."""
    for name in UNLABELLED:
        yield name, read_cloud(folder / f"{name}.npz")


def plant_size(points: Array) -> float:
    """Return the diagonal of the bounding box [m]."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def nearest(points: Array, to: Array) -> Array:
    """Return (M,) the distance of each of M positions `to` from the nearest of the points [m]."""
    return np.asarray(KDTree(points).query(to)[0])
