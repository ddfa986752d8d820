"""Blades distinguished from stems, paths that keep to stems, sections, and the stem down to the soil."""

from __future__ import annotations

import numpy as np
import pytest
from made_plants import blade, segment_distance, simple_plant, tube

from anther.perception.cloud import Cloud
from anther.perception.skeleton import Params, skeletonize
from anther.perception.skeleton._centreline import cross_sections
from anther.perception.skeleton._paths import (
    LevelSets,
    centre_on_blades,
    covering_paths,
    geodesic_tree,
    level_sets,
    shortest_paths,
)
from anther.perception.skeleton.raw_tree import RawTree, separate_branches
from anther.perception.skeleton.support import distance_to_soil
from anther.perception.skeleton.voxel_solid import Voxels, neighbour_edges, surroundings


def grid(*sizes: int) -> np.ndarray:
    return np.stack(np.meshgrid(*map(range, sizes), indexing="ij"), axis=-1).reshape(-1, 3)


def test_a_blade_is_flat_and_a_stem_is_not() -> None:
    index = np.concatenate([grid(40, 40, 2), grid(3, 3, 80) + np.array([100, 0, 0])])
    flat, off_middle = surroundings(index, 6.0)
    inside = (np.abs(index[:, :2] - 19.5).max(axis=1) < 12) & (index[:, 0] < 40)
    stem = (index[:, 0] >= 100) & (np.abs(index[:, 2] - 40) < 30)
    assert flat[inside].min() > 0.8
    assert flat[stem].max() < 0.2
    assert off_middle[inside].max() < 0.15
    rim = (index[:, 0] == 0) & (np.abs(index[:, 1] - 19.5) < 12)
    assert off_middle[rim].min() > 0.3


def test_paths_take_the_stem_and_not_the_shorter_way_across_a_blade() -> None:
    stem = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 2], [2, 0, 2]]
    leaf = [[1, 0, 1]]
    points = np.array(stem + leaf, dtype=float)
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [0, 5], [5, 4]])
    for cost_of_blade, via in [(1.0, 5), (9.0, 3)]:
        distance, before = shortest_paths(points, edges, np.array([1, 1, 1, 1, 1, cost_of_blade]), 0)
        assert before[4] == via
        assert before[0] == -1
        every = LevelSets(distance, np.arange(6))
        chosen = covering_paths(distance, before, every, 0.0)
        assert chosen[0] == 0
        assert sorted(chosen) == list(range(6))


def voxels_of(index: np.ndarray, flat: np.ndarray) -> tuple[Voxels, np.ndarray]:
    """Voxels of edge 1, neighbours joined, and their indices."""
    order, ones = np.lexsort(index.T[::-1]), np.ones(len(index))
    index = index[order]
    edges = neighbour_edges(index)
    return Voxels(index.astype(float), edges, 1.0, ones, flat[order].astype(float), 0 * ones), index


@pytest.mark.parametrize(("slit", "shortest", "lines"), [(0, 6.0, 1), (21, 6.0, 2), (21, 60.0, 1)])
def test_a_blade_has_one_line_and_each_long_lobe_another(slit: int, shortest: float, lines: int) -> None:
    """A blade of 41 x 61 voxels on a stem of 3 x 3 x 60, slit at its tip."""
    leaf = grid(41, 1, 61) + np.array([-19, 1, 60])
    index = np.concatenate([grid(3, 3, 60), leaf[(leaf[:, 0] != 1) | (leaf[:, 2] <= 120 - slit)]])
    voxels, index = voxels_of(index, index[:, 2] >= 60)
    source = int(np.flatnonzero((index == [1, 1, 0]).all(axis=1))[0])
    tree = geodesic_tree(voxels, source, level_sets(voxels, source), shortest)
    ends = tree.nodes[np.bincount(tree.parent[1:], minlength=len(tree.nodes)) == 0]
    assert len(ends) == lines
    assert ends[:, 2].min() >= 119
    assert np.count_nonzero(tree.nodes[:, 2] == 30) == 1


def test_a_line_on_a_blade_moves_to_its_middle_and_one_on_a_stem_stays() -> None:
    index = np.concatenate([grid(3, 3, 60), grid(31, 1, 61) + np.array([-14, 1, 60])])
    voxels, index = voxels_of(index, index[:, 2] >= 60)
    aside = np.array([[2, 1, z] for z in range(60)] + [[9 + z % 3, 1, z] for z in range(60, 121)], dtype=float)
    flat = np.where(aside[:, 2] < 60, 0.0, 1.0)
    tree = RawTree(aside, np.arange(-1, 120), np.ones(121), np.ones(121), flat)
    source = int(np.flatnonzero((index == [1, 1, 0]).all(axis=1))[0])
    moved = centre_on_blades(tree, np.ones(121), voxels, level_sets(voxels, source)).nodes
    np.testing.assert_allclose(moved[:60], aside[:60])
    assert np.abs(moved[80:110, 0] - 1).max() < 0.5
    assert np.abs(np.diff(moved[80:110, 0])).max() < 0.2


