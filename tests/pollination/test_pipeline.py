"""The loop at the end of the pipeline: a grasp that fails at the plant is followed by the next best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm, FakeGripper, fake_robot, horizontal_grasp
from made_foresight import made_plan
from small_planner import SmallPlanner, solve

from anther.cli.args.trial import Args
from anther.cli.trial import _params
from anther.core.errors import StageFailure
from anther.core.geometry import Array, Box
from anther.plant.model import TOMATO
from anther.pollination import pipeline
from anther.pollination.grasp import Grasp
from anther.robot.cell import Cell
from anther.robot.devices import GripperState

HEIGHTS = (-0.08, -0.05, -0.02)
GRASPS = [horizontal_grasp(np.array([0.72, 0.0, z]), np.zeros(7)) for z in HEIGHTS]
GRASPS = [replace(grasp, joints=solve(grasp.T_world_flange)) for grasp in GRASPS]


@dataclass(frozen=True)
class Plan:
    grasp: Grasp
    grasp_index: int = 0
    direction: Array = field(default_factory=lambda: np.array([0, 1.0, 0]))
    amplitude: float = 0.002
    frequency: float = 5.0
    duration: float = 0.6
    press: float = 8.0


class NoFiles:
    """A run that keeps nothing."""

    def stage(self, name: str, load: Any, make: Callable[[Any], Any], save: Any = None) -> Any:
        return make(lambda *_: None)

    def timed(self, name: str, make: Callable[[Any], Any]) -> Any:
        return make(lambda *_: None)

    def path(self, stage: str) -> Path:
        return Path(stage)

    def told(self, name: str, value: Any) -> None:
        pass

    note_attempt = print


class Meets(FakeGripper):
    """Meets something else at each attempt: widths in turn [m]. Closing after opening begins a new one."""

    def __init__(self, *widths: float) -> None:
        super().__init__(0.0)
        self.widths = list(widths)

    def move(self, opening: float) -> GripperState:
        wide = GRASPS[0].opening
        if opening < wide and self.commands[-1] == wide:
            self.width = self.widths.pop(0)
        return super().move(opening)


@pytest.mark.parametrize(
    ("widths", "failure", "tried"),
    [
        ([0.008], None, 1),
        ([0.0, 0.008], None, 2),
        ([0.03, 0.0, 0.008], None, 3),
        ([0.0, 0.03, 0.0], "nothing_grasped", 3),
    ],
)
def test_the_next_grasp_is_tried_until_one_holds(
    widths: list[float],
    failure: str | None,
    tried: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plans = list[Plan]()

    def plan_shake(rods: Any, grasps: list[Grasp], *_: Any) -> Plan:
        plans.append(Plan(grasps[0]))
        return plans[-1]

    done, robot = _pollinated(monkeypatch, plan_shake, FakeArm(), Meets(*widths))
    assert done.trial.failure == failure
    assert [plan.grasp.point[2] for plan in plans] == list(HEIGHTS[:tried])
    assert done.trial.phases[-1] == "retreat"
    assert capsys.readouterr().out.count("is left for the next: ") == tried - 1, "each is told with its reason"
    assert robot.gripper.state().opening == GRASPS[0].opening


def test_where_no_shake_is_allowed_the_lesser_grasps_are_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    offered = list[list[float]]()

    def plan_shake(rods: Any, grasps: list[Grasp], *_: Any) -> Plan:
        offered.append([grasp.score for grasp in grasps])
        if grasps[0].score == 0:
            raise StageFailure("limits_exceeded", "no shake is allowed")
        return Plan(grasps[0])

    ranked = [replace(grasp, score=score) for grasp, score in zip(GRASPS, (0.0, -0.1, -5.0), strict=True)]
    done, _ = _pollinated(monkeypatch, plan_shake, FakeArm(), Meets(0.008), ranked)
    assert offered == [[0.0, -0.1], [-5.0]]
    assert done.trial.finished


@pytest.mark.parametrize(("width", "again"), [(0.0, 1), (0.03, 0)])
def test_on_a_cart_a_stem_that_was_missed_is_looked_for_again(
    width: float, again: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It swayed away; what was held by mistake tells nothing of where it is."""
    tried, by = list[float](), 0.01

    def plan_shake(rods: Any, grasps: list[Grasp], *_: Any) -> Plan:
        tried.append(float(grasps[0].point[1]))
        return Plan(grasps[0])

    def seen_again(cell: Cell, before: str, *found: Any) -> Any:
        assert before == "frame"
        seen, planner, grasps, ahead, *_ = found
        return seen, planner, [replace(grasp, point=grasp.point + np.array([0, by, 0])) for grasp in grasps], ahead

    monkeypatch.setattr(pipeline, "_planned_ahead", lambda *_: None)
    monkeypatch.setattr(pipeline, "_driven_up", lambda _cell, _drive, *found: found[:4])
    monkeypatch.setattr(pipeline, "_seen_again", seen_again)
    camera = (SimpleNamespace(read=lambda: "frame"), np.eye(4))
    monkeypatch.setattr(pipeline, "_side_camera", lambda _: camera)
    done, _ = _pollinated(monkeypatch, plan_shake, FakeArm(), Meets(width, 0.008), on_cart=True)
    assert done.trial.failure is None
    assert np.diff(tried) == pytest.approx([again * by])


