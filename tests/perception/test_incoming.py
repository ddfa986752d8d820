"""Views that are looked at as they come give what all of them at once give."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from grown_plants import grown

from anther.core.errors import StageFailure
from anther.core.geometry import Box
from anther.core.runs import Run
from anther.perception import cloud, masks
from anther.perception.capture import Capture, Keep
from anther.perception.incoming import FirstLook, IncomingViews
from anther.plant import TOMATO
from anther.pollination import pipeline
from anther.sim.capture import capture_from_poses, orbit_poses
from anther.sim.render import d455

WORKSPACE = Box(np.array([0.32, -0.4, -0.48]), np.array([1.12, 0.4, 0.5]))


def small_capture() -> Capture:
    poses = orbit_poses(6, (0.72, 0, -0.1), distance=0.6)
    return capture_from_poses(grown("pepper", 2), poses, intrinsics=d455(424, 240), rng=np.random.default_rng(2))[0]


def looked(capture: Capture, added: int) -> FirstLook:
    with IncomingViews(WORKSPACE) as incoming:
        for number in range(added):
            incoming.add(capture.view(number % capture.views))
        return incoming.first_look(capture.views)


def test_views_one_by_one_give_the_same_masks_and_cloud() -> None:
    capture = small_capture()
    look = looked(capture, capture.views)
    labels = masks.segment(capture, WORKSPACE)
    alike = masks.segment(capture, WORKSPACE, observations=look.observations)
    np.testing.assert_array_equal(alike.labels, labels.labels)
    whole = cloud.fuse(capture, labels, WORKSPACE)
    again = cloud.fuse(capture, labels, WORKSPACE, surfaces=look.surfaces)
    np.testing.assert_array_equal(again.points, whole.points)
    np.testing.assert_array_equal(again.normals, whole.normals)
    np.testing.assert_array_equal(again.T_world_cam, whole.T_world_cam)


def test_masks_that_networks_find_are_not_looked_for_by_colour() -> None:
    capture = small_capture()
    with IncomingViews(WORKSPACE, by_colour=False) as incoming:
        for number in range(capture.views):
            incoming.add(capture.view(number))
        look = incoming.first_look(capture.views)
    assert (len(look.observations), len(look.surfaces)) == (0, capture.views)


@pytest.mark.parametrize("added", [0, 5, 7])
def test_nothing_is_known_beforehand_of_other_views_than_were_added(added: int) -> None:
    """What takes views may leave one out afterwards."""
    look = looked(small_capture(), added)
    assert (len(look.observations), len(look.surfaces)) == (0, 0)


@pytest.mark.parametrize("odometry", [0.0, 0.01])
def test_a_trial_writes_and_looks_at_each_view_as_it_comes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, odometry: float
) -> None:
    capture, given = small_capture(), list[Any]()

    def take_views(advance: Any, keep: Keep) -> Capture:
        for number in range(capture.views):
            keep(capture.view(number))
        return capture

    def perceive(*arguments: Any) -> None:
        given.extend(arguments)
        raise StageFailure("no_plant_found", "seen enough")

    monkeypatch.setattr(pipeline, "perceive", perceive)
    cell: Any = SimpleNamespace(take_views=take_views, workspace=WORKSPACE, odometry=odometry)
    with Run(tmp_path, quiet=True) as run, pytest.raises(StageFailure, match="seen enough"):
        pipeline.pollinate(cell, TOMATO, run, pipeline.Params())
    params, look = given[3], given[-1]
    assert params.cloud.registration.walk == odometry, "of the cart that carried the camera"
    assert len(look.observations) == len(look.surfaces) == capture.views
    assert Capture.load(run.path("capture")).views == capture.views
