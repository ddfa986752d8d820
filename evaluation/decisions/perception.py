"""Suite of the room `perception`: masks, cloud, skeleton, main stem, organs, flowers, and the grasp they lead to.

Inputs: simulated captures of development plants, eight views each, with sensor and pose errors; labelled scans of real
plants; files of clouds whose units and axes are found. A constant of the masks begins at the captures, one of the
skeleton at the clouds, one of the stem at the skeletons; every case goes on to the grasp.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from anther.cli.skeletonize import best_grasps
from anther.core import AntherError, Array, Box
from anther.perception import (
    Capture,
    Cloud,
    Masks,
    Skeleton,
    find_flowers,
    find_stem,
    flower_centres,
    fuse,
    measure,
    read_cloud,
    segment,
    skeletonize,
)
from anther.plant import Crop
from evaluation.perception.real.plants import HARD, LABELLED, labelled_plants
from evaluation.perception.skeleton_truth import polyline, pooled, score, visible_flowers

PLANTS: tuple[tuple[Crop, int], ...] = (("tomato", 10), ("pepper", 10), ("pepper", 13))
VIEWS = 8
FILES = ("pheno4d_tomato_03-05", "gavriel_maize_28.2.23_8", "salk_tomato_D26", "sice_robot_cloud0")
"""Clouds of several scanners, units and axes."""
STAGES = ("masks", "cloud", "skeleton", "stem")
"""Packages and modules of the room, in order; what stands before the masks begins there, what follows the stem
there."""
FIRST = ("capture", "images", "transforms")


class Case(NamedTuple):
    """A stage's input, and what is known of the plant: truth gives the accuracies of a result."""

    name: str
    capture: Capture | None
    workspace: Box | None
    masks: Masks | None
    cloud: Cloud
    skeleton: Skeleton
    truth: Any


def prepare(folder: Path, data: Path, quick: bool) -> None:
    """Write the cases and the inputs of their stages, as the source has them."""
    for name, case in _cases(data, PLANTS[:2] if quick else PLANTS, 32 if quick else 8):
        (folder / f"{name}.case").write_bytes(pickle.dumps(case))
    (folder / "files.txt").write_text("\n".join(str(data / f"{file}.npz") for file in FILES))


def _cases(data: Path, plants: tuple[tuple[Crop, int], ...], every: int) -> Iterator[tuple[str, Case]]:
    from evaluation.perception.simulated import BOX, take  # noqa: PLC0415  the arm takes a second to import

    for species, seed in plants:
        plant, capture, truth = take(species, seed, VIEWS)
        found = segment(capture, BOX)
        cloud, visible = fuse(capture, found, BOX), visible_flowers(plant, truth, capture.intrinsics)
        name = f"{species}-{seed}"
        yield name, Case(name, capture, BOX, found, cloud, skeletonize(cloud), (plant, visible))
    for labelled in labelled_plants(data, every, (*LABELLED, *HARD)) if data.exists() else ():
        skeleton = skeletonize(labelled.cloud)
        yield labelled.name, Case(labelled.name, None, None, None, labelled.cloud, skeleton, labelled.is_stem)


def decide(folder: Path, module: str) -> dict[str, dict[str, Any]]:
    """Return what is decided in each case, from the stage on that holds a module."""
    part = module.split(".")[2]
    if part == "formats":
        return {Path(file).stem: _file(Path(file)) for file in (folder / "files.txt").read_text().split("\n")}
    stage = STAGES.index("masks" if part in FIRST else part) if part in (*FIRST, *STAGES) else len(STAGES)
    found = {}
    for path in sorted(folder.glob("*.case")):
        case = pickle.loads(path.read_bytes())
        if case.capture is not None or stage >= STAGES.index("skeleton"):
            found[case.name] = _tried(partial(_decided, case, stage))
    return found


