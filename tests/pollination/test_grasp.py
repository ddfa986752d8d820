"""Grasp planning on synthetic stems whose best grasps are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import arc_length
from anther.perception.cloud import Cloud, Support
from anther.perception.masks import FLOWER, PLANT
from anther.perception.skeleton import Skeleton
from anther.perception.stem import BRANCH, STEM, TRUSS, Stem
from anther.pollination import grasp
from anther.pollination.grasp import (
    DOUBT,
    OBSTACLE_CLEARANCE,
    OFF_BY,
    STAND_OFF,
    SUPPORT_CLEARANCE,
    Grasp,
    Params,
    _costs,
    _rank,
    _refusals,
    load_grasps,
    plan_grasps,
    save_grasps,
)
from anther.pollination.grasp._candidates import candidates_along, directions_across, flange_pose
from anther.pollination.grasp._clearance import BRANCH as PETIOLE
from anther.pollination.grasp._clearance import (
    FAR,
    FLOWER_POINT,
    LEAF,
    OBSTACLE,
    Surroundings,
    _balls_along,
    clearance,
    surroundings_of,
    thin_out,
)
from anther.pollination.grasp._clearance import STEM as STEM_BALL
from anther.robot.arm.gripper_shape import GripperShape
from evaluation.trials.paper_grasp import branch_directions, paper_approach, paper_grasp

UPRIGHT = np.eye(3)


def make_plant(*, height=0.5, radius=0.004, branches=((0.2, 0.0), (0.35, 2.0)), rotation=UPRIGHT, base=(0.72, 0, -0.3)):
    """A straight stem along `rotation`'s z with 8 cm branches at (height, azimuth), and its surface as a cloud."""
    z = np.linspace(0, height, int(height / 0.01) + 1)
    nodes, parent, ids = [[0, 0, h] for h in z], [*range(-1, len(z) - 1)], list(range(len(z)))
    attachments = []
    for h, azimuth in branches:
        last = int(np.argmin(np.abs(z - h)))
        attachments.append(last)
        ray = np.array([np.cos(azimuth), np.sin(azimuth), 0.3]) / np.sqrt(1.09)
        for k in range(1, 9):
            nodes.append(list(np.array([0, 0, z[attachments[-1]]]) + 0.01 * k * ray))
            parent.append(last)
            last = len(nodes) - 1
    place = np.asarray(nodes) @ rotation.T + base
    skeleton = Skeleton(place, np.array(parent), np.full(len(place), radius))
    organ = np.full(len(place), BRANCH, dtype=np.uint8)
    organ[ids] = STEM
    stem = Stem(np.array(ids), z, np.array(sorted(attachments)), organ)
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = radius * np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    surface = (np.asarray(nodes)[:, None] + ring).reshape(-1, 3) @ rotation.T + base
    return stem, skeleton, Cloud(surface)


def add_points(cloud, points, *, label=PLANT, obstacles=()):
    return Cloud(
        np.concatenate([cloud.points, points]),
        labels=np.concatenate([np.full(len(cloud.points), PLANT), np.full(len(points), label)]),
        obstacles=np.reshape(obstacles, (-1, 3)),
    )


def test_frame_conventions():
    """The approach is the flange's +z, fingers close across the stem, and the stem lies between the pads."""
    tilt = Rotation.from_euler("xy", [0.3, -0.2]).as_matrix()
    grasps = plan_grasps(*make_plant(rotation=tilt))
    for g in grasps:
        x, y, z, p = g.T_world_flange[:3].T
        np.testing.assert_allclose(z, g.approach, atol=1e-12)
        np.testing.assert_allclose(g.tangent, tilt[:, 2], atol=1e-9)
        assert abs(y @ g.tangent) < 1e-9
        assert abs(x @ g.tangent) == pytest.approx(1)
        np.testing.assert_allclose(p + (GripperShape().depth + 0.006) * z, g.point, atol=1e-12)
        np.testing.assert_allclose(g.pregrasp(0.1)[:3, 3], p - 0.1 * z, atol=1e-12)


def test_points_lie_on_the_stem_at_their_arc_length():
    stem, skeleton, cloud = make_plant()
    for g in plan_grasps(stem, skeleton, cloud):
        np.testing.assert_allclose(g.point, skeleton.nodes[0] + [0, 0, g.arc_length], atol=1e-9)
        assert g.stem_diameter == pytest.approx(0.008)


def test_ranked_and_one_per_place():
    grasps = plan_grasps(*make_plant())
    scores = [g.score for g in grasps]
    assert scores == sorted(scores, reverse=True)
    arcs = np.sort([g.arc_length for g in grasps])
    assert len(arcs) > 20
    assert np.diff(arcs).min() > 0.012 - 1e-6, "the next grasp is another place"


def test_best_grasp_is_away_from_branches_and_leaf():
    stem, skeleton, cloud = make_plant()
    leaf = np.random.default_rng(0).uniform([0.66, -0.15, 0.12], [0.78, 0.15, 0.16], (3000, 3))
    best = plan_grasps(stem, skeleton, add_points(cloud, leaf))[0]
    assert np.abs(stem.arc_length[stem.attachments] - best.arc_length).min() > 0.03
    assert best.clearance > 0
    assert best.point[2] < 0.1


