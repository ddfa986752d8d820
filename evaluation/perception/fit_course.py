"""Fits how sure it is that a centreline still follows the stem at a place, on scenes of Anther's own plants.

    python -m evaluation.perception.fit_course

Prints a constant of grasp/_candidates.py. Scenes of two to five plants, half of them with supports, half of them as
dense as one pot, are asked for the plant that is named, as `scenes.py` does. Places where a grasp may be planned and
that lie below the forks that were found count; right are those within two radii of the true stem (pepper: below its
first fork). Helios's plants and real ones set no constant.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anther.core import Array
from anther.perception.skeleton.support import probability
from anther.pollination.grasp._candidates import course_evidence
from evaluation.harness import options, progress
from evaluation.perception.scene_plants import APART, SUPPORTS, build
from evaluation.perception.scenes import SURE, Judge, ask, plants_of
from evaluation.statistics import logistic

SEEDS = range(9500, 9580)
CLOSE = (0.05, 0.2)
"""Between the feet in dense scenes [m]: neighbours touch and cross all along."""
ENDS = (0.065, 0.05)
"""Without these at its root and top no grasp of a stem is planned [m]; at most a quarter of the stem each."""


def places(seed: int) -> tuple[Array, NDArray[np.bool_]] | None:
    """Return the evidence (K, 2) of the places of one scene and which (K,) are right; None where no stem or another's
    was found: that is no question of its course."""
    rng = np.random.default_rng([seed, 83])
    plants = plants_of("own", int(rng.integers(2, 6)), rng, Path())
    names = rng.choice(SUPPORTS, len(plants)).tolist() if seed % 4 > 1 else []
    scene = build(plants, rng, names, CLOSE if seed % 2 else APART)
    answer = ask(scene, root=scene.feet[0])
    if answer.stem is None or answer.skeleton is None:
        return None
    arc, nodes = answer.stem.arc_length, answer.skeleton.nodes[answer.stem.node_ids]
    low, high = (min(end, arc[-1] / 4) for end in ENDS)
    free = (arc >= low) & (arc <= arc[-1] - high) & (arc <= arc[answer.stem.fork])
    right = Judge(scene).on_stem(0, nodes[free])
    return (course_evidence(answer.stem, answer.skeleton, arc[free]), right) if right.any() else None


def main() -> None:
    """Gather, fit and print."""
    args = options(__doc__, quick="six scenes")
    found = [part for part in map(places, progress(SEEDS[: 6 if args.quick else None], "scenes")) if part is not None]
    evidence, right = (np.concatenate(parts) for parts in zip(*found, strict=True))
    weights = logistic(evidence, right)
    print(f"grasp/_candidates.py: of_course = ({', '.join(f'{weight:.2f}' for weight in weights)})")
    doubted = probability(weights.tolist(), evidence) < SURE
    wrong, missed, false = (int(np.sum(which)) for which in (~right, ~right & ~doubted, right & doubted))
    print(f"{wrong} of {len(right)} places are wrong, {missed} of them believed; {false} right ones doubted")


if __name__ == "__main__":
    main()
