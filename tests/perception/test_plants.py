"""Several plants in view: each point has one, the asked one is taken whole, what cannot be meant is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
from made_plants import simple_plant, tube

from anther.core.errors import InputError
from anther.core.geometry import Array
from anther.perception.cloud import Cloud
from anther.perception.skeleton import Params, Skeleton, find_plants, skeletonize
from anther.perception.skeleton.plants import _Asked, _middle_one, _Others
from anther.perception.stem import find_stem

FEET = np.array([[-0.2, 0.0, 0.0], [0.0, 0.02, 0.0], [0.17, -0.03, 0.0]])
"""Where three plants stand whose leaves reach 0.17 m: they touch and cross."""


def row(feet: Array = FEET, heights: tuple[float, ...] = (0.5, 0.42, 0.55)) -> tuple[Array, Array]:
    """Return the points (N, 3) of plants that stand at feet (K, 3), turned, and the plant (N,) of each."""
    parts = []
    for k, (foot, height) in enumerate(zip(feet, heights, strict=False)):
        c, s = np.cos(0.9 * k), np.sin(0.9 * k)
        parts.append(simple_plant(k, height=height)[::2] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + foot)
    return np.concatenate(parts), np.repeat(np.arange(len(parts)), [len(part) for part in parts])


@pytest.fixture(scope="module")
def scene() -> tuple[Array, Array]:
    return row()


def stem_foot_and_line(skeleton: Skeleton) -> tuple[Array, Array]:
    stem = find_stem(skeleton)
    return skeleton.nodes[0], skeleton.nodes[stem.node_ids]


def test_every_stem_is_found_and_every_organ_goes_to_its_own(scene: tuple[Array, Array]) -> None:
    points, truth = scene
    plants = find_plants(points)
    assert np.linalg.norm(plants.roots - FEET, axis=1).max() < 0.02  # in order, along x
    assert np.mean(plants.owner == truth) > 0.95


def test_the_way_up_every_stem_is_told_and_is_in_the_way_of_who_takes_another(scene: tuple[Array, Array]) -> None:
    points, _ = scene
    ways = find_plants(points).stems
    for way, foot, height in zip(ways, FEET, (0.5, 0.42, 0.55), strict=True):
        assert np.mean(np.linalg.norm((way - foot)[:, :2], axis=1) < 0.02) > 0.8  # the top of one is a leaf's
        assert np.ptp(way[:, 2]) > 0.9 * height
    skeleton = skeletonize(Cloud(points), Params(plant=1))
    assert np.allclose(skeleton.neighbours, np.concatenate([ways[0], ways[2]]))
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.2, 0.3
    assert np.allclose(skeleton.moved(T).neighbours - skeleton.neighbours, T[:3, 3])


def test_stems_that_cross_go_straight_on() -> None:
    rng = np.random.default_rng(0)
    ends = [((-0.08, 0.0, 0.0), (0.12, 0.0, 0.5)), ((0.12, 0.008, 0.0), (-0.12, 0.008, 0.5))]  # they touch at 0.23 m
    parts = [tube(foot, top, (0.005, 0.004), 0.0015, rng) for foot, top in ends]
    points, truth = np.concatenate(parts), np.repeat([0, 1], [len(part) for part in parts])
    plants = find_plants(points)
    assert len(plants) == 2
    apart = np.abs(points[:, 2] - 0.23) > 0.05  # where they touch either will do
    assert np.mean(plants.owner[apart] == truth[apart]) > 0.9


@pytest.mark.parametrize("bearing", [0.2, 0.4, 0.6])
def test_a_limb_that_crosses_another_plants_goes_straight_on_at_any_bearing(bearing: float) -> None:
    rng = np.random.default_rng(0)
    way = np.array([np.cos(bearing), np.sin(bearing), 0.2])
    aside = np.array([-np.sin(bearing), np.cos(bearing), 0.0])
    joint, up = np.array([0.0, 0.0, 0.25]), np.array([0.0, 0.0, 0.5])
    crossed = joint + 0.2 * way  # 0.2 m along the limb, 0.05 m from the other stem
    foot = (crossed + 0.05 * aside) * [1, 1, 0]
    limb = tube(joint, joint + 0.35 * way, (0.003, 0.002), 0.0015, rng)
    stems = [tube(at, at + up, (0.005, 0.004), 0.0015, rng) for at in (np.zeros(3), foot)]
    other = tube(crossed + 0.05 * aside, crossed - 0.1 * aside, (0.003, 0.002), 0.0015, rng)
    plants = find_plants(np.concatenate([*stems, other, limb]))
    assert len(plants) == 2
    own = int(np.argmin(np.linalg.norm(plants.roots, axis=1)))
    assert np.mean(plants.owner[-len(limb) :] == own) > 0.9


def test_the_order_of_the_points_does_not_matter(scene: tuple[Array, Array]) -> None:
    points, _ = scene
    order = np.random.default_rng(5).permutation(len(points))
    one, other = find_plants(points), find_plants(points[order])
    assert np.array_equal(one.roots, other.roots)
    assert np.array_equal(one.owner[order], other.owner)


@pytest.mark.parametrize("asked", range(3))
@pytest.mark.parametrize("by", ["root", "number"])
def test_the_asked_stem_is_traced(scene: tuple[Array, Array], asked: int, by: str) -> None:
    x, y, z = FEET[asked].tolist()
    params = Params(root=(x + 0.01, y, z)) if by == "root" else Params(plant=asked)
    foot, line = stem_foot_and_line(skeletonize(Cloud(scene[0]), params))
    assert np.linalg.norm(foot - FEET[asked]) < 0.03
    assert np.linalg.norm(line[:, :2] - FEET[asked, :2], axis=1).max() < 0.04
    assert np.ptp(line[:, 2]) > 0.3


def test_unasked_the_one_in_the_middle_is_taken_and_the_others_are_named(scene: tuple[Array, Array]) -> None:
    tree = skeletonize(Cloud(scene[0]))
    assert np.linalg.norm(tree.nodes[0] - FEET[1]) < 0.03
    (note,) = [note for note in tree.notes if "stems in view" in note]
    assert "plant 1 is taken" in note
    at_the_right = skeletonize(Cloud(scene[0]), middle=(0.3, 0.0, 0.2))
    assert np.linalg.norm(at_the_right.nodes[0] - FEET[2]) < 0.03


def in_the_middle(away: float, chance: float, second: float = 0.3) -> _Asked:
    """The first of two plants, 0.1 m and `second` [m] from the middle, where one may stand `away` [m] from it."""
    roots = np.array([[0.1, 0, 0], [second, 0, 0]])
    others = _Others(np.array([[0.0, away, 0.0]]), np.array([chance]))
    return _middle_one(roots, np.array([0.98, 0.9]), np.array([2000, 1000]), others, np.zeros(3), 0.02)


def test_a_stem_that_may_stand_nearer_the_middle_makes_the_one_there_doubtful() -> None:
    unrivalled = in_the_middle(0.3, 0.4)
    assert unrivalled.number == 0
    assert unrivalled.certain == pytest.approx(0.98)
    assert unrivalled.second is None
    doubted = in_the_middle(0.02, 0.4)
    assert doubted.certain == pytest.approx(0.98 * 0.6)
    assert doubted.second is not None
    assert doubted.second.tolist() == [0.0, 0.02, 0.0]
    assert in_the_middle(0.115, 0.4).certain == doubted.certain, "about as near counts as well"
    assert in_the_middle(0.02, 0.05).second is None, "an unlikely one is not worth a word"


def test_of_two_about_as_near_the_middle_the_larger_is_meant_by_its_share() -> None:
    asked = in_the_middle(0.3, 0.4, second=0.09)
    assert asked.number == 0
    assert asked.certain == pytest.approx(0.98 * 2 / 3)
    assert asked.second is not None
    assert asked.second[0] == 0.09


@pytest.mark.parametrize("root", [None, (0.0, 0.0, 0.0)])
def test_one_plant_alone_is_looked_at_whole(root: tuple[float, float, float] | None) -> None:
    points = simple_plant()
    plants = find_plants(points, root)
    assert len(plants) == 1
    assert not plants.owner.any()
    assert plants.certain == 1
    assert not plants.notes


def test_a_smaller_plant_that_stands_apart_can_be_named() -> None:
    points, _ = row(np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]]), (0.5, 0.25))
    foot, line = stem_foot_and_line(skeletonize(Cloud(points), Params(root=(0.6, 0.0, 0.0))))
    assert np.linalg.norm(foot - [0.6, 0, 0]) < 0.03
    assert np.ptp(line[:, 2]) > 0.12


@pytest.mark.parametrize(
    ("params", "said"),
    [
        (Params(root=(0.085, -0.1, 0.0)), "between two stems"),
        (Params(root=(-0.2, -0.3, 0.0)), "m from the plant"),
        (Params(plant=3), "plant: got 3; 3 stems in view"),
    ],
)
def test_what_names_no_stem_is_refused_and_the_nearest_are_named(
    scene: tuple[Array, Array], params: Params, said: str
) -> None:
    with pytest.raises(InputError, match=re.escape(said)) as refused:
        skeletonize(Cloud(scene[0]), params)
    numbers = [float(n) for n in re.findall(r"-?\d+\.\d{3}", str(refused.value))]
    nearest = FEET[np.argmin(np.linalg.norm(FEET[:, :2] - (params.root or (0.0, 0.0))[:2], axis=1))]
    assert min(abs(n - nearest[0]) for n in numbers) < 0.02


@pytest.mark.parametrize("length", [0.02, 0.05])
def test_the_end_of_what_hangs_between_two_plants_can_be_named(scene: tuple[Array, Array], length: float) -> None:
    """It is no foot, and so short an end is none that is counted: who names it knows."""
    knee, rng = np.array([0.085, -0.005, 0.34]), np.random.default_rng(0)
    end = knee - [0, 0, length]
    hanging = [tube(a, b, (0.005, 0.005), 0.002, rng) for a, b in (([0.0, 0.02, 0.34], knee), (knee, end))]
    found = find_plants(np.concatenate([scene[0], *hanging]), end)
    assert np.linalg.norm(found.roots[found.asked] - end) < 0.015
