"""Skeletons, main stems and grasps on real plants: against people's labels, against published graphs, beside peers.

Labelled clouds (read from --data): 93 scans of tomato seedlings (trackplant3d_tomato1a), a 26-day tomato
(salk_tomato_D26), a maize (gavriel_maize). Clouds with a published skeleton graph: two tomatoes and a maize of
Pheno4D. One parameter set for all. Beside Anther, in the same run: plain Lee thinning with the paper's tree, stem and
grasp rule and none of Anther's steps, at two resolutions, and once closed and filled first; and pc-skeletor, skeletor
and PyGEL3D with the same rules, when --pc-skeletor, --skeletor and --pygel name a Python that has them.
docs/reports/real_plants.md shows the results and says what each number means.

Keys of the --json file, without a prefix Anther's, then with plain_, plain_fine_, closed_, pc_skeletor_, skeletor_ and
pygel_:
trackplant_grasp_on_stem and all_grasp_on_stem (share of plants whose grasp is on the stem system), stem_on_label (share
of the main stem's length on it, mean over plants), stem_on_label_95 (share of plants with 95 % or more), stem_reach,
stem_distance_median_mm, single_trees, tips_per_leaf, seconds_median (processor time), no_answer, plants, and on the six
clouds without labels others_reached and others_single_trees; against the published graphs <scan>_precision_<1v|3v>,
<scan>_recall_<1v|3v> and <scan>_spurious_tips, recall_3v (mean) and spurious_tips (sum). best_peer_recall_3v and
best_peer_spurious_tips: of the method with the best recall_3v but Anther; fewest_peer_spurious_tips: the fewest of any.
For Anther alone: radius_over_points (the main stem's radius over the distance of its labelled points; 1 is right); by
the strict rule, those of disturbed_plants.py (but with --without-disturbed); and of a command in a process of its own,
skeletonize_wall_s, help_wall_s, and both with cpu.
"""

from __future__ import annotations

import contextlib
import resource
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from anther.perception import Cloud
from evaluation.harness import finish, options, progress
from evaluation.perception.real.answers import Answer, Method, Seen, anther, asked
from evaluation.perception.real.judge import (
    Outcome,
    Tolerance,
    agreement,
    judge,
    radius_over_points,
    reached,
    spurious_tips,
)
from evaluation.perception.real.peer_process import WORKERS, Peer
from evaluation.perception.real.pictures import Shown, draw_methods, draw_references, save
from evaluation.perception.real.plain_thinning import CLOSED, FINE, plain_thinning
from evaluation.perception.real.plants import (
    LABELLED,
    WITH_REFERENCE,
    Labelled,
    Reference,
    labelled_plants,
    references,
    unlabelled,
)
from evaluation.perception.real.strict import judged_all, metrics, reported
from evaluation.statistics import mean
from evaluation.tables import markdown

ENOUGH = 0.95
"""Share of the main stem that must lie on the stem system."""
SHOWN = (
    "167_tomato1_control1_plant1_D00",
    "213_tomato1_drought_plant1_D02",
    "259_tomato1_heat_plant2_D05",
    *LABELLED,
    "sice_robot_cloud0",
)
"""Plants drawn with all methods: the first, middle and last seedling, the two others with labels, the robot's."""
HEADS = {
    "anther": "Anther",
    "plain": "plain thinning",
    "plain_fine": "the same, finer",
    "closed": "finer, closed and filled",
    "pc_skeletor": "pc-skeletor",
    "skeletor": "skeletor",
    "pygel": "PyGEL3D",
}
ROWS = {
    "plants": ("labelled plants", ".0f"),
    "all_grasp_on_stem": ("grasp on the stem system", ".1%"),
    "trackplant_grasp_on_stem": ("the same, seedlings alone", ".1%"),
    "stem_on_label": ("main stem on the stem system, mean share of its length", ".1%"),
    "stem_on_label_95": ("plants with 95 % or more of it there", ".1%"),
    "stem_reach": ("height that the main stem covers, of the stem system's", ".1%"),
    "single_trees": ("labelled plants whose skeleton is one tree", ".0%"),
    "tips_per_leaf": ("skeleton's ends for each leaf, median (1 is right)", ".3g"),
    "seconds_median": ("processor time, median, s", ".2g"),
    "others_reached": ("points reached, six clouds without labels", ".1%"),
    "others_single_trees": ("the same clouds, skeleton is one tree", ".0%"),
    "recall_3v": ("recall of three published graphs at 3 voxels, mean", ".1%"),
    "spurious_tips": ("ends that these graphs do not have, sum", ".0f"),
}
"""What is printed: the numbers of `Run.rows`, what they are called, and how they are written."""

TIPS = "spurious_tips"

Outcomes = dict[str, list[Outcome]]