def test_a_wall_on_one_side_is_approached_from_the_other():
    stem, skeleton, cloud = make_plant(branches=())
    y, z = np.meshgrid(np.arange(-0.2, 0.2, 0.01), np.arange(-0.3, 0.3, 0.01))
    wall = np.stack([np.full(y.size, 0.78), y.ravel(), z.ravel()], axis=1)
    for g in plan_grasps(stem, skeleton, add_points(cloud, np.zeros((0, 3)), obstacles=wall)):
        assert g.approach[0] > 0.5
        assert g.clearance >= OBSTACLE_CLEARANCE


def test_a_leaf_wall_is_brushed_only_when_there_is_no_other_way():
    stem, skeleton, cloud = make_plant(branches=())
    rng = np.random.default_rng(1)
    leaf = np.stack([np.full(4000, 0.67), rng.uniform(-0.15, 0.15, 4000), rng.uniform(-0.3, 0.2, 4000)], axis=1)
    assert all(g.approach[0] < 0.5 for g in plan_grasps(stem, skeleton, add_points(cloud, leaf)))
    angle = rng.uniform(0, 2 * np.pi, 8000)
    cage = np.stack([0.72 + 0.05 * np.cos(angle), 0.05 * np.sin(angle), rng.uniform(-0.3, 0.2, 8000)], axis=1)
    best = plan_grasps(stem, skeleton, add_points(cloud, cage))[0]
    assert best.clearance < 0
    assert "brushes leaves" in best.reason


def test_pads_close_beside_no_petiole():
    """With a petiole every 2 cm, all to +x, pads that close along x would fold one; along y they pass beside it."""
    crowded = make_plant(branches=tuple((h, 0.0) for h in np.arange(0.06, 0.48, 0.02)))
    best = plan_grasps(*crowded)[0]
    assert abs(best.approach[0]) > 0.95
    assert "a branch between the fingers" not in best.reason


def test_pads_may_close_where_an_internode_is_longer_than_they_are():
    stem, skeleton, cloud = make_plant(branches=((0.1, 0.0), (0.14, 0.0), (0.18, 0.0), (0.3, 0.0), (0.34, 0.0)))
    best = plan_grasps(stem, skeleton, cloud)[0]
    assert 0.21 < best.arc_length < 0.3


def test_opens_half_where_it_is_narrow_and_wide_where_it_is_not():
    """Posts 47 mm to the left and right of the stem: wide open fingers reach out to 36 mm, and must keep 15 mm off."""
    stem, skeleton, cloud = make_plant(branches=())
    reach = lambda *_: np.ones(7)  # noqa: E731
    assert plan_grasps(stem, skeleton, cloud, reach=reach)[0].opening > 0.04
    z, azimuth = (x.ravel() for x in np.meshgrid(np.arange(-0.3, 0.2, 0.005), np.radians([70, 80, 90, 100])))
    posts = np.stack([0.72 + 0.047 * np.cos(azimuth), 0.047 * np.sin(azimuth), z], axis=1)
    narrow = add_points(cloud, np.zeros((0, 3)), obstacles=np.concatenate([posts, posts * [1, -1, 1]]))
    best = plan_grasps(stem, skeleton, narrow, reach=reach)[0]
    assert best.opening == pytest.approx(0.024, abs=1e-6)
    assert best.approach[0] > 0.9


def beside(plant, radius, *azimuths, gap=0.0, top=0.2):
    """A plant of `make_plant` with upright rods from its foot to a height [m], so far from the stem's surface."""
    stem, skeleton, cloud = plant
    off = float(skeleton.radius[0]) + gap + radius
    feet = [np.array([0.72 + off * np.cos(a), off * np.sin(a), -0.3]) for a in azimuths]
    kind = "string" if radius < 0.003 else "stake"
    axes = [np.linspace(foot, [*foot[:2], top], 50) for foot in feet]
    rods = [Support(kind, axis, radius, axis) for axis in axes]
    return stem, skeleton, replace(cloud, supports=tuple(rods))


def test_only_the_stem_is_between_the_pads_beside_a_pole():
    plant = make_plant(branches=())
    assert plan_grasps(*plant)[0].point[2] < 0, "without the pole"
    for g in plan_grasps(*beside(plant, 0.004, 0.0, top=0.0)):
        assert g.point[2] > 0
        assert g.clearance >= SUPPORT_CLEARANCE


def test_a_pole_behind_the_stem_stays_outside_the_pads():
    for g in plan_grasps(*beside(make_plant(branches=()), 0.004, 0.0, gap=0.012)):
        assert g.approach[0] > 0.5, "towards the pole, which is beyond the tips"


def test_gripper_strikes_no_neighbours_stem():
    """Stems of other plants 40 mm to either side: there the fingers are when the pads close along that side."""
    stem, skeleton, cloud = make_plant(branches=())
    z = np.arange(-0.3, 0.4, 0.005)
    ways = [np.column_stack([np.full(len(z), 0.72), np.full(len(z), side), z]) for side in (-0.04, 0.04)]
    among = replace(skeleton, neighbours=np.concatenate(ways))
    assert max(abs(g.approach[0]) for g in plan_grasps(stem, skeleton, cloud)) > 0.9
    for g in plan_grasps(stem, among, cloud):
        assert g.clearance >= SUPPORT_CLEARANCE
        assert abs(g.approach[1]) < 0.9, "through a neighbour's stem"


def test_where_a_pole_touches_all_along_no_grasp_is_free():
    with pytest.raises(StageFailure, match="a support or another stem between the fingers") as failure:
        plan_grasps(*beside(make_plant(branches=()), 0.004, 0.0))
    assert failure.value.kind == "no_grasp_found"


