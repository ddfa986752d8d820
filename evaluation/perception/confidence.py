"""Whether the confidences of skeleton, stem and grasp are what they say, on simulated plants seen well and badly.

Every plant is seen in 12 views at 1280 x 720 as the arm takes them, and again with the capture degraded (fewer views,
one side only, half the resolution, noisy or lost depth, a hidden foot, loose poses, one wrong pose). Right are: a node
within 5 mm of the axis of a stem, branch, petiole, rachis or truss; a stem with at least 95 % of its length within 5 mm
of the true axis (above a fork any of the stems); a grasp within 5 mm of the true main stem (pepper: below the fork).

    python -m evaluation.perception.confidence          evaluates on seeds 520 to 527 of both species
    python -m evaluation.perception.confidence --fit    fits those of nodes and stems on the development seeds 10 to 17
                                              (those of root and grasp: fit_confidence.py)

Keys of the --json file, for <kind> of node, stem, grasp: <kind>_brier and <kind>_base_brier (that of always saying the
base rate), <kind>_right (base rate), <kind>_auc (chance that a right one is believed more than a wrong one),
<kind>_calibration_error (mean distance of predicted and observed share over ten bins), <kind>_wrong_doubted and
<kind>_wrong_trusted (share of wrong ones with a confidence below and from `DOUBTFUL`), <kind>_count;
captures, refused (captures that ended in a StageFailure), silent_wrong_stems (wrong, and nothing was said).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import get_args

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from scipy.spatial import KDTree

from anther.core import Array, StageFailure
from anther.perception import Capture, Cloud, Skeleton, Stem, find_stem, flower_centres, fuse, masks, skeletonize
from anther.perception.skeleton.support import node_support, probability
from anther.perception.stem.confidence import DOUBTFUL, stem_evidence
from anther.plant import Crop
from anther.pollination import plan_grasps
from anther.sim import Organ, SimPlant, grow
from anther.sim.simulated_cell import USUAL_DISTANCE
from evaluation.harness import finish, options, progress
from evaluation.perception.degraded_views import DEGRADATIONS
from evaluation.perception.simulated import BOX, take
from evaluation.perception.skeleton_truth import AXIS, NEAR, polyline, true_samples
from evaluation.statistics import auc, logistic, reliability
from evaluation.tables import by_part, markdown

DEVELOPMENT, EVALUATION = range(10, 18), range(520, 528)
VIEWS, EACH = 12, 4
"""Of a capture, and degraded captures of each plant."""
NODE_AXES = (Organ.STEM, Organ.BRANCH, Organ.PETIOLE, Organ.RACHIS, Organ.PEDUNCLE, Organ.PEDICEL)
RIGHT_SHARE = 0.95
KINDS = {"node": "nodes of skeletons", "stem": "main stems", "grasp": "ranked grasps"}


PLACES = 0.01
"""Distance along the stem of the places that a grasp's confidence is fitted on [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One capture of one plant, and what was right of what perception made of it.

    Attributes:
        name: species, seed and degradation.
        skeleton, stem: as found.
        support: (J, 2) evidence for each node.
        node_right: (J,) bool.
        stem_right: whether the stem is.
        arcs: (K,) places along the stem [m].
        place_right: (K,) bool.
        grasp_confidence, grasp_right: (G,) of the ranked grasps.
        warned: whether cloud or stem had something to say beside poses that were corrected.
    """

    name: str
    skeleton: Skeleton
    stem: Stem
    support: Array
    node_right: NDArray[np.bool_]
    stem_right: bool
    arcs: Array
    place_right: NDArray[np.bool_]
    grasp_confidence: Array
    grasp_right: NDArray[np.bool_]
    warned: bool


def samples(seeds: range, degradations: int, draw: int, kept: Path | None) -> Iterator[Sample | None]:
    """Yield a sample for every plant as taken and under some degradations by turns; None where a stage refused.

    Args:
        seeds: of the plants.
        degradations: how many for each plant.
        draw: seed of the degradations.
        kept: folder in which clouds are kept and looked up.
    """
    names = list(DEGRADATIONS)
    for number, (seed, species) in enumerate((seed, species) for seed in seeds for species in get_args(Crop)):
        plant = grow(species, seed, 0.0, USUAL_DISTANCE)
        turn = [names[(number * degradations + i) % len(names)] for i in range(degradations)]
        for name in ["as taken", *turn]:
            try:
                cloud = _cloud(plant, name, draw, kept)
                yield _sample(f"{species}-{seed}-{name}", plant, cloud)
            except StageFailure:
                yield None


def _cloud(plant: SimPlant, name: str, draw: int, kept: Path | None) -> Cloud:
    file = None if kept is None else kept / f"{plant.species}-{plant.seed}-{name.replace(' ', '_')}" / "cloud.ply"
    if file is not None and file.exists():
        return Cloud.load(file)
    capture = photographed(plant.species, plant.seed)
    if name != "as taken":
        capture = DEGRADATIONS[name](capture, np.random.default_rng([plant.seed, draw]))
    cloud = fuse(capture, masks.segment(capture, BOX), BOX)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        cloud.save(file)
    return cloud


@cache
def photographed(species: Crop, seed: int) -> Capture:
    """Return the capture of a plant as `anther trial` would take it, in VIEWS views."""
    return take(species, seed, VIEWS)[1]


def _sample(name: str, plant: SimPlant, cloud: Cloud) -> Sample:
    skeleton = skeletonize(cloud)
    stem = find_stem(skeleton, flowers_at=flower_centres(cloud))
    assert skeleton.flatness is not None
    wood = cloud.points[cloud.labels != masks.FLOWER]
    main, axis, organs = (KDTree(true_samples(plant, of)[0]) for of in ((Organ.STEM,), AXIS, NODE_AXES))
    nodes, arcs = skeleton.nodes[stem.node_ids], np.arange(0.02, stem.arc_length[-1], PLACES)
    places = np.stack([np.interp(arcs, stem.arc_length, column) for column in nodes.T], axis=1)
    line, _ = polyline(nodes, stem.arc_length)
    try:
        grasps = plan_grasps(stem, skeleton, cloud)
    except StageFailure:
        grasps = []
    return Sample(
        name=name,
        skeleton=skeleton,
        stem=stem,
        support=node_support(skeleton.nodes, skeleton.parent, skeleton.radius, skeleton.flatness, wood),
        node_right=organs.query(skeleton.nodes)[0] <= NEAR,
        stem_right=bool(np.mean(axis.query(line)[0] <= NEAR) >= RIGHT_SHARE),
        arcs=arcs,
        place_right=main.query(places)[0] <= NEAR,
        grasp_confidence=np.array([g.confidence for g in grasps], dtype=np.float64),
        grasp_right=np.array([main.query(g.point)[0] <= NEAR for g in grasps], dtype=bool),
        warned=any("has been corrected" not in note for note in (*cloud.notes, *stem.notes)),
    )


def fit(found: list[Sample]) -> dict[str, Array]:
    """Return constant and weights of the confidences of nodes, and of stems with the nodes' new ones."""
    node = logistic(np.concatenate([s.support for s in found]), np.concatenate([s.node_right for s in found]))
    found = [replace(s, skeleton=replace(s.skeleton, confidence=probability(list(node), s.support))) for s in found]
    stems = np.stack([stem_evidence(s.skeleton, s.stem.node_ids) for s in found])
    return {"skeleton/support.py": node, "stem/confidence.py": logistic(stems, np.array([s.stem_right for s in found]))}


