"""Skeleton: always one rooted tree; on made plants the right one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from alike import check_kept
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from made_plants import one_sided_trunk, segment_distance, simple_plant, tube

from anther.core.errors import InputError, StageFailure
from anther.perception.cloud import Cloud
from anther.perception.masks import FLOWER, PLANT
from anther.perception.skeleton import Params, Skeleton, skeletonize
from anther.perception.stem import find_stem
from anther.pollination.grasp import plan_grasps

METHODS: list[Literal["geodesic", "thinning"]] = ["geodesic", "thinning"]


def assert_one_tree(skeleton: Skeleton) -> None:
    parent = np.asarray(skeleton.parent)
    assert parent[0] == -1
    assert np.all((parent[1:] >= 0) & (parent[1:] < np.arange(1, len(parent))))
    assert all(skeleton.path_from_root(node)[0] == 0 for node in range(len(parent)))


@pytest.fixture(scope="module")
def plant() -> Skeleton:
    return skeletonize(Cloud(simple_plant()))


def test_root_is_the_base_of_the_stem(plant: Skeleton) -> None:
    assert np.linalg.norm(plant.nodes[0]) < 0.006


def test_stem_is_centred_below_a_millimetre_and_has_its_radius(plant: Skeleton) -> None:
    on_stem = (np.linalg.norm(plant.nodes[:, :2], axis=1) < 0.008) & (plant.nodes[:, 2] < 0.49)
    assert on_stem.sum() > 50
    aside = segment_distance(plant.nodes[on_stem], np.zeros(3), np.array([0, 0, 0.5]))
    true_radius = 0.005 - 0.002 * plant.nodes[on_stem, 2] / 0.5
    assert np.median(aside) < 0.0005
    assert np.median(np.abs(plant.radius[on_stem] / true_radius - 1)) < 0.1


def test_every_leaf_is_a_branch_and_nothing_else_is(plant: Skeleton) -> None:
    tips = np.flatnonzero(plant.children_count == 0)
    assert len(tips) == 5


def test_blades_do_not_become_thick_branches(plant: Skeleton) -> None:
    assert plant.radius.max() < 0.007
    assert plant.width is not None
    assert plant.width.max() > 0.01


def test_nodes_are_evenly_spaced() -> None:
    skeleton = skeletonize(Cloud(simple_plant()), Params(spacing=0.008))
    length = np.linalg.norm(skeleton.nodes[1:] - skeleton.nodes[skeleton.parent[1:]], axis=1)
    assert abs(np.median(length) - 0.008) < 0.0015


def test_a_drooping_leaf_below_the_base_is_not_the_root() -> None:
    rng = np.random.default_rng(1)
    bend = [[0, 0, 0.3], [0.1, 0, 0.32], [0.16, 0, 0.1], [0.17, 0, -0.06]]
    leaf = [tube(a, b, (0.0015, 0.0015), 0.001, rng) for a, b in zip(bend, bend[1:], strict=False)]
    skeleton = skeletonize(Cloud(np.concatenate([simple_plant(), *leaf])))
    assert np.linalg.norm(skeleton.nodes[0]) < 0.01


def test_how_sure_the_root_is_comes_from_its_rivals(plant: Skeleton, tmp_path: Path) -> None:
    """A shoot on a level bar between two like stems may stand on either; a plant with one stem on one place alone."""
    assert plant.root_confidence == pytest.approx(1.0, abs=0.02)
    rng = np.random.default_rng(1)
    foot = tube([0, 0, 0], [0, 0, 0.3], (0.005, 0.004), 0.0012, rng)
    half = np.concatenate([foot, tube([0, 0, 0.3], [0.15, 0, 0.3], (0.004, 0.004), 0.0012, rng)])
    shoot = tube([0.15, 0, 0.3], [0.15, 0, 0.4], (0.004, 0.004), 0.0012, rng)
    table = Cloud(np.concatenate([half, [0.3, 0, 0] + half * [-1, 1, 1], shoot]))
    either = skeletonize(table)
    assert either.root_confidence == pytest.approx(0.5, abs=0.2)
    other = 0.3 - either.nodes[0, 0]
    (note,) = [note for note in either.notes if note.startswith("root:")]
    assert float(note.split("candidate is ")[1].split(",")[0]) == pytest.approx(other, abs=0.01)
    either.save(tmp_path / "skeleton.npz")
    assert Skeleton.load(tmp_path / "skeleton.npz").root_confidence == either.root_confidence
    known = skeletonize(table, Params(root=(0.3, 0.0, 0.0)))
    assert known.root_confidence == 1.0
    assert known.nodes[0, 0] == pytest.approx(0.3, abs=0.01)


def test_the_stem_is_as_sure_as_its_root(plant: Skeleton) -> None:
    sure, doubted = (find_stem(replace(plant, root_confidence=p)).confidence for p in (1.0, 0.4))
    assert sure is not None
    assert doubted == pytest.approx(0.4 * sure)


def test_gaps_are_bridged_and_reported() -> None:
    points = simple_plant()
    hole = (points[:, 2] > 0.10) & (points[:, 2] < 0.13)
    skeleton = skeletonize(Cloud(points[~hole]))
    assert_one_tree(skeleton)
    assert skeleton.nodes[:, 2].max() > 0.45
    assert any("bridged" in note for note in skeleton.notes)


@pytest.mark.parametrize("angle", [0.7, 2.0])
def test_turning_about_z_and_moving_changes_little(plant: Skeleton, angle: float) -> None:
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    moved = skeletonize(Cloud(simple_plant() @ turn.T + [0.3, -0.2, 0.1]))
    back = (moved.nodes - [0.3, -0.2, 0.1]) @ turn
    nearest = np.linalg.norm(back[:, None] - plant.nodes, axis=2).min(axis=1)
    assert np.median(nearest) < 0.004
    assert np.linalg.norm(back[0] - plant.nodes[0]) < 0.006


@pytest.mark.parametrize("scale", [0.1, 5.0])
def test_one_parameter_set_for_seedlings_and_trees(scale: float) -> None:
    skeleton = skeletonize(Cloud(simple_plant() * scale))
    assert np.count_nonzero(skeleton.children_count == 0) == 5
    assert np.linalg.norm(skeleton.nodes[0]) < 0.008 * scale


def test_flower_points_are_left_out() -> None:
    points = simple_plant()
    ball = np.random.default_rng(0).normal([0.02, 0, 0.55], 0.006, (500, 3))
    labels = np.r_[np.full(len(points), PLANT), np.full(500, FLOWER)].astype(np.uint8)
    skeleton = skeletonize(Cloud(np.concatenate([points, ball]), labels=labels))
    assert np.linalg.norm(skeleton.nodes - [0.02, 0, 0.55], axis=1).min() > 0.03


@settings(max_examples=25)
@given(
    arrays(np.float64, st.tuples(st.integers(60, 400), st.just(3)), elements=st.floats(-0.4, 0.4)),
    st.sampled_from(METHODS),
)
def test_any_cloud_gives_one_tree_or_a_clear_error(points: np.ndarray, method: Literal["geodesic", "thinning"]) -> None:
    try:
        skeleton = skeletonize(Cloud(points), Params(method=method))
    except (InputError, StageFailure):
        return  # refused in words, not by a crash
    assert_one_tree(skeleton)


@pytest.mark.parametrize("method", METHODS)
def test_points_on_a_line_that_lies_and_a_point_far_away_crash_nothing(
    method: Literal["geodesic", "thinning"],
) -> None:
    """Heights that have no spread bound no voxel, and no grid holds a place a thousand kilometres away."""
    flat = np.zeros((100, 3))
    flat[[0, 9, 27], 0] = 0.25, -0.1875, 0.09375
    with pytest.raises((InputError, StageFailure)):
        skeletonize(Cloud(flat), Params(method=method))
    assert_one_tree(skeletonize(Cloud(np.r_[simple_plant(), [[1e6, 0, 0.3]]]), Params(method=method)))


@pytest.mark.parametrize("method", METHODS)
def test_a_vine_that_hangs_from_both_ends_is_one_tree(method: Literal["geodesic", "thinning"]) -> None:
    """Its lowest place is no tip."""
    s = np.linspace(-1, 1, 4000)
    around = np.random.default_rng(0).normal(size=(len(s), 3))
    line = np.stack([0.2 * s, 0 * s, 0.3 * s**2], axis=1)
    skeleton = skeletonize(
        Cloud(line + 0.004 * around / np.linalg.norm(around, axis=1)[:, None]), Params(method=method)
    )
    assert_one_tree(skeleton)
    assert np.ptp(skeleton.nodes[:, 0]) > 0.3


@pytest.mark.parametrize(("points", "message"), [(np.zeros((2, 3)), "50 or more"), (np.ones((100, 3)), "units")])
def test_hopeless_clouds_are_refused(points: np.ndarray, message: str) -> None:
    with pytest.raises((InputError, StageFailure), match=message):
        skeletonize(Cloud(points))


def test_save_and_load(plant: Skeleton, tmp_path) -> None:
    check_kept(plant, tmp_path / "skeleton.npz")


def test_a_skeleton_without_width_can_be_kept(tmp_path) -> None:
    Skeleton(np.array([[0, 0, 0], [0, 0, 1.0]]), np.array([-1, 0]), np.array([0.1, 0.1])).save(tmp_path / "s.npz")
    assert Skeleton.load(tmp_path / "s.npz").width is None


@pytest.mark.parametrize("seen", [360, 180, 140], ids=lambda degrees: f"{degrees} degrees seen")
def test_a_hollow_or_one_sided_trunk_has_its_true_radius(seen: int) -> None:
    """A trunk of 120 mm as a scanner sees it: a tube without an inside, or only the side that faces it."""
    trunk = Cloud(one_sided_trunk(seen))
    tree = skeletonize(trunk)
    stem = find_stem(tree)
    low = stem.node_ids[(tree.nodes[stem.node_ids, 2] > 0.2) & (tree.nodes[stem.node_ids, 2] < 0.8)]
    assert np.median(tree.radius[low]) == pytest.approx(0.06, rel=0.15)
    assert np.median(np.linalg.norm(tree.nodes[low, :2], axis=1)) < 0.015
    with pytest.raises(StageFailure, match="thicker than the stroke"):
        plan_grasps(stem, tree, trunk)