def test_gripper_strikes_no_string():
    """Strings 27 mm to either side along y: there the fingers are when the pads close along y."""
    for g in plan_grasps(*beside(make_plant(branches=()), 0.0015, np.pi / 2, -np.pi / 2, gap=0.02)):
        assert g.clearance >= SUPPORT_CLEARANCE


def test_a_string_is_held_with_the_stem_only_if_no_place_is_bare_and_both_thicknesses_are_told():
    plant = make_plant(branches=())
    held = plan_grasps(*beside(plant, 0.0015, 0.0))[0]
    assert "stem 8.0 mm thick" in held.reason
    assert "held together with a string 3.0 mm thick" in held.reason
    bare = plan_grasps(*beside(plant, 0.0015, 0.0, top=0.0))[0]
    assert "string" not in bare.reason
    assert bare.point[2] > 0


def test_stem_and_string_together_must_fit_between_the_pads():
    thick = make_plant(branches=(), radius=0.0165)  # alone 1 mm thinner than the stroke allows
    around = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    plan_grasps(*thick)
    with pytest.raises(StageFailure, match="thicker than the stroke"):
        plan_grasps(*beside(thick, 0.0015, *around))


def test_keeps_away_from_flowers():
    stem, skeleton, cloud = make_plant(branches=())
    near = plan_grasps(stem, skeleton, cloud)[0].point
    flower = near + np.random.default_rng(2).normal(0, 0.004, (200, 3)) + [0, 0.03, 0]
    moved = plan_grasps(stem, skeleton, add_points(cloud, flower, label=FLOWER))[0].point
    assert np.linalg.norm(moved - flower.mean(axis=0)) > np.linalg.norm(near - flower.mean(axis=0))


def test_too_thick_a_stem_fails_with_counts_unless_the_gripper_may_grow():
    plant = make_plant(radius=0.03)
    with pytest.raises(StageFailure, match="thicker than the stroke") as failure:
        plan_grasps(*plant)
    assert failure.value.kind == "no_grasp_found"
    best = plan_grasps(*plant, Params(fit_gripper=False))[0]
    assert best.stem_diameter == pytest.approx(0.06)
    assert "times as large" in best.reason
    np.testing.assert_allclose(best.point[:2], [0.72, 0], atol=1e-9)


def test_of_a_plant_twice_as_large_for_any_gripper_the_grasp_is_twice_as_large():
    small, large = (
        plan_grasps(
            *make_plant(
                height=0.5 * k, radius=0.02 * k, branches=((0.1 * k, 0.0), (0.4 * k, 2.0)), base=(0.72 * k, 0, -0.3 * k)
            ),
            Params(fit_gripper=False),
        )[0]
        for k in (1, 2)
    )
    for name in ("point", "arc_length", "stem_diameter", "clearance", "opening", "squeezed"):
        np.testing.assert_allclose(getattr(large, name), 2 * np.array(getattr(small, name)), rtol=1e-6, err_msg=name)
    np.testing.assert_allclose(large.T_world_flange[:3, 3], 2 * small.T_world_flange[:3, 3])
    assert 0 < small.clearance < np.inf


@pytest.mark.parametrize("height", [0.08, 3.0])
def test_any_size_of_plant_gets_a_grasp(height):
    plant = make_plant(height=height, radius=0.01 * height, branches=((height / 2, 0.0),))
    best = plan_grasps(*plant, Params(fit_gripper=False))[0]
    assert 0.2 * height < best.arc_length < 0.8 * height


def test_asks_the_arm_lazily_and_keeps_its_joints():
    asked = []

    def reach(pregrasp, grasp):
        asked.append(grasp)
        np.testing.assert_allclose(np.linalg.norm(pregrasp[:3, 3] - grasp[:3, 3]), STAND_OFF)
        return np.arange(7.0) if grasp[2, 3] > -0.1 else None

    grasps = plan_grasps(*make_plant(), reach=reach)
    assert len(grasps) == 3 <= len(asked)
    assert all(g.T_world_flange[2, 3] > -0.1 and np.array_equal(g.joints, np.arange(7)) for g in grasps)
    assert len(np.unique(asked, axis=0)) == len(asked), "what is out of reach wide open is so half open"


def test_out_of_reach_says_so(monkeypatch):
    monkeypatch.setattr(grasp, "ASKED", 7)
    with pytest.raises(StageFailure, match="reaches none of the 28 best") as failure:
        plan_grasps(*make_plant(), reach=lambda *_: None)
    assert failure.value.kind == "unreachable"


def test_a_place_that_is_probably_not_the_main_stem_is_never_taken():
    """Bare above its fork and crowded below: the bare place is the better hold, but of a branch."""
    stem, skeleton, cloud = make_plant(branches=tuple((h, 2.4 * k) for k, h in enumerate(np.arange(0.05, 0.25, 0.01))))
    forked = replace(stem, fork=int(np.argmin(np.abs(stem.arc_length - 0.25))))
    sure = replace(skeleton, confidence=np.full(len(skeleton.nodes), 0.8))
    grasps = plan_grasps(forked, sure, cloud)
    assert all(g.arc_length <= 0.25 and g.confidence >= 0.5 for g in grasps)
    above = lambda _, grasp: np.ones(7) if grasp[2, 3] > -0.04 else None  # noqa: E731
    with pytest.raises(StageFailure, match="probably not the main stem"):
        plan_grasps(forked, sure, cloud, reach=above)
    assert plan_grasps(forked, skeleton, cloud, reach=above), "where no confidence is known nothing is refused"


