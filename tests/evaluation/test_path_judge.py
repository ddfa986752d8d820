"""Planned motions under another engine: MuJoCo's distances, at 1 kHz, and driven by the simulated arm."""

from __future__ import annotations

import numpy as np
import pytest

from anther.core.geometry import Box
from anther.robot.arm._collision import CollisionWorld
from anther.robot.arm.motions import USABLE
from anther.robot.arm.planner import Planner
from anther.robot.arm.sawyer import SAWYER
from anther.robot.arm.views import Params, Views, capture_time, plan_views
from anther.sim.simulated_cell import USUAL_DISTANCE, layout
from evaluation.robustness.path_judge import SELF, SIGHT, Surroundings, judge_path

NOTHING = np.zeros((0, 3))
PLACE = layout(USUAL_DISTANCE)
POT = Box(np.array([0.62, -0.1, -0.48]), np.array([0.82, 0.1, -0.30]))


@pytest.fixture(scope="module")
def views() -> Views:
    return plan_views(PLACE.region, PLACE.solids, Params(count=6, azimuth_step=30, widest=75.0, distances=(0.58,)))


def test_both_engines_agree_on_what_is_free() -> None:
    """What the planner calls free is free in MuJoCo; what MuJoCo finds to overlap by a millimetre, the planner sees."""
    q = np.random.default_rng(0).uniform(SAWYER.lower, SAWYER.upper, (300, 7))
    boxes = {"bench": PLACE.solids[0], "side camera": PLACE.solids[1]}
    world, other = CollisionWorld(SAWYER, NOTHING, NOTHING, boxes.values()), Surroundings(boxes, {})
    nearest = np.array([min(other.clearance(row).values()) for row in q])
    free = np.array([world.free(row) for row in q])
    assert 0.1 < free.mean() < 0.9
    assert nearest[free].min() > -1e-6
    assert not free[nearest < -1e-3].any()
    assert (nearest[~free] < SIGHT).mean() > 0.5  # the rest met the floor, which MuJoCo has not


def test_a_capture_keeps_limits_and_distance_every_millisecond(views: Views) -> None:
    around = Surroundings({"bench": PLACE.solids[0]}, {"pot": POT, "plant": PLACE.region})
    verdict = judge_path(views.motions, around, every=5)
    assert verdict.room > 0
    assert max(verdict.velocity, verdict.acceleration) <= 1
    assert verdict.effort <= USABLE
    assert min(verdict.clearance.values()) > 0
    assert capture_time(views) == pytest.approx(verdict.seconds + views.dwell.sum())


def test_a_motion_through_the_plant_s_place_is_seen() -> None:
    around = Surroundings({}, {"plant": PLACE.region})
    q = np.array([0, 0.2, 0, 0.6, 0, 0.5, 3.3])
    assert around.clearance(q)["plant"] < 0
    assert around.clearance(SAWYER.ready)[SELF] > 0


def test_a_post_no_wider_than_a_cube_is_not_jumped_over() -> None:
    """The planner finds an 8 mm post that a sweep of 1 rad passes, and its way around clears the true post."""
    a, b = (np.array([turn, -0.6, 0, 1.0, 0, 1.0, 3.0]) for turn in (-0.5, 0.5))
    hand = SAWYER.forward((a + b) / 2)[:3, 3]
    post = np.column_stack([np.tile(hand[:2], (60, 1)), np.linspace(hand[2] - 0.2, hand[2] + 0.1, 60)])
    planner = Planner(NOTHING, post)
    assert not planner.world.path_free(np.stack([a, b]))
    assert planner.world.path_free(np.stack([a, a + 0.2 * (b - a)]))
    half = np.array([0.001, 0.001, 0])
    thin = Box(post.min(axis=0) - half, post.max(axis=0) + half)
    verdict = judge_path([planner.move(a, b)], Surroundings({}, {"post": thin}))
    assert verdict.clearance["post"] > 0
