"""Organs of simulated plants against their truth, and what leaning and bending plants do to them.

Development plants only (tomato 10-13, pepper 10-15), seen as in `skeletons.py`. Their clouds are also turned as a
whole (the plant leans) and sheared with the square of the height (it bends), and skeletonised anew.

Keys of the --json file: truss_recall_5mm (true peduncle samples with a found truss within 5 mm), truss_precision_5mm
(found truss samples with a true peduncle or pedicel within 5 mm), lost_to_leaf (share of stem, branch and petiole
samples near which there is a line, but one called leaf or truss), flowers_one_to_one (share of the visible flowers with
a found one of their own within 15 mm), attached_to_organ and attached_near (share of these that hang on the organ that
bears them, and within 15 mm of where their pedicel leaves it); upright_, leaning_, bent_ with stem_error_p95_mm,
stem_covered, recall_5mm, precision_5mm, junction_f1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from anther.core import Array
from anther.perception import cloud, masks, skeleton, stem
from anther.plant import Crop
from anther.sim import Organ, SimPlant
from evaluation.harness import CROPS, finish, in_processes, options
from evaluation.perception.simulated import BOX, DEVELOPMENT, find, take
from evaluation.perception.skeleton_truth import (
    AXIS,
    FLOWER_NEAR,
    NEAR,
    WANTED,
    Score,
    found_samples,
    pooled,
    score,
    true_samples,
    visible_flowers,
)
from evaluation.tables import by_part, measured

LEAN, BEND = 25.0, 0.6
"""Degrees, and how far aside a plant is at height z: BEND z^2 [1/m], 0.15 m at half a metre."""
POSED = ("stem_error_p95_mm", "stem_covered", "recall_5mm", "precision_5mm", "junction_f1")


VERDICTS = {
    "flowers_one_to_one": "visible flowers with a found one of their own within 15 mm",
    "attached_to_organ": "of these, those on the organ that bears them",
    "attached_near": "of these, those within 15 mm of where their pedicel leaves it",
    "truss_recall_5mm": "true peduncle with a found truss within 5 mm",
    "truss_precision_5mm": "found truss with a true peduncle or pedicel within 5 mm",
    "lost_to_leaf": "stem, branch and petiole that have a line, called leaf or truss",
}


def posed(plant: SimPlant, points: cloud.Cloud, lean: float, bend: float) -> tuple[SimPlant, cloud.Cloud]:
    """Return plant and cloud (without the pot), bent and then leaning by `lean` [deg], held at the root."""
    root, way = plant.start[0], np.array([np.cos(plant.seed), np.sin(plant.seed), 0])
    turn = Rotation.from_rotvec(np.radians(lean) * np.cross([0, 0, 1], way)).as_matrix()

    def move(x: Array) -> Array:
        return (x - root + np.outer(bend * np.maximum(x[:, 2] - root[2], 0) ** 2, way)) @ turn.T + root

    moved = replace(plant, start=move(plant.start), end=move(plant.end), flower_position=move(plant.flower_position))
    return moved, cloud.Cloud(move(points.points), labels=points.labels)


def truss_counts(plant: SimPlant, tree: skeleton.Skeleton, main: stem.Stem) -> dict[str, NDArray[np.bool_]]:
    """Return the samples' verdicts: true peduncles found, found trusses true, wanted axes called leaf or truss."""
    wanted, truss = _true(plant, *WANTED), _found(tree, main, stem.TRUSS)
    limbs, others = _found(tree, main, stem.STEM, stem.BRANCH), _found(tree, main, stem.LEAF, stem.TRUSS)
    return {
        "truss_recall_5mm": near(_true(plant, Organ.PEDUNCLE), truss),
        "truss_precision_5mm": near(truss, _true(plant, Organ.PEDUNCLE, Organ.PEDICEL)),
        "lost_to_leaf": near(wanted, others) & ~near(wanted, limbs),
    }


def _true(plant: SimPlant, *organs: Organ) -> Array:
    return true_samples(plant, organs)[0] if np.isin(plant.organ, organs).any() else np.zeros((0, 3))


def _found(tree: skeleton.Skeleton, main: stem.Stem, *organs: int) -> Array:
    chosen = np.isin(main.organ, organs)
    return found_samples(tree, chosen) if chosen[1:].any() else np.zeros((0, 3))


def near(points: Array, line: Array) -> NDArray[np.bool_]:
    """Return which points lie within NEAR of the line's samples."""
    return np.asarray(KDTree(line).query(points)[0]) <= NEAR if len(line) else np.zeros(len(points), dtype=bool)