def _tried(decided: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the decisions, or why there are none."""
    try:
        return decided()
    except AntherError as error:
        return {"failure": {"words": str(error)}}


def _decided(case: Case, stage: int) -> dict[str, Any]:
    cloud = case.cloud
    if stage <= STAGES.index("cloud") and case.capture is not None and case.masks is not None:
        again = stage <= STAGES.index("masks")
        found = segment(case.capture, case.workspace) if again else case.masks
        cloud = fuse(case.capture, found, case.workspace)
    skeleton = skeletonize(cloud) if stage <= STAGES.index("skeleton") else case.skeleton
    centres = flower_centres(cloud)
    stem = find_stem(skeleton, flowers_at=centres)
    flowers = find_flowers(cloud, skeleton, stem, centres=centres)
    grasp = best_grasps(stem, skeleton, cloud)[0][0]
    step = float(np.linalg.norm(np.ptp(cloud.points, axis=0))) / 100
    lengths = np.linalg.norm(np.diff(skeleton.nodes[skeleton.edges], axis=1)[:, 0], axis=1)
    traits = measure(skeleton, stem)
    decisions: dict[str, Any] = {
        "main stem": {"line": skeleton.nodes[stem.node_ids].tolist(), "within": step},
        "grasp": {"points": [grasp.point.tolist()], "within": 2 * step},
        "flowers": {"points": flowers.positions.tolist(), "within": 0.005},
        "flower bearers": {"points": skeleton.nodes[flowers.attachment].tolist(), "within": 0.01},
        "notes": {"words": " ".join((*cloud.notes, *skeleton.notes, *stem.notes, *flowers.notes))},
        "stem confidence": {"share": stem.confidence, "within": 0.05},
        "stem radius": {"ratio": float(np.median(skeleton.radius[stem.node_ids])), "within": 0.05},
        "limbs": {"share": len(traits.limbs), "within": 0},
        "skeleton": {"places": skeleton.nodes.tolist(), "within": step},
    }
    for kind in range(4):
        decisions[f"share of {('stem', 'branch', 'truss', 'leaf')[kind]}"] = {
            "share": float(lengths[stem.organ[1:] == kind].sum() / lengths.sum()),
            "within": 0.03,
        }
    return decisions | {
        f"accuracy: {name}": {"share": value, "within": 0.02}
        for name, value in _accuracy(case.truth, cloud, skeleton, stem, flowers).items()
    }


def _accuracy(truth: Any, cloud: Cloud, skeleton: Skeleton, stem: Any, flowers: Any) -> dict[str, float]:
    """Return shares, 1 is perfect, of a simulated plant and its visible flowers, or of a labelled scan."""
    if isinstance(truth, tuple):
        plant, visible = truth
        found = pooled([score(plant, visible, skeleton, stem, flowers)])
        names = ("stem_covered", "recall_5mm", "precision_5mm", "junction_f1", "flower_recall", "flower_precision")
        error = {"stem error": 1 - found["stem_error_p95_mm"] / 100, "radius": 1 - found["radius_error"]}
        return {name: found[name] for name in names} | error
    line, radius = polyline(skeleton.nodes[stem.node_ids], skeleton.radius[stem.node_ids])
    labelled = cloud.points[truth]
    low, high = np.quantile(labelled[:, 2], [0.005, 0.995])
    on_label = np.asarray(KDTree(labelled).query(line)[0]) <= 2 * radius
    reach = np.ptp(np.clip(line[:, 2], low, high)) / (high - low)
    return {"stem on label": float(on_label.mean()), "stem reach": float(reach)}


def _file(path: Path) -> dict[str, Any]:
    def decided() -> dict[str, Any]:
        cloud = read_cloud(path)
        size: Array = np.ptp(cloud.points, axis=0)
        return {name: {"ratio": float(size[k]), "within": 0.01} for k, name in enumerate(("width", "depth", "height"))}

    return _tried(decided) if path.exists() else {}