@dataclass(eq=False)
class Run:
    """What a run has found so far.

    Attributes:
        outcomes: by method, on the labelled plants.
        others: by method, on the six other clouds: (share of points reached, is a single tree).
        agreements: by method, precision, recall and spurious tips against the published graphs.
        radius_ratios: Anther's stem radius over the distance of the stem's points, by labelled plant.
        shown: plants drawn with all methods.
        references: what is drawn of the plants with published graphs.
    """

    outcomes: Outcomes = field(default_factory=lambda: defaultdict(list))
    others: dict[str, list[tuple[float, bool]]] = field(default_factory=lambda: defaultdict(list))
    agreements: dict[str, dict[str, float]] = field(default_factory=lambda: defaultdict(dict))
    radius_ratios: list[float] = field(default_factory=list)
    shown: list[Shown] = field(default_factory=list)
    references: list[tuple[Reference, Seen]] = field(default_factory=list)

    def add_labelled(self, plant: Labelled, methods: dict[str, Method]) -> None:
        """Run all methods on a labelled plant."""
        seen, answers = all_answers(plant.cloud, methods)
        tolerance = Tolerance(seen.skeleton.nodes[seen.stem.node_ids], seen.skeleton.radius[seen.stem.node_ids])
        for name, answer in answers.items():
            self.outcomes[name].append(judge(plant, answer, tolerance))
        self.radius_ratios.append(radius_over_points(plant, seen))
        if plant.name in SHOWN:
            self.shown.append(Shown(plant.name, plant.cloud, answers, plant.is_stem))

    def add_other(self, name: str, cloud: Cloud, methods: dict[str, Method]) -> tuple[Seen, dict[str, Answer | str]]:
        """Run all methods on a plant without labels; return what Anther sees and every answer."""
        seen, answers = all_answers(cloud, methods)
        for method, answer in answers.items():
            self.others[method].append((reached(cloud, answer), isinstance(answer, Answer) and answer.is_tree))
        if name in SHOWN:
            self.shown.append(Shown(name, cloud, answers))
        return seen, answers

    def add_reference(self, plant: Reference, methods: dict[str, Method]) -> None:
        """Run all methods on a plant with a published graph; compare their skeletons with it."""
        seen, answers = self.add_other(plant.name, plant.cloud, methods)
        self.references.append((plant, seen))
        for method, answer in answers.items():
            if isinstance(answer, Answer):
                found = agreement(plant, answer) | {TIPS: spurious_tips(plant, answer)}
                self.agreements[method] |= {f"{plant.name}_{name}": value for name, value in found.items()}

    def draw(self, folder: Path) -> None:
        """Write the pictures."""
        save(draw_methods(self.shown), folder / "real_plants_methods.png")
        save(draw_references(self.references), folder / "real_plants_references.png")

    def metrics(self) -> dict[str, float]:
        """Return the numbers of the results contract; a method without an answer has missed everything."""
        found: dict[str, float] = {}
        for method, row in self.rows().items():
            found |= {("" if method == "anther" else f"{method}_") + name: value for name, value in row.items()}
        return found | self.beside_peers()

    def beside_peers(self) -> dict[str, float]:
        """Return what has no like for the other methods, and what the best of them reach."""
        peers = [row for name, row in self.rows().items() if name != "anther"]
        best = max(peers, key=lambda row: row["recall_3v"])
        return {
            "radius_over_points": float(np.median(self.radius_ratios)),
            "best_peer_recall_3v": best["recall_3v"],
            "best_peer_spurious_tips": best["spurious_tips"],
            "fewest_peer_spurious_tips": min(row["spurious_tips"] for row in peers),
        }

    def rows(self) -> dict[str, dict[str, float]]:
        """Return the numbers by method."""
        return {
            name: _of_method(outcomes, self.others[name]) | _on_graphs(self.agreements[name])
            for name, outcomes in self.outcomes.items()
        }


def all_answers(cloud: Cloud, methods: dict[str, Method]) -> tuple[Seen, dict[str, Answer | str]]:
    """Return what Anther sees, and every method's answer."""
    seen = anther(cloud)
    return seen, {"anther": seen.answer, **{name: asked(method, cloud) for name, method in methods.items()}}


def _of_method(outcomes: list[Outcome], others: list[tuple[float, bool]]) -> dict[str, float]:
    return {
        "trackplant_grasp_on_stem": mean([o.grasp_on_stem for o in outcomes if "tomato1" in o.plant]),
        "all_grasp_on_stem": mean([o.grasp_on_stem for o in outcomes]),
        "stem_on_label": mean([o.stem_share for o in outcomes]),
        "stem_on_label_95": mean([o.stem_share >= ENOUGH for o in outcomes]),
        "stem_reach": mean([o.stem_reach for o in outcomes]),
        "stem_distance_median_mm": float(np.nanmedian([o.distance for o in outcomes])) * 1e3,
        "single_trees": mean([o.is_tree for o in outcomes]),
        "tips_per_leaf": float(np.nanmedian([o.tips_per_leaf for o in outcomes])),
        "seconds_median": float(np.nanmedian([o.seconds for o in outcomes])),
        "no_answer": sum(o.failure is not None for o in outcomes),
        "plants": len(outcomes),
        "others_reached": mean([share for share, _ in others]),
        "others_single_trees": mean([is_tree for _, is_tree in others]),
    }