def flower_counts(plant: SimPlant, visible: NDArray[np.bool_], found: Any) -> dict[str, NDArray[np.bool_]]:
    """Return the verdicts of the visible flowers, and of where those that were found hang."""
    tree, _, seen = found
    true = np.flatnonzero(visible)
    apart = np.linalg.norm(plant.flower_position[true, None] - seen.positions, axis=2)
    row, column = linear_sum_assignment(np.minimum(apart, 2 * FLOWER_NEAR))
    own = apart[row, column] <= FLOWER_NEAR
    foot = np.array([_foot(plant, int(plant.flower_segment[k])) for k in true[row[own]]], dtype=np.int64)
    hangs_at = tree.nodes[seen.attachment[column[own]]]
    away = np.linalg.norm(hangs_at - plant.start[foot], axis=1)
    borne_by = np.isin(plant.organ[plant.parent[foot]], AXIS)
    return {
        "flowers_one_to_one": np.arange(len(true)) < own.sum(),
        "attached_near": away <= FLOWER_NEAR,
        "attached_to_organ": (away <= NEAR) | (borne_by == _on_axis(plant, hangs_at)),
    }


def _foot(plant: SimPlant, segment: int) -> int:
    """Return the first segment of the pedicel that ends with this one."""
    while plant.organ[plant.parent[segment]] == Organ.PEDICEL:
        segment = int(plant.parent[segment])
    return segment


def _on_axis(plant: SimPlant, points: Array) -> NDArray[np.bool_]:
    """Return which points are nearer to stem and branches than to petioles, leaves and trusses."""
    others = _true(plant, Organ.PETIOLE, Organ.RACHIS, Organ.LEAF, Organ.PEDUNCLE)
    return np.asarray(KDTree(_true(plant, *AXIS)).query(points)[0] < KDTree(others).query(points)[0])


def one_plant(which: tuple[Crop, int]) -> tuple[dict[str, NDArray[np.bool_]], dict[str, Score]]:
    """Return the plant's verdicts, and its score upright, leaning and bent."""
    plant, capture, truth = take(*which)
    points = cloud.fuse(capture, masks.segment(capture, BOX), BOX)
    visible = visible_flowers(plant, truth, capture.intrinsics)
    found = find(points)
    scores = {"upright": score(plant, visible, *found)}
    for name, lean, bend in (("leaning", LEAN, 0.0), ("bent", 0.0, BEND)):
        moved, cloud_there = posed(plant, points, lean, bend)
        scores[name] = score(moved, visible, *find(cloud_there))
    return truss_counts(plant, found[0], found[1]) | flower_counts(plant, visible, found), scores


def metrics(results: list[tuple[dict[str, NDArray[np.bool_]], dict[str, Score]]]) -> dict[str, float]:
    """Return the flat table: every sample and flower counts once."""
    table = {key: float(np.mean(np.concatenate([verdicts[key] for verdicts, _ in results]))) for key in results[0][0]}
    for name in results[0][1]:
        of_all = pooled([scores[name] for _, scores in results])
        table |= {f"{name}_{key}": float(of_all[key]) for key in POSED}
    return table


def main() -> None:
    """Run, print the verdicts and the plants as they stand, leaning and bent, write --json."""
    own = {"--each": (6, "plants of each species, of four tomatoes and six peppers")}
    args = options(__doc__, quick="one plant of each species only", jobs="plants", own=own)
    each = 1 if args.quick else args.each
    plants = [plant for crop in CROPS for plant in [p for p in DEVELOPMENT if p[0] == crop][:each]]
    found = metrics(in_processes(one_plant, plants, args.jobs, "plants"))
    posed = {
        "main stem's error, 95th percentile, mm": "*_stem_error_p95_mm:.1f",
        "true stem found": "*_stem_covered:.1%",
        "recall at 5 mm": "*_recall_5mm:.1%",
        "precision at 5 mm": "*_precision_5mm:.1%",
        "junctions at 10 mm, F1": "*_junction_f1:.2f",
    }
    poses = {name: name for name in ("upright", "leaning", "bent")}
    words = f"The same plants, leaning by {LEAN:.0f}°, and bent by {100 * BEND / 4:.0f} cm at half a metre:"
    said = f"Shares over {len(plants)} plants:"
    finish(args, found, said, measured(found, VERDICTS), words, by_part(found, "plants", poses, posed))


if __name__ == "__main__":
    main()
