"""Reaching, moving and shaking: every promise of the planner is checked by forward kinematics and the limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from anther.core.errors import InputError, StageFailure
from anther.core.geometry import Box, transform, transform_points
from anther.robot.arm import _kinematics, motions, shaking
from anther.robot.arm._collision import CollisionWorld
from anther.robot.arm._kinematics import newton_step
from anther.robot.arm.planner import Params, Planner
from anther.robot.arm.sawyer import SAWYER
from anther.robot.devices import JointTrajectory
from anther.robot.swing import whole_shake

NOTHING = np.zeros((0, 3))
BENCH = Box(np.array([0.4, -0.5, -0.6]), np.array([1.1, 0.5, -0.47]))


def flange_pose(point, approach, up=(0, 0, 1)):
    approach, up = np.asarray(approach, float), np.asarray(up, float)
    rotation = np.stack([up, np.cross(approach, up), approach], axis=1)
    return transform(rotation, np.asarray(point) - 0.11712 * approach)


GRASP = flange_pose([0.72, 0, -0.1], [1, 0, 0])
PREGRASP = flange_pose([0.62, 0, -0.1], [1, 0, 0])


@pytest.fixture(scope="module")
def planner():
    """A stem with a small crown of leaves in a pot on a bench."""
    rng = np.random.default_rng(0)
    z = np.linspace(-0.3, 0.3, 200)
    stem = np.stack([0.72 + 0 * z, 0 * z, z], axis=1)
    leaves = rng.normal([0.72, 0, 0.2], [0.05, 0.05, 0.05], (1500, 3))
    angle = rng.uniform(0, 2 * np.pi, 1500)
    pot = np.stack([0.72 + 0.1 * np.cos(angle), 0.1 * np.sin(angle), rng.uniform(-0.45, -0.3, 1500)], axis=1)
    return Planner(np.concatenate([stem, leaves]), pot, [BENCH])


def assert_within_limits(motion, share=1.0):
    """At 1 kHz, between the samples too."""
    spline = CubicHermiteSpline(motion.times, motion.positions, motion.velocities)
    t = np.arange(0, motion.duration, 1e-3)
    assert np.all(spline(t) >= SAWYER.lower)
    assert np.all(spline(t) <= SAWYER.upper)
    assert np.abs(spline(t, 1) / SAWYER.velocity).max() <= share
    assert np.abs(np.diff(spline(t, 1), axis=0) * 1e3 / SAWYER.acceleration).max() <= share
    np.testing.assert_allclose(motion.velocities[[0, -1]], 0, atol=1e-6)


def test_inverse_undoes_forward():
    rng = np.random.default_rng(0)
    margin = 0.05 + 0.05  # the first is never given: it is kept free at both ends
    for q in rng.uniform(SAWYER.lower + margin, SAWYER.upper - margin, (30, 7)):
        pose = SAWYER.forward(q)
        branches = _kinematics.inverse(SAWYER, pose)
        assert len(branches) > 0
        np.testing.assert_allclose(SAWYER.forward(branches), np.broadcast_to(pose, (len(branches), 4, 4)), atol=1e-6)
        assert np.all((branches > SAWYER.lower) & (branches < SAWYER.upper))


def test_inverse_branches_differ_and_near_comes_first():
    near = _kinematics.inverse(SAWYER, GRASP)[3]
    branches = _kinematics.inverse(SAWYER, GRASP, near=near)
    np.testing.assert_allclose(branches[0], near, atol=1e-5)
    gaps = np.abs(branches[:, None] - branches[None]).max(axis=2) + np.eye(len(branches))
    assert gaps.min() > 0.25
    assert len(branches) > 10


def test_free_motion_stays_within_its_space(monkeypatch):
    around = np.eye(7)[0]
    here, there = SAWYER.neutral + 0.6 * around, SAWYER.neutral - 1.3 * around
    straight = Planner(NOTHING, NOTHING).move(here, there)
    farthest = SAWYER.forward(straight.positions)[:, 0, 3].max()
    wide, narrow = (Box(np.full(3, -2.0), np.array([x, 2.0, 2.0])) for x in (farthest + 0.01, farthest - 0.02))
    assert Planner(NOTHING, NOTHING, space=wide).move(here, there).duration == pytest.approx(straight.duration)
    monkeypatch.setattr(Planner, "_search_time", 0.1)
    with pytest.raises(StageFailure, match="no free path"):  # the search finds the straight line again
        Planner(NOTHING, NOTHING, space=narrow).move(here, there)


def test_a_motion_too_fast_for_flange_or_joints_is_slowed_evenly_and_no_other():
    t = np.linspace(0, 1, 200)
    share = 10 * t**3 - 15 * t**4 + 6 * t**5
    way = np.array([0.8, 0, 0, 0, 0, 0, 0])
    rate = 30 * t**2 - 60 * t**3 + 30 * t**4
    motion = JointTrajectory(t, SAWYER.neutral + share[:, None] * way, rate[:, None] * way)
    speed = motions.flange_speed(SAWYER, motion)
    calm = motions.slow_down(SAWYER, motion, 0.5 * speed)
    assert motions.flange_speed(SAWYER, calm) == pytest.approx(0.5 * speed, rel=1e-6)
    assert calm.duration == pytest.approx(2 * motion.duration)
    np.testing.assert_array_equal(calm.positions, motion.positions)
    assert motions.slow_down(SAWYER, motion, 2 * speed).duration == pytest.approx(motion.duration)
    hasty = JointTrajectory(t / 4, motion.positions, 4 * motion.velocities)
    slow = motions.slow_down(SAWYER, hasty, 100.0)
    acceleration = CubicHermiteSpline(slow.times, slow.positions, slow.velocities)(slow.times, 2)
    assert 0.9 < np.abs(acceleration / SAWYER.acceleration).max() <= 1


def test_compiled_newton_step_is_the_damped_least_squares_step():
    rng = np.random.default_rng(3)
    q, goal = rng.uniform(SAWYER.lower, SAWYER.upper, (2, 40, 7))
    target = SAWYER.forward(goal)
    at = SAWYER.forward(q)
    turn = Rotation.from_matrix(target[:, :3, :3] @ np.swapaxes(at[:, :3, :3], 1, 2)).as_rotvec()
    error = np.concatenate([target[:, :3, 3] - at[:, :3, 3], turn], axis=1)
    J = SAWYER.jacobian(q)
    step = np.swapaxes(J, -1, -2) @ np.linalg.solve(J @ np.swapaxes(J, -1, -2) + 1e-3 * np.eye(6), error[..., None])
    got_step, got_error = newton_step(SAWYER, q, target, damping=1e-3)
    np.testing.assert_allclose(got_error, error, atol=1e-12)
    np.testing.assert_allclose(got_step, step[..., 0], atol=1e-9)
    target.flags.writeable = False
    np.testing.assert_array_equal(newton_step(SAWYER, np.asfortranarray(q), target, damping=1e-3)[0], got_step)
    assert len(_kinematics._steps.signatures) == 1, "each is compiled for itself"


def test_inverse_finds_the_bends_of_elbow_and_wrist_that_thirty_times_the_seeds_find():
    """A branch is one way to bend right_j3 and right_j5; along each, the solutions form curves, which are sampled."""

    def bends(q):
        return set(map(tuple, np.sign(q[:, [3, 5]])))

    rng, found, there = np.random.default_rng(0), 0, 0
    for _ in range(15):
        turn = rng.uniform(-1.3, 1.3)
        point = rng.uniform([0.6, -0.1, -0.2], [0.9, 0.1, 0.3])
        pose = flange_pose(point, [np.cos(turn), np.sin(turn), 0], (0, 0, rng.choice([-1, 1])))
        every = bends(_kinematics.inverse(SAWYER, pose, seeds=1500))
        found, there = found + len(every & bends(_kinematics.inverse(SAWYER, pose))), there + len(every)
    assert there > 30
    assert found >= 0.95 * there


@pytest.mark.parametrize("approach", [(1, 0, 0), (-1, 0, 0)])
@pytest.mark.parametrize("point", [(1.4, 0, 0.3), (5, 5, 5)])
def test_out_of_reach_gives_no_branch(point, approach):
    assert len(_kinematics.inverse(SAWYER, flange_pose(point, approach))) == 0


def test_turned_back_at_the_edge_of_reach_gives_no_branch():
    assert len(_kinematics.inverse(SAWYER, flange_pose([1.1, 0, 0.3], [1, 0, 0]))) > 0
    assert len(_kinematics.inverse(SAWYER, flange_pose([1.1, 0, 0.3], [-1, 0, 0]))) == 0


def test_inverse_refuses_a_matrix_that_is_no_pose():
    with pytest.raises(InputError, match="rigid"):
        _kinematics.inverse(SAWYER, np.diag([2.0, 1, 1, 1]))


def test_collision_world():
    wall = np.stack(np.meshgrid([0.6], np.arange(-0.4, 0.4, 0.01), np.arange(-0.4, 0.6, 0.01)), axis=-1).reshape(-1, 3)
    assert CollisionWorld(SAWYER, NOTHING, NOTHING).free(SAWYER.neutral)
    assert not CollisionWorld(SAWYER, NOTHING, wall - [0.15, 0, 0]).free(SAWYER.neutral)
    assert not CollisionWorld(SAWYER, NOTHING, NOTHING, [Box(np.array([0.3, 0, 0]), np.array([0.6, 0.3, 0.1]))]).free(
        SAWYER.neutral
    )
    folded = np.array([0, -3.7, 0, 3.0, 0, 0, 0])
    assert not CollisionWorld(SAWYER, NOTHING, NOTHING).free(folded)
    assert not CollisionWorld(SAWYER, NOTHING, NOTHING).free(SAWYER.upper + 0.1)


def test_only_the_gripper_may_touch_the_plant():
    hand = SAWYER.forward(SAWYER.neutral)[:3, 3] + [0, 0, -0.04]
    elbow = SAWYER.link_poses(SAWYER.neutral)[4, :3, 3]
    at_hand, at_elbow = (CollisionWorld(SAWYER, np.tile(p, (5, 1)), NOTHING) for p in (hand, elbow))
    assert not at_hand.free(SAWYER.neutral)
    assert not at_elbow.free(SAWYER.neutral)
    with at_hand.touching_plant(), at_elbow.touching_plant():
        assert at_hand.free(SAWYER.neutral)
        assert not at_elbow.free(SAWYER.neutral)
    assert not at_hand.free(SAWYER.neutral)


def test_reach_gives_joints_at_the_grasp(planner):
    q = planner.reach(PREGRASP, GRASP)
    np.testing.assert_allclose(SAWYER.forward(q), GRASP, atol=1e-6)
    assert planner.reach(flange_pose([0.82, 0, -0.1], [-1, 0, 0]), flange_pose([0.72, 0, -0.1], [-1, 0, 0])) is None
    in_pot = flange_pose([0.72, 0, -0.33], [1, 0, 0])
    assert planner.reach(in_pot @ transform(np.eye(3), [0, 0, -0.1]), in_pot) is None


def test_line_is_straight_and_slow(planner):
    q = planner.reach(PREGRASP, GRASP)
    back = planner.line(q, PREGRASP)
    poses = SAWYER.forward(back.positions)
    along = (poses[:, :3, 3] - GRASP[:3, 3]) @ [-1, 0, 0]
    np.testing.assert_allclose(poses[:, :3, 3], GRASP[:3, 3] - along[:, None] * [1, 0, 0], atol=2e-5)
    np.testing.assert_allclose(poses[:, :3, :3], np.broadcast_to(GRASP[:3, :3], poses[:, :3, :3].shape), atol=2e-4)
    assert along[-1] == pytest.approx(0.1, abs=1e-6)
    assert np.all(np.diff(along) > -1e-9)
    assert np.max(np.diff(along) / np.diff(back.times)) <= 0.0505
    assert_within_limits(back)


@pytest.mark.parametrize("length", [0.0, 1e-6, 1e-4, 1e-3, 0.01])
def test_a_line_however_short_keeps_the_limits(planner, length):
    """An arm that was stopped where it began goes back by such a line, and the guard looks between the samples."""
    q = planner.reach(PREGRASP, GRASP)
    back = planner.line(q, GRASP @ transform(np.eye(3), [0, 0, -length]))
    curve = CubicHermiteSpline(back.times, back.positions, back.velocities)
    ends = [curve(back.times[:-1], 2), curve(np.nextafter(back.times[1:], 0), 2)]
    assert np.abs(ends / SAWYER.acceleration).max() <= 1
    assert_within_limits(back)


def test_line_into_the_bench_is_refused(planner):
    q = planner.reach(PREGRASP, GRASP)
    down = GRASP.copy()
    down[2, 3] -= 0.25
    with pytest.raises(StageFailure) as failure:
        planner.line(q, down)
    assert failure.value.kind in {"collision", "unreachable"}


def test_move_to_the_pregrasp_is_free_and_within_limits(planner):
    q = planner.reach(PREGRASP, GRASP)
    goal = planner.line(q, PREGRASP).positions[-1]
    motion = planner.move(SAWYER.neutral, goal)
    np.testing.assert_allclose(motion.positions[[0, -1]], [SAWYER.neutral, goal], atol=1e-6)
    assert all(planner.world.free(x) for x in motion.positions[::5])
    assert_within_limits(motion, share=0.6)


def test_move_goes_around_what_is_in_the_straight_way():
    a, b = (np.array([turn, -0.6, 0, 1.0, 0, 1.0, 3.0]) for turn in (-0.6, 0.6))
    middle = SAWYER.link_poses((a + b) / 2)[7, :3, 3]
    post = middle + np.stack(np.meshgrid([-0.02, 0, 0.02], [-0.02, 0, 0.02], np.arange(-0.2, 0.1, 0.01)), -1).reshape(
        -1, 3
    )
    planner = Planner(NOTHING, post)
    assert not planner.world.path_free(np.stack([a, b]))
    motion = planner.move(a, b)
    assert all(planner.world.free(x) for x in motion.positions[::5])
    assert_within_limits(motion, share=0.6)


@pytest.mark.parametrize(("share", "below"), [(0.35, 0.107), (0.65, 0.1), (0.7, 0.084)])
def test_move_goes_around_what_only_a_finer_check_finds_in_the_straight_way(share, below):
    a, b = (np.array([turn, -0.6, 0, 1.0, 0, 1.0, 3.0]) for turn in (-0.6, 0.6))
    planner = Planner(NOTHING, [SAWYER.link_poses(a + share * (b - a))[7, :3, 3] - [0, 0, below]])
    assert planner.world.path_free(np.stack([a, b]), planner.search_step)
    assert not planner.world.path_free(np.stack([a, b]))
    assert planner.world.path_free(planner.move(a, b).positions)


def test_an_open_gripper_around_the_stem_touches_nothing(planner):
    assert planner.world.free(planner.reach(PREGRASP, GRASP))


def test_move_draws_back_out_of_leaves():
    leaf = GRASP[:3, 3] + [0.02, 0.05, 0] + np.random.default_rng(0).uniform(-0.02, 0.02, (200, 3))
    planner = Planner(leaf, NOTHING)
    at_grasp = planner.reach(PREGRASP, GRASP)
    assert not planner.world.free(at_grasp)
    motion = planner.move(at_grasp, SAWYER.neutral)
    np.testing.assert_allclose(motion.positions[[0, -1]], [at_grasp, SAWYER.neutral], atol=1e-6)
    assert_within_limits(motion, share=0.6)
    early = SAWYER.forward(motion.positions[motion.times < 0.4])[:, :3, 3] - GRASP[:3, 3]
    np.testing.assert_allclose(early[:, 1:], 0, atol=1e-5)


def test_leaves_around_the_arm_at_home_do_not_hold_it_there_and_all_others_are_kept_clear_of():
    q = np.array(SAWYER.neutral)
    poses, rng = SAWYER.link_poses(q), np.random.default_rng(0)
    around = [T[:3, 3] + rng.uniform(-0.05, 0.05, (100, 3)) for T in poses[3:]]
    ahead = poses[7, :3, 3] + poses[7, :3, 2] * 0.35 + rng.uniform(-0.02, 0.02, (100, 3))
    planner = Planner(np.concatenate([*around, ahead]), NOTHING, params=Params(home=tuple(q)))
    assert planner.world.free(q)
    with pytest.raises(StageFailure, match="not free"):
        planner.line(q, poses[7] @ transform(np.eye(3), [0, 0, 0.3]))
    goal = q + 0.4 * np.eye(7)[0]
    assert np.allclose(planner.move(q, goal).positions[-1], goal)


@pytest.mark.parametrize("pocket", [0.1, 1.0])
def test_move_draws_back_farther_where_the_nearest_free_place_is_shut_in(monkeypatch, pocket):
    leaf = GRASP[:3, 3] + [0.02, 0.05, 0] + np.random.default_rng(0).uniform(-0.02, 0.02, (200, 3))
    planner = Planner(leaf, NOTHING)
    at_grasp, around = planner.reach(PREGRASP, GRASP), planner._free_motion
    near = planner._back_out(at_grasp)[0]

    def shut_in(start, goal):
        if np.linalg.norm(SAWYER.forward(start)[:3, 3] - SAWYER.forward(near)[:3, 3]) < pocket:
            raise StageFailure("unreachable", "shut in")
        return around(start, goal)

    monkeypatch.setattr(planner, "_free_motion", shut_in)
    if pocket > 0.5:
        with pytest.raises(StageFailure, match="shut in"):
            planner.move(at_grasp, SAWYER.neutral)
        return
    motion = planner.move(at_grasp, SAWYER.neutral)
    np.testing.assert_allclose(motion.positions[[0, -1]], [at_grasp, SAWYER.neutral], atol=1e-6)
    assert_within_limits(motion, share=0.6)


def shake(planner, q, direction, amplitude, frequency, duration):
    return planner.swing(q, direction, whole_shake(amplitude, frequency, duration), amplitude)


def test_an_arm_that_rests_at_the_edge_of_its_margin_may_still_shake_a_little():
    leaf = GRASP[:3, 3] + [0.02, 0.05, 0] + np.random.default_rng(0).uniform(-0.02, 0.02, (200, 3))
    planner = Planner(leaf, NOTHING)
    q = planner.reach(PREGRASP, GRASP)
    for direction in np.eye(3):
        amplitude = planner.shake_limit(q, direction, [1.0])[0]
        assert amplitude > 0.001
        assert shake(planner, q, direction, amplitude, 1.0, duration=5.0).duration == pytest.approx(5.0)


def test_where_the_wrist_would_stand_in_the_plant_nothing_is_reached(monkeypatch):
    rng = np.random.default_rng(3)
    leaves = GRASP[:3, 3] + [-0.1, 0, 0] + rng.uniform(-0.15, 0.15, (8, 3))
    planner, refused = Planner(leaves, NOTHING), 0
    for aside in rng.uniform(-0.1, 0.1, (12, 3)):
        poses = PREGRASP.copy(), GRASP.copy()
        for pose in poses:
            pose[:3, 3] += aside
        if planner.reach(*poses) is None:
            refused += 1
            with monkeypatch.context() as patch:
                patch.setattr(planner, "_wrist_in_plant", lambda *_: False)
                assert planner.reach(*poses) is None
    assert 0 < refused < 12


def test_move_from_inside_an_obstacle_fails(planner):
    with pytest.raises(StageFailure) as failure:
        planner.move(np.array([0, 0.6, 0, 0.3, 0, 0.5, 0]), SAWYER.neutral)
    assert failure.value.kind == "collision"


@pytest.mark.parametrize("frequency", [1.0, 10.0, 30.0])
@pytest.mark.parametrize("direction", [(0, 1, 0), (1, 0, 0), (0, 3, 4)])
def test_shake_is_the_sinusoid_asked_for(planner, direction, frequency):
    q = planner.reach(PREGRASP, GRASP)
    amplitude = planner.shake_limit(q, direction, [frequency])[0]
    motion = shake(planner, q, direction, amplitude, frequency, duration=10 / frequency)
    poses = SAWYER.forward(motion.positions)
    offset = poses[:, :3, 3] - GRASP[:3, 3]
    ray = np.array(direction) / np.linalg.norm(direction)
    along = offset @ ray
    np.testing.assert_allclose(offset - along[:, None] * ray, 0, atol=0.002 * amplitude)
    np.testing.assert_allclose(poses[:, :3, :3], np.broadcast_to(GRASP[:3, :3], poses[:, :3, :3].shape), atol=1e-4)
    middle = (motion.times > 3 / frequency) & (motion.times < 7 / frequency)
    pure = amplitude * np.sin(2 * np.pi * frequency * motion.times)
    np.testing.assert_allclose(along[middle], pure[middle], atol=0.002 * amplitude)
    assert np.abs(along).max() <= 1.002 * amplitude
    assert len(motion.times) >= max(20 * 10, 200 * motion.duration)
    assert_within_limits(motion)


def test_shake_limit_matches_the_facts():
    """Medians over IK solutions at the stem pose, within 15 % of facts: sawyer 6 (whose solutions are others)."""
    branches = np.concatenate(
        [_kinematics.inverse(SAWYER, flange_pose([0.72, 0, -0.05], [1, 0, 0], up)) for up in ([0, 0, 1], [0, 0, -1])]
    )
    for direction, medians in (
        ((0, 1, 0), (7.2, 1.8, 0.20)),
        ((1, 0, 0), (4.4, 1.1, 0.12)),
        ((0, 0, 1), (4.9, 1.2, 0.14)),
    ):
        ours = 1e3 * np.median(shaking.amplitude_limit(SAWYER, branches, direction, [5, 10, 30]), axis=0)
        np.testing.assert_allclose(ours, medians, rtol=0.15)


def test_shake_limit_is_the_best_over_elbow_motions():
    """No joint motion along the direction, of many tried, does better."""
    q = _kinematics.inverse(SAWYER, GRASP)[0]
    J = SAWYER.jacobian(q)
    null = np.linalg.svd(J)[2][6]
    rates = np.linalg.pinv(J) @ [0, 1, 0, 0, 0, 0] + np.linspace(-20, 20, 200_001)[:, None] * null
    omega = 2 * np.pi * 10
    brute = (
        1 / np.maximum(omega / SAWYER.velocity, omega**2 / SAWYER.acceleration).__mul__(np.abs(rates)).max(axis=1).min()
    )
    assert shaking.amplitude_limit(SAWYER, q, [0, 1, 0], [10])[0] == pytest.approx(brute, rel=1e-3)


def test_too_strong_a_shake_is_refused(planner):
    q = planner.reach(PREGRASP, GRASP)
    with pytest.raises(StageFailure, match="mm are possible") as failure:
        shake(planner, q, [0, 1, 0], 0.005, 30, 1)
    assert failure.value.kind == "limits_exceeded"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"amplitude": -1e-3}, "amplitude"),
        ({"frequency": 0}, "frequency"),
        ({"frequency": np.nan}, "frequency"),
        ({"duration": 1e4}, "duration"),
        ({"direction": [0, 0, 0]}, "direction"),
        ({"q": [0, 0]}, "joints"),
    ],
)
def test_shake_refuses_bad_input(planner, changes, message):
    good = {"q": SAWYER.neutral, "direction": [0, 1, 0], "amplitude": 1e-3, "frequency": 5, "duration": 2}
    with pytest.raises(InputError, match=message):
        shake(planner, **(good | changes))


def test_planner_refuses_points_that_are_none():
    with pytest.raises(InputError, match="plant points"):
        Planner(np.full((3, 3), np.nan), NOTHING)


def test_joined_motions_follow_each_other():
    path = np.linspace(SAWYER.neutral, SAWYER.neutral + 0.1, 9)
    there = motions.along_line(SAWYER, path, 0.1, 0.05)
    back = motions.along_line(SAWYER, path[::-1], 0.1, 0.05)
    both = motions.join([there, back])
    assert both.duration == pytest.approx(there.duration + back.duration)
    np.testing.assert_allclose(both.positions[[0, -1]], [path[0], path[0]], atol=1e-9)
    assert_within_limits(both)


def test_a_planner_among_what_has_moved_goes_the_ways_that_were_known(planner, monkeypatch):
    """A search takes longer than there is time for: here it finds nothing."""
    known = planner.moved(np.eye(4))
    joints = known.reach(PREGRASP, GRASP)
    by = transform(Rotation.from_rotvec([0, 0, 0.02]).as_matrix(), [0.01, -0.008, 0.004])
    elsewhere = known.moved(by)
    from_moved = KDTree(transform_points(by, known.plant)).query(elsewhere.plant)[0]
    assert from_moved.max() < 0.03, "cubes of a grid"
    monkeypatch.setattr(Planner, "_search", lambda *_: None)
    near = elsewhere.reach(by @ PREGRASP, by @ GRASP)
    assert np.abs(near - joints).max() < 0.1
    np.testing.assert_allclose(SAWYER.forward(near), by @ GRASP, atol=1e-4)
    before = elsewhere.line(near, by @ PREGRASP).positions[-1]
    motion = elsewhere.move(SAWYER.ready, before)
    assert elsewhere.world.path_free(motion.positions)
    np.testing.assert_allclose(motion.positions[-1], before, atol=1e-6)
    blocked = Planner(*elsewhere._around[:2], [Box(np.array([0.3, -0.4, -0.4]), np.array([0.6, 0.4, 0.4]))])
    blocked._known = list(known._known)
    assert blocked.reach(by @ PREGRASP, by @ GRASP) is None, "a known way is gone only where it is free"


def test_a_way_that_was_prepared_is_gone_among_what_has_moved_without_another_search(planner, monkeypatch):
    before = planner.line(planner.reach(PREGRASP, GRASP), PREGRASP).positions[-1]
    halfway = SAWYER.forward((planner.home + before) / 2)[:3, 3]
    first = Planner(*planner._around[:2], [Box(halfway - 0.03, halfway + 0.03)])  # on the straight way
    joints = first.reach(PREGRASP, GRASP)
    first.prepare(joints, PREGRASP)
    prepared = first.move(first.home, first.line(joints, PREGRASP).positions[-1])
    by = transform(np.eye(3), [0.004, -0.006, 0.003])
    elsewhere = first.moved(by)
    near = elsewhere.reach(by @ PREGRASP, by @ GRASP)
    monkeypatch.setattr(Planner, "_ways", lambda *_: pytest.fail("it was found before"))
    before = elsewhere.line(near, by @ PREGRASP).positions[-1]
    motion = elsewhere.move(SAWYER.ready, before)
    assert not elsewhere.world.path_free(np.linspace(SAWYER.ready, before, 100)), "there is no straight way"
    np.testing.assert_allclose(motion.positions[-1], before, atol=1e-6)
    assert elsewhere.world.path_free(motion.positions)
    assert motion.duration < 1.3 * prepared.duration


def test_nothing_is_prepared_for_what_is_out_of_reach(planner):
    first = planner.moved(np.eye(4))
    first._quickest.clear()
    first.prepare(SAWYER.neutral, transform(np.eye(3), [3.0, 0.0, 0.0]))
    assert not first._quickest