def claims(found: list[Sample]) -> dict[str, tuple[Array, NDArray[np.bool_]]]:
    """Return, for node, stem and grasp, what was claimed and what was right."""
    nodes = np.concatenate([s.skeleton.confidence for s in found]), np.concatenate([s.node_right for s in found])
    grasps = np.concatenate([s.grasp_confidence for s in found]), np.concatenate([s.grasp_right for s in found])
    stems = np.array([s.stem.confidence for s in found]), np.array([s.stem_right for s in found])
    return {"node": nodes, "stem": stems, "grasp": grasps}


def metrics(found: list[Sample | None]) -> dict[str, float]:
    """Return the flat numbers of the docstring above."""
    seen = [s for s in found if s is not None]
    out: dict[str, float] = {"captures": len(found), "refused": len(found) - len(seen)}
    out["silent_wrong_stems"] = sum(not s.stem_right and not s.warned for s in seen)
    for kind, (claimed, right) in claims(seen).items():
        bins, doubted = reliability(claimed, right), claimed < DOUBTFUL
        out |= {
            f"{kind}_brier": float(np.mean((claimed - right) ** 2)),
            f"{kind}_base_brier": float(right.mean() * (1 - right.mean())),
            f"{kind}_right": float(right.mean()),
            f"{kind}_auc": auc(claimed, right),
            f"{kind}_calibration_error": float(np.average(np.abs(bins[:, 0] - bins[:, 1]), weights=bins[:, 2])),
            f"{kind}_wrong_doubted": float(1 - right[doubted].mean()) if doubted.any() else np.nan,
            f"{kind}_wrong_trusted": float(1 - right[~doubted].mean()) if not doubted.all() else np.nan,
            f"{kind}_count": len(right),
        }
    return out


