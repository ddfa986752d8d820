"""Fits how sure root and grasp are, on development plants: grown ones with exact labels, and some of the real ones.

    python -m evaluation.perception.fit_confidence

Prints the constants of skeleton/support.py and grasp/_candidates.py. Development plants: 48 grown (`real/grown.py`),
five of the ten seedlings of trackplant3d_tomato1a (every third scan), gavriel_maize_28.2.23_8; each disturbed once in
every way (`real/strict.py`), and for the grasp some development captures of confidence.py as well. None of them is
among the plants that disturbed_plants.py reports. The root: a conditional logit among low tips, nested in whether the
base is in the cloud. The grasp: right when the strict rule says so, in a capture when the true main stem is within
5 mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from anther.core import Array
from anther.perception import skeleton as skeleton_stage
from anther.perception.skeleton.raw_tree import RawTree
from anther.perception.skeleton.support import PlantBase, base_evidence, find_root
from anther.pollination.grasp._candidates import place_evidence
from evaluation.harness import options, progress
from evaluation.perception.confidence import DEVELOPMENT, samples
from evaluation.perception.real.answers import NoAnswer, anther
from evaluation.perception.real.grown import grown_plants
from evaluation.perception.real.plants import HARD, LABELLED, Labelled, develops, labelled_plants, plant_size
from evaluation.perception.real.strict import AT_BASE, disturbed, on_stem
from evaluation.statistics import logistic

GROWN, FIRST_GROWN = 48, 300
CAPTURED = DEVELOPMENT[:2]
SPARSE = 8
"""Of the places along a captured stem every so many counts: they are alike, and grasps are to weigh as much."""
CANDIDATES = 60


class Choice(NamedTuple):
    """Evidence (C, 3) of the tips at which a plant may stand, and which of them (C,) are its base."""

    evidence: Array
    right: NDArray[np.bool_]


@dataclass
class Gathered:
    """What the development plants say: choices of a root; evidence (4,) of grasps, and which were right."""

    choices: list[Choice]
    evidence: list[Array]
    right: list[bool]

    def add(self, plant: Labelled, base: Array) -> None:
        """Add what Anther makes of a plant whose stem's base (3,) [m] is known."""
        trees: list[RawTree] = []

        def noted(tree: RawTree) -> PlantBase:
            trees.append(tree)
            return find_root(tree)

        try:
            with patch.object(skeleton_stage, "find_root", noted):
                seen = anther(plant.cloud)
            place = np.array([seen.grasp.arc_length])
            self.evidence.append(place_evidence(seen.stem, seen.skeleton, place)[0])
            self.right.append(on_stem(plant, seen.grasp))
        except NoAnswer:
            pass
        near = AT_BASE * plant_size(plant.cloud.points)
        seen_base = np.linalg.norm(plant.cloud.points - base, axis=1).min() <= near
        for tree in trees:
            tips, evidence = base_evidence(tree, CANDIDATES)
            at_base = np.linalg.norm(tree.nodes[tips] - base, axis=1) <= near
            self.choices.append(Choice(evidence, at_base & seen_base))


def fit_root(choices: list[Choice], ridge: float = 0.5) -> tuple[Array, Array]:
    """Return the weights (3,) among tips, and constant and weight (2,) of whether the base is among them."""
    found = [choice for choice in choices if choice.right.any()]
    spread = np.concatenate([choice.evidence for choice in choices]).std(axis=0)

    def loss(weights: Array) -> float:
        utilities = [(choice.evidence / spread) @ weights for choice in found]
        missed = (
            np.logaddexp.reduce(u) - np.logaddexp.reduce(u[c.right]) for u, c in zip(utilities, found, strict=True)
        )
        return float(sum(missed) + ridge / 2 * weights @ weights)

    weights = minimize(loss, np.zeros(len(spread)), method="L-BFGS-B").x / spread
    best = np.array([np.logaddexp.reduce(choice.evidence @ weights) for choice in choices])
    return weights, logistic(best[:, None], np.array([choice.right.any() for choice in choices]))


def main() -> None:
    """Gather, fit and print."""
    clouds = {"--clouds": (Path, "keep the captures' clouds in this folder, and use those there")}
    args = options(__doc__, quick="six grown plants, every 31st scan, no captures", data="clouds", own=clouds)
    found = Gathered([], [], [])
    real = labelled_plants(args.data, 31 if args.quick else 3, LABELLED + HARD)
    plants = [*grown_plants(6 if args.quick else GROWN, FIRST_GROWN), *filter(develops, real)]
    for plant in progress(plants, "plants"):
        for other, base in {kind: case for kind, *case in reversed([*disturbed(plant)])}.values():
            found.add(other, base)
    for s in [] if args.quick else samples(CAPTURED, 4, 7, args.clouds):
        if s is not None and len(s.arcs):
            found.evidence += list(place_evidence(s.stem, s.skeleton, s.arcs[::SPARSE]))
            found.right += s.place_right[::SPARSE].tolist()
    names = ("skeleton/support.py: of_base", "skeleton/support.py: of_seen", "grasp/_candidates.py: fitted")
    fitted = [*fit_root(found.choices), logistic(np.array(found.evidence), np.array(found.right))]
    for name, weights in zip(names, fitted, strict=True):
        print(f"{name} = ({', '.join(f'{weight:.2f}' for weight in weights)})")


if __name__ == "__main__":
    main()
