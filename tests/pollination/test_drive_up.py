"""What was seen, planned and judged to be in reach on the way, where the cart then stands."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_robot import horizontal_grasp

from anther.core.errors import InputError
from anther.core.geometry import Array, Intrinsics, small_transform, transform_points
from anther.core.runs import Run
from anther.perception.cloud import Cloud
from anther.perception.flowers import Flowers
from anther.perception.masks import Masks
from anther.perception.skeleton import Skeleton
from anther.perception.stem import Stem
from anther.pollination import pipeline
from anther.pollination.pipeline import Params, Seen
from anther.robot.devices import DeviceError, Frame

BY = small_transform([0.0, 0.0, 0.01], [0.01, -0.03, 0.002])
GRASPS = [horizontal_grasp(np.array([0.72, 0.0, z]), np.zeros(7)) for z in (-0.08, -0.02)]


def seen() -> Seen:
    nodes: Array = np.stack([np.full(5, 0.7), np.zeros(5), 0.1 * np.arange(5.0)], axis=1)
    stem = Stem(np.arange(5), np.linspace(0.0, 0.4, 5), np.zeros(0, int), np.zeros(5, np.uint8))
    flowers = Flowers(nodes[-1:] + np.array([0.02, 0, 0]), np.array([4]))
    labels = Masks(np.ones((1, 4, 4), np.uint8), "colour")
    return Seen(labels, Cloud(nodes), Skeleton(nodes, np.arange(5) - 1, np.full(5, 0.004)), stem, flowers)


class Around:
    """A planner that reaches some of what it is asked."""

    def __init__(self, reached: Array | None, T: Array | None = None) -> None:
        self.reached, self.T, self.asked = reached, T, list[Array]()

    def moved(self, T: Array) -> Around:
        return Around(self.reached, T)

    def reach(self, before: Array, at: Array) -> Array | None:
        self.asked.append(at)
        return self.reached


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A cell whose side camera shows the plant moved by BY, once it has driven up."""
    order = list[str]()

    def read() -> Frame:
        order.append("looked")
        return Frame(0.1 * len(order), np.full((4, 4, 3), len(order), np.uint8), np.ones((4, 4), np.float32))

    monkeypatch.setattr("anther.perception.cloud.moved_since", lambda *_: BY)
    camera = SimpleNamespace(read=read, intrinsics=Intrinsics(4, 4, 4.0, 4.0, 1.5, 1.5))
    robot = SimpleNamespace(side_camera=camera, T_world_side_camera=np.eye(4))
    return SimpleNamespace(robot=robot, workspace=None, order=order, drive_up=lambda: order.append("drove"))


def driven(cell: Any, tmp_path: Any, planner: Any, ahead: Any = None) -> Any:
    with Run(tmp_path, quiet=True) as run:
        found = pipeline._driven_up(cell, cell.drive_up, seen(), planner, GRASPS, ahead, run, Params())
        kept = Skeleton.load(run.path("skeleton")), Cloud.load(run.path("cloud"))
    return *found, *kept


def test_all_that_was_seen_is_moved_to_where_the_side_camera_has_it(cell: Any, tmp_path: Any) -> None:
    joints = np.full(7, 0.1)
    here, around, grasps, _, skeleton, cloud = driven(cell, tmp_path, Around(joints))
    assert cell.order == ["looked", "drove", "looked"]
    before = seen()
    for now, then in (
        (here.skeleton.nodes, before.skeleton.nodes),
        (here.flowers.positions, before.flowers.positions),
        (skeleton.nodes, before.skeleton.nodes),
        (cloud.points, before.cloud.points),
    ):
        np.testing.assert_allclose(now, transform_points(BY, then), atol=1e-6)
    np.testing.assert_allclose(around.T, BY)
    for now, then in zip(grasps, GRASPS, strict=True):
        np.testing.assert_allclose(now.T_world_flange, BY @ then.T_world_flange)
        np.testing.assert_allclose(now.point, transform_points(BY, then.point))
        np.testing.assert_allclose(now.approach, BY[:3, :3] @ then.approach)
        np.testing.assert_allclose(now.joints, joints)


def test_where_none_of_the_grasps_is_reached_any_more_they_are_ranked_anew(
    cell: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = replace(GRASPS[0], joints=np.ones(7))
    monkeypatch.setattr("anther.pollination.grasp.plan_grasps", lambda *_, **__: [other])
    assert driven(cell, tmp_path, Around(None))[2] == [other]


@pytest.mark.parametrize("reached", [np.full(7, 0.1), None])
def test_the_plan_is_moved_to_the_grasps_that_are_reached_and_left_without_them(
    cell: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch, reached: Array | None
) -> None:
    def moved(plan: Any, T: Array, grasps: list[Any], actuator: Any) -> Any:
        asked.append((plan, T, [one.point.tolist() for one in grasps], actuator.name))
        return "moved" if grasps else None

    asked = list[Any]()
    monkeypatch.setattr("anther.pollination.shake.moved_plan", moved)
    monkeypatch.setattr("anther.pollination.grasp.plan_grasps", lambda *_, **__: GRASPS)
    plan = driven(cell, tmp_path, Around(reached), "made ahead")[3]
    points = [] if reached is None else [transform_points(BY, one.point).tolist() for one in GRASPS]
    assert asked == [("made ahead", BY, points, "arm")]
    assert plan == ("moved" if points else None)


def test_without_a_side_camera_nothing_drives_up(cell: Any, tmp_path: Any) -> None:
    cell.robot.side_camera = None
    with pytest.raises(InputError, match="side camera: got none, in a cell that looks ahead"):
        driven(cell, tmp_path, Around(None))
    assert not cell.order


@pytest.mark.parametrize("frozen", ["time", "picture"])
def test_a_side_camera_that_still_shows_what_was_before_the_drive_is_a_fault(
    cell: Any, tmp_path: Any, frozen: str
) -> None:
    first, live = cell.robot.side_camera.read(), cell.robot.side_camera.read
    stuck = {"time": first.time} if frozen == "time" else {"rgb": first.rgb}
    cell.robot.side_camera.read = lambda: replace(live(), **stuck)
    with pytest.raises(DeviceError, match=r"the picture of 0\.\d0 s again"):
        driven(cell, tmp_path, Around(None))