def test_asks_on_while_it_has_nothing_and_then_is_content(monkeypatch):
    monkeypatch.setattr(grasp, "ASKED", 7)
    asked = []

    def reach(_, grasp):
        asked.append(grasp)
        return np.ones(7) if len(asked) == 20 else None

    assert len(plan_grasps(*make_plant(), reach=reach)) == 1
    assert len(asked) == 20


def test_paper_grasp_holds_the_middle_of_that_internode_across_the_nearest_branches():
    stem, skeleton, _ = make_plant(height=0.5, branches=((0.1, 0.0), (0.35, 0.0)))
    grasp = paper_grasp(stem, skeleton)
    held = grasp.T_world_flange @ [0, 0, Params().gripper.depth, 1]
    np.testing.assert_allclose(held[:3], [0.72, 0, -0.3 + 0.225], atol=1e-9)
    np.testing.assert_allclose(grasp.T_world_flange[:3, 2], grasp.approach)
    assert abs(grasp.approach @ [1, 0, 0]) < 1e-9, "both branches point along x"
    assert grasp.stem_diameter == pytest.approx(0.008)


def test_paper_grasp_comes_from_either_side_or_says_that_neither_is_reached():
    stem, skeleton, _ = make_plant(branches=((0.1, 0.0), (0.35, 0.0)))
    first = paper_grasp(stem, skeleton)
    other = paper_grasp(stem, skeleton, reach=lambda _, T: np.ones(7) if T[:3, 2] @ first.approach < 0 else None)
    np.testing.assert_allclose(other.approach, -first.approach)
    with pytest.raises(StageFailure, match="n\\* =") as failure:
        paper_grasp(stem, skeleton, reach=lambda *_: None)
    assert failure.value.kind == "unreachable"


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.integers(1, 6))
def test_paper_approach_equals_brute_force(seed, count):
    rng = np.random.default_rng(seed)
    tangent, *branches = (v / np.linalg.norm(v) for v in rng.normal(size=(count + 1, 3)))
    n = paper_approach(tangent, np.array(branches))
    assert abs(n @ tangent) < 1e-9
    assert np.linalg.norm(n) == pytest.approx(1)
    around = directions_across(tangent, 20_000)
    brute = np.abs(around @ np.array(branches).T).max(axis=1).min()
    assert np.abs(np.array(branches) @ n).max() == pytest.approx(brute, abs=4e-4)


def test_branch_directions_point_outward():
    stem, skeleton, _ = make_plant(branches=((0.2, 0.5),))
    arcs, rays = branch_directions(stem, skeleton, 0.03)
    np.testing.assert_allclose(arcs, [0.2])
    np.testing.assert_allclose(rays, [np.array([np.cos(0.5), np.sin(0.5), 0.3]) / np.sqrt(1.09)], atol=1e-9)


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((0, 0.0408333, 0.1), 0.005),
        ((0, 0.03, 0.1), -0.005833),
        ((0, 0, 0.09), 0.0208335),
        ((0.03, 0.0258, 0.1), 0.022),
    ],
)
def test_clearance_of_one_ball_is_its_distance_from_the_fingers(point, distance):
    gripper = GripperShape(body=())
    ball = Surroundings(np.array([point]), np.zeros(1), np.array([OBSTACLE]), np.zeros(1))
    met = clearance(np.eye(4)[None], ball, gripper.boxes(0.1), gripper.closing())
    assert met.distance.shape == (1, 7)
    assert met.distance[0, OBSTACLE] == pytest.approx(distance, abs=1e-5)
    assert met.touched[0, OBSTACLE] == (distance < 0.002)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25)
def test_clearance_is_that_of_all_balls_and_boxes_one_by_one(seed):
    """Large balls, far balls, several cubes of them, turned grippers."""
    rng, gripper = np.random.default_rng(seed), GripperShape()
    count = int(rng.integers(1, 40))
    centers, radius = rng.uniform(-0.3, 0.3, (count, 3)), rng.choice([0.0, 0.005, 0.06], count)
    balls = Surroundings(centers, radius, np.full(count, OBSTACLE), np.zeros(count))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.1, 0.1, 3)
    boxes = gripper.boxes(0.1)
    local = (centers - pose[:3, 3]) @ pose[:3, :3]
    d = np.maximum(boxes[:, None, :3] - local, local - boxes[:, None, 3:])
    gap = np.where((d > 0).any(axis=2), np.linalg.norm(np.maximum(d, 0), axis=2), d.max(axis=2)) - radius
    met = clearance(pose[None], balls, boxes, gripper.closing())
    assert met.distance[0, OBSTACLE] == pytest.approx(min(gap.min(), FAR), abs=1e-9)
    assert met.touched[0, OBSTACLE] == (gap.min(axis=0) < 0.002).sum()


def test_the_whole_way_in_counts():
    """A ball that the gripper's body passes on the way is met although the gripper at the grasp is clear of it."""
    gripper, pose = GripperShape(), np.eye(4)[None]
    ball = Surroundings(np.array([[0.0, 0.05, -0.09]]), np.zeros(1), np.array([OBSTACLE]), np.zeros(1))
    at_end = clearance(pose, ball, gripper.boxes(0.0), gripper.closing())
    on_way = clearance(pose, ball, gripper.boxes(0.1), gripper.closing())
    assert at_end.distance[0, OBSTACLE] > 0.02
    assert on_way.distance[0, OBSTACLE] < 0


