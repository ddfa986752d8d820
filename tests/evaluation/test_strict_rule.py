"""What disturbed_plants.py judges with: what is right, what is doubted, and how plants are disturbed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_plants import simple_plant

from anther.perception.cloud import Cloud
from evaluation.perception.real.plants import Labelled
from evaluation.perception.real.strict import KINDS, Judged, disturbed, judged, metrics


@pytest.fixture(scope="module")
def plant() -> Labelled:
    points = simple_plant()
    return Labelled("small", Cloud(points), np.hypot(points[:, 0], points[:, 1]) < 0.008, 4)


def test_a_plant_is_judged_by_its_labels(plant: Labelled) -> None:
    right = judged(plant, KINDS[0], np.zeros(3))
    assert (right.on_stem, right.into_leaf, right.root_ok, right.refused) == (True, False, True, False)
    turned = judged(replace(plant, is_stem=~plant.is_stem), KINDS[0], np.zeros(3))
    assert (turned.on_stem, turned.into_leaf) == (False, True)
    assert not judged(plant, KINDS[0], np.array([0.0, 0.0, 0.1])).root_ok


def test_a_plant_is_disturbed_in_every_way_and_stands_where_it_stood(plant: Labelled) -> None:
    kinds = []
    for kind, other, base in disturbed(plant):
        kinds.append(kind)
        assert len(other.cloud.points) == len(other.is_stem)
        assert np.linalg.norm(base) < 0.01
        if kind in KINDS[:3]:
            assert np.linalg.norm(other.stem_points - base, axis=1).min() < 0.01
    assert set(kinds) == set(KINDS)
    assert len(kinds) == 14
    found = {kind: other.cloud.points for kind, other, _ in disturbed(plant)}
    whole = len(plant.cloud.points)
    assert len(found["10 % of the points"]) == whole // 10
    assert len(found["one side"]) < whole
    assert found["half cut away"][:, 0].min() > plant.cloud.points[:, 0].mean()
    up = plant.cloud.points[plant.cloud.points[:, 2].argmax()]
    tilted = found["tilted by 40"][plant.cloud.points[:, 2].argmax()]
    assert np.degrees(np.arccos(up @ tilted / np.linalg.norm(up) / np.linalg.norm(tilted))) == pytest.approx(40, abs=3)


def test_a_refusal_is_wrong_and_doubted_and_a_bold_error_counts() -> None:
    rows = [
        Judged("a", KINDS[0], True, False, True, 0.9, False),
        Judged("b", KINDS[0], True, True, True, 0.5, False),
        Judged("c", KINDS[1]),
        Judged("d", KINDS[2], False, True, False, 0.99, False),
    ]
    found = metrics(rows)
    assert (found["strict_grasp_on_stem"], found["into_leaf"], found["root_ok"]) == (1.0, 0.5, 1.0)
    assert (found["tilt20"], found["tilt40"]) == (0.0, 0.0)
    assert (found["flagged_wrong"], found["false_flags"]) == (0.5, 0.5)