def draw(found: list[Sample], path: Path) -> None:
    """Draw the reliability of the three confidences."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 4.1), sharey=True, layout="constrained")
    for ax, (kind, (claimed, right)) in zip(axes, claims(found).items(), strict=True):
        bins = reliability(claimed, right)
        error = np.sqrt(bins[:, 1] * (1 - bins[:, 1]) / bins[:, 2])
        ax.bar(bins[:, 0], bins[:, 2] / bins[:, 2].sum(), width=0.06, color="#dfe6e1", label="share of cases")
        ax.plot([0, 1], [0, 1], color="#5d6b62", lw=1, ls=":")
        ax.errorbar(bins[:, 0], bins[:, 1], yerr=error, color="#2f7d4f", marker="o", capsize=2, label="observed")
        ax.axvline(DOUBTFUL, color="#b3402e", lw=1, label="warns below")
        ax.set(title=f"{kind} (n = {len(right)})", xlabel="confidence", xlim=(0, 1), ylim=(0, 1.02))
    axes[0].set_ylabel("share that is right")
    axes[0].legend(loc="upper left", fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def report(numbers: dict[str, float], seen: list[Sample]) -> list[RenderableType]:
    """Return the scores of the three confidences, and what was right by what was said."""
    scores = {
        "number": "*_count:,.0f",
        "right": "*_right:.1%",
        "Brier score": "*_brier:.3f",
        "of always saying the share that is right": "*_base_brier:.3f",
        "AUC": "*_auc:.3f",
        "calibration error": "*_calibration_error:.3f",
        f"wrong of those below {DOUBTFUL}": "*_wrong_doubted:.0%",
        "wrong of the others": "*_wrong_trusted:.0%",
    }
    tenths = {kind: reliability(*claim) for kind, claim in claims(seen).items()}
    cells = {(kind, min(int(10 * p), 9)): f"{right:.0%} of {n:.0f}" for kind in KINDS for p, right, n in tenths[kind]}
    by_tenth = [
        (f"{k / 10:.1f} to {(k + 1) / 10:.1f}", *(cells.get((kind, k), "–") for kind in KINDS)) for k in range(10)
    ]
    wrong_stems = sum(not s.stem_right for s in seen)
    return [
        by_part(numbers, "", KINDS, scores),
        "Share that is right by what is said, with the number of cases:",
        markdown(("confidence", *KINDS.values()), by_tenth),
        f"{numbers['captures']} captures, {numbers['refused']} refused. Of {wrong_stems} wrong stems "
        f"{numbers['silent_wrong_stems']} came without any warning.",
    ]


def main() -> None:
    """Fit or evaluate, print, and write --json and --figure."""
    own = {
        "--fit": (False, "fit the constants on the development seeds instead"),
        "--clouds": (Path, "keep clouds in this folder, and use those that are there"),
        "--each": (int, "so many plants of each species"),
    }
    quick = "two plants of each species"
    args = options(__doc__, quick=quick, seed=(7, "of the degradations"), figure="the reliability", own=own)
    seeds = (DEVELOPMENT if args.fit else EVALUATION)[: 2 if args.quick else args.each]
    drawn = samples(seeds, EACH, args.seed, args.clouds)
    found = list(progress(drawn, "captures", 2 * len(seeds) * (1 + EACH)))
    seen = [s for s in found if s is not None]
    if args.fit:
        for file, weights in fit(seen).items():
            print(f"{file}: fitted = ({', '.join(f'{w:.2f}' for w in weights)})")
        return
    numbers = metrics(found)
    finish(args, numbers, *report(numbers, seen))
    if args.figure:
        draw(seen, args.figure)


if __name__ == "__main__":
    main()
