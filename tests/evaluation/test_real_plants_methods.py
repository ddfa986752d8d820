"""What real_plants.py judges with: the paper's stem rule, plain thinning, and the comparison with labels."""

from __future__ import annotations

import numpy as np
import pytest

from anther.core.geometry import Array
from anther.perception.cloud import Cloud
from evaluation.perception.real.answers import Answer, NoAnswer, asked
from evaluation.perception.real.judge import Tolerance, ends, judge, reached, sampled, spurious_tips
from evaluation.perception.real.paper_rule import core_stem
from evaluation.perception.real.plain_thinning import CLOSED, FINE, plain_thinning
from evaluation.perception.real.plants import Labelled, Reference, plant_size

RADIUS = 0.004
STEM = np.array([[0, 0, z] for z in np.linspace(0, 0.3, 31)])
LEAF = np.array([[x, 0, 0.2 + 0.1 * x] for x in np.linspace(0.01, 0.2, 20)])


def chain(first: int, count: int) -> list[tuple[int, int]]:
    return [(k, k + 1) for k in range(first, first + count - 1)]


def small_tree() -> tuple[Array, np.ndarray, Array]:
    """A vertical stem of 30 cm with a nearly level leaf at 20 cm."""
    nodes = np.concatenate([STEM, LEAF])
    edges = np.array([*chain(0, len(STEM)), (20, len(STEM)), *chain(len(STEM), len(LEAF))])
    radius = np.where(np.arange(len(nodes)) < len(STEM), RADIUS, RADIUS / 3)
    return nodes, edges, radius


def labelled(rng: np.random.Generator) -> Labelled:
    """The same plant as a cloud of labelled points within its organs' radii."""
    nodes, edges, _ = small_tree()
    points = sampled(nodes, edges, 1e-4)
    is_stem = points[:, 0] == 0
    points = points + rng.uniform(-1, 1, points.shape) * np.where(is_stem, RADIUS, RADIUS / 3)[:, None]
    return Labelled("small", Cloud(points), is_stem, 1)


def test_core_stem_is_the_upright_path_and_the_grasp_its_longest_part() -> None:
    nodes, edges, radius = small_tree()
    stem, grasp = core_stem(nodes, edges, radius)
    assert set(stem.ravel()) == set(range(len(STEM)))
    assert grasp == pytest.approx([0, 0, 0.1])


def test_core_stem_ends_where_the_path_leaves_the_vertical() -> None:
    limb = np.array([[0.01 * k, 0, 0.2] for k in range(1, 20)])
    nodes = np.concatenate([STEM[:21], limb, [[0, 0.01, 0.2]]])
    edges = np.array([*chain(0, 40), (20, 40)])
    stem, grasp = core_stem(nodes, edges, np.full(len(nodes), RADIUS))
    assert set(stem.ravel()) == set(range(21))
    assert grasp == pytest.approx([0, 0, 0.1])


def test_core_stem_of_a_forest_is_in_its_largest_tree() -> None:
    nodes, edges, radius = small_tree()
    more = np.concatenate([nodes, [[1, 1, -1], [1, 1, 2]]])
    both = np.concatenate([edges, [[len(nodes), len(nodes) + 1]]])
    assert core_stem(more, both, np.append(radius, [1, 1]))[0].max() < len(STEM)


def test_a_lying_skeleton_has_no_core_stem() -> None:
    nodes, edges, radius = small_tree()
    with pytest.raises(NoAnswer, match="no stem"):
        core_stem(nodes[:, [2, 1, 0]], edges[:30], radius)


def test_plain_thinning_finds_a_plain_plant_and_is_judged_so() -> None:
    plant = labelled(np.random.default_rng(0))
    answer = asked(plain_thinning, plant.cloud)
    assert isinstance(answer, Answer)
    outcome = judge(plant, answer, Tolerance(STEM, np.full(len(STEM), RADIUS)))
    assert outcome.grasp_on_stem
    assert outcome.is_tree
    assert outcome.stem_share > 0.9
    assert outcome.stem_reach > 0.8


def test_a_stem_drawn_through_the_leaf_is_judged_off_the_stem() -> None:
    plant = labelled(np.random.default_rng(0))
    nodes, edges, _ = small_tree()
    leaf = edges[len(STEM) :]
    outcome = judge(plant, Answer(nodes, edges, leaf, nodes[-1], 0.0), Tolerance(STEM, np.full(len(STEM), RADIUS)))
    assert not outcome.grasp_on_stem
    assert outcome.stem_share < 0.1
    assert outcome.is_tree
    assert outcome.tips_per_leaf == 2


def test_what_a_dropped_leaf_costs() -> None:
    plant = labelled(np.random.default_rng(0))
    nodes, edges, _ = small_tree()
    whole, stem = Answer(nodes, edges, edges, nodes[0], 0.0), Answer(nodes, edges[:30], edges[:30], nodes[0], 0.0)
    assert reached(plant.cloud, whole) == 1
    assert 0.6 < reached(plant.cloud, stem) < 0.8
    assert reached(plant.cloud, "died") == 0


def test_spurious_tips_are_those_no_published_end_claims() -> None:
    """A spur of 4 voxels does not count, one of 8 does, and a blade's line may end beyond the published one."""
    nodes, edges, _ = small_tree()
    cloud = labelled(np.random.default_rng(0)).cloud
    voxel = plant_size(cloud.points) / 200
    published = Reference("small", cloud, nodes[:-3], edges[:-3])
    assert len(ends(nodes, edges, 0.0)) == 3
    assert spurious_tips(published, Answer(nodes, edges, edges, nodes[0], 0.0)) == 0
    for length, spurious in [(4, 0), (8, 1)]:
        spur = np.concatenate([nodes, [STEM[5] + [0, length * voxel / 2, 0], STEM[5] + [0, length * voxel, 0]]])
        with_spur = np.concatenate([edges, [[5, len(nodes)], [len(nodes), len(nodes) + 1]]])
        assert spurious_tips(published, Answer(spur, with_spur, edges, nodes[0], 0.0)) == spurious


def test_thinning_of_a_sparse_tube_makes_fewer_ends_when_closed() -> None:
    rng = np.random.default_rng(0)
    angle, z = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(0, 0.3, 4000)
    cloud = Cloud(np.stack([0.01 * np.cos(angle), 0.01 * np.sin(angle), z], axis=1))
    cage, line = plain_thinning(cloud, FINE), plain_thinning(cloud, FINE, closed=CLOSED)
    assert line.tips < cage.tips / 4


def test_no_answer_counts_as_missed() -> None:
    outcome = judge(labelled(np.random.default_rng(0)), "died", Tolerance(STEM, np.ones(len(STEM))))
    assert outcome.failure == "died"
    assert (outcome.grasp_on_stem, outcome.stem_share, outcome.is_tree) == (False, 0.0, False)


def test_pieces_and_cycles_are_no_tree() -> None:
    nodes, edges, _ = small_tree()
    assert Answer(nodes, edges[:-1], edges, nodes[0], 0.0).pieces == 2
    assert not Answer(nodes, np.concatenate([edges, [[0, 5]]]), edges, nodes[0], 0.0).is_tree


def test_samples_stand_for_equal_lengths() -> None:
    nodes = np.array([[0, 0, 0], [0, 0, 1.0], [0, 0, 4.0]])
    points = sampled(nodes, np.array([[0, 1], [1, 2]]), 0.1)
    assert np.diff(points[:, 2]) == pytest.approx(0.1)
    assert points[:, 2].mean() == pytest.approx(2)