def test_a_broad_blade_has_one_smooth_midrib() -> None:
    """Seen with noise; 60 mm long, 40 mm wide, on a petiole of 30 mm."""
    rng = np.random.default_rng(3)
    foot, base, tip = np.array([0, 0, 0.2]), np.array([0.03, 0, 0.21]), np.array([0.09, 0, 0.22])
    stem = tube([0, 0, 0], [0, 0, 0.25], (0.004, 0.003), 0.001, rng)
    leaf = [tube(foot, base, (0.0015, 0.0015), 0.0007, rng), blade(base, tip, 0.02, 0.0007, rng)]
    points = np.concatenate([stem, *leaf])
    skeleton = skeletonize(Cloud(points + rng.normal(0, 0.0004, points.shape)))
    ends = skeleton.nodes[skeleton.children_count == 0]
    assert len(ends) == 2
    assert np.linalg.norm(ends - tip, axis=1).min() < 0.005
    assert np.linalg.norm(ends - [0, 0, 0.25], axis=1).min() < 0.005
    midrib = skeleton.nodes[skeleton.nodes[:, 0] > 0.032]
    assert segment_distance(midrib, base, tip).max() < 0.0025


def test_paths_side_by_side_in_one_stem_become_one() -> None:
    line = np.stack([np.zeros(20), np.zeros(20), np.arange(20.0)], axis=1)
    close = np.concatenate([line[1:11] + np.array([0.5, 0, 0]), [[1.5 + k, 0, 11 + k] for k in range(5)]])
    nodes = np.concatenate([line, close])
    parent = np.concatenate([[-1], np.arange(19), [0], np.arange(20, 34)])
    order = np.argsort(nodes[:, 2], kind="stable")
    rank = np.argsort(order)
    tree = RawTree(
        nodes[order], np.where(parent[order] >= 0, rank[parent[order]], -1), np.ones(35), np.ones(35), np.zeros(35)
    )
    apart = separate_branches(tree, np.where(tree.nodes[:, 0] == 0, 2.0, 1.0))
    assert len(apart.nodes) == 25
    fork = np.flatnonzero(np.bincount(apart.parent[1:], minlength=25) == 2)
    assert apart.nodes[fork].tolist() == [[0, 0, 10]]


def test_sections_find_the_circle_about_a_node_beside_the_axis() -> None:
    angle = np.linspace(0, 2 * np.pi, 200)
    points = np.stack([0.004 * np.cos(angle), 0.004 * np.sin(angle), np.linspace(-0.004, 0.004, 200)], axis=1)
    at = cross_sections(points, np.array([[0.001, 0, 0]]), np.array([[0, 0, 1.0]]), np.array([[-1, 0, -1]]))
    np.testing.assert_allclose(at.centre[0], [-0.001, 0, 0], atol=1e-5)
    assert at.circle[0] == pytest.approx(0.004, rel=1e-3)
    assert at.count[0] == 200


def test_radii_lose_what_a_depth_camera_adds() -> None:
    cloud, params = Cloud(simple_plant()), Params(fattening=0.0)
    thick, thin = skeletonize(cloud, params), skeletonize(Cloud(cloud.points, footprint=0.002))
    np.testing.assert_array_equal(thick.nodes, thin.nodes)
    on_stem = np.linalg.norm(thick.nodes[:, :2], axis=1) < 0.008
    assert np.median(thick.radius[on_stem] - thin.radius[on_stem]) == pytest.approx(0.001, abs=1e-4)


def test_the_stem_goes_on_to_the_soil_it_was_not_seen_in() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.1, 0.1, (2, 400))
    soil = np.stack([x, y, np.full(400, -0.02)], axis=1)
    skeleton = skeletonize(Cloud(simple_plant(), obstacles=soil))
    assert np.linalg.norm(skeleton.nodes[0] - [0, 0, -0.02]) < 0.004
    assert any("not seen" in note for note in skeleton.notes)
    far = skeletonize(Cloud(simple_plant(), obstacles=soil - [0, 0, 0.2]))
    assert far.nodes[0, 2] > -0.01
    assert not any("not seen" in note for note in far.notes)


@pytest.mark.parametrize(("upward", "length"), [([0, 0, 1], 0.02), ([0.6, 0, 0.8], 0.025), ([0.8, 0, 0.6], 0)])
def test_distance_to_the_soil_is_along_the_stem(upward: list[float], length: float) -> None:
    soil = np.stack([*np.random.default_rng(0).uniform(-0.05, 0.05, (2, 100)), np.zeros(100)], axis=1)
    assert distance_to_soil(np.array([0, 0, 0.02]), np.array(upward), soil) == pytest.approx(length)


def test_a_petiole_leaves_where_it_does() -> None:
    rng = np.random.default_rng(2)
    base, tip = np.array([0, 0, 0.25]), np.array([0.08, 0, 0.33])
    petiole = tube(base, tip, (0.0015, 0.0015), 0.001, rng)
    stem = tube([0, 0, 0], [0, 0, 0.5], (0.005, 0.004), 0.001, rng)
    skeleton = skeletonize(Cloud(np.concatenate([stem, petiole])))
    forks = skeleton.nodes[skeleton.children_count > 1]
    assert np.linalg.norm(forks - base, axis=1).min() < 0.006
    ends = skeleton.nodes[skeleton.children_count == 0]
    assert np.linalg.norm(ends - tip, axis=1).min() < 0.004
    limb = skeleton.nodes[skeleton.nodes[:, 0] > 0.01]
    assert segment_distance(limb, base, tip).max() < 0.002