@given(depth=st.floats(-0.01, 0.007), stiffness=st.floats(0, 1e-6))
def test_what_is_pushed_aside_pushes_back(depth, stiffness):
    """A petiole's ball `depth` inside a finger, which is 15 mm thick, moves by that and the margin."""
    gripper = GripperShape(body=())
    ball = Surroundings(
        np.array([[0, gripper.stroke / 2 + depth, 0.1]]), np.zeros(1), np.array([PETIOLE]), np.array([stiffness])
    )
    met = clearance(np.eye(4)[None], ball, gripper.boxes(0.1), gripper.closing())
    assert met.push[0] == pytest.approx(max(0.002 + depth, 0) * stiffness)


@given(aside=st.floats(-0.01, 0.01), thick=st.floats(0.001, 0.01))
def test_what_is_between_the_pads_spreads_as_far_as_its_farther_side(aside, thick):
    gripper = GripperShape()
    balls = Surroundings(np.array([[0, aside, 0.1]]), np.array([thick]), np.array([PETIOLE]), np.zeros(1))
    met = clearance(np.eye(4)[None], balls, gripper.boxes(0.1), gripper.closing())
    assert met.enclosed[0, PETIOLE] == 1
    assert met.spread[0, PETIOLE] == pytest.approx(abs(aside) + thick)


@given(seed=st.integers(0, 10_000))
def test_thinned_points_are_the_means_of_cubes_each_of_which_has_one(seed):
    points = np.random.default_rng(seed).uniform(-0.1, 0.1, (60, 3))
    thinned = thin_out(points, 0.03)
    cubes = np.floor((points - points.min(axis=0)) / 0.03)
    means = [points[(cubes == cube).all(axis=1)].mean(axis=0) for cube in np.unique(cubes, axis=0)]
    np.testing.assert_allclose(thinned[np.lexsort(thinned.T)], np.array(means)[np.lexsort(np.array(means).T)])


@pytest.mark.parametrize(
    ("name", "met", "kind", "worse"),
    [
        ("leaves between the fingers", "enclosed", LEAF, (0, 2, 5)),
        ("crowded with petioles", "enclosed", PETIOLE, (0, 2, 5)),
        ("a branch between the fingers", "spread", PETIOLE, (0.004, 0.0045, 0.0055)),
        ("near a petiole", "distance", PETIOLE, (DOUBT, 0.5 * DOUBT, 0.1 * DOUBT)),
    ],
)
def test_the_more_is_in_the_way_the_more_it_costs(name, met, kind, worse):
    stem, skeleton, cloud = make_plant(branches=())
    ranking = _rank(stem, skeleton, cloud, Params(), toward_base=False)

    def cost(value):
        changed = getattr(ranking.met, met).copy()
        changed[:, kind] = value
        return _costs(ranking.candidates, replace(ranking.met, **{met: changed}), cloud, Params(), 0.5)[name][0]

    nothing, some, more = (cost(value) for value in worse)
    assert nothing == pytest.approx(0)
    assert nothing < some < more < 1  # which is clearly bad
    assert more > 0.2


def test_the_more_of_the_stem_is_hidden_the_more_a_place_costs_and_another_is_taken():
    stem, skeleton, cloud = make_plant(branches=())
    height = cloud.points[:, 2] + 0.3
    seen = Cloud(cloud.points[np.abs(height - 0.25) > 0.05])  # a leaf was before its middle, where it else is held
    ranking = _rank(stem, skeleton, seen, Params(), toward_base=False)
    cost, arc = ranking.costs["the stem is hidden"], ranking.candidates.arc_length
    assert cost[np.abs(arc - 0.25) < 0.03].min() > 1
    assert cost[np.abs(arc - 0.25) > 0.07].max() == 0
    edge = np.abs(arc - 0.2) < 0.01
    assert 0 < cost[edge].max() < 1.8
    assert abs(plan_grasps(stem, skeleton, cloud)[0].arc_length - 0.25) < 0.05 + 1e-9
    assert abs(plan_grasps(stem, skeleton, seen)[0].arc_length - 0.25) > 0.05


def test_every_edge_has_balls_from_its_start_to_its_end():
    skeleton = Skeleton(np.array([[0, 0, 0], [0, 0, 0.02], [0.011, 0, 0.02]]), np.array([-1, 0, 1]), np.full(3, 0.002))
    balls = _balls_along(skeleton, np.array([1, 2]), 0.003, np.zeros(3))
    up, aside = balls[balls[:, 0] == 0], balls[balls[:, 0] > 0]
    np.testing.assert_allclose(up[:, 2], 0.02 * np.arange(1, 8) / 7)
    np.testing.assert_allclose(aside[:, 0], 0.011 * np.arange(1, 5) / 4)


def test_a_petiole_is_no_thicker_than_its_end_where_it_leaves_the_stem():
    nodes = np.array([[0, 0, 0], [0, 0, 0.02], [0.01, 0, 0.02], [0.02, 0, 0.02]])
    skeleton = Skeleton(nodes, np.array([-1, 0, 1, 2]), np.array([0.008, 0.006, 0.002, 0.001]))
    balls = _balls_along(skeleton, np.array([1, 2, 3]), 0.003, np.array([0, 0, 0.01, 0.02]))
    stem, first, beyond = np.split(balls[:, 3], [7, 11])
    np.testing.assert_allclose(stem, 0.008 - 0.002 * np.arange(1, 8) / 7)
    np.testing.assert_allclose(first, 0.002)
    np.testing.assert_allclose(beyond, 0.002 - 0.001 * np.arange(1, 5) / 4)


