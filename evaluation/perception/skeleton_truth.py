"""How well a skeleton, its stem and its flowers match the simulated plant they were seen from.

Lines are compared as samples every millimetre. Organs of the truth: a stem and its forks (STEM, BRANCH), petioles,
rachises (the axis of a compound leaf behind its petiole), peduncles (the axis of a truss). Blades and pedicels have
lines too, but nobody is asked to find them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from anther.core import Array, Intrinsics, transform_points
from anther.core.geometry import arc_length, interpolate
from anther.perception import Flowers, Skeleton, Stem
from anther.perception.stem import BRANCH, LEAF, STEM
from anther.sim import CaptureTruth, Organ, SimPlant

STEP = 0.001
"""Distance between the samples of a line [m]."""
NEAR = 0.005
"""A centreline is found, or right, within this [m] (issue targets: recall and precision at 5 mm)."""
JUNCTION_NEAR, FLOWER_NEAR = 0.010, 0.015
"""The same for junctions and flowers [m]."""
LEAST_PIXELS = 20
"""A flower that shows at least so many pixels in one view is visible."""

AXIS = (Organ.STEM, Organ.BRANCH)
WANTED = (Organ.STEM, Organ.BRANCH, Organ.PETIOLE)
RIGHT = (Organ.STEM, Organ.BRANCH, Organ.PETIOLE, Organ.RACHIS)


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """One plant's comparison; arrays so that several plants can be pooled by `pooled`.

    Attributes:
        stem_error: (n,) distance of the found main stem's samples to the true axis [m]; above a fork (pepper) any
            branch of the axis will do.
        radius_ratio: (n,) found over true radius at these samples, where they lie within NEAR of the axis.
        stem_covered: share of the true stem (pepper: up to the first fork) within NEAR of the found one.
        recalled: (m,) bool, true stem, branch and petiole samples with a found stem or branch sample within NEAR.
        precise: (k,) bool, found stem and branch samples with a true one (rachises count as well) within NEAR.
        junctions: true, found, and matched one to one within JUNCTION_NEAR: (3,).
        flowers: visible, visible and found, found, found and real: (4,).
        tree: whether the skeleton is one tree with one root.
        root_error: distance of node 0 from where the stem leaves the soil [m].
    """

    stem_error: Array
    radius_ratio: Array
    stem_covered: float
    recalled: NDArray[np.bool_]
    precise: NDArray[np.bool_]
    junctions: NDArray[Any]
    flowers: NDArray[Any]
    tree: bool
    root_error: float


def score(plant: SimPlant, visible: NDArray[np.bool_], skeleton: Skeleton, stem: Stem, flowers: Flowers) -> Score:
    """Compare what was found with the plant; `visible` (F,) says which of its flowers any view shows."""
    axis, axis_radius = true_samples(plant, AXIS)
    wanted, right = true_samples(plant, WANTED)[0], true_samples(plant, RIGHT)[0]
    found, found_radius = polyline(skeleton.nodes[stem.node_ids], skeleton.radius[stem.node_ids])
    lines = found_samples(skeleton, np.isin(stem.organ, [STEM, BRANCH]))
    error, nearest = KDTree(axis).query(found)
    error, nearest = np.asarray(error), np.asarray(nearest)
    close = error <= NEAR
    covered = KDTree(found).query(true_samples(plant, (Organ.STEM,))[0])[0] <= NEAR
    return Score(
        stem_error=error,
        radius_ratio=found_radius[close] / axis_radius[nearest[close]],
        stem_covered=float(np.mean(covered)),
        recalled=KDTree(lines).query(wanted)[0] <= NEAR,
        precise=KDTree(right).query(lines)[0] <= NEAR,
        junctions=_matches(true_junctions(plant), found_junctions(skeleton, stem), JUNCTION_NEAR),
        flowers=_flower_counts(plant.flower_position, visible, flowers.positions),
        tree=is_one_tree(skeleton.parent),
        root_error=float(np.linalg.norm(skeleton.nodes[0] - plant.start[0])),
    )


def pooled(scores: list[Score]) -> dict[str, float]:
    """Return the flat metrics of several plants together: every sample, junction and flower counts once."""
    error = np.concatenate([s.stem_error for s in scores])
    ratio = np.concatenate([s.radius_ratio for s in scores])
    true, found, matched = np.sum([s.junctions for s in scores], axis=0)
    visible, seen, claimed, real = np.sum([s.flowers for s in scores], axis=0)
    return {
        "stem_error_median_mm": 1e3 * float(np.median(error)),
        "stem_error_p95_mm": 1e3 * float(np.quantile(error, 0.95)),
        "stem_covered": float(np.mean([s.stem_covered for s in scores])),
        "radius_error": float(np.median(np.abs(ratio - 1))),
        "radius_bias": float(np.median(ratio) - 1),
        "radius_within_15_percent": float(np.mean([abs(np.median(s.radius_ratio) - 1) <= 0.15 for s in scores])),
        "recall_5mm": float(np.mean(np.concatenate([s.recalled for s in scores]))),
        "precision_5mm": float(np.mean(np.concatenate([s.precise for s in scores]))),
        "junction_recall": matched / max(true, 1),
        "junction_precision": matched / max(found, 1),
        "junction_f1": 2 * matched / max(true + found, 1),
        "flower_recall": seen / max(visible, 1),
        "flower_precision": real / max(claimed, 1),
        "tree_share": float(np.mean([s.tree for s in scores])),
        "root_error_median_mm": 1e3 * float(np.median([s.root_error for s in scores])),
        "root_error_max_mm": 1e3 * float(np.max([s.root_error for s in scores])),
        "plants": float(len(scores)),
    }


def true_samples(plant: SimPlant, organs: tuple[Organ, ...]) -> tuple[Array, Array]:
    """Return samples (n, 3) [m] every STEP along the axes of these organs, and the radii (n,) [m] there."""
    lines, radii = [], []
    for k in np.flatnonzero(np.isin(plant.organ, organs)):
        line = np.stack([plant.start[k], plant.end[k]])
        points, radius = polyline(line, np.array([plant.radius_start[k], plant.radius_end[k]]))
        lines.append(points)
        radii.append(radius)
    return np.concatenate(lines), np.concatenate(radii)


def polyline(line: Array, values: Array) -> tuple[Array, Array]:
    """Return the line (n, 3) and the values (n,) on it sampled every STEP or closer."""
    arc = arc_length(line)
    at = np.linspace(0, arc[-1], max(int(np.ceil(arc[-1] / STEP)), 1) + 1)
    return interpolate(at, arc, line), np.interp(at, arc, values)


def found_samples(skeleton: Skeleton, chosen: NDArray[np.bool_]) -> Array:
    """Return samples (n, 3) along the edges whose lower node is chosen (J,)."""
    edges = [skeleton.nodes[[skeleton.parent[j], j]] for j in np.flatnonzero(chosen) if skeleton.parent[j] >= 0]
    return np.concatenate([polyline(edge, np.zeros(2))[0] for edge in edges])


def true_junctions(plant: SimPlant) -> Array:
    """Return where a branch, petiole or truss leaves the stem or a branch (n, 3) [m]; a fork is one junction."""
    side = np.isin(plant.organ, [Organ.BRANCH, Organ.PETIOLE, Organ.PEDUNCLE]) & (plant.parent >= 0)
    leaves = side & np.isin(plant.organ[plant.parent], AXIS)
    goes_on = (plant.organ == Organ.BRANCH) & (plant.organ[plant.parent] == Organ.BRANCH)
    siblings = np.bincount(plant.parent[leaves], minlength=len(plant.parent))
    points = plant.start[leaves & ~(goes_on & (siblings[plant.parent] == 1))]
    near = KDTree(points).query_ball_point(points, 0.002)
    return points[[i for i, group in enumerate(near) if i == min(group)]]


def found_junctions(skeleton: Skeleton, stem: Stem) -> Array:
    """Return the nodes (n, 3) [m] of stem and branches from which another organ than a blade leaves."""
    limb = np.isin(stem.organ, [STEM, BRANCH])
    counts = np.bincount(skeleton.parent[1:][stem.organ[1:] != LEAF], minlength=len(skeleton.nodes))
    return skeleton.nodes[limb & (counts >= 2)]


def _matches(true: Array, found: Array, near: float) -> NDArray[Any]:
    """Return the numbers of true, found, and matched points; each is matched at most once."""
    if not len(true) or not len(found):
        return np.array([len(true), len(found), 0])
    apart = np.linalg.norm(true[:, None] - found, axis=2)
    rows, columns = linear_sum_assignment(np.minimum(apart, 2 * near))
    return np.array([len(true), len(found), int((apart[rows, columns] <= near).sum())])


def _flower_counts(true: Array, visible: NDArray[np.bool_], found: Array) -> NDArray[Any]:
    if not len(true) or not len(found):
        return np.array([visible.sum(), 0, len(found), 0])
    apart = np.linalg.norm(true[:, None] - found, axis=2)
    seen, real = apart.min(axis=1) <= FLOWER_NEAR, apart.min(axis=0) <= FLOWER_NEAR
    return np.array([visible.sum(), (visible & seen).sum(), len(found), real.sum()])


def visible_flowers(plant: SimPlant, truth: CaptureTruth, intrinsics: Intrinsics) -> NDArray[np.bool_]:
    """Return which flowers (F,) show at least LEAST_PIXELS pixels in one of the views."""
    most = np.zeros(len(plant.flower_position), dtype=np.int64)
    tree = KDTree(plant.flower_position)
    for T, depth, organ in zip(truth.T_world_cam, truth.depth, truth.organ, strict=True):
        points = transform_points(T, intrinsics.back_project(depth, organ == Organ.FLOWER))
        _, nearest = tree.query(points)
        most = np.maximum(most, np.bincount(np.asarray(nearest, dtype=np.int64), minlength=len(most)))
    return most >= LEAST_PIXELS


def is_one_tree(parent: NDArray[Any]) -> bool:
    """Walk up from every node: in one rooted tree all walks end at node 0."""
    above = np.arange(len(parent))
    for _ in range(len(parent)):
        above = np.where(above > 0, parent[above], 0)
    return not above.any() and int((parent < 0).sum()) == 1
