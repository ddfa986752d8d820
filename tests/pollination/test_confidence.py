"""The confidences of skeleton, stem and grasp: what raises and lowers them, and that they survive files.

That they are calibrated is measured by evaluation/perception/confidence.py (docs/reports/confidence.md).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from anther.core.errors import InputError, StageFailure
from anther.perception.cloud import Cloud
from anther.perception.skeleton import Skeleton
from anther.perception.skeleton.support import node_confidence, probability
from anther.perception.stem import Params, Stem, find_stem
from anther.perception.stem.confidence import DOUBTFUL, doubt, find_second_stem, plant_evidence, stem_confidence
from anther.pollination.grasp import Grasp, load_grasps, plan_grasps, save_grasps
from anther.pollination.grasp._candidates import place_confidence

RNG = np.random.default_rng(0)


def tube(length: float, radius: float) -> np.ndarray:
    """Points on an upright tube from the origin."""
    angle, z = RNG.uniform(0, 2 * np.pi, 4000), RNG.uniform(0, length, 4000)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1) + RNG.normal(0, 2e-4, (4000, 3))


def line_confidence(points: np.ndarray, radius: float, flatness: float) -> np.ndarray:
    """Confidence of the nodes of a straight upright line of 0.3 m."""
    nodes = np.stack([np.zeros(51), np.zeros(51), np.linspace(0, 0.3, 51)], axis=1)
    parent = np.arange(-1, 50)
    return node_confidence(nodes, parent, np.full(51, radius), np.full(51, flatness), points)


def fork(thickness: float) -> tuple[Skeleton, np.ndarray]:
    """An upright stem of 0.4 m that a side path of so many times its thickness leaves at half height; the stem's nodes.

    The stem's own radius is 5 mm; both paths rise equally.
    """
    z = np.linspace(0, 0.4, 41)
    stem = np.stack([0 * z, 0 * z, z], axis=1)
    side = np.stack([0.3 * (z[21:] - 0.2), 0 * z[21:], z[21:]], axis=1)
    parent = np.concatenate([np.arange(-1, 40), [20], np.arange(41, 60)])
    radius = np.concatenate([np.full(41, 0.005), np.full(20, 0.005 * thickness)])
    nodes = np.concatenate([stem, side])
    return Skeleton(nodes, parent, radius, width=radius, confidence=np.full(61, 0.95)), np.arange(41)


def test_a_tube_is_believed_and_neither_a_gap_nor_a_blade_nor_a_smear() -> None:
    points = tube(0.3, 0.005)
    whole = line_confidence(points, 0.005, 0.1)
    gap = line_confidence(points[np.abs(points[:, 2] - 0.15) > 0.04], 0.005, 0.1)
    blade = line_confidence(points * [0.3, 6, 1], 0.0015, 0.8)
    smear = line_confidence(points * RNG.uniform(0.1, 2, (len(points), 1)) ** [1, 1, 0], 0.005, 0.1)
    assert np.median(whole) > 0.8
    assert gap[25] < 0.3 < gap[5]
    assert np.median(blade) < 0.3
    assert 1 - np.median(smear) > 3 * (1 - np.median(whole))


def test_a_place_above_a_fork_is_doubted() -> None:
    skeleton, _ = fork(1.0)
    stem = find_stem(skeleton)
    places = place_confidence(stem, skeleton, np.array([0.1, 0.35]))
    assert places is not None
    assert places[0] > 0.9
    assert places[1] < 0.4


@pytest.mark.parametrize(
    ("turn", "thickness", "believed"),
    [(0, 0.8, True), (15, 0.8, True), (0, 0.6, True), (60, 1.0, False), (35, 0.55, False), (10, 0.3, False)],
)
def test_a_place_where_the_line_turns_from_the_way_up_or_thins_is_doubted(
    turn: float, thickness: float, *, believed: bool
) -> None:
    """It has gone on into a limb above a fork that was not seen, or into a leaf; below, it is believed all the same."""
    z = np.linspace(0, 0.25, 26)
    up = np.stack([0 * z, 0 * z, z], axis=1)
    angle, steps = np.radians(turn), np.linspace(0.01, 0.2, 20)[:, None]
    nodes = np.concatenate([up, up[-1] + steps * [np.sin(angle), 0, np.cos(angle)]])
    radius = np.concatenate([np.full(26, 0.005), np.full(20, 0.005 * thickness)])
    line = Skeleton(nodes, np.arange(-1, 45), radius, width=radius, confidence=np.full(46, 0.95))
    stem = Stem(np.arange(46), np.linspace(0, 0.45, 46), np.zeros(0, np.int64), np.zeros(46, np.uint8))
    places = place_confidence(stem, line, np.array([0.15, 0.3]))
    assert places is not None
    assert places[0] > 0.9
    assert (places[1] >= DOUBTFUL) == believed


def test_a_stem_is_doubted_for_its_root_its_flat_sections_and_the_little_it_carries() -> None:
    skeleton, path = fork(0.3)
    sure = plant_evidence(skeleton, path)
    assert plant_evidence(replace(skeleton, root_confidence=0.6), path)[0] < sure[0]
    assert plant_evidence(skeleton, path[:5])[1] < sure[1]
    assert plant_evidence(replace(skeleton, width=3 * skeleton.radius), path)[2] < sure[2]


def test_a_main_stem_of_a_few_per_cent_of_the_plant_is_warned_of_and_not_grasped() -> None:
    skeleton, _ = fork(0.3)
    short = find_stem(skeleton, Params(tip=(0.0, 0.0, 0.03)))
    assert "it rises only 30 mm of the plant's 400 mm" in short.notes[0]
    places = place_confidence(short, skeleton, np.array([0.01, 0.02]))
    assert places is not None
    assert places.max() < 0.5
    with pytest.raises(StageFailure, match=r"probably not the main stem.*Take more views"):
        plan_grasps(short, skeleton, Cloud(skeleton.nodes))


def test_without_support_nothing_is_said_and_with_little_a_warning() -> None:
    skeleton, path = fork(0.3)
    unknown = replace(skeleton, confidence=None)
    assert stem_confidence(unknown, path) is None
    assert find_stem(unknown).notes == ()
    poor, good = (stem_confidence(replace(skeleton, confidence=np.full(61, c)), path) for c in (0.05, 0.95))
    assert poor is not None
    assert good is not None
    assert poor < good
    assert doubt(DOUBTFUL) == ()
    assert f"below {DOUBTFUL:g}" in doubt(DOUBTFUL - 0.01)[0]


def test_a_tree_that_comes_down_to_the_soil_twice_is_two_plants() -> None:
    skeleton, path = fork(1.0)
    assert find_second_stem(skeleton, path) == ()
    down = np.stack([np.full(40, 0.2), np.zeros(40), np.linspace(0.39, 0, 40)], axis=1)
    twice = Skeleton(
        np.concatenate([skeleton.nodes, down]),
        np.concatenate([skeleton.parent, [60], np.arange(61, 100)]),
        np.full(101, 0.005),
        width=np.full(101, 0.005),
        confidence=np.full(101, 0.95),
    )
    assert "x, y = 0.20, 0.00 m: two plants" in find_second_stem(twice, path)[0]
    tapers = replace(twice, radius=np.append(np.full(61, 0.005), np.linspace(0.02, 0.004, 40)))
    assert find_second_stem(tapers, path) == (), "a leaf hangs down"
    thin = replace(twice, radius=np.append(np.full(61, 0.005), np.full(40, 0.0025)))
    assert find_second_stem(thin, path) == (), "so does a thin one"


def test_confidences_of_grasps_survive_files(tmp_path: Path) -> None:
    grasp = Grasp(np.eye(4), np.zeros(3), np.eye(3)[2], np.eye(3)[0], 0.1, 0.01, 0.0, 0.0, "here", confidence=0.7)
    save_grasps(tmp_path / "grasps.json", [grasp, replace(grasp, confidence=None)])
    assert [g.confidence for g in load_grasps(tmp_path / "grasps.json")] == [0.7, None]


@pytest.mark.parametrize("wrong", [1.2, -0.1, np.nan])
def test_a_confidence_is_a_probability(wrong: float) -> None:
    skeleton, _ = fork(0.5)
    with pytest.raises(InputError, match="confidence"):
        replace(skeleton, confidence=np.full(61, wrong))
    assert probability((0.0, 1.0), np.array([[0.0]]))[0] == 0.5
