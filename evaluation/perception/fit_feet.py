"""Fits how likely a stem stands at a minimum of height, on development plants alone and merged into scenes.

    python -m evaluation.perception.fit_feet

Prints the constants of skeleton/plants.py. Development plants: five of the ten seedlings of trackplant3d_tomato1a, a
maize, and grown ones (`real/grown.py`); each alone, some disturbed in every way (`real/strict.py`), and two to five of
those that are no grasses 0.15 to 0.8 of their height apart, turned, on almost one level. Also says how many feet of
other scenes, of plants that the fit has not seen, are missed, and what else is taken for one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from anther.core import Array
from anther.perception.skeleton.plants import _evidence, _graph, _minima
from anther.perception.skeleton.support import probability
from evaluation.harness import options, progress
from evaluation.perception.real.grown import grown_plants
from evaluation.perception.real.plants import HARD, LABELLED, Labelled, develops, labelled_plants
from evaluation.perception.real.strict import disturbed
from evaluation.statistics import logistic

SCENES, MOST_POINTS = 40, 12_000
GRASSES = ("gavriel_maize", "grass", "maize")
"""They stand alone: their leaves hang to the ground as stems stand, which no minimum of height tells apart."""
AT_FOOT = 0.06
"""A minimum this near to a base, of the scene's height, is its foot."""


class Scene(NamedTuple):
    """Points (N, 3) of one or several plants, and where these stand (K, 3) [m]."""

    points: Array
    bases: Array


class Choice(NamedTuple):
    """Evidence (C, 4) of the minima of a scene, which (C,) are feet, and how many feet are at none."""

    evidence: Array
    right: NDArray[np.bool_]
    hidden: int


def merged(plants: Sequence[tuple[Array, Array]], rng: np.random.Generator) -> Scene:
    """Return two to five of the plants (points, base), one high in the mean, turned and set side by side or round."""
    count, apart, around = int(rng.integers(2, 6)), rng.uniform(0.15, 0.8), rng.uniform() < 0.5
    points, bases = [], []
    for k in range(count):
        cloud, base = plants[int(rng.integers(len(plants)))]
        angle, turn = 2 * np.pi * k / count, rng.uniform(0, 2 * np.pi)
        ring = apart / 2 / np.sin(np.pi / count) * np.array([np.cos(angle), np.sin(angle)])
        place = np.append(ring if around else [k * apart, 0], 0) + rng.normal(0, 0.02, 3)
        c, s = np.cos(turn), np.sin(turn)
        cloud = rng.permutation(cloud)[:MOST_POINTS] - base
        cloud = cloud * rng.uniform(0.7, 1.2) / np.ptp(cloud[:, 2]) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        points.append(cloud + place)
        bases.append(place)
    return Scene(np.concatenate(points), np.array(bases))


def chosen(scene: Scene) -> Choice:
    """Return the minima of a scene, and which are feet: the nearest to each base."""
    graph = _graph(scene.points)
    minima = _minima(graph)
    away = np.linalg.norm(graph.points[minima][:, None] - scene.bases, axis=2)
    found = np.flatnonzero(away.min(axis=0) <= AT_FOOT * graph.height)
    right = np.isin(np.arange(len(minima)), away.argmin(axis=0)[found])
    return Choice(_evidence(graph, minima), right, len(scene.bases) - len(found))


def scenes(plants: Sequence[Labelled], count: int, seed: int) -> Iterator[Scene]:
    """Yield every plant alone, every eighth in every way disturbed, and `count` merged scenes."""
    known = []
    for k, plant in enumerate(plants):
        for number, (_, other, base) in enumerate(disturbed(plant)):
            if number == 0 and not plant.name.startswith(GRASSES):
                known.append((plant.cloud.points, base))
            if number == 0 or k % 8 == 0:
                yield Scene(other.cloud.points, base[None])
    rng = np.random.default_rng([seed, 59])
    for _ in range(count):
        yield merged(known, rng)


def main() -> None:
    """Fit on the development plants, print, and count the errors on the others."""
    args = options(__doc__, quick="every 16th scan, six scenes", data="clouds")
    every, count = (16, 6) if args.quick else (6, SCENES)
    real = list(labelled_plants(args.data, every, LABELLED + HARD))
    sets = {
        "fit": [*filter(develops, real), *grown_plants(count // 2, 300)],
        "others": [*(plant for plant in real if not develops(plant)), *grown_plants(count // 2, 700)],
    }
    weights: Array | None = None
    for seed, (name, plants) in enumerate(sets.items()):
        found = [chosen(scene) for scene in progress(list(scenes(plants, count, seed)), name)]
        evidence, right = (np.concatenate(parts) for parts in list(zip(*found, strict=True))[:2])
        if weights is None:
            weights = logistic(evidence, right)
            print(f"skeleton/plants.py: fitted = ({', '.join(f'{weight:.2f}' for weight in weights)})")
        taken = probability(weights.tolist(), evidence) >= 0.5
        hidden = sum(choice.hidden for choice in found)
        missed, wrong = np.count_nonzero(right & ~taken), np.count_nonzero(taken & ~right)
        print(f"{name}: {right.sum() + hidden} feet, {hidden} at no minimum, {missed} missed; {wrong} others taken")


if __name__ == "__main__":
    main()