def _on_graphs(found: dict[str, float]) -> dict[str, float]:
    """Return a method's numbers on the published graphs, with mean recall and all spurious tips."""
    recall = [value for name, value in found.items() if name.endswith("recall_3v")]
    tips = [value for name, value in found.items() if name.endswith("spurious_tips")]
    return found | {"recall_3v": sum(recall) / len(WITH_REFERENCE), "spurious_tips": float(sum(tips))}


CLOUD, RUNS = "sorghum_kinect_fused.npz", 7
"""A plant of 50 thousand points, and how often a command is started."""


def started(folder: Path) -> dict[str, float]:
    """Return the wall time [s] of `anther --help` and of `anther skeletonize`, the best of some runs in processes of
    their own after one that may compile, and the processor time of both [s], which other programs disturb less."""
    asked = {"help": ["--help"], "skeletonize": ["skeletonize", str(folder / CLOUD)]}
    found: dict[str, float] = {}
    for name, words in asked.items():
        _once(words)
        runs = [_once(words) for _ in progress(range(RUNS), f"start of {name}")]
        found |= {f"{name}_wall_s": min(wall for wall, _ in runs), f"{name}_cpu_s": min(cpu for _, cpu in runs)}
    return found


def _once(words: list[str]) -> tuple[float, float]:
    """Run a command; return its wall time and its processor time [s]."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, "-m", "anther.cli", *words], check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def report(found: Run) -> Iterator[RenderableType]:
    """Yield the methods side by side, and what went wrong."""
    rows = found.rows()
    heads = [HEADS[name] for name in rows]
    lines = [(words, *(f"{row[key]:{form}}" for row in rows.values())) for key, (words, form) in ROWS.items()]
    yield markdown(("", *heads), lines)
    yield "Against the published graphs: recall and precision at 3 voxels, and ends that they do not have."
    lines = []
    for plant in WITH_REFERENCE:
        each = ([row.get(f"{plant}_{k}", np.nan) for k in ("recall_3v", "precision_3v", TIPS)] for row in rows.values())
        lines.append((plant, *(f"{recall:.0%}, {precision:.0%}, {tips:.0f}" for recall, precision, tips in each)))
    yield markdown(("plant", *heads), lines)
    ratio = found.beside_peers()["radius_over_points"]
    yield f"The main stem's radius over the distance of its labelled points: {ratio:.2f} (median)."
    poor = [o for o in found.outcomes["anther"] if not o.grasp_on_stem or o.stem_share < ENOUGH]
    if poor:
        yield "Anther's grasps off the stem system, and main stems with less than 95 % of their length on it:"
    for o in poor:
        grasp = "right" if o.grasp_on_stem else "off the stem"
        yield f"{o.plant}: grasp {grasp}, {o.stem_share:.0%} of the main stem on it."
    for method, outcomes in found.outcomes.items():
        for reason, count in Counter(o.failure for o in outcomes if o.failure).items():
            yield f"{HEADS[method]}: no answer on {count} plants: {reason}"


def main() -> None:
    """Run, print a table, list what went wrong, write --json and the pictures."""
    own: dict[str, Any] = {
        f"--{name.replace('_', '-')}": {"type": Path, "metavar": "PYTHON", "help": f"a Python that has {name}"}
        for name in WORKERS
    }
    own |= {
        "--peers-every": (1, "peers see every so many of the seedlings"),
        "--without-disturbed": (False, "leave them to disturbed_plants.py"),
    }
    args = options(__doc__, quick="every eighth seedling only", data="clouds", figures="the pictures", own=own)
    found, fine = Run(), partial(plain_thinning, resolution=FINE)
    plain: dict[str, Method] = {"plain": plain_thinning, "plain_fine": fine, "closed": partial(fine, closed=CLOSED)}
    with contextlib.ExitStack() as stack:
        wanted = [(name, python) for name in WORKERS if (python := getattr(args, name))]
        peers = {name: stack.enter_context(contextlib.closing(Peer(name, python))) for name, python in wanted}
        methods = {**plain, **peers}
        plants = list(labelled_plants(args.data, 8 if args.quick else 1))
        for k, plant in enumerate(progress(plants, "labelled plants")):
            every = k % args.peers_every == 0 or plant.name in SHOWN
            found.add_labelled(plant, methods if every else plain)
        for plant in progress(list(references(args.data)), "published graphs"):
            found.add_reference(plant, methods)
        for name, cloud in progress(list(unlabelled(args.data)), "without labels"):
            found.add_other(name, cloud, methods)
    numbers: dict[str, float] = {}
    if args.json:
        disturbed = [] if args.without_disturbed else reported(args.data, quick=args.quick)
        strict = metrics(judged_all(progress(disturbed, "disturbed plants"))) if disturbed else {}
        numbers = found.metrics() | strict | started(args.data)
    finish(args, numbers, *report(found))
    if args.figures:
        found.draw(args.figures)


if __name__ == "__main__":
    main()