def _pollinated(
    monkeypatch: pytest.MonkeyPatch,
    plan_shake: Any,
    arm: FakeArm,
    gripper: FakeGripper,
    ranked: Any = GRASPS,
    *,
    on_cart: bool = False,
) -> tuple[pipeline.Done, Any]:
    monkeypatch.setattr(pipeline, "perceive", lambda *_: SimpleNamespace(**dict.fromkeys(_SEEN)))
    monkeypatch.setattr(pipeline, "rank_grasps", lambda *_: list(ranked))
    monkeypatch.setattr(pipeline, "model_plant", lambda *_: SimpleNamespace(material=TOMATO))
    monkeypatch.setattr(pipeline.shake, "plan_shake", plan_shake)
    robot = replace(fake_robot(arm, gripper), side_camera=None)
    planner: Any = SmallPlanner()
    planner.reach = None
    workspace = Box(-np.ones(3), np.ones(3))
    views: Any = SimpleNamespace(views=1)
    cell = Cell(lambda *_: views, lambda _: planner, robot, workspace, LIMITS)  # type: ignore[arg-type,return-value]
    cell = replace(cell, drive_up=(lambda: None) if on_cart else None)
    return pipeline.pollinate(cell, TOMATO, NoFiles(), pipeline.Params()), robot  # type: ignore[arg-type]


_SEEN = ("masks", "cloud", "skeleton", "stem", "flowers")


@pytest.mark.parametrize(("allowed", "lasts"), [(30.0, 20.0), (15.0, 15.0), (9.9, None)])
def test_a_watched_shake_ends_within_what_the_cell_allows(
    monkeypatch: pytest.MonkeyPatch, allowed: float, lasts: float | None
) -> None:
    """Else the guard would end it in the middle; where there is no time to look, the plan alone is done."""
    monkeypatch.setattr(pipeline, "foresee", lambda *_, **__: None)
    monkeypatch.setattr(pipeline, "watch_points", lambda _, **__: [0])
    monkeypatch.setattr(pipeline, "_grip_motion", lambda *_: None)
    monkeypatch.setattr(pipeline, "Escalation", lambda *_, params, **__: params)
    robot = SimpleNamespace(
        side_camera=SimpleNamespace(intrinsics=None), T_world_side_camera=np.eye(4), T_flange_imu=None
    )
    cell: Any = SimpleNamespace(robot=robot, limits=replace(LIMITS, shake_duration=allowed))
    cloud = SimpleNamespace(points=np.zeros((0, 3)))
    seen: Any = SimpleNamespace(flowers=SimpleNamespace(positions=np.zeros((2, 3))), cloud=cloud)
    rods: Any = SimpleNamespace(rods=SimpleNamespace(nodes=np.zeros((1, 3))))
    made: Any = pipeline._watching(cell, cast(Any, None), rods, made_plan(), seen, pipeline.Params())
    assert (None if isinstance(made, str) else made.most_seconds) == lasts
    assert lasts is not None or "shake_duration" in made


def test_a_trial_asks_for_the_stem_that_is_named() -> None:
    asked = _params(Args(stem=1), None).skeleton, _params(Args(root="0.7,0.1,-0.3"), None).skeleton
    assert [(each.plant, each.root) for each in asked] == [(1, None), (None, (0.7, 0.1, -0.3))]


@pytest.mark.parametrize(
    ("params", "camera", "flowers", "why"),
    [
        (_params(Args(shake="paper"), None), "one", 2, "the paper's shake"),
        (_params(Args(watch=False), None), "one", 2, "as asked"),
        (pipeline.Params(escalate=False), "one", 2, "as asked"),
        (pipeline.Params(), None, 2, "no side camera"),
        (pipeline.Params(), "one", 0, "no flower was found"),
    ],
)
def test_the_plan_alone_has_its_reason(params: pipeline.Params, camera: Any, flowers: int, why: str) -> None:
    cell: Any = SimpleNamespace(robot=SimpleNamespace(side_camera=camera, T_world_side_camera=np.eye(4)), limits=LIMITS)
    seen: Any = SimpleNamespace(flowers=SimpleNamespace(positions=np.zeros((flowers, 3))))
    said = pipeline._watching(cell, cast(Any, None), cast(Any, None), made_plan(), seen, params)
    assert isinstance(said, str)
    assert why in said


def test_a_shake_cut_short_before_the_camera_saw_enough_loses_nothing() -> None:
    """What was filmed of it is too little to measure; the trial goes on to its record without a response."""
    robot = SimpleNamespace(side_camera=SimpleNamespace(intrinsics=None), T_world_side_camera=np.eye(4))
    trial = SimpleNamespace(frames=(SimpleNamespace(time=1.0),) * 7, steady=(0.0, 2.0), steps=())
    seen = SimpleNamespace(flowers=SimpleNamespace(positions=np.zeros((2, 3))))
    words: Any = (SimpleNamespace(robot=robot), trial, GRASPS[0], seen, None)
    assert pipeline._watched(*words) is None