def test_every_pose_is_a_rotation_and_each_direction_is_tried_both_ways_up():
    """Of a stem in waves too, whose fitted line is shorter than the stem."""
    stem, skeleton, _ = make_plant(branches=())
    nodes = skeleton.nodes + np.outer(0.004 * np.sin(stem.arc_length / 0.01), [1, 0, 0])
    arc = arc_length(nodes)
    skeleton, stem = replace(skeleton, nodes=nodes), replace(stem, arc_length=arc)
    c = candidates_along(stem, skeleton, directions=8, spacing=0.02, window=0.03, ends=(0.05, 0.05), depth=0.1)
    R = c.T_world_flange[:, :3, :3]
    np.testing.assert_allclose(np.swapaxes(R, 1, 2) @ R, np.broadcast_to(np.eye(3), R.shape), atol=1e-9)
    along = np.einsum("ci,ci->c", R[..., 0], c.tangents)
    for station in np.unique(c.station):
        assert sorted(np.round(along[c.station == station])) == [-1] * 8 + [1] * 8


def test_a_place_that_seems_thin_is_as_thick_as_the_stem_about_it():
    """Half of it was hidden."""
    stem, skeleton, _ = make_plant(branches=())
    hidden = np.abs(stem.arc_length - 0.25) < 0.02
    skeleton = replace(skeleton, radius=np.where(hidden, 0.002, skeleton.radius))
    c = candidates_along(stem, skeleton, directions=1, spacing=0.01, window=0.014, ends=(0.05, 0.05), depth=0.1)
    np.testing.assert_allclose(c.radius, 0.004)


def test_a_stem_that_tapers_is_as_thick_as_it_is_there_and_so_far_from_its_petioles():
    stem, skeleton, _ = make_plant(branches=((0.2, 0.0), (0.35, 2.0)))
    tapered = np.where(stem.organ == STEM, 0.006, 0.001)
    tapered[stem.node_ids] -= 0.008 * stem.arc_length
    c = candidates_along(
        stem, replace(skeleton, radius=tapered), directions=4, spacing=0.01, window=0.014, ends=(0.05, 0.05), depth=0.1
    )
    np.testing.assert_allclose(c.radius, 0.006 - 0.008 * c.arc_length, rtol=0.1)
    attached = stem.arc_length[stem.attachments]
    apart = np.abs(c.arc_length[:, None] - attached).min(axis=1)
    np.testing.assert_allclose(c.attachment_distance, apart)
    np.testing.assert_allclose(c.outward(), c.approach[:, 0], atol=1e-3)  # the arm stands in its direction -x


def test_the_farther_from_behind_the_plant_the_arm_comes_the_more_it_costs():
    ranking = _rank(*make_plant(branches=()), Params(), toward_base=True)
    behind, cost = -ranking.candidates.approach[:, 0], ranking.costs["comes from behind the plant"]
    order = np.argsort(behind)
    assert np.all(np.diff(cost[order]) >= -1e-3)
    assert cost[order[0]] == pytest.approx(0, abs=1e-3)
    assert 0.2 < cost[order[-1]] < 1


def test_a_stem_in_waves_between_the_pads_is_clearly_bad_and_a_straight_one_not():
    stem, skeleton, cloud = make_plant(branches=())
    waves = replace(skeleton, nodes=skeleton.nodes + np.outer(0.005 * np.sin(stem.arc_length / 0.01), [1, 0, 0]))
    straight, bent = (_rank(stem, s, cloud, Params(), toward_base=False).costs["bent stem"] for s in (skeleton, waves))
    assert straight.max() < 1e-6
    assert np.median(bent) > 1


def test_the_nearer_the_root_the_more_it_costs():
    ranking = _rank(*make_plant(branches=()), Params(), toward_base=False)
    order = np.argsort(ranking.candidates.arc_length, kind="stable")
    cost = ranking.costs["near the root"][order]
    assert np.all(np.diff(cost) <= 1e-12)
    assert cost[0] > 10 * cost[-1]


def test_half_of_what_the_pads_fold_pulls_the_stem_aside_and_strains_its_root():
    """A stem pulled aside by d at height L sees 3 r d / L^2 at its root; a quarter of what it bears is clearly bad."""
    stem, skeleton, cloud = make_plant(branches=())
    ranking = _rank(stem, skeleton, cloud, Params(), toward_base=False)
    c, spread = ranking.candidates, ranking.met.spread.copy()
    for folded in (0.0, 0.003):
        spread[:, PETIOLE] = c.radius + folded
        cost = _costs(c, replace(ranking.met, spread=spread), cloud, Params(), 0.5)["near the root"]
        strain = 3 * c.radius * (OFF_BY + folded / 2) / c.arc_length**2
        np.testing.assert_allclose(cost, strain / (0.25 * 0.01))


def test_the_reason_tells_thickness_and_clearance_in_millimetres():
    best = plan_grasps(*make_plant())[0]
    assert f"{1e3 * best.stem_diameter:.1f} mm thick, clearance {1e3 * best.clearance:.0f} mm" in best.reason


LEAVES_COST = ("brushes leaves", "leaves between the fingers")


