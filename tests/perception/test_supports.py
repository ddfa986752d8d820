"""Supports on made cylinders beside a curved, tapering stem with branches: what is one, what is none."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from anther.perception.cloud import SUPPORT, Cloud, Support
from anther.perception.cloud.ply import read_ply
from anther.perception.hanging import StringLine
from anther.perception.skeleton import skeletonize
from anther.perception.stem import find_stem
from anther.perception.supports import Evidence, _orphans, _Rod, _Scene, find_supports, log_odds, notes_beside
from tests.support.made_plants import blade, segment_distance, tube

HEIGHT = 0.5


def curved_plant(bow: float = 0.02, seed: int = 0):
    """A stem of 12 to 6 mm that bows aside by `bow` [m] at half its height, with petioles and blades."""
    rng = np.random.default_rng(seed)
    heights = np.linspace(0, HEIGHT, 26)
    line = np.stack([bow * np.sin(np.pi * heights / HEIGHT), 0 * heights, heights], axis=1)
    radius = np.linspace(0.006, 0.003, 26)
    parts = [tube(line[k], line[k + 1], (radius[k], radius[k + 1]), 0.0015, rng) for k in range(25)]
    for k in range(5):
        base = line[6 + 4 * k]
        out = np.array([np.cos(2.4 * k), np.sin(2.4 * k), 0.6])
        parts.append(tube(base, base + 0.07 * out, (0.002, 0.0015), 0.0013, rng))
        parts.append(blade(base + 0.07 * out, base + 0.07 * out + 0.1 * out * [1, 1, 0.2], 0.03, 0.002, rng))
    return np.concatenate(parts)


def cylinder(start, end, radius: float, seed: int = 1, spacing: float = 0.0015):
    rng = np.random.default_rng(seed)
    points = tube(start, end, (radius, radius), spacing, rng)
    return points + rng.normal(0, 0.0003, points.shape)


def found_in(*rods, plant=None, colors=None):
    """The cloud of a plant and rods with its supports found, and how many of its points were plant."""
    plant = curved_plant() if plant is None else plant
    return find_supports(Cloud(np.concatenate([plant, *rods]), colors=colors)), len(plant)


RODS = {
    "string 20 mm beside the stem": ([-0.028, 0, 0], [-0.02, 0, 0.62], 0.0015, "string"),
    "string that touches the base": ([-0.0076, 0, 0], [-0.05, 0, 0.62], 0.0015, "string"),
    "stake": ([0.01, -0.04, 0], [0.01, -0.045, 0.45], 0.0045, "stake"),
    "pole": ([-0.135, -0.173, 0], [-0.135, -0.173, 0.6], 0.0255, "pole"),
    "wire over the plant": ([-0.3, 0.02, 0.53], [0.3, 0.02, 0.535], 0.0015, "wire"),
}


@pytest.mark.parametrize("case", RODS)
def test_support_is_set_apart_and_the_plant_stays(case):
    start, end, radius, kind = RODS[case]
    rod = cylinder(start, end, radius)
    cloud, plant = found_in(rod)
    assert [s.kind for s in cloud.supports] == [kind], cloud.notes
    (support,) = cloud.supports
    assert support.radius == pytest.approx(radius, abs=0.0012)
    off = segment_distance(rod, support.axis[0], support.axis[-1])
    assert np.quantile(off, 0.95) < radius + 0.002, "its axis is the rod's, over all of it"
    assert len(support.points) > 0.9 * len(rod)
    assert len(cloud.points) > 0.97 * plant, "the plant keeps its points"
    assert any(support.name in note for note in cloud.notes)


@pytest.mark.parametrize("bow", [0.003, 0.02, 0.05])
@pytest.mark.parametrize("seed", range(3))
def test_stem_is_no_support(bow, seed):
    """A stem is none, be it nearly straight: it tapers, and its leaves hang on it."""
    plant = curved_plant(bow, seed)
    cloud = find_supports(Cloud(plant))
    assert not cloud.supports
    assert len(cloud.points) == len(plant)


def test_stake_that_bends_is_followed():
    """It bends aside by 20 mm over half a metre, and its axis with it: no straight one is within 3 mm of its ends."""
    rng = np.random.default_rng(3)
    heights = np.linspace(0, 0.5, 26)
    line = np.stack([-0.05 + 0.02 * (heights / 0.5) ** 2, 0.02 + 0 * heights, heights], axis=1)
    rod = np.concatenate([tube(line[k], line[k + 1], (0.004, 0.004), 0.0015, rng) for k in range(25)])
    cloud, plant = found_in(rod)
    (support,) = cloud.supports
    off = np.min([segment_distance(line[1:-1], a, b) for a, b in itertools.pairwise(support.axis)], axis=0)
    assert off.max() < 0.002
    assert len(support.points) > 0.9 * len(rod)
    assert len(cloud.points) > 0.97 * plant


def test_a_bare_stem_that_stands_alone_is_taken_for_the_plant_and_a_note_says_what_it_looks_like():
    alone = Cloud(cylinder([0, 0, 0], [0, 0, 0.6], 0.005))
    found = find_supports(alone)
    assert found.supports == ()
    assert np.array_equal(found.points, alone.points)
    assert "looks like a stake of 10 mm" in found.notes[-1]


def test_a_straight_stem_on_its_string_is_no_stake_and_the_stake_beside_it_is_one():
    stem, stake = cylinder([0.2, 0, 0], [0.2, 0, 0.6], 0.005), cylinder([0.2, 0.08, 0], [0.2, 0.08, 0.6], 0.005)
    scene = Cloud(np.concatenate([curved_plant(), stem, stake]))
    assert len(find_supports(scene).supports) == 2
    found = find_supports(scene, StringLine((0.21, 0.01, 1.4)))
    (kept,) = found.supports
    assert kept.axis[0, 1] == pytest.approx(0.08, abs=0.003)
    assert len(found.points) > len(curved_plant()) + 0.95 * len(stem)


def test_two_supports_are_told_apart():
    cloud, _ = found_in(
        cylinder([-0.04, 0, 0], [-0.04, 0, 0.6], 0.0015), cylinder([0.05, 0.1, 0], [0.05, 0.1, 0.5], 0.005)
    )
    assert sorted(s.kind for s in cloud.supports) == ["stake", "string"]


def test_what_comes_loose_without_a_stem_does_not_depend_on_what_else_is_in_view():
    plant = curved_plant(bow=0.0)
    pipe = cylinder([0.5, 0, 0], [0.5, 0, 0.7], 0.0255)  # of more points than the plant
    stem = _Rod(np.zeros(3), np.eye(3)[2], np.eye(3)[:2], 0.01, np.zeros((51, 2)), 0.005, np.ones(50, dtype=bool))
    scenes = [_Scene.of(Cloud(points)) for points in (plant, np.concatenate([plant, pipe]))]
    cell = scenes[0].cell
    alone, beside = (_orphans(replace(scene, cell=cell), stem) for scene in scenes)
    assert alone == beside == 4  # of five leaves one counts as the plant that stays


def test_wound_string_stays_with_the_stem():
    turn = np.linspace(0, 8 * np.pi, 1500)
    height = np.linspace(0.02, 0.45, 1500)
    axis = 0.02 * np.sin(np.pi * height / HEIGHT)
    around = np.stack([axis + 0.0065 * np.cos(turn), 0.0065 * np.sin(turn), height], axis=1)
    cloud, _ = found_in(around)
    assert not cloud.supports


def test_string_is_never_the_main_stem():
    """A string from the stem's base to overhead: with it the tree's stem climbs the string, without it the stem."""
    rod = cylinder([-0.0076, 0, 0], [-0.05, 0, 0.62], 0.0015)
    cloud, _ = found_in(rod)
    tree = skeletonize(cloud)
    stem = find_stem(tree)
    line = tree.nodes[stem.node_ids]
    assert line[:, 2].max() > 0.4
    high = line[line[:, 2] > 0.1]
    assert segment_distance(high, [-0.0076, 0, 0], [-0.05, 0, 0.62]).min() > 0.01
    (note,) = notes_beside(cloud, tree, stem)
    assert cloud.supports[0].name in note
    assert "the main stem" in note


EVIDENCE = Evidence(
    length=0.4,
    bow=0.0005,
    noise=0.0005,
    taper=0.0,
    ripple=0.005,
    ripple_noise=0.005,
    slenderness=100.0,
    filled=0.8,
    alone=0.9,
    orphans=0,
    beyond=False,
)


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        ({}, {"bow": 0.004}),
        ({}, {"slenderness": 25.0}),
        ({}, {"filled": 0.3}),
        ({}, {"alone": 0.4}),
        ({}, {"taper": -0.5}),
        ({}, {"ripple": 0.05}),
        ({}, {"orphans": 2}),
        ({"beyond": True}, {}),
        ({"greenness": (0.0, 0.25, 0.1)}, {"greenness": (0.25, 0.25, 0.1)}),
    ],
)
def test_each_trait_of_a_stem_speaks_against_a_support(better, worse):
    assert log_odds(replace(EVIDENCE, **better)) > log_odds(replace(EVIDENCE, **worse)) + 0.5


def test_supports_are_kept_in_the_files(tmp_path):
    axis = [[0, 0, 0], [0, 0, 0.5]]
    support = Support("string", axis, 0.0015, cylinder(*axis, 0.0015))
    plant = curved_plant()
    cloud = Cloud(plant, colors=np.full(plant.shape, 90, np.uint8), supports=(support,))
    cloud.save(tmp_path / "cloud.ply")
    again = Cloud.load(tmp_path / "cloud.ply")
    np.testing.assert_allclose(again.points, plant)
    assert len(again.colors) == len(again.labels) == len(plant)
    np.testing.assert_allclose(again.supports[0].points, support.points)
    assert (again.supports[0].kind, again.supports[0].radius) == ("string", 0.0015)
    assert np.count_nonzero(read_ply(tmp_path / "cloud.ply")["labels"] == SUPPORT) == len(support.points)
    (tmp_path / "cloud.npz").unlink()
    alone = Cloud.load(tmp_path / "cloud.ply")
    np.testing.assert_allclose(alone.points, plant)
    np.testing.assert_allclose(alone.obstacles, support.points)
