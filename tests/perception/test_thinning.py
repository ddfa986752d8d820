"""Thinning: nothing is lost, hollow things become lines, links favour the thick and vertical."""

from __future__ import annotations

import numpy as np
import pytest
from made_plants import simple_plant, tube

from anther.perception.cloud import Cloud
from anther.perception.skeleton import Params, skeletonize
from anther.perception.skeleton.thinning import knn_links, link_costs, medial_line, spanning_tree
from anther.perception.skeleton.voxel_solid import VoxelSolid, components, neighbour_edges, solidify
from evaluation.perception.real.paper_rule import core_stem


def bar(width: int, depth: int, length: int) -> np.ndarray:
    return np.stack(np.meshgrid(range(1, width + 1), range(1, depth + 1), range(1, length + 1)), -1).reshape(-1, 3)


def solid_of(index: np.ndarray) -> VoxelSolid:
    return VoxelSolid(index[np.lexsort(index.T[::-1])], np.zeros(3), 1.0, np.ones(len(index)))


@pytest.mark.parametrize("width", [2, 3, 4, 6, 8])
def test_straight_bars_of_any_width_survive(width: int) -> None:
    solid = solid_of(bar(width, width, 100))
    left = medial_line(solid.index, neighbour_edges(solid.index))
    z = solid.index[left][:, 2]
    assert left.any()
    assert np.ptp(z) > 99 - 2 * width
    assert left.sum() < 2.5 * 100


def test_every_component_survives() -> None:
    index = np.concatenate([bar(4, 4, 60), bar(2, 2, 40) + np.array([30, 0, 0]), bar(1, 1, 1) + np.array([0, 40, 0])])
    solid = solid_of(index)
    edges = neighbour_edges(solid.index)
    label = components(len(index), edges)
    left = medial_line(solid.index, edges)
    assert set(label[left]) == {0, 1, 2}


def test_a_hollow_tube_is_filled_and_becomes_a_line() -> None:
    points = tube([0, 0, 0], [0.02, 0.01, 0.2], (0.006, 0.006), 0.001, np.random.default_rng(0))
    solid = solidify(points, 0.0015, close=2, fill=0.015)
    inside = solid.thickness.max()
    assert 0.004 < inside < 0.0085
    edges = neighbour_edges(solid.index)
    line = solid.points[medial_line(solid.index, edges)]
    axis = np.array([0.02, 0.01, 0.2]) / np.linalg.norm([0.02, 0.01, 0.2])
    aside = np.linalg.norm(line - (line @ axis)[:, None] * axis, axis=1)
    assert np.median(aside) < 0.0015


def test_links_prefer_the_thick_and_the_vertical() -> None:
    nodes = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0.0]])
    links = np.array([[0, 1], [0, 2], [0, 3]])
    cost = link_costs(nodes, np.array([2.0, 2, 2, 1]), links)
    assert cost[0] < cost[1] < cost[2]


def test_spanning_tree_joins_all_neighbours() -> None:
    nodes = np.random.default_rng(0).uniform(0, 1, (60, 3))
    links = knn_links(nodes, 1.0)
    tree = spanning_tree(60, links, link_costs(nodes, np.ones(60), links))
    assert len(tree) == 59
    assert components(60, tree).max() == 0


def test_the_papers_method_finds_the_made_plant() -> None:
    skeleton = skeletonize(Cloud(simple_plant()), Params(method="thinning"))
    assert np.linalg.norm(skeleton.nodes[0]) < 0.012
    on_stem = np.linalg.norm(skeleton.nodes[:, :2], axis=1) < 0.008
    assert np.ptp(skeleton.nodes[on_stem, 2]) > 0.45
    assert np.all(skeleton.parent[1:] < np.arange(1, len(skeleton.parent)))


def test_the_papers_steps_in_order_end_in_the_stem() -> None:
    """P7 to P11 on an upright stem from which a thinner limb leaves level half way up."""
    limb = bar(120, 3, 3) + np.array([5, 1, 100])
    index = np.concatenate([bar(5, 5, 200), limb])
    radius = np.concatenate([np.full(5 * 5 * 200, 2.5), np.full(len(limb), 1.5)])
    solid, order = solid_of(index), np.lexsort(index.T[::-1])
    line = medial_line(solid.index, neighbour_edges(solid.index))  # P7
    nodes, radius = solid.points[line], radius[order][line]
    links = knn_links(nodes, 3.0)  # P8
    links = spanning_tree(len(nodes), links, link_costs(nodes, radius, links))  # P9
    assert len(links) == len(nodes) - 1
    core = nodes[np.unique(core_stem(nodes, links, radius)[0])]  # P10, P11
    assert np.abs(core[:, :2] - 3).max() <= 2
    assert core[:, 2].min() < 6
    assert core[:, 2].max() > 194