@pytest.mark.parametrize(
    ("kind", "name", "least"),
    [(OBSTACLE, "would hit pot or bench", 0.015), (STEM_BALL, "would hit the stem", 0.003)],
)
def test_open_fingers_keep_as_far_off_as_docs_grasp_says(kind, name, least):
    stem, skeleton, cloud = make_plant(branches=())
    ranking = _rank(stem, skeleton, cloud, Params(), toward_base=False)
    for distance, refused in ((0.9 * least, True), (1.1 * least, False)):
        near = ranking.met.distance.copy()
        near[:, kind] = distance
        said = _refusals(ranking.candidates, replace(ranking.met, distance=near), None, Params())[name]
        assert np.all(said == refused)


def test_above_a_fork_every_place_costs_more_than_well_below_it():
    stem, skeleton, cloud = make_plant(branches=())
    stem = replace(stem, fork=25)
    fork = stem.arc_length[stem.fork]
    ranking = _rank(stem, skeleton, cloud, Params(), toward_base=False)
    arc, cost = ranking.candidates.arc_length, ranking.costs["near or above a fork"]
    assert cost[arc > fork].min() > cost[arc < fork - 0.05].max()
    assert plan_grasps(stem, skeleton, cloud)[0].arc_length < fork


def test_however_crowded_it_is_below_the_fork_the_main_stem_is_held_there():
    """Leaves all around, which the open fingers brush and the pads close on, up to the fork; well above it none."""
    stem, skeleton, cloud = make_plant(branches=())
    stem = replace(stem, fork=25)
    fork = stem.arc_length[stem.fork]
    around, height = np.random.default_rng(0).uniform([0, 0], [2 * np.pi, fork + 0.02], (20000, 2)).T
    off = np.random.default_rng(1).uniform(0.008, 0.05, len(around))
    leaves = np.stack([0.72 + off * np.cos(around), off * np.sin(around), height - 0.3], axis=1)
    crowded = add_points(cloud, leaves)
    ranking = _rank(stem, skeleton, crowded, Params(), toward_base=False)
    arc, cost = ranking.candidates.arc_length, np.sum([ranking.costs[n] for n in LEAVES_COST], axis=0)
    assert cost[arc <= fork].min() > 2
    assert cost[arc > fork].min() == 0
    assert plan_grasps(stem, skeleton, crowded)[0].arc_length < fork


def test_toward_the_base_every_place_below_the_fork_is_tried_and_few_above_it():
    stem, skeleton, cloud = make_plant()
    stem = replace(stem, fork=25)
    every, few = (_rank(stem, skeleton, cloud, Params(), toward_base=b).candidates for b in (False, True))
    fork = stem.arc_length[stem.fork]
    below = lambda c: {a for a in c.arc_length if a <= fork}  # noqa: E731
    above = lambda c: {a for a in c.arc_length if a > fork}  # noqa: E731
    assert below(few) == below(every)
    assert 0 < len(above(few)) <= len(above(every)) / 4 + 1
    assert few.outward().min() > 0


def test_views_that_see_through_each_other_make_every_place_less_sure():
    stem, skeleton, cloud = make_plant(branches=())
    skeleton = replace(skeleton, confidence=np.full(len(skeleton.nodes), 0.8))
    agree, differ = (
        _rank(stem, skeleton, replace(cloud, seen_through=share), Params(), toward_base=False).confidence
        for share in (0.0, 0.25)
    )
    assert agree.min() > 0.5
    assert differ == pytest.approx(0.75 * agree)


def test_half_open_costs_and_wide_open_does_not():
    ranking = _rank(*make_plant(branches=()), Params(), toward_base=False)
    half = ranking.candidates.opening < GripperShape().stroke
    assert half.any()
    assert not half.all()
    np.testing.assert_array_equal(ranking.costs["half open"] > 0, half)


def test_a_stem_twice_as_thick_is_strained_an_eighth_by_what_is_pushed_aside():
    stem, skeleton, cloud = make_plant(branches=((0.2, 0.0), (0.35, 2.0)))
    thin, thick = (
        _rank(
            stem,
            replace(skeleton, radius=np.where(stem.organ == STEM, radius, 0.001)),
            cloud,
            Params(),
            toward_base=False,
        ).costs["pushes a petiole"]
        for radius in (0.003, 0.006)
    )
    known = (thin > 0) & (thin < 6)  # the cost's most
    assert known.sum() > 10
    assert thick[known] == pytest.approx(thin[known] / 8)


@pytest.mark.parametrize(("less", "refused"), [(0.5, True), (1.5, False)])
def test_a_stem_needs_the_margin_between_the_open_pads(less, refused):
    radius = (GripperShape().stroke - less * 0.008) / 2
    ranking = _rank(*make_plant(branches=(), radius=radius), Params(), toward_base=False)
    assert ranking.fell["thicker than the stroke"] == refused * len(ranking.candidates.station)


def test_the_space_between_the_pads_is_as_large_as_they_are_and_the_margin():
    gripper = GripperShape()
    lower, upper = gripper.closing(0.003)[0].reshape(2, 3)
    np.testing.assert_allclose((lower + upper) / 2, [0, 0, gripper.depth], atol=1e-12)
    np.testing.assert_allclose(upper - lower, [gripper.pad[0] + 0.006, gripper.stroke, gripper.pad[1] + 0.006])


def test_balls_stand_close_however_far_apart_the_nodes_are():
    stem, skeleton, cloud = make_plant(branches=())
    ids = np.arange(0, len(stem.node_ids), 10)
    few = Skeleton(skeleton.nodes[ids], np.arange(-1, len(ids) - 1), skeleton.radius[ids])
    coarse = Stem(np.arange(len(ids)), stem.arc_length[ids], np.zeros(0, dtype=np.int64), stem.organ[ids])
    around = surroundings_of(coarse, few, cloud)
    along = np.sort(around.centers[around.kind == STEM_BALL][:, 2])
    assert np.diff(along).max() <= 0.003 + 1e-9
    assert along[-1] - along[0] > 0.49


