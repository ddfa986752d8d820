"""A gripper whose force is missing, stuck or invented: it is named, and the stem neither crushed nor shaken loose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fake_robot import LIMITS, FakeArm, FakeGripper, fake_robot
from hypothesis import given, settings
from hypothesis import strategies as st
from test_execution import GRASP, PLANNER, Plan

from anther.pollination.execution import execute, lost_grip
from anther.pollination.execution._closing import STEP
from anther.robot.devices import DeviceError, GripperState
from anther.robot.safety import GuardedGripper, check_idle
from anther.robot.safety._grip import IDLE, SOFTEST

OPEN = GripperState(GRASP.opening, 0.0, False)


class ElasticStem(FakeGripper):
    """The pads stand where they are sent, and an elastic stem presses back; what is told of it may be a lie.

    `true` and `most` are the force on the stem and its greatest [N]; `lie` is told the commands so far.
    """

    def __init__(
        self,
        lie: Callable[[int, GripperState], GripperState] = lambda _, state: state,
        *,
        width: float = 0.008,
        stiffness: float = 3e3,
    ) -> None:
        super().__init__(width)
        self.lie, self.stiffness, self.most = lie, stiffness, 0.0

    @property
    def true(self) -> float:
        return self.stiffness * max(self.width - self.opening, 0.0)

    def move(self, opening: float) -> GripperState:
        self.commands.append(opening)
        self.opening = opening
        self.most = max(self.most, self.true)
        return self.state()

    def state(self) -> GripperState:
        return self.lie(len(self.commands), GripperState(self.opening, self.true, self.true > 0))


@settings(max_examples=15)
@given(st.floats(2.5e3, 2e4), st.floats(0.0, STEP))
def test_an_honest_gripper_holds_a_stem_of_any_stiffness_and_presses_it_no_harder_than_a_step_more(
    stiffness: float, wider: float
) -> None:
    gripper = ElasticStem(width=0.008 + wider, stiffness=stiffness)
    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(), gripper), LIMITS)
    assert trial.finished, trial.stop_reason
    assert gripper.most < 8.0 + stiffness * STEP


def stuck(force: float, *, since: int = 0, holds: bool | None = None) -> Callable[[int, GripperState], GripperState]:
    """From the command `since` on this force is told, and, unless None, whether something is held."""

    def lie(commands: int, state: GripperState) -> GripperState:
        held = state.is_gripping if holds is None else holds
        return state if commands <= since else replace(state, force=force, is_gripping=held)

    return lie


LIES = {
    "stuck at 0": (stuck(0.0), "changed by 0.0 N"),
    "stuck at 0, holds nothing": (stuck(0.0, holds=False), "holds nothing: the pads stand 3.5 mm apart"),
    "stuck at 8 N": (stuck(8.0), "got 8.0 N with the pads 41.7 mm open"),
    "stuck at 8 N once it closes": (stuck(8.0, since=1), "yet the gripper says that it holds nothing"),
    "says that it holds, with 8 N, once it closes": (stuck(8.0, since=1, holds=True), "the pads let go"),
    "stuck at 3 N on the way": (stuck(3.0, since=5), "changed by 0.0 N"),
    "pulls": (stuck(-5.0), "got -5.0 N"),
    "pulls once it closes": (stuck(-5.0, since=1), "pads do not pull"),
    "missing": (stuck(np.nan), "A missing signal is not 0"),
    "missing once it closes": (stuck(np.nan, since=1), "A missing signal is not 0"),
    "missing on the way": (stuck(np.nan, since=4), "A missing signal is not 0"),
    "never holds": (lambda _, state: replace(state, is_gripping=False), "says that it holds nothing"),
    "always holds": (lambda _, state: replace(state, is_gripping=True), "something held"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_force_that_does_not_fit_the_way_of_the_pads_is_named_and_the_stem_let_go(lie: str) -> None:
    arm, gripper = FakeArm(), ElasticStem(LIES[lie][0])
    trial = execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS)
    assert LIES[lie][1] in trial.stop_reason
    assert trial.failure == ("nothing_grasped" if lie == "stuck at 0, holds nothing" else "device_fault")
    assert "shake" not in trial.phases
    assert gripper.true == 0
    assert gripper.most < 14.0, "18 N where the pads close until they meet nothing nearer than 2 mm"
    assert trial.phases[-1] == ("open" if arm.done == 0 else "retreat")


def test_what_can_be_noticed_before_the_plant_is_touched_is() -> None:
    for force, holds in ((8.0, False), (0.0, True), (-5.0, False), (np.nan, False)):
        arm, gripper = FakeArm(), ElasticStem(stuck(force, holds=holds))
        execute(PLANNER, Plan(), fake_robot(arm, gripper), LIMITS)
        assert (arm.done, gripper.most) == (0, 0.0)


def test_pads_that_met_hold_nothing() -> None:
    class RunsThrough(FakeGripper):
        """Sent to close, its pads meet, press on each other and say that they hold something."""

        def move(self, opening: float) -> GripperState:
            super().move(opening)
            self.opening = 0.0 if opening < 0.009 else opening
            return self.state()

        def state(self) -> GripperState:
            return GripperState(self.opening, 8.0 if self.opening == 0 else 0.0, self.opening == 0)

    gripper = RunsThrough()
    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(), gripper), LIMITS)
    assert trial.failure == "nothing_grasped"
    assert "the gripper holds nothing: the pads stand 0.0 mm apart with 8.0 N" in trial.stop_reason
    assert gripper.commands[-1] == GRASP.opening


@pytest.mark.parametrize(("measured", "thinnest"), [(0.008, 0.0035), (0.016, 0.008)])
def test_the_pads_come_no_nearer_than_the_thinnest_stem_that_can_be(measured: float, thinnest: float) -> None:
    """Too thick by 4.5 mm, or by half."""
    plan = replace(Plan(), grasp=replace(GRASP, stem_diameter=measured))
    missed, held = ElasticStem(width=thinnest - STEP), ElasticStem(width=thinnest + STEP, stiffness=2e4)
    trial = execute(PLANNER, plan, fake_robot(FakeArm(), missed), LIMITS)
    assert trial.failure == "nothing_grasped"
    assert min(missed.commands) == pytest.approx(thinnest)
    assert execute(PLANNER, plan, fake_robot(FakeArm(), held), LIMITS).failure is None


@given(st.floats(SOFTEST * 1.01, 1e5), st.integers(1, 12))
def test_no_step_of_an_honest_closing_is_doubted(stiffness: float, steps: int) -> None:
    """Up to a grip force of any size, then held off at it."""
    gripper = ElasticStem(width=0.01, stiffness=stiffness)
    guarded = GuardedGripper(gripper, replace(LIMITS, grip_force=100.0))
    guarded.move(0.03)
    for k in range(steps):
        if stiffness * STEP * (k + 1) < 20:
            assert guarded.move(0.01 - k * STEP).force == pytest.approx(stiffness * k * STEP, abs=1e-6)


def test_a_firm_force_that_was_told_before_something_was_held_must_fall_as_the_pads_let_go() -> None:
    """The stem holds the pads off by half of each step; of 8 N that are told 3.75 are true."""

    class Yields(ElasticStem):
        def move(self, opening: float) -> GripperState:
            return super().move(opening + max(0.008 - opening, 0.0) / 2)

        def state(self) -> GripperState:
            firm = self.opening < 0.0078
            return replace(super().state(), is_gripping=firm, force=8.0 if self.opening <= 0.008 else 0.0)

    gripper = Yields(stiffness=15e3)
    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(), gripper), LIMITS)
    assert "the pads let go" in trial.stop_reason
    assert (trial.failure, gripper.most) == ("device_fault", pytest.approx(3.75))


def test_pads_that_something_holds_off_press_on_it() -> None:
    class Deaf(FakeGripper):
        def state(self) -> GripperState:
            return replace(super().state(), force=0.0)

    gripper = Deaf(0.008)
    trial = execute(PLANNER, Plan(), fake_robot(FakeArm(), gripper), LIMITS)
    assert "got 0.0 N" in trial.stop_reason
    assert "held off by something" in trial.stop_reason
    assert (trial.failure, trial.phases[-1]) == ("device_fault", "retreat")
    assert min(gripper.commands) == pytest.approx(0.008 - 1.5e-3)


@given(st.floats(-0.5, 19.0), st.floats(0.0, 0.1))
def test_a_force_that_only_trembles_while_the_pads_close_is_stuck(force: float, tremble: float) -> None:
    rng = np.random.default_rng(1)
    gripper = ElasticStem(lambda _, s: replace(s, force=force + tremble * rng.normal(), is_gripping=True))
    gripper.move(0.03)
    guarded = GuardedGripper(gripper, LIMITS)
    steps = round(1.5e-3 / STEP)
    for k in range(steps):
        guarded.move(0.008 - k * STEP)
    with pytest.raises(DeviceError, match="changed by"):
        guarded.move(0.008 - steps * STEP)
    assert gripper.commands[-1] == pytest.approx(0.008 - 1.5e-3)


def test_a_stem_that_one_pad_bends_away_is_no_stuck_force() -> None:
    def bent(_: int, state: GripperState) -> GripperState:
        way = 0.0157 - state.opening
        return replace(state, force=1.5 + 60 * way if way >= 0 else 0.0, is_gripping=False)

    guarded = GuardedGripper(ElasticStem(bent), LIMITS)
    for opening in (0.03, *(0.0157 - STEP * np.arange(8))):
        state = guarded.move(opening)
    assert (state.opening, state.force) == pytest.approx((0.0122, 1.71))


def test_pads_that_are_opened_open_whatever_the_force_reads() -> None:
    gripper = ElasticStem()
    guarded = GuardedGripper(gripper, LIMITS)
    guarded.move(0.006)
    gripper.lie = stuck(np.nan)
    assert guarded.move(GRASP.opening).opening == gripper.opening == GRASP.opening
    with pytest.raises(DeviceError, match="missing signal"):
        guarded.state()


def test_open_pads_press_with_nothing() -> None:
    check_idle(replace(OPEN, force=0.9 * IDLE))
    for lie in ({"force": 1.1 * IDLE}, {"force": -1.1 * IDLE}, {"force": np.nan}, {"is_gripping": True}):
        with pytest.raises(DeviceError, match=r"allowed: (1 N|numbers)"):
            check_idle(replace(OPEN, **lie))  # type: ignore[arg-type]


def test_a_grip_without_force_is_lost() -> None:
    held = GripperState(0.008, 8.0, True)
    assert not lost_grip(held, replace(held, force=4.0))
    assert lost_grip(held, replace(held, force=0.2))
