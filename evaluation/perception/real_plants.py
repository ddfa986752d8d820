"""Skeletons, main stems and grasps on real plants: against people's labels, against published graphs, and disturbed.

Labelled clouds (read from --data): 93 scans of tomato seedlings (trackplant3d_tomato1a), a 26-day tomato
(salk_tomato_D26), a maize (gavriel_maize). Clouds with a published skeleton graph: two tomatoes and a maize of
Pheno4D. One parameter set for all. Beside Anther, in the same run: plain Lee thinning with the paper's tree, stem and
grasp rule and none of Anther's steps, at two resolutions, and once closed and filled first. By a strict rule, each as
scanned and disturbed (`real/strict.py`): every second scan of the five seedlings on which no confidence was fitted, the
tomato and two hard plants (salk_benthi_D18, gavriel_maize_28.2.23_2).
docs/reports/real_plants.md shows the results and says what each number means.

Keys of the --json file, without a prefix Anther's, then with plain_, plain_fine_ and closed_:
trackplant_grasp_on_stem and all_grasp_on_stem (share of plants whose grasp is on the stem system), stem_on_label (share
of the main stem's length on it, mean over plants), stem_on_label_95 (share of plants with 95 % or more), stem_reach,
stem_distance_median_mm, single_trees, tips_per_leaf, seconds_median (processor time), no_answer, plants, and on the six
clouds without labels others_reached and others_single_trees; against the published graphs <scan>_precision_<1v|3v>,
<scan>_recall_<1v|3v> and <scan>_spurious_tips, recall_3v (mean) and spurious_tips (sum).
For Anther alone: radius_over_points (the main stem's radius over the distance of its labelled points; 1 is right), and
by the strict rule strict_grasp_on_stem, into_leaf, root_ok (shares of the plants as scanned), tilt20 and tilt40 (share
of grasps on the stem), flagged_wrong and false_flags (share of wrong and of right grasps with a confidence below 0.75,
a refusal being wrong and doubted; all disturbances), strict_cases, strict_wrong.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

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
from evaluation.perception.real.strict import Judged, judged_all, metrics, reported, table
from evaluation.statistics import mean
from evaluation.tables import by_number, markdown, written

ENOUGH = 0.95
"""Share of the main stem that must lie on the stem system."""
DRAWN = (
    "167_tomato1_control1_plant1_D00",
    "213_tomato1_drought_plant1_D02",
    "259_tomato1_heat_plant2_D05",
    *LABELLED,
    "sice_robot_cloud0",
)
"""Plants drawn with all methods: the first, middle and last seedling, the two others with labels, the robot's."""
METHODS = {
    "": "Anther",
    "plain_": "plain thinning",
    "plain_fine_": "the same, finer",
    "closed_": "finer, closed and filled",
}
"""What the numbers of a method begin with."""
SHOWN = {
    "labelled plants": "*plants:.0f",
    "grasp on the stem system": "*all_grasp_on_stem:.1%",
    "the same, seedlings alone": "*trackplant_grasp_on_stem:.1%",
    "main stem on the stem system, mean share of its length": "*stem_on_label:.1%",
    "plants with 95 % or more of it there": "*stem_on_label_95:.1%",
    "height that the main stem covers, of the stem system's": "*stem_reach:.1%",
    "labelled plants whose skeleton is one tree": "*single_trees:.0%",
    "skeleton's ends for each leaf, median (1 is right)": "*tips_per_leaf:.3g",
    "processor time, median, s": "*seconds_median:.2g",
    "points reached, six clouds without labels": "*others_reached:.1%",
    "the same clouds, skeleton is one tree": "*others_single_trees:.0%",
    "recall of three published graphs at 3 voxels, mean": "*recall_3v:.1%",
    "ends that these graphs do not have, sum": "*spurious_tips:.0f",
}
"""What is printed of each method."""
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
        if plant.name in DRAWN:
            self.shown.append(Shown(plant.name, plant.cloud, answers, plant.is_stem))

    def add_other(self, name: str, cloud: Cloud, methods: dict[str, Method]) -> tuple[Seen, dict[str, Answer | str]]:
        """Run all methods on a plant without labels; return what Anther sees and every answer."""
        seen, answers = all_answers(cloud, methods)
        for method, answer in answers.items():
            self.others[method].append((reached(cloud, answer), isinstance(answer, Answer) and answer.is_tree))
        if name in DRAWN:
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
        return found | {"radius_over_points": float(np.median(self.radius_ratios))}

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


def report(found: Run, numbers: dict[str, float]) -> Iterator[RenderableType]:
    """Yield the methods side by side, and what went wrong."""
    yield by_number(numbers, "", METHODS, SHOWN)
    yield "Against the published graphs: recall and precision at 3 voxels, and ends that they do not have."
    graphs = {p: f"*{p}_recall_3v:.0%, *{p}_precision_3v:.0%, *{p}_spurious_tips:.0f" for p in WITH_REFERENCE}
    yield by_number(numbers, "plant", METHODS, graphs)
    yield written("The main stem's radius over the distance of its labelled points: radius_over_points:.2f.", numbers)
    poor = [o for o in found.outcomes["anther"] if not o.grasp_on_stem or o.stem_share < ENOUGH]
    if poor:
        yield "Anther's grasps off the stem system, and main stems with less than 95 % of their length on it:"
    for o in poor:
        grasp = "right" if o.grasp_on_stem else "off the stem"
        yield f"{o.plant}: grasp {grasp}, {o.stem_share:.0%} of the main stem on it."
    for method, outcomes in found.outcomes.items():
        for reason, count in Counter(o.failure for o in outcomes if o.failure).items():
            yield f"{method}: no answer on {count} plants: {reason}"


def strictly(rows: list[Judged]) -> Iterator[RenderableType]:
    """Yield what became of the plants as scanned and disturbed, and each wrong grasp."""
    yield "As scanned and disturbed, by the strict rule."
    yield table(rows)
    wrong = [row for row in rows if not row.on_stem]
    if wrong:
        said = [(row.plant, row.kind, "no answer" if row.refused else f"{row.confidence:.2f}") for row in wrong]
        yield "Every grasp that is off the stem:"
        yield markdown(("plant", "seen", "confidence"), said)


def main() -> None:
    """Run, print a table, list what went wrong, write --json and the pictures."""
    args = options(__doc__, quick="every eighth seedling only", data="clouds", figures="the pictures")
    found, fine = Run(), partial(plain_thinning, resolution=FINE)
    methods: dict[str, Method] = {"plain": plain_thinning, "plain_fine": fine, "closed": partial(fine, closed=CLOSED)}
    for plant in progress(list(labelled_plants(args.data, 8 if args.quick else 1)), "labelled plants"):
        found.add_labelled(plant, methods)
    for plant in progress(list(references(args.data)), "published graphs"):
        found.add_reference(plant, methods)
    for name, cloud in progress(list(unlabelled(args.data)), "without labels"):
        found.add_other(name, cloud, methods)
    disturbed = judged_all(progress(reported(args.data, quick=args.quick), "disturbed plants"))
    numbers = found.metrics() | metrics(disturbed)
    finish(args, numbers, *report(found, numbers), *strictly(disturbed))
    if args.figures:
        found.draw(args.figures)


if __name__ == "__main__":
    main()