def test_a_leaf_that_is_seen_connected_to_no_plant_is_in_the_way_as_much_as_any():
    stem, skeleton, cloud = make_plant(branches=())
    leaf = np.array([0.66, 0.0, -0.1]) + (np.mgrid[0:1, -9:10, -60:61].reshape(3, -1).T * 0.004)
    connected, loose = add_points(cloud, leaf), replace(cloud, loose=leaf)
    of = lambda seen: [(g.score, g.clearance) for g in plan_grasps(stem, skeleton, seen)]  # noqa: E731
    assert of(loose) == of(connected)
    assert len(loose.yielding) == len(connected.yielding)
    assert surroundings_of(stem, skeleton, loose).kind.tolist().count(LEAF) > 100


def test_a_truss_that_hangs_before_the_stem_is_avoided_as_flowers_are():
    """Ten centimetres from the stem no branch is stiff any more, but what hangs on a truss is pressed on the stem."""
    stem, skeleton, cloud = make_plant(branches=())
    way = np.array([[0.0, 0.0, 0.45], [-0.05, 0.022, 0.5], *([-0.05, 0.022, z] for z in np.arange(0.48, 0.1, -0.02))])
    nodes = np.concatenate([skeleton.nodes, way[1:] + skeleton.nodes[0]])
    parent = np.concatenate([skeleton.parent, [45], np.arange(len(skeleton.nodes), len(nodes) - 1)])
    hung = Skeleton(nodes, parent, np.full(len(nodes), 0.004))

    def met(organ: int) -> tuple[int, np.ndarray]:
        kinds = np.append(stem.organ, np.full(len(way) - 1, organ, dtype=np.uint8))
        own = Stem(stem.node_ids, stem.arc_length, np.array([45]), kinds)
        around, best = surroundings_of(own, hung, cloud), plan_grasps(own, hung, cloud)[0]
        assert 0.1 < best.arc_length < 0.4, "beside what hangs there"
        return int(np.sum(around.kind == FLOWER_POINT)), best.approach

    count, straight = met(BRANCH)
    assert count == 0
    np.testing.assert_allclose(straight, [1, 0, 0], atol=1e-6)  # a finger pushes it aside
    count, round_it = met(TRUSS)
    assert count > 30
    assert abs(round_it[1]) > 0.2


def test_a_short_petiole_is_stiffer_than_a_long_one():
    around = surroundings_of(*make_plant())
    from_stem = np.linalg.norm(around.centers[:, :2] - [0.72, 0], axis=1)
    of = lambda low, high: around.stiffness[(around.kind == PETIOLE) & (from_stem > low) & (from_stem < high)]  # noqa: E731
    assert np.all(around.stiffness[around.kind != PETIOLE] == 0)
    assert of(0.02, 0.03).min() > 5 * of(0.05, 0.06).max() > 0


def test_a_petiole_pushes_back_as_a_rod_held_by_the_stem():
    """A force f at s from its root bends a rod by f s^3 / (3 E I), I = pi r^4 / 4; over E, of petioles 4 mm thick."""
    around = surroundings_of(*make_plant(branches=((0.2, 0.0),)))
    petiole = around.kind == PETIOLE
    lever = np.linalg.norm(around.centers[petiole] - [0.72, 0, -0.1], axis=1)
    assert lever.min() < 0.01
    assert lever.max() == pytest.approx(0.08)
    np.testing.assert_allclose(around.stiffness[petiole], 3 * np.pi * 0.002**4 / 4 / np.maximum(lever, 0.015) ** 3)


def test_save_and_load(tmp_path):
    grasps = plan_grasps(*make_plant(), reach=lambda *_: np.ones(7))
    save_grasps(tmp_path / "grasp.json", grasps)
    loaded = load_grasps(tmp_path / "grasp.json")
    assert len(loaded) == 3
    np.testing.assert_allclose(loaded[0].T_world_flange, grasps[0].T_world_flange, atol=1e-12)
    np.testing.assert_allclose(loaded[1].joints, grasps[1].joints)
    assert loaded[1].reason == grasps[1].reason
    assert (loaded[0].opening, loaded[0].squeezed) == (grasps[0].opening, grasps[0].squeezed)


@pytest.mark.parametrize("text", ["{", "[]", '{"kind": "grasps", "schema": 1, "grasps": [{"pose": [0,0,0,0,0,0,1]}]}'])
def test_broken_files_are_refused(tmp_path, text):
    (tmp_path / "grasp.json").write_text(text)
    with pytest.raises(InputError):
        load_grasps(tmp_path / "grasp.json")


def test_a_stem_of_another_skeleton_is_refused():
    stem, _, cloud = make_plant()
    _, other, _ = make_plant(branches=())
    with pytest.raises(InputError, match="of this skeleton"):
        plan_grasps(stem, other, cloud)


def test_grasp_checks_its_numbers():
    pose = flange_pose(np.zeros(3), np.array([0, 0, 1.0]), np.array([1.0, 0, 0]), 0.1)
    with pytest.raises(InputError, match="point"):
        Grasp(pose, np.full(3, np.nan), np.zeros(3), np.zeros(3), 0.1, 0.01, 0, 0, "")
